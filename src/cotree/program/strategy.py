"""Which axes to resolve each cluster in: try, count, keep the cheapest."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

from cotree.dag.traverse import reachable, substitute
from cotree.formulation.elimination import factorise, substitute_back
from cotree.formulation.first_graph import form_first_graph
from cotree.graph import tree_walk
from cotree.program.counts import count_operations
from cotree.sensitivity.graphs import form_derivatives

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cotree.formulation.first_graph import FirstGraph
    from cotree.graph import Tree
    from cotree.scene.description import SceneDescription

_FEW = 3  # turning clusters up to which every choice is tried


@dataclass(frozen=True)
class Alternative:
    """One way to resolve the clusters, and what it costs.

    Attributes
    ----------
    own_axes : tuple of int
        The clusters resolved in their own axes.
    n_operations : int
        Estimated operations of the right-hand side with all sensitivities.
    """

    own_axes: tuple[int, ...]
    n_operations: int


def choose_first_graph(
    scene: SceneDescription, tree: Tree, sensitivities: Sequence[str]
) -> tuple[FirstGraph, tuple[Alternative, ...]]:
    """Form the first graph in the axes that cost least.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    tree : Tree
        The tree of its joints.
    sensitivities : sequence of str
        What sensitivities are wanted to.

    Returns
    -------
    first : FirstGraph
        The cheapest.
    alternatives : tuple of Alternative
        All that were tried, the cheapest first.
    """
    found: list[tuple[Alternative, FirstGraph]] = []
    for own_axes in _choices(scene, tree):
        first = form_first_graph(scene, tree, own_axes)
        found.append((Alternative(own_axes, _estimate(first, sensitivities)), first))
    found.sort(key=lambda item: item[0].n_operations)
    return found[0][1], tuple(item[0] for item in found)


def _choices(scene: SceneDescription, tree: Tree) -> Iterator[tuple[int, ...]]:
    """List sets of clusters: all sets of a few, else none and all."""
    turning = []
    cluster = 0  # numbered as the walk meets the freedoms that carry them
    for step in tree_walk(tree):
        for freedom in scene.edges[step.edge].component.motion_space[:: step.sign]:
            cluster += 1
            if freedom.rotates:
                turning.append(cluster)
    if len(turning) > _FEW:
        yield ()
        yield tuple(turning)
        return
    for size in range(len(turning) + 1):
        yield from combinations(turning, size)


def _estimate(first: FirstGraph, sensitivities: Sequence[str]) -> int:
    """Count the right-hand side, and one sensitivity in place of all."""
    factors = factorise(first.system.dag, first.matrix, first.is_safe)
    unknowns = substitute_back(factors, first.forcing)
    alone = count_operations(reachable(unknowns)).total
    if not sensitivities:
        return alone
    row = form_derivatives(first, sensitivities[len(sensitivities) // 2 :][:1])[0]
    solved = dict(zip(first.unknowns, unknowns, strict=True))
    tangents = substitute_back(factors, substitute(row.forcing, solved))
    both = count_operations(reachable([*unknowns, *tangents])).total
    return alone + len(sensitivities) * (both - alone)
