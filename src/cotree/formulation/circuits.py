"""f-circuits as prefix sums over the tree, for vectors resolved in the bases of the clusters."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.dag import vector

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.dag.vector import Vector
    from cotree.formulation.clusters import Branch, Clusters
    from cotree.formulation.frames import Frames


@dataclass(frozen=True)
class Circuits:
    """Sums of an across variable along paths of the tree, each formed once.

    Attributes
    ----------
    clusters, frames : Clusters, Frames
        Topology and bases.
    across : callable
        The across variable of a branch, in the basis of its parent.
    known : Circuits or None
        The first graph's, where this is a sensitivity graph's: they serve where nothing changes.
    """

    clusters: Clusters
    frames: Frames
    across: Callable[[Branch], Vector]
    known: Circuits | None = None
    _sums: dict[tuple[int, int], Vector] = field(default_factory=dict)

    def between(self, ancestor: int, cluster: int, zero: Vector) -> Vector:
        """Sum from an ancestor's origin to a cluster's, in the ancestor's basis.

        Parameters
        ----------
        ancestor, cluster : int
            Where the path begins and ends.
        zero : Vector
            The empty sum.

        References
        ----------
        [1] eq. 2.
        """
        if self.known is not None and self.frames.is_kept(cluster):
            return self.known.between(ancestor, cluster, zero)
        total = zero
        for branch in self.clusters.path(cluster, ancestor):
            # Paths from one ancestor share their beginnings, so that each sum extends a known one
            # by one term.
            key = (ancestor, branch.child)
            if key not in self._sums:
                # Sums are formed in the basis of the ancestor, not in that of the branch's parent.
                step = inwards(
                    self.clusters, self.frames, self.across(branch), branch.parent, ancestor
                )
                self._sums[key] = vector.add(total, step)
            total = self._sums[key]
        return total


def inwards(clusters: Clusters, frames: Frames, a: Vector, cluster: int, ancestor: int) -> Vector:
    """Resolve a vector of a cluster's basis in an ancestor's.

    Parameters
    ----------
    clusters, frames : Clusters, Frames
        The clusters and their bases.
    a : Vector
        The vector.
    cluster, ancestor : int
        The bases before and after.
    """
    while cluster != ancestor:
        # Bases change one branch at a time; where a cluster shares its parent's basis nothing is
        # formed.
        a = frames.up(cluster, a)
        branch = clusters.branches[cluster]
        assert branch is not None
        cluster = branch.parent
    return a


def outwards(clusters: Clusters, frames: Frames, a: Vector, ancestor: int, cluster: int) -> Vector:
    """Resolve a vector of an ancestor's basis in a cluster's.

    Parameters
    ----------
    clusters, frames : Clusters, Frames
        The clusters and their bases.
    a : Vector
        The vector.
    ancestor, cluster : int
        The bases before and after.
    """
    for branch in clusters.path(cluster, ancestor):
        a = frames.down(branch.child, a)
    return a
