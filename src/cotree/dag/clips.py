"""Derivatives of roots and powers at the end of their domain: the branch is chosen first.

``sqrt(max(x, 0))``, ``max(x, 0)**0.7``, ``sqrt(x + abs(x))`` and ``acos(min(x, 1))`` are constant
in one branch, in which the chain rule multiplies an infinite slope by zero. The derivative is zero
there, the end of the branch included. At the zero of its condition, a selection has the derivative
of the side without a root that ends there, as in ``where(x < 0, 0, x*sqrt(x))``.
"""

from __future__ import annotations

import math
import random
from itertools import product
from typing import TYPE_CHECKING

from cotree.dag.continuity import ways_to_zero
from cotree.dag.nodes import Dag, reachable, substitute, symbols_in
from cotree.dag.operations import OPERATIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.dag.nodes import Node

_BRANCHING = frozenset({"select", "abs", "sign"})

#: Largest number of branches of a value that are kept, constants first.
_MOST_BRANCHES = 16

#: The number of random points at which sums are evaluated. A sum below this fraction of its terms
#: at all of them is zero.
_N_PLACES, _ROUNDING = 3, 1e-12


def _excess_of_power(base: Node, exponent: Node) -> Node | None:
    # A constant exponent of one or more has a finite derivative at zero.
    return None if exponent.value is not None and exponent.value >= 1.0 else -base


def _excess_of_arcsine(x: Node) -> Node:
    return x.dag.function("abs", x) - 1.0


#: Operations with a value but no finite derivative at some arguments. Each function forms an
#: expression that is zero or more at these.
SINGULAR: dict[str, Callable[..., Node | None]] = {
    "sqrt": lambda x: -x,
    "log": lambda x: -x,
    "pow": _excess_of_power,
    "asin": _excess_of_arcsine,
    "acos": _excess_of_arcsine,
    "atan2": lambda y, x: -(x * x + y * y),
}


#: Operations with a finite derivative at any positive first argument.
_OF_POSITIVE = frozenset({"sqrt", "log", "pow"})


def _is_nonnegative(node: Node, *, is_strict: bool = False) -> bool:
    """Return whether a value is a sum of squares and of constants above zero.

    ``is_strict``: one of these constants is positive.
    """
    if node.value is not None:
        return node.value > 0.0 or (node.value == 0.0 and not is_strict)
    if node.op == "add":
        a, b = node.args
        return any(
            _is_nonnegative(x, is_strict=is_strict) and _is_nonnegative(y)
            for x, y in ((a, b), (b, a))
        )
    is_square = node.op == "mul" and node.args[0] is node.args[1]
    is_even = node.op == "pow" and node.args[1].value == 2.0
    return (is_square or is_even) and not is_strict


def is_singular(op: str, args: Sequence[Node]) -> bool:
    """Return whether an operation certainly has no finite derivative at its arguments."""
    excess = SINGULAR[op](*args) if op in SINGULAR else None
    return excess is not None and excess.value is not None and excess.value >= 0.0


