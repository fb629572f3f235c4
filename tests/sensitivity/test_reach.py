"""A sensitivity graph visits only what its seed reaches."""

from __future__ import annotations

import pytest
from rod_chain import rod_chain

from cotree.formulation.first_graph import form_first_graph
from cotree.pipeline import draw_graphs
from cotree.scene.graphs import joint_tree
from cotree.sensitivity.across import move_tangent
from cotree.sensitivity.graphs import differentiate, state_columns
from cotree.sensitivity.seed import Seed, Support

N = 12


@pytest.fixture
def first():
    scene, _ = rod_chain(N)
    _, trees = draw_graphs(scene, None)
    return form_first_graph(scene, joint_tree(scene, trees))


@pytest.mark.parametrize("place", [0, 5, N - 1])
def test_a_coordinate_reaches_the_clusters_beyond_its_joint(first, place):
    seed = Seed(first.system.dag, {first.states[place].symbol: first.system.dag.one}, Support())
    moved = move_tangent(first.motion, seed)
    reached = [phi is not None for phi in moved.phi]
    assert reached == [cluster > place for cluster in range(N + 1)]
    assert sum(geometry is not None for geometry in moved.geometry) == N - place


def test_a_mass_moves_nothing(first):
    symbol = first.system.parameters["m3"]
    moved = move_tangent(
        first.motion, Seed(first.system.dag, {symbol: first.system.dag.one}, Support())
    )
    assert all(phi is None for phi in moved.phi)
    assert all(geometry is None for geometry in moved.geometry)


def test_columns_of_outer_joints_cost_less(first):
    """Nodes made for a column shrink with the part of the chain beyond its joint."""
    dag, made = first.system.dag, []
    for state in first.states[:N]:
        before = len(dag)
        differentiate(first, {state.name: {state.symbol: dag.one}}, Support())[0]
        made.append(len(dag) - before)
    assert made[-1] < made[N // 2] < made[1]
    assert len(state_columns(first, Support())) == 2 * N
