from __future__ import annotations

import math
import re

import numpy as np
import pytest

import cotree
from cotree.errors import ModelError, ParameterError, SingularSystemError, SolveError

pytestmark = pytest.mark.compiler


@pytest.fixture
def slider(model_of):
    return model_of("slider-pendulum")


def _cart(**body):
    scene = cotree.Scene("cart")
    scene.parameter("q", 2.0)
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness=10.0, force="q")
    scene.edge("body", "rigid_body", "ground", "A", **body)
    return scene


def _massless():
    """Two sliders in a row along one line with nothing between them: nothing decides between."""
    scene = cotree.Scene("massless")
    scene.parameter("m", 1.0)
    scene.edge("j1", "prismatic", "ground", "A", axis=[1, 0, 0], force="m")
    scene.edge("j2", "prismatic", "A", "B", axis=[1, 0, 0])
    scene.edge("body", "rigid_body", "ground", "B", mass="m")
    return scene


def test_names(slider):
    assert slider.states == ("j1.s", "h2.theta", "j1.s_dot", "h2.theta_dot")
    assert slider.parameters == ("m1", "m2", "L", "r", "zeta", "k", "s0", "g")
    assert slider.sensitivities == slider.parameters
    assert (slider.inputs, slider.outputs) == ((), ("rod_x",))
    assert slider.default_parameters.tolist() == [1.0, 5.0, 1.0, 0.03, 10.0, 50.0, 0.5, 9.81]
    assert slider.initial_state.tolist() == [0.5, 0.0, 1.0, 0.0]


def test_results_are_fresh_arrays(slider):
    y = slider.initial_state
    first = slider.rhs(0.0, y)
    kept = first.copy()
    slider.rhs(0.0, y + 1.0)
    assert np.array_equal(first, kept)
    assert slider.jacobian(0.0, y) is not slider.jacobian(0.0, y)


def test_arguments_are_not_changed(slider):
    y, s, p = slider.initial_state, np.ones((4, 8)), slider.default_parameters
    slider.sensitivity_rhs(0.0, y, s, p)
    assert y.tolist() == [0.5, 0.0, 1.0, 0.0]
    assert np.array_equal(s, np.ones((4, 8)))
    assert np.array_equal(p, slider.default_parameters)


def test_lists_strides_and_integers_are_accepted(slider):
    y = np.array([0.3, 0.2, -0.4, 1.0])
    expected = slider.rhs(0.0, y)
    assert np.array_equal(slider.rhs(0, y.tolist()), expected)
    assert np.array_equal(slider.rhs(0, np.repeat(y, 2)[::2]), expected)
    s = np.arange(32.0).reshape(4, 8)
    expected = slider.sensitivity_rhs(0.0, y, s)
    assert np.array_equal(slider.sensitivity_rhs(0.0, y, np.asfortranarray(s)), expected)


def test_parameters_take_effect_and_go_again(slider):
    y, p = [0.3, 0.2, -0.4, 1.0], slider.default_parameters
    before = slider.rhs(0.0, y)
    p[2] = 2.0
    assert not np.array_equal(slider.rhs(0.0, y, p), before)
    p[2] = 1.0  # the caller's array is not kept
    assert np.array_equal(slider.rhs(0.0, y, p), before)
    assert np.array_equal(slider.rhs(0.0, y), before)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0],), r"the states must be an array of shape \(4,\), not of shape \(1,\)"),
        ((["a"] * 4,), r"the states must be an array of numbers of shape \(4,\)"),
        (([0.0] * 4, [1.0]), r"the parameters must be an array of shape \(8,\)"),
        (([0.0] * 4, [math.nan] * 8), "parameter 'm1' is not finite"),
        (([0.0] * 4, None, [1.0]), r"inputs must be an array of shape \(0,\)"),
    ],
)
def test_wrong_arrays_are_refused(slider, arguments, message):
    with pytest.raises(ParameterError, match=message):
        slider.rhs(0.0, *arguments)


def test_wrong_sensitivities_are_refused(slider):
    with pytest.raises(ParameterError, match=r"the sensitivities .* shape \(4, 8\)"):
        slider.sensitivity_rhs(0.0, np.zeros(4), np.zeros((8, 4)))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"m1": -1.0}, "mass of edge 'm5' is -1"),
        ({"m2": -5.0}, "'m6'"),
        ({"L": 0.0, "r": 0.0}, "joint 'h2' .* must be positive"),
        ({"m1": math.nan}, "'m1' is nan"),
        ({"m1": math.inf}, "'m1' is inf"),
        ({"m1": "heavy"}, "'m1' is 'heavy'"),
        ({"M1": 1.0}, "no tunable parameter 'M1'; did you mean 'm1'"),
    ],
)
def test_guards_name_the_culprit(slider, values, message):
    with pytest.raises(ParameterError, match=message) as caught:
        slider.simulate((0, 1), parameters=values)
    assert "\n" not in str(caught.value)
    # A refused set of parameters leaves the model as it was.
    assert slider.rhs(0.0, slider.initial_state)[0] == 1.0


