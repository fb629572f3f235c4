"""Operating points of long networks: work in proportion to the length, and seconds that show."""

from __future__ import annotations

import time

import numpy as np
import pytest
from bare_models import BareModel
from evaluated_kernels import EvaluatedKernels

from cotree import Scene
from cotree.dag.nodes import Dag, symbols_in, symbols_of_each
from cotree.linear.factors import factorise, factorise_definite
from cotree.pipeline import formulate, generate
from cotree.scene.variants import scene_at_rest


def _ladder(n, rung):
    """A ladder of n resistors of 1 ohm and capacitors from 1 V, held at 0.5 V in its middle."""
    scene = Scene("ladder")
    scene.edge("V", "voltage_source", "n0", "ground", voltage=1.0)
    for i in range(n):
        scene.edge(f"R{i}", "resistor", f"n{i}", f"n{i + 1}", resistance=1.0)
        scene.edge(f"C{i}", "capacitor", f"n{i + 1}", "ground", capacitance=1e-6)
        rung(scene, i)
    return scene


def _nothing(scene, i):
    """No rung but the capacitor."""


def _diode(scene, i):
    """A diode and a resistor in series."""
    scene.edge(f"D{i}", "diode", f"n{i + 1}", f"m{i}", saturation_current=1e-12)
    scene.edge(f"S{i}", "resistor", f"m{i}", "ground", resistance=1e3)


