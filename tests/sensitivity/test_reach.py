"""A sensitivity graph visits only what its seed reaches."""

from __future__ import annotations

import pytest
from rod_chain import rod_chain

from cotree.dag.dual import is_varied
from cotree.formulation.across import move
from cotree.formulation.first_graph import form_first_graph
from cotree.pipeline import draw_graphs
from cotree.scene.graphs import joint_tree
from cotree.sensitivity.graphs import differentiate, state_columns
from cotree.sensitivity.turning import Seed, Support, turn_axes

N = 12


@pytest.fixture
def first():
    scene, _ = rod_chain(N)
    _, trees = draw_graphs(scene, None)
    return form_first_graph(scene, joint_tree(scene, trees))


def moved_along(first, symbol):
    dag, motion = first.system.dag, first.motion
    frames = turn_axes(motion, Seed(dag, {symbol: dag.one}, Support()))
    return move(first.system, motion.clusters, frames, motion)


@pytest.mark.parametrize("place", [0, 5, N - 1])
def test_a_coordinate_reaches_the_clusters_beyond_its_joint(first, place):
    moved = moved_along(first, first.states[place].symbol)
    assert moved.frames.reached == set(range(place + 1, N + 1))
    kept = [own is known for own, known in zip(moved.geometry, first.motion.geometry, strict=True)]
    assert kept == [branch < place for branch in range(N)]


def test_a_mass_moves_nothing(first):
    moved = moved_along(first, first.system.parameters["m3"])
    assert not moved.frames.reached
    assert moved.geometry == first.motion.geometry
    assert not is_varied(*moved.omega)


def test_columns_of_outer_joints_cost_less(first):
    """Nodes made for a column shrink with the part of the chain beyond its joint."""
    dag, made = first.system.dag, []
    for state in first.states[:N]:
        before = len(dag)
        differentiate(first, {state.name: {state.symbol: dag.one}}, Support())[0]
        made.append(len(dag) - before)
    assert made[-1] < made[N // 2] < made[1]
    assert len(state_columns(first, Support())) == 2 * N