def test_a_guard_without_a_value_names_the_culprit_too():
    model = _cart(mass="sqrt(q)").compile()
    with pytest.raises(ParameterError, match="mass of edge 'body' is nan"):
        model.rhs(0.0, [0.0, 0.0], [-1.0])


def test_a_bad_value_in_the_scene_is_found_when_it_is_compiled():
    with pytest.raises(ParameterError, match="mass of edge 'body' is -1"):
        _cart(mass="1 - q").compile()


@pytest.mark.parametrize("compiler", ["", "none"])
def test_a_singular_matrix_is_found_when_the_scene_is_compiled(monkeypatch, compiler):
    # It is found before C is written, so that nobody is told that there is no compiler.
    monkeypatch.setenv("COTREE_COMPILER", compiler)
    with pytest.raises(SingularSystemError, match="the mass matrix is singular"):
        _massless().compile()


def test_without_a_compiler_nothing_is_evaluated(monkeypatch, tmp_path):
    monkeypatch.setenv("COTREE_COMPILER", "none")
    with pytest.warns(RuntimeWarning, match="models cannot be evaluated") as caught:
        model = cotree.load("slider-pendulum").compile(["L"])
    assert len(caught) == 1
    y, s = np.zeros(4), np.zeros((4, 1))
    for call in (
        lambda: model.rhs(0.0, y),
        lambda: model.rhs(0.0, np.zeros((4, 3))),
        lambda: model.jacobian(0.0, y),
        lambda: model.sensitivity_rhs(0.0, y, s),
        lambda: model.output_values(0.0, y),
        model.start,
        model.linearize,
        model.trim,
    ):
        with pytest.raises(SolveError, match="pip install ziglang"):
            call()
    assert "s_ddot" in str(cotree.load("slider-pendulum").equations(["L"]))
    assert model.write(tmp_path / "project").files
    assert model.export_fmu(tmp_path / "x.fmu", platforms=[]).path.exists()


def test_without_a_compiler_nothing_is_simulated(monkeypatch):
    monkeypatch.setenv("COTREE_COMPILER", "none")
    with pytest.warns(RuntimeWarning, match="models cannot be evaluated or simulated"):
        model = cotree.load("bouncing-ball").compile()
    for method in ("auto", "dopri5", "cvode", "DOP853"):
        with pytest.raises(SolveError, match="pip install ziglang"):
            model.simulate((0, 1), method=method)
    with pytest.raises(SolveError, match="pip install ziglang"):
        model.ensemble((0, 1), {model.parameters[0]: [1.0, 2.0]}, t_eval=[1.0])


def test_undefined_numbers_are_nan():
    scene = _cart(mass="q", inertia=1.0)
    scene.edge("push", "force", "ground", "A", force=["sqrt(1 - t)", 0, 0])
    model = scene.compile()
    # The square root has no value after t = 1.
    assert np.isnan(model.rhs(2.0, [0.0, 0.0])[1])
    assert model.rhs(0.0, [0.0, 0.0]).tolist() == [0.0, 1.5]


def test_a_start_without_a_value_is_said_when_the_scene_is_compiled():
    scene = _cart(mass="q")
    scene.edge("push", "force", "ground", "A", force=["sqrt(t - 1)", 0, 0])
    with pytest.raises(ValueError, match=r"'guide\.s_dot' is not finite at the initial state"):
        scene.compile()


def test_inputs_are_read_from_the_call_or_from_the_scene():
    scene = cotree.Scene("pushed")
    scene.parameter("a", 3.0)
    scene.input("F", "a*t", unit="N")
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], force="F")
    scene.edge("body", "rigid_body", "ground", "A", mass=2.0)
    model = scene.compile()
    assert model.inputs == ("F",)
    assert model.rhs(2.0, [0.0, 0.0]).tolist() == [0.0, 3.0]
    assert model.rhs(2.0, [0.0, 0.0], [5.0]).tolist() == [0.0, 5.0]
    assert model.rhs(2.0, [0.0, 0.0], None, [8.0]).tolist() == [0.0, 4.0]
    assert model.kernels.input_values(2.0).tolist() == [6.0]