@pytest.mark.compiler
def test_a_held_node_in_a_long_ladder():
    n = 140
    scene = _ladder(n, _nothing)
    scene.simulation(start="operating point", held={f"n{n // 2}": 0.5})
    begun = time.perf_counter()
    model = scene.compile()
    taken = time.perf_counter() - begun
    v = model.initial_state
    # No current reaches the far half, and one falls evenly along the near half.
    near = 1 - 0.5 * np.arange(1, n // 2 + 1) / (n // 2)
    np.testing.assert_allclose(v, np.concatenate([near, np.full(n // 2, 0.5)]), rtol=1e-12)
    assert list(model.times) == ["formulate", "generate", "compile", "start"]
    assert model.times["start"] > 0.0
    assert sum(model.times.values()) == pytest.approx(taken, rel=0.05)
    assert "start" in model.simulate((0, 1e-9)).times


@pytest.mark.parametrize(("rung", "n"), [(_nothing, 140), (_diode, 80)])
def test_the_equations_grow_as_the_ladder_does(rung, n):
    """Twice the length, twice the nodes."""

    def n_nodes(n):
        scene = _ladder(n, rung)
        scene.simulation(start="operating point", held={f"n{n // 2}": 0.5})
        first, equations, _ = formulate(scene_at_rest(scene, [f"C{n - 1}.v"], {}), (), None)
        assert len(equations.states) == (n if rung is _diode else 0)
        return len(first.system.dag)

    # Branch by branch the nodes grow fourfold and, with diodes eliminated, eightfold.
    assert n_nodes(2 * n) / n_nodes(n) < 2.2


def test_a_ladder_of_diodes_as_short_ones_are():
    """Potentials of parts for the long ladder, branches for the short: one operating point.

    Ten ladders side by side are one network of many unknowns, each with the solution of one alone.
    """
    one = _ladder(8, _diode)
    one.simulation(start="operating point")
    alone = one.compile().initial_state
    many = Scene("many")
    many.edge("V", "voltage_source", "n0", "ground", voltage=1.0)
    for k in range(10):
        nodes = ["n0", *(f"k{k}n{i}" for i in range(1, 9))]
        for i in range(8):
            many.edge(f"R{k}x{i}", "resistor", nodes[i], nodes[i + 1], resistance=1.0)
            many.edge(f"C{k}x{i}", "capacitor", nodes[i + 1], "ground", capacitance=1e-6)
            many.edge(f"D{k}x{i}", "diode", nodes[i + 1], f"m{k}x{i}", saturation_current=1e-12)
            many.edge(f"S{k}x{i}", "resistor", f"m{k}x{i}", "ground", resistance=1e3)
    # A bond of the ends, which makes one block of all and carries nothing.
    for k in range(9):
        many.edge(f"B{k}", "resistor", f"k{k}n8", f"k{k + 1}n8", resistance=1.0)
    many.simulation(start="operating point")
    # Newton's method leaves rounding of 1 V.
    found = many.compile().initial_state
    for first, wanted in ((0, alone[:8]), (80, alone[8:])):  # capacitors, then diodes
        np.testing.assert_allclose(found[first : first + 80], np.tile(wanted, 10), atol=1e-13)


def _amplifiers(n):
    """Stages that the collector of the one before biases through a resistor."""
    scene = Scene("amplifiers")
    scene.edge("V", "voltage_source", "top", "ground", voltage=12.0)
    for i in range(n):
        before, b, c, e = f"c{i - 1}" if i else "top", f"b{i}", f"c{i}", f"e{i}"
        for name, ends, value in (
            ("A", (before, b), 47e3),
            ("B", (b, "ground"), 22e3 if i else 10e3),
            ("C", ("top", c), 2.2e3),
            ("E", (e, "ground"), 470.0),
        ):
            scene.edge(f"R{name}{i}", "resistor", *ends, resistance=value)
        scene.edge(f"CE{i}", "capacitor", e, "ground", capacitance=1e-5)
        scene.edge(f"Q{i}", "bjt_npn", c, b, e, saturation_current=1e-14, forward_gain=100.0)
        for end in "bce":
            scene.edge(f"M{end}{i}", "current_source", f"{end}{i}", "ground", current=0.0)
    scene.simulation(start="operating point")
    return scene


def test_a_chain_of_transistors_is_sparse_and_meets_kirchhoff():
    n = 40
    scene = _amplifiers(n)
    wanted = [f"M{end}{i}.v" for i in range(n) for end in "bce"]
    program, _ = generate(formulate(scene_at_rest(scene, wanted, {}), (), None)[1])
    # A few unknowns in each equation: eliminated to the junctions, 80 times 80 entries are left.
    layout = program.layout
    assert len(layout.row_indices) < 6 * len(layout.states)
    model = BareModel(program, EvaluatedKernels(program))
    b, c, e = model.output_values(0.0, model.start().y).reshape(n, 3).T
    be, bc = (1e-14 * np.expm1((b - v) / 0.02585) for v in (e, c))
    into_c, into_b = be - bc - bc, be / 100.0 + bc
    before, below = np.append(12.0, c[:-1]), np.where(np.arange(n), 22e3, 10e3)
    feeds = (before - b) / 47e3
    after = np.append(feeds[1:], 0.0)
    # Rounding of 12 V by the steepest junction, 1 mA by 26 mV.
    np.testing.assert_allclose(feeds - b / below - into_b, 0.0, atol=1e-14)
    np.testing.assert_allclose((12.0 - c) / 2.2e3 - after - into_c, 0.0, atol=1e-13)
    np.testing.assert_allclose(into_b + into_c - e / 470.0, 0.0, atol=1e-13)
    assert np.ptp(c) > 1.0


def test_symbols_of_each_root_are_those_of_its_own_walk():
    dag = Dag()
    x = [dag.symbol("x", i) for i in range(70)]
    roots = [dag.constant(2.0), x[3], x[0] * x[69] + 1.0]
    for i in range(69):
        roots.append(roots[-1] * x[i] + dag.function("sin", x[i + 1]))
    for root, symbols in zip(roots, symbols_of_each(roots), strict=True):
        assert symbols == symbols_in([root])


def test_the_sparse_factors_are_those_of_the_full_matrix():
    dag = Dag()
    n = 12
    rows = [{i: dag.symbol("x", i) + 4.0} for i in range(n)]
    for i in range(n - 1):
        rows[i][i + 1] = rows[i + 1][i] = dag.symbol("x", n + i)
    rows[0][n - 1] = rows[n - 1][0] = dag.symbol("x", 2 * n)
    full = [[row.get(j, dag.zero) for j in range(n)] for row in rows]
    rhs = [dag.symbol("x", 30 + i) for i in range(n)]
    first, second = factorise(dag, full, [True] * n), factorise_definite(dag, rows)
    assert first.factors.pivots == second.factors.pivots
    assert first.solve(rhs) == second.solve(rhs)
