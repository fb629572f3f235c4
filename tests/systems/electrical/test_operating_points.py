"""Hard operating points from the default guess, against an independent nodal solution."""

from __future__ import annotations

import itertools
import math
import re

import numpy as np
import operating_points as circuits
import pytest
from operating_points import THERMAL, Circuit, Nodal

from cotree import Scene
from cotree.errors import SolveError

pytestmark = pytest.mark.compiler

# Newton's method from a guess that is improved where that is needed takes 106 at most.
MOST_EVALUATIONS = 120


class Counted:
    """Kernels that count evaluations of the equations."""

    def __init__(self, kernels):
        self._kernels = kernels
        self.count = 0

    def __getattr__(self, name):
        return getattr(self._kernels, name)

    def __call__(self, name, *arguments):
        self.count += name == "rhs"
        return self._kernels(name, *arguments)


def _potentials(circuit: Circuit, monkeypatch) -> dict[str, float]:
    """Find the operating point, in few evaluations."""
    monkeypatch.setattr("cotree.api.check_start", lambda model: None)  # it would be found twice
    model = circuit.scene().compile()
    model.kernels.code = counted = Counted(model.kernels.code)
    found = model.output_values(0.0, model.start().y)
    assert counted.count <= MOST_EVALUATIONS
    return {name.removeprefix("at_"): v for name, v in zip(model.outputs, found, strict=True)}


def _check(circuit: Circuit, monkeypatch, tolerance: float = 1e-9) -> dict[str, float]:
    """Compare with the independent solution, in volts.

    Rounding of 1e-15 of some ten volts is enlarged by conductances from 1e-12 to 1, as far as
    that is possible without spoiling the balance of currents.
    """
    nodal = Nodal(circuit)
    expected, found = nodal.solve(), _potentials(circuit, monkeypatch)
    values = [found[node] for node in nodal.places if node != "ground"]
    np.testing.assert_allclose(values, expected[: nodal.n_nodes], rtol=0, atol=tolerance)
    return found


def _check_balance(circuit: Circuit, found: dict[str, float]) -> None:
    """Check the currents into each node: where there are several solutions any will do.

    The currents of sources are those that balance their nodes. Potentials of 10 V have a rounding
    of 2e-15, which junctions enlarge by 1 / THERMAL, and unknowns that are differences some times;
    over the least resistance it is a current of 1e-17.
    """
    nodal = Nodal(circuit)
    x = np.zeros(nodal.size)
    x[: nodal.n_nodes] = [found[node] for node in nodal.places if node != "ground"]
    own = nodal.matrix[:-1, nodal.n_nodes : -1]
    x[nodal.n_nodes :] = -np.linalg.lstsq(own, nodal.balance(x)[0], rcond=None)[0]
    left, size = nodal.balance(x)
    assert np.all(np.abs(left) <= 1e-11 * size + 1e-17)


CHAINS = [
    *itertools.product((1, 2, 5, 10), (5.0, 60.0, 1000.0), (1e-16, 1e-9), (1.0, 1e3, 1e6)),
    *itertools.product((20, 50), (5.0, 1000.0), (1e-16, 1e-9), (1.0, 1e6)),
    (50, 60.0, 1e-12, 1e3),
]


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("n", "voltage", "saturation", "resistance"), CHAINS)
def test_diodes_in_a_chain(n, voltage, saturation, resistance, monkeypatch):
    circuit = circuits.chain(n, voltage, saturation, resistance)
    found = _potentials(circuit, monkeypatch)
    # All diodes are alike: one of them on the n-th part of source and resistance.
    expected = Nodal(circuits.chain(1, voltage / n, saturation, resistance / n)).solve()
    drop = expected[list(Nodal(circuits.chain(1, 1.0, 1.0, 1.0)).places).index("n1")]
    current = saturation * np.expm1(drop / THERMAL)
    # The current is the difference of the source and the diodes' sum, by the resistance; with
    # little current its rounding moves the diodes' shares.
    rounding = 4 * np.finfo(float).eps * voltage
    tolerance = rounding + n * THERMAL * rounding / (resistance * (current + saturation))
    values = [found[f"n{i}"] for i in range(1, n + 1)]
    wanted = [drop * (n + 1 - i) for i in range(1, n + 1)]
    np.testing.assert_allclose(values, wanted, rtol=0, atol=tolerance)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("voltage", [5.0, -12.0, 325.0])
@pytest.mark.parametrize("saturation", [1e-15, 1e-9])
@pytest.mark.parametrize("resistance", [1.0, 1e4])
def test_bridge(voltage, saturation, resistance, monkeypatch):
    _check(circuits.bridge(voltage, saturation, resistance), monkeypatch)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("n", [1, 3, 6])
@pytest.mark.parametrize("voltage", [5.0, -100.0])
def test_pairs_of_diodes(n, voltage, monkeypatch):
    _check(circuits.clippers(n, voltage, 100.0), monkeypatch)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("n", [2, 4, 6])
def test_stages_that_limit_their_voltage(n, monkeypatch):
    found = _check(circuits.regulators(n, 50.0), monkeypatch)
    # 2 n diodes with about 3 A: 0.85 V each.
    assert found["s1"] == pytest.approx(0.85 * 2 * n, rel=0.03)


