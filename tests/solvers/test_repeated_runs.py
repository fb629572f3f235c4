"""Many runs of one model: what is prepared once, and that it changes no bit of any run."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest

from cotree import Experiment, ParameterError, Scene, SolveError, fit, load, optimise, sampled
from cotree.ensemble.batch import run_block
from cotree.ensemble.plan import Plan
from cotree.scene.settings import Settings
from cotree.sharing import RecentCache
from cotree.solvers import select
from cotree.solvers.job import Job
from cotree.solvers.prepare import Preparation, key_of

pytestmark = pytest.mark.compiler

# Scenes with sensitivities, events, algebraic unknowns and constraints, and ends of their runs.
SCENES = [
    ("slider-pendulum", ("L",), 3.0),
    ("bouncing-ball", ("e",), 2.0),
    ("bridge-rectifier", ("Rs",), 0.02),
    ("motor-linkage", (), 0.3),
]


@pytest.fixture(scope="module")
def slider():
    return load("slider-pendulum").compile(["L"])


def bits(result):
    """Everything that a run computed."""
    arrays = (result.t, result.y, result.s, result.output_values, result.output_sensitivities)
    events = [row.t.tobytes() + row.s.tobytes() for row in result.events.values()]
    drift = None if result.drift is None else result.drift.residual.tobytes()
    work = replace(result.statistics, seconds=0.0, compile_seconds=0.0)
    return *(array.tobytes() for array in arrays), *events, drift, result.message, work


def anew(model, *args, **settings):
    """Run with nothing that an earlier run has left."""
    model._kept = RecentCache(8)
    return bits(model.simulate(*args, **settings))


@pytest.mark.parametrize("method", ["dop853", "rodas5", "auto"])
@pytest.mark.parametrize(("name", "sensitivities", "end"), SCENES)
def test_runs_that_others_preceded_have_the_same_bits(name, sensitivities, end, method):
    model = load(name).compile(sensitivities)
    first = model.parameters[0]
    moved = {first: 1.03 * model.default_parameters[0]}
    run = {"t_span": (0.0, end), "t_eval": np.linspace(0.0, end, 21), "method": method}
    alone = anew(model, **run), anew(model, **run, parameters=moved)
    assert alone[0] != alone[1]
    # The jobs of these begin again, with other values each time, and after runs of other lengths.
    model._kept = RecentCache(8)
    for parameters, wanted in ((None, 0), (moved, 1), (None, 0), (None, 0), (moved, 1)):
        assert bits(model.simulate(**run, parameters=parameters)) == alone[wanted]
        model.simulate((0.0, end), method=method)


def test_threads_share_what_was_prepared(slider):
    run = {"t_span": (0.0, 2.0), "t_eval": [1.0, 2.0], "method": "auto"}
    lengths = np.linspace(0.9, 1.1, 12).tolist()
    alone = [anew(slider, **run, parameters={"L": length}) for length in lengths]
    slider._kept = RecentCache(8)
    with ThreadPoolExecutor(4) as threads:
        runs = list(threads.map(lambda L: slider.simulate(**run, parameters={"L": L}), lengths * 4))
    assert [bits(found) for found in runs] == alone * 4


@pytest.fixture
def made(monkeypatch):
    """Count jobs that are made, preparations, and probes of a method."""
    counts = {"jobs": 0, "preparations": 0, "probes": 0}

    def counted(what, function):
        def call(*args, **kwargs):
            counts[what] += 1
            return function(*args, **kwargs)

        return call

    monkeypatch.setattr(Job, "__init__", counted("jobs", Job.__init__))
    monkeypatch.setattr(Preparation, "__init__", counted("preparations", Preparation.__init__))
    monkeypatch.setattr(select.Probe, "rates", counted("probes", select.Probe.rates))
    return counts


def test_nothing_is_made_twice(slider, made):
    slider._kept = RecentCache(8)
    run = {"t_span": (0.0, 2.0), "t_eval": np.linspace(0.0, 2.0, 5)}
    for _ in range(3):
        slider.simulate(**run)
    # The steps by which the method is chosen are those of the run.
    assert made == {"jobs": 1, "preparations": 1, "probes": 1}
    for length in (0.9, 1.1, 0.9):
        slider.simulate(**run, parameters={"L": length}, initial={"h2.theta": 0.1})
    # The choice of a method depends on the values, and is made once for each.
    assert made == {"jobs": 1, "preparations": 1, "probes": 3}
    slider.simulate(**run, rtol=1e-6)
    assert made["preparations"] == 2


def test_a_change_of_the_callers_arrays_is_seen(slider):
    times = np.array([0.5, 1.0])
    assert slider.simulate((0.0, 2.0), times).t.tolist() == [0.5, 1.0]
    times[1] = 2.0
    assert slider.simulate((0.0, 2.0), times).t.tolist() == [0.5, 2.0]


def test_results_belong_to_their_run(slider):
    first = slider.simulate((0.0, 1.0), [0.5, 1.0], "dop853")
    kept = bits(first)
    second = slider.simulate((0.0, 1.0), [0.5, 1.0], "dop853", parameters={"L": 1.2})
    assert bits(first) == kept
    second.y[:] = 0.0
    second.units.clear()
    assert bits(slider.simulate((0.0, 1.0), [0.5, 1.0], "dop853")) == kept
    assert slider.simulate((0.0, 1.0), [0.5, 1.0], "dop853").unit("j1.s") == "m"


def test_what_is_refused_stays_refused(slider):
    slider.simulate((0.0, 1.0), [1.0], rtol=1e-6)
    with pytest.raises(ParameterError, match=r"initial is .*mapping"):
        slider.simulate((0.0, 1.0), [1.0], rtol=1e-6, initial=[1.0])
    with pytest.raises(ParameterError, match="no tunable parameter 'M'"):
        slider.simulate((0.0, 1.0), [1.0], rtol=1e-6, parameters={"M": 1.0})
    with pytest.raises(ParameterError, match="rtol is 'True'"):
        slider.simulate((0.0, 1.0), [1.0], rtol=True)
    with pytest.warns(RuntimeWarning, match="rtol is 0.5"):
        slider.simulate((0.0, 1.0), [1.0], rtol=0.5)
    with pytest.warns(RuntimeWarning, match="rtol is 0.5"):
        slider.simulate((0.0, 1.0), [1.0], rtol=0.5)


def test_functions_of_python_are_asked_at_every_run():
    scene = Scene("forced")
    scene.input("u", 0.0)
    scene.edge("m", "translational_mass", "ground", "a", mass=2.0)
    scene.edge("f", "force_source", "ground", "a", force="u")
    model, forces = scene.compile(), iter([2.0, 4.0])
    for wanted in (1.0, 2.0):
        force = next(forces)
        found = model.simulate((0.0, 1.0), [1.0], inputs={"u": lambda t, force=force: force})
        assert found["m.v"][-1] == pytest.approx(wanted, rel=1e-9)  # v = F t / m, a method's own
    numbers = [model.simulate((0.0, 1.0), [1.0], inputs={"u": u})["m.v"][-1] for u in (2.0, 4.0)]
    assert numbers == pytest.approx([1.0, 2.0], rel=1e-9)


@pytest.mark.parametrize(
    "other",
    [
        {"t_span": (-0.0, 1.0)},
        {"t_eval": [0.5]},
        {"rtol": 1e-9},
        {"max_step": 0.1},
        {"throw": True},
        {"inputs": {"u": 1.0}},
        {"scales": {"L": 2.0}},
    ],
)
def test_settings_that_differ_have_different_keys(other):
    settings = Settings(t_span=(0.0, 1.0), t_eval=[1.0])
    assert key_of(vars(settings)) == key_of(vars(replace(settings)))
    assert key_of(vars(settings)) != key_of(vars(replace(settings, **other)))


@pytest.mark.parametrize("other", [{"t_eval": np.linspace(0.0, 1.0, 20_000)}])
def test_settings_that_cannot_be_compared_have_none(other):
    assert key_of(vars(Settings(t_span=(0.0, 1.0), **other))) is None


def test_settings_of_the_last_calls_are_recognised(slider):
    model, ends = slider, np.array([0.25, 0.5])

    def found(**settings):
        run = model.simulate(**{"t_span": (0.0, 0.5), "t_eval": ends, "rtol": 1e-6} | settings)
        return run.t.tolist(), run.settings.rtol

    for _ in range(3):  # from the third call on, settings are compared with those of the last one
        assert found() == ([0.25, 0.5], 1e-6)
    ends[0] = 0.125  # the same array with another time
    assert found() == ([0.125, 0.5], 1e-6)
    assert found(rtol=1e-7) == ([0.125, 0.5], 1e-7)
    assert found(t_span=[0.0, 0.5]) == ([0.125, 0.5], 1e-6)
    assert found(t_eval=None)[0][0] == 0.0
    with pytest.raises(TypeError, match="rtoll"):
        model.simulate((0.0, 0.5), rtoll=1e-6)


def doubled(t):
    return 2.0 * t


class Doubled:
    def __call__(self, t):
        return 2.0 * t


TABLE = (np.array([0.0, 1.0]), np.array([0.0, 2.0]))


@pytest.mark.parametrize(
    "given", [doubled, Doubled(), TABLE, [[0, 1], [0, 2]], sampled(doubled, 0.1)]
)
def test_functions_and_tables_are_prepared_once(monkeypatch, given):
    model, run = load("cart-pole").compile(), {"t_span": (0.0, 1.0), "t_eval": [1.0]}
    first = bits(model.simulate(**run, inputs={"push": given}))
    other = model.simulate(**run, inputs={"push": lambda t: 3.0 * t})
    assert bits(other)[1] != first[1]
    # Nothing is prepared again.
    monkeypatch.setattr(Preparation, "__init__", None)
    assert bits(model.simulate(**run, inputs={"push": given})) == first


def test_a_change_of_the_callers_table_is_seen():
    model, times, forces = load("cart-pole").compile(), np.array([0.0, 1.0]), np.array([0.0, 2.0])
    run = {"t_span": (0.0, 1.0), "t_eval": [1.0], "inputs": {"push": (times, forces)}}
    first = bits(model.simulate(**run))
    forces[1] = 3.0
    assert bits(model.simulate(**run)) != first


def test_settings_are_refused_at_each_call(slider):
    for _ in range(2):
        with pytest.raises(SolveError, match=r"t_eval holds t = 3"):
            slider.simulate((0.0, 2.0), [3.0])
        with pytest.raises(ParameterError, match="no input 'u'"):
            slider.simulate((0.0, 2.0), inputs={"u": 1.0})
        with pytest.raises(TypeError, match=r"no setting 'rtoll'.*'rtol'"):
            slider.simulate((0.0, 2.0), rtoll=1e-6)
        with pytest.raises(ParameterError, match="no state 'x'"):
            slider.simulate((0.0, 2.0), initial={"x": 1.0})


def driven():
    """A stiff network, driven by a voltage that changes with time."""
    scene = Scene("driven")
    scene.parameter("R", 2.0)
    scene.edge("V1", "voltage_source", "a", "ground", voltage="sin(3 * t)")
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    scene.edge("C1", "capacitor", "b", "ground", capacitance=0.5, initial={"v": 0.0})
    scene.edge("R2", "resistor", "b", "c", resistance=1e-4)
    scene.edge("C2", "capacitor", "c", "ground", capacitance=0.1, initial={"v": 0.0})
    return scene


@pytest.mark.parametrize(
    "method",
    ["dop853", "rodas5", "auto", pytest.param("DOP853", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize("name", ["slider-pendulum", "bouncing-ball", "motor-linkage", "driven"])
def test_runs_of_states_alone(name, method):
    scene = driven() if name == "driven" else load(name)
    if name in ("bouncing-ball", "motor-linkage") and method == "DOP853":
        pytest.skip("SciPy's methods refuse events and constraints")
    plain = scene.compile()
    model = scene.compile([plain.parameters[0]])
    # SciPy's method takes the stiff circuit two seconds for each unit of time.
    t_end = 0.1 if (name, method) == ("driven", "DOP853") else 1.0
    run = {"t_span": (0.0, t_end), "t_eval": np.linspace(0.0, t_end, 11), "method": method}
    found = model.simulate(**run, sensitivities=False)
    assert found.parameters_of_sensitivity == ()
    assert found.s.shape == (len(model.states), 0, 11)
    assert found.output_sensitivities.shape == (len(model.outputs), 0, 11)
    # The same equations without sensitivities. Kernels of one expression round alike.
    assert bits(found) == bits(plain.simulate(**run))
    # Preparing the same kernels through one model is seen by the other.
    first = model.parameters[0]
    moved = {first: 1.02 * model.default_parameters[0]}
    model.simulate(**run, sensitivities=False, parameters=moved)
    assert model.simulate(**run).s.shape == (len(model.states), 1, 11)
    assert bits(model.simulate(**run, sensitivities=False)) == bits(found)


def test_members_without_sensitivities_need_no_room_for_their_time_slopes():
    """Time slopes of a model with sensitivities have these, whether a run has them or not."""
    model, times = driven().compile(["R"]), np.linspace(0.0, 1.0, 5)
    settings = Settings((0.0, 1.0), times, "rodas5", sensitivities=False)
    # Single members and runs have the same bits; lanes differ from them by rounding.
    plan = Plan(model.kernels, settings, ("R",), lanes=1)
    block = run_block(plan, np.array([[2.0]]))
    alone = model.simulate((0.0, 1.0), times, "rodas5", sensitivities=False)
    assert np.array_equal(block.z[0].T, alone.y)


def test_sensitivities_of_a_run_are_wanted_or_not(slider):
    with pytest.raises(ParameterError, match=r"sensitivities is \['L'\]: give True or False"):
        slider.simulate((0.0, 1.0), sensitivities=["L"])


def test_what_is_read_later_is_of_the_run_itself(slider):
    settings = {"t_span": (0.0, 1.0), "t_eval": [0.5, 1.0], "method": "dop853"}
    kept = bits(slider.simulate(**settings))
    result = slider.simulate(**settings)
    result.y[:], result.t[:] = 0.0, 0.0  # nobody has read an output yet
    slider.simulate(**settings, parameters={"L": 1.2})
    names = ("output_values", "output_sensitivities")
    assert tuple(getattr(result, name).tobytes() for name in names) == kept[3:5]
    assert result.parameter_values["L"] == 1.0
    assert result.output_values is result.output_values
    with pytest.raises(AttributeError, match="has no attribute 'output_value'"):
        _ = result.output_value


def test_who_reads_states_by_name_does_not_wait_for_outputs(slider):
    result = slider.simulate((0.0, 1.0), [0.5, 1.0], "dop853")
    assert slider.outputs[0] in result
    result["j1.s"], result.sensitivity("j1.s", "L")
    assert "output_values" not in vars(result)
    assert len(result[slider.outputs[0]]) == 2


def test_copies_and_pickles_have_what_nobody_has_read():
    model = load("bouncing-ball").compile(["e"])
    kept = model.simulate((0.0, 2.0), [1.0, 2.0])
    for other in (pickle.loads(pickle.dumps(kept)), copy.copy(kept), replace(kept, message="")):
        assert replace(other, message=kept.message).message == kept.message
        np.testing.assert_array_equal(other.output_values, kept.output_values)
        assert other.events.keys() == kept.events.keys()
        np.testing.assert_array_equal(other.events["hit"].s, kept.events["hit"].s)
    assert len(kept.events["hit"].t) > 0


def test_functions_of_python_are_asked_before_the_result_is_there():
    calls = []

    def force(t):
        calls.append(t)
        return np.sin(t)

    model = load("cart-pole").compile()
    result = model.simulate((0.0, 1.0), [0.5, 1.0], "dop853", inputs={"push": force})
    n_calls = len(calls)
    np.testing.assert_array_equal(result.input_values[0], np.sin([0.5, 1.0]))
    assert len(calls) == n_calls


#: Settings as NumPy's functions return them: scalars, and arrays without axes.
OF_NUMPY = {
    "method": np.str_("dop853"),
    "rtol": np.float64(1e-7),
    "atol": np.array(1e-9),
    "max_step": np.float64(0.5),
    "max_steps": np.int64(10_000),
    "max_events": np.int32(1_000),
    "time_limit": np.float32(64.0),
    "error_test_sensitivities": np.True_,
    "project": np.array(True),
    "scales": {"L": np.float64(2.0)},
    "initial": {"j1.s": np.float64(0.4)},
    "t_span": np.array([0.0, 1.0]),
    "t_eval": [0.5, 1.0],
}
OF_PYTHON = {
    name: value.tolist() if hasattr(value, "tolist") else value for name, value in OF_NUMPY.items()
} | {"scales": {"L": 2.0}, "initial": {"j1.s": 0.4}}


def test_numbers_of_numpy_are_those_of_python_and_find_the_same_preparation(slider, monkeypatch):
    of_run = {"sensitivities": np.True_, "throw": np.False_}
    slider._kept = RecentCache(8)
    first = bits(slider.simulate(**OF_PYTHON))
    # Nothing is prepared again.
    monkeypatch.setattr(Preparation, "__init__", None)
    assert bits(slider.simulate(**OF_NUMPY, **of_run)) == first


def test_fractions_and_decimals_find_their_preparation_again(slider, monkeypatch):
    slider._kept = RecentCache(8)
    tolerances = {"rtol": Fraction(1, 10**7), "atol": Decimal("1e-9"), "max_step": Fraction(1, 2)}
    first = bits(slider.simulate((0.0, 1.0), [Fraction(1, 2), 1.0], **tolerances))
    monkeypatch.setattr(Preparation, "__init__", None)
    assert bits(slider.simulate((0.0, 1.0), [Fraction(1, 2), 1.0], **tolerances)) == first


@pytest.mark.parametrize("value", ["much", None, 10**400, [1.0, 2.0], 1j])
def test_functions_that_return_no_number_are_refused_by_name(value):
    model = load("cart-pole").compile()
    with pytest.raises(ParameterError, match=r"input 'push' is .* at t = 0: .* return a number"):
        model.simulate((0.0, 1.0), inputs={"push": lambda t: value})


@pytest.mark.parametrize("value", [10**400, 1 + 2j, np.complex128(1 + 2j)])
def test_what_is_no_real_number_is_refused_at_every_place(slider, value):
    for place in ({"parameters": {"L": value}}, {"initial": {"j1.s": value}}, {"rtol": value}):
        with pytest.raises(ParameterError, match="give a number"):
            slider.simulate((0.0, 1.0), **place)
    with pytest.raises(ParameterError, match="give a number"):
        load("cart-pole").compile().simulate((0.0, 1.0), inputs={"push": value})
    with pytest.raises(SolveError, match="t_eval must be a sequence of numbers"):
        slider.simulate((0.0, 1.0), np.array([0.0, value]))
    with pytest.raises(ParameterError, match="the parameters must be an array of numbers"):
        slider.simulate((0.0, 1.0), parameters=np.array([value] * len(slider.parameters)))


def test_every_study_takes_numbers_of_numpy(slider):
    lengths = {"L": np.array([0.9, 1.1])}
    counts = {"lanes": np.int64(1), "threads": np.int64(1), "sensitivities": np.True_}
    one = slider.ensemble(members=lengths, **OF_NUMPY, **counts)
    other = slider.ensemble(members=lengths, **OF_PYTHON, lanes=1, threads=1)
    np.testing.assert_array_equal(one["j1.s"].values, other["j1.s"].values)
    tolerances = {"rtol": np.float64(1e-7), "atol": np.array(1e-9)}
    t = np.array([0.5, 1.0])
    measured = {"t": t, "j1.s": slider.simulate((0.0, 1.0), t)["j1.s"]}
    counts = {"starts": np.int64(1), "seed": np.int64(0), "max_evaluations": np.int64(50)}
    found = fit(
        slider, Experiment(measured), {"L": (0.5, 2.0)}, **tolerances, **counts, progress=False
    )
    assert found.parameters["L"] == pytest.approx(1.0, rel=1e-5)
    limits = {"starts": np.int64(1), "tolerance": np.float64(1e-9), "max_iterations": np.int64(50)}
    over = {"L": (np.float64(0.5), np.float64(2.0))}
    best = optimise(
        slider, "(j1.s - 0.4)**2", over, t_span=np.array([0.0, 1.0]), **tolerances, **limits
    )
    assert 0.5 <= best.parameters["L"] <= 2.0


def test_a_chosen_explicit_method_gives_the_bits_of_its_name(slider):
    run = {"t_span": (0.0, 10.0), "t_eval": np.linspace(0.0, 10.0, 21), "rtol": 1e-10}
    named, chosen = (slider.simulate(**run, method=method) for method in ("dop853", "auto"))
    assert "dop853 was chosen: not stiff, the span is at most" in chosen.message
    assert bits(named)[:5] == bits(chosen)[:5]
    # The steps by which it was chosen are among these, and counted once.
    assert named.statistics.nfev == chosen.statistics.nfev


def test_runs_of_states_alone_are_those_of_a_model_without_sensitivities():
    """Algebraic unknowns are integrated in both, which needs a kernel of its own."""
    scene = load("bridge-rectifier")
    plain = scene.compile().simulate((0.0, 0.02), [0.02], "dop853")
    alone = scene.compile(["Rs"]).simulate((0.0, 0.02), [0.02], "dop853", sensitivities=False)
    assert alone.statistics.n_steps == plain.statistics.n_steps
    # Two texts of the same equations may round differently.
    np.testing.assert_allclose(alone.y, plain.y, rtol=1e-9)


def test_the_oldest_thing_that_nobody_asked_for_makes_room():
    kept, made = RecentCache(3), []

    def ask(key):
        return kept.of(key, lambda: made.append(key) or key)

    for key in "abcadab":
        assert ask(key) == key
    assert "".join(made) == "abcdb"
