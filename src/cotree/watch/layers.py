"""Layers of the bodies of a plane: neighbours in a joint lie in different ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components import Role

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.formulation.fields import BoundEdge
    from cotree.watch.poses import Place


def layers_of(edges: Iterable[BoundEdge], places: Mapping[str, Place], n: int) -> list[int]:
    """Give each cluster the lowest layer that no neighbour of a smaller number has.

    Parameters
    ----------
    edges : iterable of BoundEdge
        Their joints and constraints make neighbours.
    places : mapping of str to Place
        Where the nodes are.
    n : int
        Number of clusters.
    """
    neighbours: list[set[int]] = [set() for _ in range(n)]
    for edge in edges:
        if edge.component.role in (Role.JOINT, Role.CONSTRAINT):
            a, b = (places[name].cluster for name in (edge.first, edge.second))
            neighbours[max(a, b)].add(min(a, b))
    layers = [0] * n
    # A greedy colouring: only neighbours of smaller numbers have their layers already.
    for cluster in range(1, n):
        # The ground takes no layer.
        taken = {layers[other] for other in neighbours[cluster] if other}
        layers[cluster] = next(i for i in range(n) if i not in taken)
    return layers
