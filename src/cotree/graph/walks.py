"""Walks over the tree: f-circuits as prefix sums, f-cutsets as suffix sums.

In: a `Tree` and one value for each branch or chord. Out: the across variable of every node, the
through variable of every branch, in O(n) additions. What two equations share is shared by
construction. The values may be of any type that adds and subtracts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from cotree.graph.traversal import Step, walk_edges

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.graph.tree import Tree


class _Addable(Protocol):
    def __add__(self, other: Any, /) -> Any: ...
    def __sub__(self, other: Any, /) -> Any: ...


T = TypeVar("T", bound=_Addable)

_NUMBER_ZERO: Any = 0


def tree_walk(tree: Tree) -> tuple[Step, ...]:
    """Walk the tree from the reference node outwards.

    Parameters
    ----------
    tree : Tree
        The tree.

    Returns
    -------
    tuple of Step
        One step a branch: parents before children, siblings in edge order.
    """
    return walk_edges(tree.graph, tree.branches, tree.graph.reference)


def prefix_sums(tree: Tree, values: Mapping[str, T], zero: T = _NUMBER_ZERO) -> dict[str, T]:
    """Sum branch values along the path from the reference to each node.

    The across variable of an edge is then the sum at its head minus the sum at its tail, which is
    its f-circuit equation.

    Parameters
    ----------
    tree : Tree
        The tree.
    values : mapping of str to T
        Across variable of each branch.
    zero : T
        The value at the reference; needed for types that do not add to the number 0.

    Returns
    -------
    dict of str to T
        Across variable of each node relative to the reference.
    """
    sums = {tree.graph.reference: zero}
    for step in tree_walk(tree):
        before, value = sums[step.parent], values[step.edge]
        sums[step.child] = before + value if step.sign > 0 else before - value
    return sums


def suffix_sums(tree: Tree, values: Mapping[str, T], zero: T = _NUMBER_ZERO) -> dict[str, T]:
    """Sum chord values from the leaves towards the reference.

    Parameters
    ----------
    tree : Tree
        The tree.
    values : mapping of str to T
        Through variable of each chord.
    zero : T
        The empty sum; needed for types that do not add to the number 0.

    Returns
    -------
    dict of str to T
        Through variable of each branch, in edge order, such that its f-cutset equation holds:
        through of the branch + signed sum of the chords in its f-cutset = 0.
    """
    # Sum of what leaves each node by chords, then of what leaves the whole subtree behind it.
    leaving = dict.fromkeys(tree.graph.nodes, zero)
    for name in tree.chords:
        edge, value = tree.graph.edge(name), values[name]
        leaving[edge.tail] = leaving[edge.tail] + value
        leaving[edge.head] = leaving[edge.head] - value
    through: dict[str, T] = {}
    for step in reversed(tree_walk(tree)):
        total = leaving[step.child]
        leaving[step.parent] = leaving[step.parent] + total
        through[step.edge] = total if step.sign > 0 else zero - total
    return {name: through[name] for name in tree.branches}
