"""Laws of hydraulic, thermal and chemical components against independent computations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import brentq

from cotree import Scene
from cotree.components import COMPONENTS
from cotree.errors import ParameterError, SceneError, SingularSystemError

TIGHT = {"method": "dop853", "rtol": 1e-12, "atol": 1e-14}
EXACT = TIGHT | {"method": "DOP853"}


def law_of(name, which, **values):
    """Return a terminal equation as a function of its variable, for arrays."""
    law = getattr(COMPONENTS[name].ports[0], which)
    variable = {"across": "through", "through": "across"}[which]
    return np.vectorize(lambda x: law.form({**values, variable: float(x)}.__getitem__))


def test_an_orifice_is_smooth_and_odd():
    flow = law_of("orifice", "through", area=2e-4, coefficient=0.6, density=900.0, transition=2.0)
    p = np.array([2.0, 3.0, 1e3, 1e7])
    exact = 0.6 * 2e-4 * np.sqrt(2 * p / 900.0)
    np.testing.assert_allclose(flow(p), exact, rtol=1e-14)
    np.testing.assert_allclose(flow(-p), -exact, rtol=1e-14)
    # Values, slopes and curvatures from both sides of the transition.
    for order, h in ((1, 1e-6), (2, 1e-4)):
        steps = h * np.arange(3)
        below, above = (np.diff(flow(2.0 + side * steps), order)[0] for side in (-1, 1))
        sign = -1 if order == 1 else 1
        assert abs(below * sign - above) < 20 * h * abs(above)  # the next derivative's share
    assert np.all(np.diff(flow(np.linspace(-4, 4, 4001))) > 0.0)


def test_both_forms_of_a_pump_are_inverse():
    fields = {"pressure": 1e5, "resistance": 2e5, "quadratic": 3e6}
    rise, flow = law_of("pump", "across", **fields), law_of("pump", "through", **fields)
    p = np.linspace(-2e5, 3e5, 101)
    np.testing.assert_allclose(rise(flow(p)), p, rtol=1e-12, atol=1e-6)
    straight = law_of("pump", "through", **{**fields, "quadratic": 0.0})
    np.testing.assert_allclose(straight(p), (p - 1e5) / 2e5, rtol=1e-14)


def test_radiation_between_two_bodies():
    scene = Scene("bodies")
    start = {"A": 900.0, "B": 300.0}
    for name, temperature in start.items():
        scene.edge(name, "heat_capacitor", name, "ground", capacity=5.0, initial={"T": temperature})
        scene.output(f"T{name}", f"{name}.T")
    scene.edge("R", "radiation", "A", "B", area=0.1, emissivity=0.7)
    result = scene.compile().simulate((0, 20), t_eval=[5.0, 20.0], **TIGHT)

    def rates(t, y):
        heat = 5.670374419e-8 * 0.1 * 0.7 * (y[0] ** 4 - y[1] ** 4)
        return [-heat / 5.0, heat / 5.0]

    exact = solve_ivp(rates, (0, 20), [900.0, 300.0], t_eval=[5.0, 20.0], **EXACT)
    np.testing.assert_allclose([result["TA"], result["TB"]], exact.y, rtol=1e-10)


def test_an_elastic_pipe_is_a_pipe_between_two_halves():
    def final(is_one):
        scene = Scene("line")
        scene.edge("T", "accumulator", "a", "ground", capacity=1e-9, initial={"p": 1e6})
        scene.edge("S", "hydraulic_resistor", "a", "b", resistance=1e8)
        fields = {"resistance": 1e7, "inertance": 1e6}
        if is_one:
            scene.edge("P", "pipe", "b", "c", capacity=4e-10, **fields)
        else:
            scene.edge("P", "pipe", "b", "c", **fields)
            for node in ("b", "c"):
                scene.edge(f"half_{node}", "accumulator", node, "ground", capacity=2e-10)
        scene.edge("R", "hydraulic_resistor", "c", "ground", resistance=2e8)
        scene.output("p", "c.p")
        model = scene.compile()
        assert len(model.states) == 4
        return model.simulate((0, 0.3), **TIGHT)["p"][-1]

    # Both are the same equations in another order.
    assert final(True) == pytest.approx(final(False), rel=1e-9)


def test_an_elastic_pipe_into_the_ground_has_one_half():
    scene = Scene("outlet")
    scene.edge("P", "pipe", "a", "ground", inertance=1e6, capacity=4e-10)
    scene.edge("S", "flow_source", "ground", "a", flow=1e-3)
    assert scene.compile().states == ("P.q", "P.plus.p")


def test_a_pump_works_where_its_curve_meets_the_pipe():
    scene = Scene("duty")
    scene.edge("pump", "pump", "a", "ground", pressure=1e5, resistance=1e5, quadratic=1e6)
    scene.edge("P", "pipe", "a", "ground", resistance="4e6*abs(P.q)", inertance=1e4)
    scene.output("q", "P.q")
    q = scene.compile().simulate((0, 5), **TIGHT)["q"][-1]
    exact = brentq(lambda q: 1e5 - 1e5 * q - 1e6 * q * q - 4e6 * q * q, 0.0, 1.0, xtol=1e-15)
    assert q == pytest.approx(exact, rel=1e-9)


def test_a_reversible_reaction_comes_to_its_equilibrium():
    scene = Scene("equilibrium")
    for name, start in {"A": 1.0, "B": 2.0, "C": 0.0}.items():
        scene.edge(name, "species", name, "ground", volume=0.5, initial={"c": start})
        scene.output(f"c{name}", f"{name}.c")
    scene.edge(
        *("R", "reaction"),
        **{"reactants": ["A", "B", "B"], "products": ["C"], "rate": 3.0, "reverse_rate": 0.5},
        volume=0.5,
    )
    scene.output("taken", "R.B.n")
    scene.output("made", "-R.C.n")
    result = scene.compile().simulate((0, 30), method="BDF", rtol=1e-10, atol=1e-12)
    a, b, c = (result[f"c{name}"] for name in "ABC")
    np.testing.assert_allclose(a + c, 1.0, atol=1e-9)
    np.testing.assert_allclose(b + 2 * c, 2.0, atol=1e-9)
    np.testing.assert_allclose(result["taken"], 2 * result["made"], atol=1e-12)
    assert 3.0 * a[-1] * b[-1] ** 2 == pytest.approx(0.5 * c[-1], rel=1e-7)


def test_a_catalyst_is_not_used_up():
    scene = Scene("catalyst")
    for name, start in {"A": 1.0, "K": 0.2}.items():
        scene.edge(name, "species", name, "ground", volume=1.0, initial={"c": start})
        scene.output(f"c{name}", f"{name}.c")
    scene.edge("R", "reaction", reactants=["A", "K"], products=["K"], rate=4.0)
    result = scene.compile().simulate((0, 2), **TIGHT)
    np.testing.assert_allclose(result["cK"], 0.2, rtol=1e-15)
    np.testing.assert_allclose(result["cA"], np.exp(-0.8 * result.t), rtol=1e-10)


def test_michaelis_and_menten():
    scene = Scene("enzyme")
    scene.edge("S", "species", "S", "ground", volume=1.0, initial={"c": 2.0})
    scene.edge("P", "species", "P", "ground", volume=1.0)
    scene.edge("R", "reaction", reactants=["S"], products=["P"], rate="0.7/(0.4 + S.c)")
    scene.output("s", "S.c")
    result = scene.compile().simulate((0, 2), **TIGHT)
    s = result["s"]
    # K log(s / s0) + s - s0 = -V t
    left = 0.4 * np.log(s / 2.0) + s - 2.0
    np.testing.assert_allclose(left, -0.7 * result.t, atol=1e-10)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({}, "needs reactants or products"),
        ({"reactants": "A"}, "must be a list of names of nodes"),
        ({"reactants": ["A", 3]}, "must be a list of names of nodes"),
        ({"reactants": ["A"], "product": ["B"]}, "has no field 'product'"),
        ({"reactants": ["ground"]}, "name 'ground', the reference of concentrations"),
        ({"reactants": ["A b"]}, "A b"),
    ],
)
def test_reactions_that_are_none(fields, message):
    with pytest.raises(SceneError, match=message):
        Scene("s").edge("R", "reaction", rate=1.0, **fields)


def test_a_cell_by_a_table():
    scene = Scene("cell")
    curve = {"of": "U.soc", "x": [0.0, 1.0], "y": [3.0, 4.0]}
    start = {"soc": 0.9}
    scene.edge(
        *("U", "open_circuit_voltage", "p", "ground"), voltage=curve, capacity=10.0, initial=start
    )
    scene.edge("R", "resistor", "p", "ground", resistance=2.0)
    scene.output("v", "p.v")
    scene.output("soc", "U.soc")
    model = scene.compile(["U.soc"])
    assert model.states == ("U.soc",)
    result = model.simulate((0, 3), **TIGHT)
    decay = np.exp(-result.t / 20.0)
    np.testing.assert_allclose(result["v"], 3.9 * decay, rtol=1e-11)
    np.testing.assert_allclose(result.sensitivity("v", "U.soc"), decay, rtol=1e-11)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"of": "t", "x": [0, 1]}, "give 'of', an expression"),
        ({"of": "t", "x": [0, 1], "y": [1]}, "has 2 numbers x but 1 values"),
        ({"of": "t", "x": [1, 0], "y": [1, 2]}, "must ascend: number 2 is 0, after 1"),
        ({"of": "t", "x": [0, 1], "y": [1, "a +"]}, "is not an expression"),
        ({"of": "t +", "x": [0, 1], "y": [1, 2]}, "is not an expression"),
    ],
)
def test_tables_that_are_none(table, message):
    with pytest.raises(SceneError.__mro__[1], match=message):
        Scene("s").edge("V", "voltage_source", "a", "ground", voltage=table)


@pytest.mark.parametrize(
    ("storage", "dissipator", "field", "state", "closed_form"),
    [
        ("capacitor", "resistor", "resistance", "v", lambda r: np.exp(-0.5 / r)),
        ("accumulator", "hydraulic_resistor", "resistance", "p", lambda r: np.exp(-0.5 / r)),
        ("translational_mass", "translational_damper", "damping", "v", lambda d: np.exp(-d / 2)),
        ("rotational_inertia", "rotational_damper", "damping", "w", lambda d: np.exp(-d / 2)),
    ],
)
def test_a_negative_dissipator_feeds_energy_in(storage, dissipator, field, state, closed_form):
    scene = Scene("fed")
    scene.parameter("k", -0.8)
    size = {
        "translational_mass": "mass",
        "rotational_inertia": "inertia",
        "accumulator": "capacity",
    }
    value = {size.get(storage, "capacitance"): 2.0, "initial": {state: 1.0}}
    ends = ("A", "ground") if field == "resistance" else ("ground", "A")
    scene.edge("store", storage, *ends, **value)
    scene.edge("loss", dissipator, *ends, **{field: "k"})
    run = scene.compile(["k"]).simulate((0, 1), rtol=1e-10)
    assert run[f"store.{state}"][-1] == pytest.approx(closed_form(-0.8), rel=1e-8)
    step = 1e-5
    slope = (closed_form(-0.8 + step) - closed_form(-0.8 - step)) / (2 * step)
    # Central differences of the closed form are good to the square of the step.
    assert run.sensitivity(f"store.{state}", "k")[-1] == pytest.approx(slope, rel=1e-7)
    assert [row.name for row in scene.lint() if row.rule == "magnitude"] == ["loss"]
    with pytest.raises(ParameterError, match="'loss' must be negative, as in the scene"):
        scene.compile().simulate((0, 1), parameters={"k": 0.8})
    scene.set("k", 0.8)
    assert not [row for row in scene.lint() if row.rule == "magnitude"]
    scene.edge("short", dissipator, *ends, **{field: 0.0})
    with pytest.raises(ParameterError, match=f"{field} of edge 'short' must not be zero"):
        scene.compile()


@pytest.mark.parametrize(
    ("kind", "storage", "size", "speed"),
    [
        ("translational_spring", "translational_mass", "mass", "v"),
        ("rotational_spring", "rotational_inertia", "inertia", "w"),
    ],
)
def test_springs_may_be_negative(kind, storage, size, speed):
    scene = Scene("apart")
    scene.parameter("k", -0.8)
    scene.edge("m", storage, "ground", "a", **{size: 1.0, "initial": {speed: 1.0}})
    scene.edge("x", kind, "ground", "a", stiffness="k")
    run = scene.compile(["k"]).simulate((0, 1), rtol=1e-10)
    rate = np.sqrt(0.8)  # the square of the frequency is negative: cosh in place of cos
    assert run[f"m.{speed}"][-1] == pytest.approx(np.cosh(rate), rel=1e-8)
    slope = -np.sinh(rate) / (2 * rate)
    assert run.sensitivity(f"m.{speed}", "k")[-1] == pytest.approx(slope, rel=1e-7)
    assert [row.name for row in scene.lint() if row.rule == "magnitude"] == ["x"]
    with pytest.raises(ParameterError, match="'x' must be negative, as in the scene"):
        scene.compile().simulate((0, 1), parameters={"k": 0.0})
    scene.set("k", 0.0)
    with pytest.raises(ParameterError, match="stiffness of edge 'x' must not be zero"):
        scene.compile()


def test_a_pivot_of_negative_resistors_may_vanish():
    """1 and -1 ohm at a node cancel each other's conductance: no pivot may be taken there."""
    scene = Scene("cancelling")
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("R1", "resistor", "a", "b", resistance=1.0)
    scene.edge("R2", "resistor", "b", "ground", resistance=-1.0)
    scene.edge("R3", "resistor", "b", "c", resistance=1.0)
    scene.edge("R4", "resistor", "c", "ground", resistance=2.0)
    scene.output("y", "R4.v")
    # All of 1 A from R1 through R3 and R4, since (1 - u) + u is 1.
    assert scene.compile().simulate((0, 1))["y"][-1] == pytest.approx(2.0, rel=1e-12)


