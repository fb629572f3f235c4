"""Roots whose slope is infinite on both sides of zero, and their replacement near zero.

A flow with the law ``sign(v)*sqrt(abs(v))`` comes to rest in a finite time, but the law has no
derivative at rest. Within a band of half-width b around zero, the root r(z) is replaced by
``r(b)*(z/b)**3``, whose slope is zero at rest. If the law drives the state to zero from both sides,
the solutions with both laws remain within the band and differ by at most b. The engine sets b to
the tolerance of z while z is near zero (``templates/runtime/hybrid/cotree_branches.c``); otherwise
b is zero or negative, and the root is exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.dag.derivative import SINGULAR, is_singular, tangent
from cotree.dag.nodes import substitute, ways_to_zero

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from cotree.dag.nodes import Node


def find_roots(
    nodes: Iterable[Node], condition: Node, is_same: Callable[[Node], bool]
) -> dict[Node, Node] | None:
    """Return the roots whose domain ends at the zero of a condition, each with its signed argument.

    ``is_same`` returns whether a value has the same zero as the condition and changes sign there.
    The result is None if the domain of another operation ends at this zero, or if an argument
    touches zero with a slope of zero.
    """
    found: dict[Node, Node] = {}
    for way in ways_to_zero(condition):
        moved = next(reversed(way))
        for node in nodes:
            if node.op not in SINGULAR or node in found or not ends(node, way):
                continue
            if node.op not in ("sqrt", "pow"):
                return None
            signed = _signed(node.args[0], is_same)
            slope = tangent(signed, {moved: condition.dag.one})
            if substitute([slope], way)[0].is_zero:
                return None
            found[node] = signed
    return found or None


def ends(node: Node, way: Mapping[Node, Node]) -> bool:
    """Return whether the domain of an operation ends at the zero of a condition."""
    first, *others = substitute(node.args, way)
    if node.op == "pow":
        return first.value is not None and first.value <= 0.0
    return is_singular(node.op, (first, *others))


def _signed(value: Node, is_same: Callable[[Node], bool]) -> Node:
    """Return a value in which the absolute value of the condition is replaced by the condition."""
    known: dict[Node, Node] = {}
    stack = [value]
    while stack:
        node = stack.pop()
        if node.op == "abs" and is_same(node.args[0]):
            known[node] = node.args[0]
        else:
            stack += node.args
    return substitute([value], known)[0]


def _exponent(root: Node) -> Node:
    return root.dag.constant(0.5) if root.op == "sqrt" else root.args[1]


@dataclass(frozen=True)
class SteepRoots:
    """Roots with their signed arguments, and the replacement of roots near zero."""

    signed: Mapping[Node, Node]

    @cached_property
    def _slopes(self) -> dict[Node, Node]:
        """Powers that occur in the derivatives of the roots, each with its root."""
        return {root.dag.pow(root.args[0], _exponent(root) - 1.0): root for root in self.signed}

    def root_of(self, node: Node) -> Node | None:
        """Return the root if a value is a root or the slope of one, else None."""
        if node.op == "div" and node.args[1].op == "sqrt":
            node = node.args[1]
        node = self._slopes.get(node, node)
        return node if node in self.signed else None

    def replaced(self, node: Node, args: tuple[Node, ...], distance: Node, width: Node) -> Node:
        """Form a root, or a part of its slope, with the replacement inside the band.

        ``node`` is the root r, a quotient c/r, or a power z**(e - 1); ``args`` are its new
        arguments, for a quotient c and z. ``distance`` is z with its sign, ``width`` the half-width
        b of the band.
        """
        dag, root = node.dag, self.root_of(node)
        assert root is not None
        z = args[0] if node.op != "div" else args[1]
        exponent = _exponent(root)
        share = z / width
        inside = dag.pow(width, exponent) * share * share
        if node is root:
            exact = dag.rebuild(node, args)
            inside = inside * share
        elif node.op == "div":  # c/r contributes 2 c r'
            exact = args[0] / dag.function("sqrt", z)
            inside = args[0] * (6.0 * inside / width)
        else:  # z**(e - 1) contributes r'/e
            exact = dag.rebuild(node, args)
            inside = 3.0 * inside / (exponent * width)
        return dag.select(dag.function("abs", distance) - width, exact, inside)
