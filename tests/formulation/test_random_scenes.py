"""Random spatial and planar scenes: every route to the same equations gives the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
from fast_and_slow import seeds
from random_scenes import random_loop, random_scene

from cotree import Scene
from cotree.dag.derivative import tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import symbols_in
from cotree.equations import spread
from cotree.formulation.first_graph import form_first_graph
from cotree.pipeline import draw_graphs
from cotree.scene.graphs import joint_tree
from cotree.sensitivity.graphs import form_equations

# Values are sums of some hundred products of order one to a hundred; the two routes differ by
# their roundings, which stay four decades below this.
RELATIVE = 1e-10

AXES = [(), tuple(range(1, 99)), (1, 3), (2,)]


def equations(scene, own_axes, wanted=(), tree=None):
    _, trees = draw_graphs(scene, tree)
    return form_equations(form_first_graph(scene, joint_tree(scene, trees), own_axes), wanted)


def point(eqs, seed):
    """Random values of every symbol, the same for every route."""
    rng = np.random.default_rng(seed)
    values = {eqs.dag.symbol("t", 0): 0.3}
    n_states = len(eqs.states)
    for kind, n in (("u", 1), ("x", n_states), ("w", n_states), ("s", 4 * n_states)):
        for i, value in enumerate(rng.uniform(-1.0, 1.0, n)):
            values[eqs.dag.symbol(kind, i)] = float(value)
    for i, value in enumerate(eqs.parameter_values):
        values[eqs.dag.symbol("p", i)] = value
    return lambda nodes: np.array(evaluate(list(nodes), values))


def wanted_of(scene):
    return ["a", "b", "g", f"j1.{scene.edges['j1'].component.motion_space[0].name}"]


@pytest.mark.sampled(6)
@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("own_axes", AXES)
def test_mass_matrix_is_the_derivative_of_the_balances(seed, own_axes):
    eqs = equations(random_scene(seed, is_planar=seed % 2 == 0), own_axes)
    value = point(eqs, seed)
    matrix = np.array([value(row) for row in eqs.matrix])
    columns = [value(tangents(eqs.balances, {w: eqs.dag.one})) for w in eqs.unknowns]
    assert np.allclose(matrix, np.array(columns).T, rtol=RELATIVE, atol=RELATIVE)
    assert np.array_equal(matrix, matrix.T)
    assert np.linalg.eigvalsh(matrix).min() > 0.0
    residual = matrix @ value(eqs.unknowns) - value(eqs.forcing)
    assert np.allclose(residual, value(eqs.balances), rtol=RELATIVE, atol=RELATIVE)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", seeds(4, 6))
@pytest.mark.parametrize("own_axes", AXES)
def test_sensitivity_graphs_agree_with_differentiated_equations(seed, own_axes):
    scene = random_scene(seed, is_planar=seed % 2 == 0)
    eqs = equations(scene, own_axes, wanted_of(scene))
    value = point(eqs, seed)
    for row in (*eqs.sensitivities, *eqs.columns):
        direct = value(tangents(eqs.balances, row.seed))
        scale = max(1.0, np.abs(direct).max())
        assert np.abs(direct + value(row.forcing)).max() <= RELATIVE * scale, row.name
        direct = value(tangents(eqs.output_values, row.seed))
        scale = max(1.0, np.abs(direct).max())
        outputs = value(spread(row.outputs, len(eqs.outputs), eqs.dag.zero))
        assert np.abs(direct - outputs).max() <= RELATIVE * scale, row.name


@pytest.mark.sampled(4)
@pytest.mark.parametrize("seed", [0, 5, 9, 11])
@pytest.mark.parametrize("own_axes", AXES)
def test_sensitivity_graphs_of_loops_turn_what_a_multiplier_pulls_along(seed, own_axes):
    """A joint outside the loop turns its reactions, whose components in own axes are constant."""
    scene, tree = random_loop(seed, is_planar=seed % 4 == 0)
    eqs = equations(scene, own_axes, ["a", "b"], tree)
    value = point(eqs, seed)
    for row in (*eqs.sensitivities, *eqs.columns):
        direct = value(tangents(eqs.balances, row.seed))
        found = -value(row.forcing)[: len(direct)]
        scale = max(1.0, np.abs(direct).max())
        assert np.abs(direct - found).max() <= RELATIVE * scale, row.name


@pytest.mark.sampled(2)
@pytest.mark.parametrize("seed", seeds(4, 8))
def test_every_choice_of_axes_gives_the_same_equations(seed):
    found = []
    for own_axes in AXES:
        eqs = equations(random_scene(seed), own_axes)
        value = point(eqs, seed)
        found.append(np.concatenate([value(eqs.balances), value(eqs.output_values)]))
    for other in found[1:]:
        assert np.allclose(found[0], other, rtol=RELATIVE, atol=RELATIVE)


def test_a_planar_scene_reads_only_the_inertia_about_its_normal():
    """Principal inertias are parameters of their own here: the two in the plane are never read."""
    scene = Scene("planar", gravity=[0, -9.81, 0])
    for name in ("jx", "jy", "jz"):
        scene.parameter(name, 1.0)
    for i, before in enumerate(("ground", "B0")):
        scene.edge(f"r{i}", "arm", before, f"A{i}", vector=[1.0, 0.2, 0.0])
        scene.edge(f"h{i}", "revolute", f"A{i}", f"B{i}", axis=[0, 0, 1])
        scene.edge(f"m{i}", "rigid_body", "ground", f"B{i}", mass=1.0, inertia=["jx", "jy", "jz"])
    eqs = equations(scene, (), ["jx", "jz"])
    roots = [node for row in eqs.matrix for node in row] + [*eqs.balances, *eqs.forcing]
    names = {eqs.parameters[node.data[1]].name for node in symbols_in(roots) if node.data[0] == "p"}
    assert names == {"jz"}
