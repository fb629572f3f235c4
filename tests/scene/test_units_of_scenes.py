"""Units: read, converted, checked against what they stand for, and kept by files."""

from __future__ import annotations

import math
import subprocess
import sys

import pytest

from cotree import Scene
from cotree.components import COMPONENTS, OWN
from cotree.errors import ExpressionError, SceneError, UnitError
from cotree.scene.toml_file import read_scene
from cotree.scene.toml_text import scene_text
from cotree.units import read_unit, stated_unit, unit_text


@pytest.mark.parametrize(
    ("text", "value", "si", "wanted"),
    [
        # NIST SP 811, appendix B.8: inch, mile, psi (its table has seven digits), atmosphere, Btu.
        ("in", 1.0, "m", 0.0254),
        ("mile/h", 1.0, "m/s", 0.44704),
        ("psi", 1.0, "Pa", pytest.approx(6894.757, rel=1e-7)),
        ("atm", 1.0, "Pa", 101325.0),
        ("mmHg", 1.0, "Pa", pytest.approx(133.3224, rel=1e-6)),
        ("furlong", 1.0, "m", pytest.approx(201.168, rel=1e-5)),  # of the survey foot or not
        ("rpm", 60.0, "rad/s", pytest.approx(2 * math.pi, rel=1e-15)),
        ("deg", 180.0, "rad", pytest.approx(math.pi, rel=1e-15)),
        ("°", 180.0, "rad", pytest.approx(math.pi, rel=1e-15)),
        ("degC", 20.0, "K", 293.15),
        ("°C", -273.15, "K", 0.0),
        ("degF", 32.0, "K", pytest.approx(273.15, rel=1e-15)),
        ("delta_degF", 9.0, "K", pytest.approx(5.0, rel=1e-15)),
        # Powers of ten are exact: the double of the decimal number.
        ("mm", 35.0, "m", 0.035),
        ("g/cm^3", 7.85, "kg/m^3", 7850.0),
        ("N mm", 3.0, "N m", 0.003),
        ("kΩ", 4.7, "ohm", 4700.0),
        ("µF", 4.7, "F", 4.7e-6),
        ("kHz", 2.0, "Hz", 2000.0),
        ("l/min", 60.0, "m^3/s", pytest.approx(1e-3, rel=1e-15)),
        ("mAh", 1.0, "C", 3.6),
        ("kWh", 1.0, "J", 3.6e6),
        ("%", 5.0, "1", 0.05),
        ("N·m·s/rad", 2.0, "N·m·s/rad", 2.0),
        ("kg m²", 2.0, "kg m²", 2.0),
        ("V^0.5", 2.0, "V^0.5", 2.0),
        ("s⁻¹", 2.0, "s⁻¹", 2.0),
        ("1", 2.0, "1", 2.0),
        ("-", 2.0, "-", 2.0),
        ("((((((m))))))", 2.0, "((((((m))))))", 2.0),
    ],
)
def test_values_in_si(text, value, si, wanted):
    unit = read_unit(text)
    assert (unit.si, unit.to_si(value)) == (si, wanted)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("furlongg", "did you mean 'furlong'"),
        ("m/s2", "a number instead of a symbol"),
        ("10**10**10", "a power that is not a number"),
        ("m**9**9", "a power that is not a number"),
        ("m^99", "a power beyond 12"),
        ("m" * 61, "longer than 60"),
        ("J/degC", "has its own zero: a difference is in 'K' or 'delta_degC'"),
        ("dB", "logarithmic"),
        ("bit/s", "based on 'bit'"),
        ("(m", "not a product of powers"),
        ("m)", "not a product of powers"),
        ("m /", "not a product of powers"),
        ("__import__('os')", "holds '_'"),
        ("m\nkg; x", "holds ';'"),
        ('*/ int system("x"); /* ??/', "holds '"),
    ],
)
def test_what_is_no_unit(text, told):
    with pytest.raises(UnitError, match=f"unit of parameter 'L' is .*{told}"):
        Scene("x").parameter("L", 1.0, unit=text)


def test_units_of_fields_need_no_library():
    """The import of pint takes a good part of a second: units of SI do without it."""
    program = (
        "import sys\nfrom cotree.components import COMPONENTS\nfrom cotree.units import stated_unit"
        "\nfor row in COMPONENTS.values():\n    [stated_unit(f.unit) for f in row.fields]\n"
        "import cotree\ncotree.load('slider-pendulum')\nassert 'pint' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_every_field_states_a_unit_that_can_be_read():
    several = {"any", "rad or m", "1, m or 1/m", ""}
    for name in OWN:
        for field in COMPONENTS[name].fields:
            assert field.unit in several or stated_unit(field.unit) is not None


def pendulum():
    scene = Scene("p", gravity=[0, "-g", 0])
    scene.parameter("g", 9.81, unit="m/s^2")
    scene.parameter("L", 1000, unit="mm")
    scene.input("tau", [[0, 1], [0, 5]], unit="N cm")
    start = {"theta": {"value": 30, "unit": "deg"}, "theta_dot": {"value": 6, "unit": "rpm"}}
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], torque="tau", initial=start)
    scene.edge("r", "arm", "A", "B", vector=[0, "-L", 0])
    scene.edge("s", "arm", "A", "C", vector={"value": [0, -50, 0], "unit": "cm"})
    scene.edge("b", "rigid_body", "ground", "B", mass={"value": 500, "unit": "g"})
    scene.output("height", "B.y + L")
    scene.output("energy", "0.5*L*L*h.theta_dot**2")
    scene.output("speed", "L*h.theta_dot")
    scene.output("unknown", "37.5*L")
    return scene


