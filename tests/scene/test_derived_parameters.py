"""Parameters derived from others: values, sensitivities through them, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from click.testing import CliRunner

import cotree
from cotree import Scene
from cotree.cli.app import app
from cotree.errors import ExpressionError, ParameterError, SceneError
from cotree.scene.toml_file import read_scene
from cotree.scene.toml_text import scene_text

RHO, R, L, STIFFNESS = 7850.0, 0.01, 1.2, 100.0


def rod(mass="m"):
    """A cylinder that swings on a spring; forward references are allowed."""
    scene = Scene("rod")
    if mass == "m":
        scene.parameter("m", "rho*A*L", unit="kg")
        scene.parameter("A", "pi*r**2", unit="m^2")
    for name, value in {"rho": RHO, "r": R, "L": L, "k": STIFFNESS}.items():
        scene.parameter(name, value)
    scene.edge("s", "translational_spring", "ground", "a", stiffness="k")
    scene.edge("b", "translational_mass", "ground", "a", mass=mass, initial={"v": 1.0})
    scene.output("omega", f"sqrt(k/({mass}))")
    return scene


@pytest.fixture(scope="module")
def model():
    return rod().compile(["rho", "r", "L"])


def test_sensitivities_through_derived_parameters_are_exact(model):
    """Closed form: s = sin(w t)/w, w = sqrt(k/m); the chain rule gives dm/dr = 2 m/r, ..."""
    result = model.simulate((0, 3), rtol=1e-11, atol=1e-13)
    m = RHO * math.pi * R**2 * L
    w, t = math.sqrt(STIFFNESS / m), 3.0
    # Errors of the run gather over five oscillations: a hundred times its tolerance.
    assert result["s.s"][-1] == pytest.approx(math.sin(w * t) / w, rel=1e-9)
    by_m = (t * math.cos(w * t) / w - math.sin(w * t) / w**2) * (-w / (2 * m))
    for name, along in {"rho": m / RHO, "r": 2 * m / R, "L": m / L}.items():
        assert result.sensitivity("s.s", name)[-1] == pytest.approx(by_m * along, rel=1e-8)
        # An output that names it: d(omega)/d(m) = -omega/(2 m).
        assert result.sensitivity("omega", name)[-1] == pytest.approx(-w / (2 * m) * along)


def test_it_costs_what_the_expression_in_the_field_costs(model):
    written_out = rod("rho*(pi*r**2)*L").compile(["rho", "r", "L"])
    own, other = (
        {name: row.total for name, row in m.operations.items()} for m in (model, written_out)
    )
    assert own == other
    np.testing.assert_array_equal(
        model.sensitivity_rhs(0.0, [0.1, 0.2], np.ones((2, 3))),
        written_out.sensitivity_rhs(0.0, [0.1, 0.2], np.ones((2, 3))),
    )


def test_it_is_computed_once_when_parameters_are_prepared(model):
    # The rate reads its reciprocal: of the expression nothing is left in the kernel.
    assert model.kernels.program.kernels["rhs"].operations.total <= 3
    assert "parameter m" in model.kernels.source
    assert "parameter A" in model.kernels.source


def test_values_follow_the_parameters_of_a_run(model):
    assert model.parameters == ("rho", "r", "L", "k")
    assert model.kernels.derived()["m"] == pytest.approx(RHO * math.pi * R**2 * L)
    assert model.kernels.derived({"r": 2 * R})["A"] == pytest.approx(4 * math.pi * R**2)
    result = model.simulate((0, 0.1), parameters={"L": 2 * L})
    assert result["omega"][-1] == pytest.approx(
        math.sqrt(STIFFNESS / (2 * L * RHO * math.pi * R**2))
    )


def test_inputs_of_a_run_may_name_it():
    scene = rod()
    scene.input("F", 0.0)
    scene.output("seen", "F")
    result = scene.compile().simulate((0, 1), inputs={"F": "m*t"}, parameters={"L": 2.0})
    assert result["seen"][-1] == pytest.approx(RHO * math.pi * R**2 * 2.0)
    seen = scene.compile(["L"]).simulate((0, 1), inputs={"F": "m*t"})
    assert seen.sensitivity("seen", "L")[-1] == pytest.approx(RHO * math.pi * R**2)


def test_parameters_that_are_fixed_fold():
    scene = Scene("fixed")
    scene.parameter("a", 2.0, tunable=False)
    scene.parameter("b", "a**3")
    scene.edge("R", "resistor", "n", "ground", resistance="b")
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.0})
    model = scene.compile()
    assert model.parameters == ()
    assert model.kernels.derived() == {"b": 8.0}
    assert model.rhs(0.0, [1.0])[0] == pytest.approx(-1 / 8)


def test_an_alias_is_no_second_argument():
    scene = rod()
    scene.parameter("length", "L")
    assert scene.compile().parameters == ("rho", "r", "L", "k")


@pytest.mark.parametrize(
    ("act", "told"),
    [
        (lambda s: s.compile(["m"]), "m = rho.A.L; it follows from 'rho', 'r', 'L'.*sensitivities"),
        (lambda s: s.compile().simulate((0, 1), parameters={"m": 1.0}), "it follows from 'rho'"),
        (lambda s: s.compile(tunable=["m"]), "name 'rho', 'r', 'L' instead"),
        (lambda s: s.parameter("q", "q + 1"), "'q' depends on itself: q -> q"),
        (lambda s: s.parameter("q", "L", tunable=False), "set it for those"),
        (lambda s: (s.parameter("q", "z"), s.parameter("z", "q")), "z -> q -> z"),
    ],
)
def test_refusals(act, told):
    with pytest.raises((ParameterError, SceneError), match=told):
        act(rod())


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("rhoo*2", "the unknown parameter 'rhoo'; did you mean 'rho'"),
        ("t", "uses the unknown parameter 't'"),
        ("b.v", "uses the unknown parameter 'b.v'"),
        ("sqrt(L - 3)", "has no value"),
        ("1/(L - L)", "has no value"),
    ],
)
def test_expressions_without_a_value(text, told):
    scene = rod()
    scene.parameter("q", text)
    with pytest.raises(ExpressionError, match=told):
        scene.compile()


def test_a_value_that_a_run_takes_away_is_told(model):
    with pytest.raises(ParameterError, match=r"'rho', 'r', 'L'"):
        model.simulate((0, 1), parameters={"L": 0.0})


def test_files_keep_expressions():
    text = scene_text(rod())
    assert 'm = { value = "rho*A*L", unit = "kg" }' in text
    again = read_scene(text, "again.toml", Scene)
    assert again.parameters == rod().parameters
    assert "m = rho*A*L" in again.summary()


def test_long_chains_need_no_recursion():
    scene = Scene("chain")
    for i in range(1500, 0, -1):
        scene.parameter(f"p{i}", f"p{i - 1} + 1")
    scene.parameter("p0", 0.5)
    scene.edge("R", "resistor", "n", "ground", resistance="p1500")
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.0})
    assert scene.compile().rhs(0.0, [1.0])[0] == pytest.approx(-1 / 1500.5)


def test_reports_show_expression_and_value(tmp_path):
    file = tmp_path / "rod.toml"
    cotree.Scene.save(rod(), file)
    shown = CliRunner().invoke(app, ["run", str(file), "--t-end", "0.1"]).output
    assert "m = rho*A*L =  2.95938" in shown
    assert "kg" in shown
    shown = CliRunner().invoke(app, ["check", str(file), "-s", "r", "--t-end", "0.1"]).output
    assert "A = pi*r**2 =  0.000314159" in shown
    assert "all sensitivities passed" in shown


def test_units_follow_where_all_are_known():
    scene = rod()
    scene.parameter("c", "2*d")
    scene.parameter("d", 3.0, unit="N s/m")
    scene.output("seen", "c + d")
    layout = scene.compile().kernels.layout
    assert {row.name: row.unit for row in layout.derived} == {"m": "kg", "A": "m^2", "c": "kg/s"}
    assert layout.units["seen"] == "kg/s"


def test_results_of_scenes_with_derived_parameters_are_drawn() -> None:
    scene = cotree.Scene("scene")
    scene.parameter("K", 2.0)
    scene.parameter("k", "3*K")
    scene.edge("rail", "prismatic", "ground", "A", axis=[1, 0, 0], stiffness="k")
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
    result = scene.compile().simulate((0, 1), initial={"rail.s": 1.0})
    assert result.plot().axes
    assert "<canvas" in result.animate().html