def test_capacitors_may_be_negative():
    """The leading minor 1 - 2 + 1 of the matrix of capacitances is zero, the matrix is regular."""
    scene = Scene("negative")
    scene.parameter("C", -2.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("R1", "resistor", "a", "b", resistance=1.0)
    scene.edge("R2", "resistor", "c", "ground", resistance=1.0)
    scene.edge("C1", "capacitor", "b", "ground", capacitance=1.0)
    scene.edge("C2", "capacitor", "b", "ground", capacitance="C")
    scene.edge("C3", "capacitor", "b", "c", capacitance=1.0)
    scene.edge("C4", "capacitor", "c", "ground", capacitance=1.0)
    scene.output("b", "b.v")
    run = scene.compile(["C"]).simulate((0, 1), rtol=1e-10, atol=1e-12)

    def closed_form(capacitance):
        rates = -np.linalg.inv([[2.0 + capacitance, -1.0], [-1.0, 2.0]])
        # Rates are A (x - end), where the end is 1 V at b and 0 V at c.
        return 1.0 - (expm(rates) @ [1.0, 0.0])[0]

    # The solution grows by exp(2.4).
    assert run["b"][-1] == pytest.approx(closed_form(-2.0), rel=1e-8)
    slope = (closed_form(-2.0 + 1e-5) - closed_form(-2.0 - 1e-5)) / 2e-5
    assert run.sensitivity("b", "C")[-1] == pytest.approx(slope, rel=1e-7)
    assert [row.name for row in scene.lint() if row.rule == "magnitude"] == ["C2"]
    scene.set("C", 0.0)
    with pytest.raises(ParameterError, match="capacitance of edge 'C2' must not be zero"):
        scene.compile()


def test_inductors_may_be_negative():
    """Of 1 H and -3 H in series, -2 H are left: the current grows."""
    scene = Scene("negative")
    scene.parameter("L", -3.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("L1", "inductor", "b", "c", inductance=1.0)
    scene.edge("L2", "inductor", "c", "ground", inductance="L")
    scene.output("y", "R.i")
    run = scene.compile(["L"]).simulate((0, 1), rtol=1e-10, atol=1e-12)
    assert run["y"][-1] == pytest.approx(1.0 - np.exp(0.5), rel=1e-8)
    # d/dL of 1 - exp(-1/(1 + L)) at L = -3.
    assert run.sensitivity("y", "L")[-1] == pytest.approx(-np.exp(0.5) / 4.0, rel=1e-8)


@pytest.mark.parametrize("edge", ["capacitor", "inductor"])
def test_storages_that_cancel_are_named(edge):
    scene = Scene("cancelling")
    field = {"capacitor": "capacitance", "inductor": "inductance"}[edge]
    middle = "ground" if edge == "capacitor" else "c"
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("x", edge, "b", middle, **{field: 1.0})
    scene.edge("y", edge, "b" if edge == "capacitor" else "c", "ground", **{field: -1.0})
    with pytest.raises(SingularSystemError, match="of opposite sign cancel"):
        scene.compile().simulate((0, 1))


@pytest.mark.parametrize("edge", ["translational_mass", "rotational_inertia"])
def test_negative_masses_stay_refused(edge):
    scene = Scene("negative")
    field = {"translational_mass": "mass", "rotational_inertia": "inertia"}[edge]
    scene.edge("x", edge, "ground", "A", **{field: -1.0})
    with pytest.raises(ParameterError, match=f"{field} of edge 'x'.*positive"):
        scene.compile()