def test_values_are_converted_and_results_are_in_si():
    scene = pendulum()
    row = scene.parameters["L"]
    assert (row.value, row.unit, row.given) == (1.0, "m", (1000.0, "mm"))
    model = scene.compile(["L"])
    assert model.initial_state.tolist() == pytest.approx([math.pi / 6, 2 * math.pi / 10])
    result = model.simulate((0, 1), rtol=1e-9)
    # A moment at the start: m L^2 theta_ddot = -m g L sin(theta).
    assert model.rhs(0.0, model.initial_state)[1] == pytest.approx(-9.81 * 0.5)
    assert result["tau"][-1] == pytest.approx(0.05)
    assert [result.unit(n) for n in ("L", "tau", "height")] == ["m", "N m", "m"]
    # A run gives values in SI.
    longer = model.simulate((0, 1), parameters={"L": 2.0})
    assert longer["height"][0] == pytest.approx(2.0 * (1 - math.cos(math.pi / 6)))


def test_outputs_have_units_where_they_are_known():
    result = pendulum().compile().simulate((0, 0.1))
    units = [result.unit(name) for name in ("height", "energy", "speed", "unknown")]
    assert units == ["m", "m^2/s^2", "m/s", ""]
    assert result.to_dataframe().attrs["units"]["h.theta_dot"] == "rad/s"


def test_outputs_of_networks_have_units():
    scene = Scene("rc")
    scene.parameter("R", 2.0, unit="ohm")
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("r", "resistor", "n", "ground", resistance="R")
    scene.edge("W", "heat_capacitor", "w", "ground", capacity=1.0, initial={"T": 300.0})
    for name, text in {"v": "n.v", "p": "n.v**2/R", "T": "w.T", "celsius": "w.T - 273.15"}.items():
        scene.output(name, text)
    layout = scene.compile().kernels.layout
    assert [row.unit for row in layout.outputs] == ["V", "W", "K", "degC"]


def test_files_keep_what_was_given():
    text = scene_text(pendulum())
    assert 'L = { value = 1000.0, unit = "mm" }' in text
    assert 'theta = { value = 30, unit = "deg" }' in text
    again = read_scene(text, "p.toml", Scene)
    assert again.parameters == pendulum().parameters
    assert scene_text(again) == text
    assert (again.compile().initial_state == pendulum().compile().initial_state).all()


def body(scene, mass):
    scene.edge("m", "rigid_body", "ground", "X", mass=mass)


def refused_at_once(act):
    scene = Scene("x")
    scene.parameter("L", 1.0, unit="m")
    act(scene)


@pytest.mark.parametrize(
    ("act", "told"),
    [
        (lambda s: body(s, {"value": 1, "unit": "mm"}), "given in 'mm', but is in 'kg'"),
        (lambda s: body(s, {"value": "L", "unit": "g"}), "an expression, .* 'kg', not 'g'"),
        (lambda s: body(s, {"value": 1, "unit": "g", "x": 1}), "'value' and 'unit', no more"),
        (lambda s: s.parameter("m", "L*2", unit="mm"), "its unit is 'm', not 'mm'"),
        (lambda s: s.parameter("m", "1000 mm"), 'value = 1000, unit = "mm"'),
        (lambda s: s.input("u", "sin(t)", unit="deg"), "its unit is 'rad', not 'deg'"),
        (
            lambda s: s.edge(
                "j",
                "revolute",
                "ground",
                "A",
                axis=[0, 0, 1],
                initial={"theta_dot": {"value": 1, "unit": "Hz"}},
            ),
            "given in 'Hz', but is in 'rad/s' .a cycle is 2.pi rad",
        ),
    ],
)
def test_what_does_not_fit_is_refused(act, told):
    with pytest.raises((UnitError, SceneError, ExpressionError), match=told):
        refused_at_once(act)


def test_a_parameter_of_another_dimension_is_refused():
    scene = Scene("x", gravity=[0, -9.81, 0])
    scene.parameter("L", 1.0, unit="m")
    scene.edge("j", "prismatic", "ground", "X", axis=[1, 0, 0], initial={"s": "-L"})
    body(scene, "L")
    told = "mass of edge 'm' is parameter 'L', which is given in 'm', but is in 'kg'"
    with pytest.raises(UnitError, match=told):
        scene.compile()


def test_a_torque_per_radian_is_a_torque():
    scene = Scene("x")
    scene.parameter("c", 1.0, unit="N m")
    scene.edge("k", "rotational_spring", "ground", "X", stiffness="c")
    scene.edge("J", "rotational_inertia", "ground", "X", inertia=1.0, initial={"w": 1.0})
    assert scene.compile().states == ("k.theta", "J.w")


def test_dimensions_as_units():
    assert unit_text(read_unit("N/m").dimension) == "kg/s^2"
    assert unit_text(read_unit("N m rad").dimension) == "N m"
    assert unit_text(read_unit("J/(K kg)").dimension) == "m^2/(s^2 K)"
