"""Walks over a program's nodes: reachable nodes, and the substitution of other symbols."""

from __future__ import annotations

from operator import attrgetter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node

_by_index = attrgetter("index")


def reachable(roots: Iterable[Node], stop: Container[Node] = ()) -> list[Node]:
    """List every node that the roots depend on, themselves included, in order of evaluation.

    Nodes of ``stop`` are listed, but what they depend on is not followed.
    """
    found = set(roots)
    stack = list(found)
    while stack:
        node = stack.pop()
        if node in stop:
            continue
        for arg in node.args:
            if arg not in found:
                found.add(arg)
                stack.append(arg)
    # A node is made after its arguments, so its index is an order of evaluation.
    return sorted(found, key=_by_index)


def dependent(nodes: Iterable[Node], sources: Iterable[Node]) -> set[Node]:
    """Give the sources and those of ``nodes`` (in order of evaluation) that depend on them."""
    marked = set(sources)
    for node in nodes:
        # In order of evaluation, all arguments have been decided on.
        if any(arg in marked for arg in node.args):
            marked.add(node)
    return marked


def substitute(roots: Iterable[Node], replacement: Mapping[Node, Node]) -> list[Node]:
    """Rebuild the roots with some nodes replaced; values that do not depend on them stay.

    Parameters
    ----------
    roots : iterable of Node
        The values wanted.
    replacement : mapping of Node to Node
        The new node for each node that is replaced.

    Returns
    -------
    list of Node
        The new values, in the order of ``roots``.
    """
    roots = list(roots)
    new: dict[Node, Node] = dict(replacement)
    # The walk ends at replaced nodes. Their arguments are rebuilt only where another path leads.
    for node in reachable(roots, stop=replacement):
        if node in replacement:
            continue
        made = rebuilt(node, new)
        if made is not node:
            new[node] = made
    return [new.get(root, root) for root in roots]


def rebuilt(node: Node, new: Mapping[Node, Node]) -> Node:
    """Rebuild a value from what replaces its arguments; it keeps its origin."""
    args = tuple([new.get(arg, arg) for arg in node.args])
    if args == node.args:
        return node
    # Rebuilding folds: what replaces an argument may make the value simpler.
    made = node.dag.rebuild(node, args)
    if node in node.dag.origins:
        node.dag.note_origin(made, node.dag.origins[node])
    return made


def symbols_of_each(
    roots: Sequence[Node], among: Container[Node] | None = None
) -> list[list[Node]]:
    """List the symbols that each root depends on, in one walk over all of them.

    The symbols of a value are an integer with one bit for each, of those in ``among`` if given.
    """
    walk = reachable(roots)
    symbols = [node for node in walk if node.op == "symbol" and (among is None or node in among)]
    masks = {node: 1 << i for i, node in enumerate(symbols)}
    for node in walk:
        if node.args:
            mask = 0
            for arg in node.args:
                # Sets as integers: a union is one operation, however many symbols there are.
                mask |= masks.get(arg, 0)
            masks[node] = mask
    known: dict[int, list[Node]] = {}
    for root in roots:
        mask = masks.get(root, 0)
        if mask not in known:
            digits = bin(mask)[:1:-1]  # the lowest first
            known[mask] = [symbols[i] for i, digit in enumerate(digits) if digit == "1"]
    return [known[masks.get(root, 0)] for root in roots]


def symbols_in(roots: Iterable[Node]) -> list[Node]:
    """List the symbols that the roots depend on."""
    return [node for node in reachable(roots) if node.op == "symbol"]