class Clips:
    """Terms of the chain rule for operations whose arguments are constant in some branch.

    One object serves one traversal of a program. Terms of all other operations are plain products.
    ``standing`` are nodes that later replace symbols and may have branches, too.
    """

    def __init__(self, standing: Mapping[Node, Node]) -> None:
        self._standing = standing
        # Branches are formed in a separate arena, which leaves the numbers of nodes unchanged.
        self._own = Dag()
        self._branches: dict[Node, tuple[Node, ...]] = {}
        self._values: dict[Node, tuple[float, ...]] = {}
        self._has_ends: dict[Node, bool] = {}
        self._random = random.Random(1)  # the same points in each run

    def forward(self, node: Node, partial: Node, d_arg: Node) -> Node:
        """Form a partial derivative of an operation times the derivative of its argument."""
        term, dag = partial * d_arg, node.dag
        if node.op not in SINGULAR or term.is_zero:
            return term
        condition = self._reached(node)
        if condition is None and self._may_stand_still(node):
            condition = -dag.function("abs", d_arg)
        return term if condition is None else dag.select(condition, dag.zero, term)

    def reverse(self, node: Node, partial: Node, weight: Node) -> Node:
        """Form a partial derivative of an operation times the adjoint of its value."""
        term, dag = partial * weight, node.dag
        if (node.op not in SINGULAR and node.op != "div") or term.is_zero:
            return term
        condition = self._reached(node) if node.op in SINGULAR else None
        if condition is None and any(branch.is_zero for branch in self._of(weight)):
            # The value has no influence if another branch is taken.
            condition = -dag.function("abs", weight)
        return term if condition is None else dag.select(condition, dag.zero, term)

    def select(self, node: Node, above: Node, below: Node) -> Node:
        """Form the result of a selection between values that belong to its sides.

        At the zero of its condition, it is that of the side whose domain does not end there.
        """
        condition, *sides = node.args
        ends = above is not below and self._ends_at(condition, sides[0])
        if ends and not self._ends_at(condition, sides[1]):
            return node.dag.select(-condition, below, above)
        return node.dag.select(condition, above, below)

    def reaches(self, node: Node) -> bool:
        """Return whether the chain rule has no derivative at the end of a branch of a value."""
        if node.op == "select":
            return self._ends_at(*node.args[:2])
        return node.op in SINGULAR and self._reached(node) is not None

    def _ends_at(self, condition: Node, side: Node) -> bool:
        """Return whether a root or similar function in a side ends at the zero of a condition."""
        known = self._has_ends
        for node in reachable([side], stop=known):
            known.setdefault(node, node.op in SINGULAR or any(known[arg] for arg in node.args))
        if not known[side]:
            return False
        roots = [node for node in reachable(self._of(side)) if node.op in SINGULAR]
        ways = [way for own in self._of(condition) for way in ways_to_zero(own)]
        for way, node in product(ways, roots):
            try:
                if is_singular(node.op, substitute(node.args, way)):
                    return True
            except (ArithmeticError, ValueError):  # it has no value there
                continue
        return False

    def _reached(self, node: Node) -> Node | None:
        """Form an expression that is zero or more at the singular argument of a constant branch."""
        form = SINGULAR[node.op]
        if node.op in _OF_POSITIVE and _is_nonnegative(node.args[0], is_strict=True):
            return None
        branches = [self._of(arg) for arg in node.args]
        if all(len(found) == 1 for found in branches):
            return None
        found = any(is_singular(node.op, args) for args in product(*branches))
        return form(*node.args) if found else None

    def _may_stand_still(self, node: Node) -> bool:
        """Return whether a branch that may be singular lacks a symbol that another one has."""
        if node.op in _OF_POSITIVE and _is_nonnegative(node.args[0], is_strict=True):
            return False
        branches = [self._of(arg) for arg in node.args]
        if all(len(found) == 1 for found in branches):
            return False
        formed = [SINGULAR[node.op](*args) for args in product(*branches)]
        sets = [set(symbols_in([excess])) for excess in formed if excess is not None]
        # Constants without symbols are certainly not singular here.
        return any(own and own != set().union(*sets) for own in sets)

    def _of(self, root: Node) -> tuple[Node, ...]:
        """List the branches of a value, in the separate arena."""
        known = self._branches
        if root not in known:
            for node in reachable([root], stop=known):
                if node not in known:
                    # The symbol's replacement may be this node itself.
                    found = self._formed(node)
                    known.setdefault(node, found)
        return known[root]

    def _formed(self, node: Node) -> tuple[Node, ...]:
        own = self._own
        if node.value is not None:
            return (own.constant(node.value),)
        if node.op == "symbol":
            value = self._standing.get(node)
            return (own.symbol(*node.data),) if value is None else self._of(value)
        given = [self._branches[arg] for arg in node.args]
        if node.op == "select":
            return _kept([*given[1], *given[2]])
        if node.op == "abs":
            return _kept([side for x in given[0] for side in (x, -x)])
        if node.op == "sign":
            return (own.one, -own.one)
        made = []
        for args in product(*given):
            try:
                branch = own.rebuild(node, args)
            except (ArithmeticError, ValueError):  # this combination has no value
                continue
            is_sum = node.op in ("add", "sub") and len(given[0]) + len(given[1]) > 2
            made.append(own.zero if is_sum and self._cancels(branch) else branch)
        return _kept(made) or (own.symbol("undefined", node.index),)

    def _cancels(self, total: Node) -> bool:
        """Return whether the two terms of a sum are opposite at random places."""
        if total.op not in ("add", "sub"):
            return False
        terms = [self._valued(arg) for arg in total.args]
        sums = zip(self._valued(total), *terms, strict=True)
        return all(abs(c) <= _ROUNDING * (abs(a) + abs(b)) for c, a, b in sums)

    def _valued(self, root: Node) -> tuple[float, ...]:
        """Evaluate a branch at random points; nan if it has no value."""
        known = self._values
        for node in reachable([root], stop=known):
            if node in known:
                continue
            if node.value is not None:
                known[node] = (node.value,) * _N_PLACES
            elif node.op in OPERATIONS:
                given = zip(*[known[arg] for arg in node.args], strict=True)
                known[node] = tuple(OPERATIONS[node.op].real(*args) for args in given)
            elif node.op == "symbol":
                known[node] = tuple(self._random.uniform(0.3, 2.0) for _ in range(_N_PLACES))
            else:
                known[node] = (math.nan,) * _N_PLACES
        return known[root]


def _kept(branches: list[Node]) -> tuple[Node, ...]:
    different = dict.fromkeys(branches)
    return tuple(sorted(different, key=lambda node: node.value is None)[:_MOST_BRANCHES])