@pytest.mark.parametrize("make", [circuits.darlington, circuits.wilson, circuits.cascode])
def test_transistors(make, monkeypatch):
    _check(make(), monkeypatch)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("drive", [0.0, 5.0, -10.0, 14.0])
def test_complementary_followers(drive, monkeypatch):
    _check(circuits.class_ab(drive), monkeypatch)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("voltage", [0.0, 1.0, 2.0, 2.5, 3.0, 4.0, 8.0])
def test_schmitt_trigger(voltage, monkeypatch):
    circuit = circuits.schmitt(voltage)
    _check_balance(circuit, _potentials(circuit, monkeypatch))


@pytest.mark.parametrize("imbalance", [0.0, 0.1])
def test_flip_flop(imbalance, monkeypatch):
    circuit = circuits.flip_flop(imbalance)
    _check_balance(circuit, _potentials(circuit, monkeypatch))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("signal", [0.0, 0.5, -1.0])
def test_operational_amplifier_with_feedback(signal, monkeypatch):
    found = _check(circuits.amplifier(signal), monkeypatch)
    # 1 + 9 k / 1 k; offset, bias currents and an open loop of some ten thousand leave 0.1 %.
    assert found["out"] == pytest.approx(10.0 * signal, rel=1e-3, abs=5e-3)


def test_operational_amplifier_in_saturation(monkeypatch):
    circuit = circuits.amplifier(3.0)
    found = _potentials(circuit, monkeypatch)
    _check_balance(circuit, found)
    assert 13.0 < found["out"] < 15.0


@pytest.mark.slow
@pytest.mark.parametrize("guess", [15.0, -30.0, 40.0])
def test_poor_guesses_of_an_operational_amplifier(guess):
    model = circuits.amplifier(0.5).scene().compile()
    start = model.start(initial=dict.fromkeys(model.states, guess))
    np.testing.assert_allclose(start.y, model.start().y, atol=1e-9)


def test_a_current_that_no_diode_lets_through_names_edge_and_unknown():
    scene = Scene("blocked")
    scene.edge("I1", "current_source", "ground", "a", current=1.0)
    scene.edge("D7", "diode", "ground", "a", saturation_current=1e-12)
    scene.output("v", "a.v")
    with pytest.raises(SolveError, match=re.escape("'D7.v' stays")):
        scene.compile()


def test_junctions_evaluate_what_the_equations_are():
    """Exponentials equal those of their exponents, and slopes equal differences."""
    model = circuits.darlington().scene().compile()
    y, p, u = model.start().y, model.default_parameters, np.zeros(0)
    point = model.kernels.junctions.at(0.0, y, p, u)
    n, m = len(y), len(model.kernels.junctions.exponentials)
    assert m > 0
    exponents = point._evaluate(y, np.ones(m))[0][n:]
    values, entries = point._evaluate(y, np.exp(exponents))
    slopes = np.zeros((n + m, n + m))
    slopes[point._rows, point._columns] = entries
    np.testing.assert_allclose(values[:n], model.rhs(0.0, y), atol=1e-12)
    together = slopes[:n, :n] + slopes[:n, n:] * np.exp(exponents) @ slopes[n:, :n]
    np.testing.assert_allclose(together, model.jacobian(0.0, y), rtol=1e-10)


def test_terms_of_a_step_that_cancel_each_other_are_no_solution():
    """At zero the first two terms of the inverse series are -4 V and 4 V; see the slopes there."""
    scene = Scene("cancelling")
    scene.resistor("R", "c", "ground", resistance=1e3)
    scene.capacitor("C", "c", "ground", capacitance=1e-6)
    law = "log(1 + c.v) + exp(-c.v) + sqrt(c.v + 1) + atan(c.v)"
    scene.voltage_source("B", "d", "ground", voltage=law)
    scene.resistor("S", "d", "c", resistance=1e3)
    scene.simulation(start="operating point")
    c = scene.compile(tunable=[]).start().y[0]
    assert c > 1.0
    # Both currents into c are equal, to the rounding of a sum of a few volts.
    assert abs(math.log1p(c) + math.exp(-c) + math.sqrt(c + 1) + math.atan(c) - 2 * c) < 1e-12


def test_neighbours_that_overflow_do_not_make_a_residual_rounding():
    """From the guess, a junction of 2.5 V, a step of 1e18 V is what the matrix gives."""
    scene = Scene("overflow")
    scene.edge("V", "voltage_source", "vdd", "ground", voltage=3.0)
    scene.edge("R2", "resistor", "c", "vdd", resistance=22e3)
    scene.edge("R3", "resistor", "d", "ground", resistance=47e3)
    for node in ("c", "d"):
        scene.edge(f"C{node}", "capacitor", node, "ground", capacitance=1e-8)
    values = {"saturation_current": 1e-15, "forward_gain": 50.0, "reverse_gain": 1.0}
    values |= {"thermal_voltage": THERMAL, "leakage": 1e-12}
    scene.edge("Q", "bjt_pnp", "vdd", "d", "c", "ground", **values)
    scene.simulation(start="operating point")
    model = scene.compile(tunable=[])
    found = dict(zip(model.states, model.start().y, strict=True))
    # By ngspice, with a thermal voltage that differs in the fifth digit.
    assert found["Cc.v"] == pytest.approx(2.9995, abs=1e-3)
    assert found["Cd.v"] == pytest.approx(2.3632, abs=1e-3)
