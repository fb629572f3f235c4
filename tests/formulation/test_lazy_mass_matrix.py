"""Deep trees: the mass matrix is formed where it is asked for, and nobody asks for it."""

from __future__ import annotations

import numpy as np
import pytest
from rod_chain import rod_chain

import cotree
from cotree.dag.evaluate import evaluate
from cotree.formulation.mass_matrix import LateMatrix
from cotree.pipeline import formulate
from cotree.program.solved import SolvedSystem


def _equations(n):
    _, equations, alternatives = formulate(rod_chain(n)[0], (), None)
    return equations, alternatives


@pytest.mark.slow
def test_a_long_chain_is_eliminated_along_its_tree_only():
    equations, alternatives = _equations(60)
    assert all(row.is_along_tree for row in alternatives)
    assert isinstance(equations.matrix, LateMatrix)
    assert equations.matrix._upper is None
    assert {row.is_along_tree for row in _equations(20)[1]} == {False, True}


def test_many_short_branches_are_not_deep():
    scene = cotree.Scene("brush", gravity=[0, -9.81, 0])
    for i in range(80):
        scene.edge(f"h{i}", "revolute", "ground", f"B{i}", axis=[0, 0, 1])
        scene.edge(f"b{i}", "rigid_body", "ground", f"B{i}", mass=1.0, inertia=0.1)
    assert {row.is_along_tree for row in formulate(scene, (), None)[2]} == {False, True}


@pytest.mark.slow
def test_both_eliminations_give_the_same_accelerations():
    n = 60
    equations, _ = _equations(n)
    solved = SolvedSystem.of(equations).unknowns
    rng = np.random.default_rng(5)
    values = {s.symbol: rng.uniform(-1.0, 1.0) for s in equations.states}
    values |= {equations.dag.symbol("p", i): v for i, v in enumerate(equations.parameter_values)}
    matrix = np.array([evaluate(row, values) for row in equations.matrix], dtype=float)
    assert np.array_equal(matrix, matrix.T)
    forcing = np.array(evaluate(equations.forcing, values), dtype=float)
    found = np.array(evaluate([solved[w] for w in equations.unknowns], values), dtype=float)
    # What is lost to rounding grows with the condition of the matrix, about 1e6 at 60 rods.
    assert np.allclose(matrix @ found, forcing, rtol=0.0, atol=1e-9 * np.abs(forcing).max())
    assert equations.matrix[n:] == []
    with pytest.raises(IndexError):
        equations.matrix[n]