def test_parameters_that_are_not_tunable_are_numbers_in_the_code():
    scene = cotree.Scene("fixed")
    scene.parameter("m", 4.0, tunable=False)
    scene.parameter("k", 8.0)
    scene.edge("guide", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k")
    scene.edge("body", "rigid_body", "ground", "A", mass="m")
    model = scene.compile(["k"])
    assert model.parameters == ("k",)
    assert model.rhs(0.0, [1.0, 0.0]).tolist() == [0.0, -2.0]
    with pytest.raises(ModelError, match="m"):
        scene.compile(["m"])


def test_source_and_times(slider):
    assert "int slider_pendulum_rhs(" in slider.kernels.source
    assert set(slider.times) == {"formulate", "generate", "compile", "start"}
    assert all(seconds >= 0.0 for seconds in slider.times.values())


def test_two_models_live_side_by_side(model_of):
    one, two = model_of("slider-pendulum", ["L"]), model_of("spring-mass-damper", ["k"])
    before = one.rhs(0.0, one.initial_state)
    two.rhs(0.0, two.initial_state, two.default_parameters * 2.0)
    assert np.array_equal(one.rhs(0.0, one.initial_state), before)


def test_parameters_changed_in_place_are_seen(model_of):
    """Arrays of any kind are copied, never kept."""
    pandas = pytest.importorskip("pandas")
    model = model_of("slider-pendulum")
    y = model.initial_state + 0.3
    series = pandas.Series(model.default_parameters, index=model.parameters)
    before = model.rhs(0.0, y, series)
    series["L"] = 4.0
    fresh = model.rhs(0.0, y, series.to_numpy())
    assert not np.array_equal(before, fresh)
    model.rhs(0.0, y)
    assert np.array_equal(model.rhs(0.0, y, series), fresh)


def test_the_summary_lists_formulations_by_cycles():
    lines = cotree.load("slider-pendulum").compile(["L"]).summary().splitlines()
    at = lines.index("formulations tried, the fewest estimated cycles first")
    assert lines[at + 1].split()[:2] == ["operations", "cycles"]
    found = []
    for line in lines[at + 2 :]:
        row = re.fullmatch(r" +(\d+) +(\d+) +\d+ +\d+  \S.*  \S.*  \S.*", line)
        if row is None:
            break
        found.append(int(row[2]))
    assert len(found) > 1
    assert found == sorted(found)


def test_columns_of_pandas_are_read_by_their_labels():
    pandas = pytest.importorskip("pandas")
    scene = cotree.Scene("driven")
    scene.parameter("m", 2.0)
    scene.parameter("k", 0.0)
    scene.input("F", np.array(1.0))
    scene.translational_mass("M", "ground", "x", mass="m", initial={"v": 1.0})
    scene.force_source("f", "ground", "x", force="F - k*M.v")
    model = scene.compile(optimize="-O0")
    assert model.parameters == ("m", "k")
    values = {"k": 0.0, "m": 4.0}
    for form in (dict, pandas.Series):
        result = model.simulate(
            (0, 1),
            [0, 1],
            parameters=form(values),
            initial=form({"M.v": 3.0}),
            inputs=form({"F": 8.0}),
        )
        # v = v0 + F t / m, which every method takes exactly.
        assert result["M.v"][-1] == pytest.approx(5.0, rel=1e-12)
        assert model.rhs(0.0, [0.0], form(values)) == pytest.approx([0.25])
    many = model.ensemble((0, 1), {"k": [0.0, 0.0]}, parameters=pandas.Series({"m": 4.0}))
    assert many["M.v"].values[:, -1] == pytest.approx([1.25, 1.25], rel=1e-12)
    # Without names, numbers have the order of the parameters.
    assert model.rhs(0.0, [0.0], pandas.Series([4.0, 0.0])) == pytest.approx([0.25])


def test_states_and_inputs_of_pandas_are_read_by_their_labels(model_of):
    pandas = pytest.importorskip("pandas")
    model = model_of("slider-pendulum")
    y = model.initial_state + 0.1 * np.arange(1, 1 + len(model.states))
    series = pandas.Series(y, index=model.states)[::-1]
    many = np.column_stack([y, 2.0 * y])
    table = pandas.DataFrame(many, index=model.states)[::-1]
    for call in (model.rhs, model.jacobian, model.output_values):
        for form in (series, series.to_dict()):
            assert np.array_equal(call(0.0, form), call(0.0, y))
        assert np.array_equal(call(0.0, table), call(0.0, many))
    assert np.array_equal(model.linearize(y=series).A, model.linearize(y=y).A)
    with pytest.raises(cotree.ParameterError, match="the model has no state 'wrong'"):
        model.rhs(0.0, series.rename({model.states[0]: "wrong"}))
    with pytest.raises(cotree.ParameterError, match=f"state '{model.states[0]}' has no value"):
        model.rhs(0.0, series[:-1])

    scene = cotree.Scene("driven")
    scene.input("F", np.array(1.0))
    scene.input("G", np.array(1.0))
    scene.translational_mass("M", "ground", "x", mass=2.0)
    scene.force_source("f", "ground", "x", force="F - 3*G")
    driven = scene.compile(optimize="-O0")
    u = pandas.Series({"G": 1.0, "F": 5.0})
    assert driven.rhs(0.0, [0.0], u=u) == pytest.approx([1.0])
    assert driven.rhs(0.0, [[0.0, 0.0]], u=u) == pytest.approx(np.ones((1, 2)))
    with pytest.raises(cotree.ParameterError, match="the model has no input 'H'"):
        driven.rhs(0.0, [0.0], u={"F": 1.0, "G": 1.0, "H": 1.0})
