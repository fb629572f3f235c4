"""An NMOS NAND gate whose transistors exchange drain and source as their voltage turns.

The circuit of the NAND gate in the IVP test set (Mazzia and Magherini, Bari), with resistances,
capacitances and transistors of its kind: a depletion-type load above two enhancement-type
transistors. Voltages are in V, currents in A, times in ns, so that capacitances are in nF.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cotree import Scene

pytestmark = pytest.mark.compiler

END = 80.0
GIVEN = {"VDD": 5.0, "VBB": -2.5, "CG": 0.6e-4, "C9": 0.5e-4, "CB": 0.24e-4, "phi": 0.87}
GIVEN |= {"IS": 1e-14, "VT": 25.85, "lam": 0.02}
#: Threshold voltage, body effect, surface potential and gain of the load, and of the others.
TYPES = {1: (-2.43, 0.2, 1.28, 5.35e-4), 2: (0.2, 0.035, 1.01, 1.748e-3)}
#: Delay, length and period of the pulses at both gates, with edges of 5 ns.
PULSES = {"g1": (5.0, 5.0, 20.0), "g2": (15.0, 15.0, 40.0)}

#: Nodes of each capacitor, junction, resistor, and of each transistor: its type, drain and source,
#: gate and source, bulk and source, gate and drain, bulk and drain.
GATES = [(1, 5), (2, 5), (6, "g1"), (7, "g1"), (11, "g2"), (12, "g2")]
NODES = [(5, 0), (10, 0)]
JUNCTIONS = [(3, 5), (4, "dd"), (9, 5), (8, 10), (14, 10), (13, 0)]
RESISTORS = [(1, 5), (2, "dd"), (5, 7), (6, 10), (10, 12), (11, 0)]
BULKS = (3, 4, 8, 9, 13, 14)
TRANSISTORS = [
    (1, (2, 1), (5, 1), (3, 5), (5, 2), (4, "dd")),
    (2, (7, 6), ("g1", 6), (8, 10), ("g1", 7), (9, 5)),
    (2, (12, 11), ("g2", 11), (13, 0), ("g2", 12), (14, 10)),
]
START = {0: 0.0, 1: 5.0, 2: 5.0, 3: -2.5, 4: -2.5, 5: 5.0, 6: 3.62385, 7: 5.0, 8: -2.5, 9: -2.5}
START |= {10: 3.62385, 11: 0.0, 12: 3.62385, 13: -2.5, 14: -2.5, "dd": 5.0, "g1": 0.0, "g2": 0.0}

#: Voltages of the nodes 1, 5, 6 and 10 in the end: SciPy's Radau at 1e-10 with the equations below.
EXPECTED = (4.971206403595, 4.970955751432, -0.203553880291, -0.203461452215)
NOTED = (1, 5, 6, 10)


def _node(name):
    return "ground" if name == 0 else f"n{name}"


def _drop(nodes):
    a, b = ("0" if name == 0 else f"n{name}.v" for name in nodes)
    return f"({a} - {b})"


def _channel(kind, drain, gate, bulk):
    """Write the current of a transistor with a positive voltage between drain and source."""
    over = f"({gate} - (vt{kind} + g{kind}*(sqrt(s{kind} - {bulk}) - sqrt(s{kind}))))"
    saturated = f"b{kind}*{over}**2*(1 + lam*{drain})"
    linear = f"b{kind}*{drain}*(2*{over} - {drain})*(1 + lam*{drain})"
    return f"where({over} <= 0, 0, where({over} <= {drain}, {saturated}, {linear}))"


def gate() -> Scene:
    scene = Scene("nand")
    for name, value in GIVEN.items():
        scene.parameter(name, value)
    for kind, values in TYPES.items():
        for name, value in zip(("vt", "g", "s", "b"), values, strict=True):
            scene.parameter(f"{name}{kind}", value)
    scene.edge("VD", "voltage_source", "ndd", "ground", voltage="VDD")
    scene.edge("VB", "voltage_source", "nbb", "ground", voltage="VBB")
    for name, (delay, length, period) in PULSES.items():
        t = f"mod(t, {period})"
        ramps = f"min(({t} - {delay})/5, ({delay + length + 10} - {t})/5)"
        voltage = f"5*max(0, min(1, {ramps}))"
        scene.edge(f"V{name}", "voltage_source", f"n{name}", "ground", voltage=voltage)

    def capacitor(a, b, capacitance):
        start = {"v": START[a] - START[b]}
        name = f"C{a}_{b}"
        scene.edge(name, "capacitor", _node(a), _node(b), capacitance=capacitance, initial=start)
        return f"{name}.v"

    for a, b in GATES:
        capacitor(a, b, "CG")
    for a, b in NODES:
        capacitor(a, b, "C9")
    for a, b in JUNCTIONS:
        v = f"C{a}_{b}.v"
        capacitor(a, b, f"where({v} <= 0, CB/sqrt(1 - {v}/phi), CB*(1 + {v}/(2*phi)))")
        current = f"where({v} <= 0, IS*(exp({v}/VT) - 1), 0)"
        scene.edge(f"I{a}_{b}", "current_source", _node(a), _node(b), current=current)
    for a, b in RESISTORS:
        scene.edge(f"R{a}_{b}", "resistor", _node(a), _node(b), resistance=4.0)
    for a in BULKS:
        scene.edge(f"R{a}", "resistor", _node(a), "nbb", resistance=10.0)
    for i, (kind, *nodes) in enumerate(TRANSISTORS):
        ds, gs, bs, gd, bd = map(_drop, nodes)
        exchanged = _channel(kind, f"(-{ds})", gd, bd)
        current = f"where({ds} < 0, -{exchanged}, {_channel(kind, ds, gs, bs)})"
        scene.edge(f"M{i}", "current_source", *map(_node, nodes[0]), current=current)
    for i in NOTED:
        scene.output(f"y{i}", f"n{i}.v")
    return scene


def _rates(t: float, y: np.ndarray) -> np.ndarray:
    """Solve the node equations for the rates of the voltages of nodes 1 to 14."""
    v = {0: 0.0, "dd": GIVEN["VDD"], "bb": GIVEN["VBB"], **dict(enumerate(y.tolist(), 1))}
    slope = {}
    for name, (delay, length, period) in PULSES.items():
        at = t % period - delay
        v[name] = 5 * max(0.0, min(1.0, at / 5, (length + 10 - at) / 5))
        slope[name] = float(0 < at < 5) - float(length + 5 < at < length + 10)
    matrix, sums = np.zeros((15, 15)), np.zeros(15)

    def carry(a, b, current):
        for node, sign in ((a, -1), (b, 1)):
            if isinstance(node, int):
                sums[node] += sign * current

    def store(a, b, c):
        for one, other in ((a, b), (b, a)):
            if isinstance(one, int):
                matrix[one, one] += c
                if isinstance(other, int):
                    matrix[one, other] -= c
                else:
                    sums[one] += c * slope.get(other, 0.0)

    def channel(kind, drain, gate, bulk):
        threshold, body, surface, gain = TYPES[kind]
        over = gate - threshold - body * (math.sqrt(surface - bulk) - math.sqrt(surface))
        if over <= 0:
            return 0.0
        if over <= drain:
            return gain * over**2 * (1 + GIVEN["lam"] * drain)
        return gain * drain * (2 * over - drain) * (1 + GIVEN["lam"] * drain)

    for a, b in GATES:
        store(a, b, GIVEN["CG"])
    for a, b in NODES:
        store(a, b, GIVEN["C9"])
    for a, b in JUNCTIONS:
        at = (v[a] - v[b]) / GIVEN["phi"]
        store(a, b, GIVEN["CB"] * (1 / math.sqrt(1 - at) if at <= 0 else 1 + at / 2))
        carry(a, b, GIVEN["IS"] * (math.exp(min(v[a] - v[b], 0) / GIVEN["VT"]) - 1))
    for a, b in RESISTORS:
        carry(a, b, (v[a] - v[b]) / 4)
    for a in BULKS:
        carry(a, "bb", (v[a] - v["bb"]) / 10)
    for kind, *nodes in TRANSISTORS:
        ds, gs, bs, gd, bd = (v[a] - v[b] for a, b in nodes)
        current = channel(kind, ds, gs, bs) if ds > 0 else -channel(kind, -ds, gd, bd)
        carry(*nodes[0], current)
    return np.linalg.solve(matrix[1:, 1:], sums[1:])


@pytest.mark.slow
def test_the_expected_voltages_solve_the_node_equations():
    y = np.array([START[i] for i in range(1, 15)])
    # The pulses have corners each 5 ns.
    for t in np.arange(0.0, END, 5.0):
        span = (t + 1e-12, t + 5.0 - 1e-12)
        y = solve_ivp(_rates, span, y, method="Radau", rtol=1e-7, atol=1e-9).y[:, -1]
    # Sixteen runs at 1e-7.
    np.testing.assert_allclose(y[[i - 1 for i in NOTED]], EXPECTED, rtol=0, atol=1e-5)


def _agrees(model, method):
    result = model.simulate((0, END), [0.0, END], method=method, rtol=1e-6, atol=1e-8)
    assert result.success, result.message
    found = [result[f"y{i}"][-1] for i in NOTED]
    # Multistep methods err by some hundred tolerances over thirty corners.
    np.testing.assert_allclose(found, EXPECTED, rtol=0, atol=1e-4)
    return result


def test_a_nand_gate_with_exchanged_transistors():
    _agrees(gate().compile(optimize="-O0"), "ida")


@pytest.mark.slow
def test_a_nand_gate_with_sensitivities():
    model = gate().compile(["vt2", "b1"], optimize="-O0")
    slopes = []
    for method in ("rodas4", "rodas5", "cvode", "ida"):
        result = _agrees(model, method)
        slopes.append([result.sensitivity(f"y{i}", "b1")[-1] for i in NOTED])
    # A share of the largest, as the voltages.
    np.testing.assert_allclose(slopes, slopes[1:2] * 4, rtol=0, atol=1e-3 * np.max(np.abs(slopes)))


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dopri5", "rkf45", "dop853"])
def test_a_nand_gate_by_explicit_methods(method):
    """Half a million steps: the time constants are 5e-4 ns."""
    _agrees(gate().compile(), method)
