"""Derivatives of nodes: forward (tangents) and reverse (adjoints).

Component laws and expressions are differentiated here. Tests check sensitivity graphs against this.

``sqrt(max(x, 0))``, ``max(x, 0)**0.7``, ``sqrt(x + abs(x))`` and ``acos(min(x, 1))`` are constant
in one branch, in which the chain rule would multiply an infinite slope by zero. The derivative is
zero there, including the end of the branch. If the domain of a root ends at the zero of a
selection's condition, as in ``where(x < 0, 0, x*sqrt(x))``, the other side's derivative is used.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import product
from types import MappingProxyType

from cotree.dag.multi_output import SEVERAL, Function, LinearMap, call, results, sizes_of, solve
from cotree.dag.nodes import CHANGE, Dag, Node, reachable, substitute, symbols_in, ways_to_zero
from cotree.dag.operations import OPERATIONS

_BRANCHING = frozenset({"select", "abs", "sign"})

#: Maximum number of branches stored for a value; constants are kept first.
_MOST_BRANCHES = 16

#: Number of random points, and the fraction of its terms below which a sum counts as zero.
_N_PLACES, _ROUNDING = 3, 1e-12


def _excess_of_arcsine(x: Node) -> Node:
    return x.dag.function("abs", x) - 1.0


#: Operations that have a value but no finite derivative at certain arguments. Each function forms
#: an expression that is nonnegative at these arguments.
SINGULAR: dict[str, Callable[..., Node | None]] = {
    "sqrt": lambda x: -x,
    "log": lambda x: -x,
    # A constant exponent of one or more has a finite derivative at zero.
    "pow": lambda x, exponent: None if (exponent.value or 0.0) >= 1.0 else -x,
    "asin": _excess_of_arcsine,
    "acos": _excess_of_arcsine,
    "atan2": lambda y, x: -(x * x + y * y),
}


#: Operations with a finite derivative at any positive first argument.
_OF_POSITIVE = frozenset({"sqrt", "log", "pow"})


def _is_nonnegative(node: Node, *, is_strict: bool = False) -> bool:
    """Return whether a value is a sum of squares and nonnegative constants, one > 0 if strict."""
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
    """Chain rule that avoids 0 * inf if an argument has a constant branch at a singular point.

    For all other operations, the chain rule is a plain product. ``replacements`` are nodes that
    will replace symbols and may also have branches.
    """

    def __init__(self, replacements: Mapping[Node, Node]) -> None:
        self._replacements = replacements
        # Branches are formed in a separate graph, so that the main graph does not change.
        self._own = Dag()
        self._branches: dict[Node, tuple[Node, ...]] = {}
        self._values: dict[Node, tuple[float, ...]] = {}
        self._has_ends: dict[Node, bool] = {}
        self._random = random.Random(1)  # fixed seed: the same points in each run

    def forward(self, node: Node, partial: Node, d_arg: Node) -> Node:
        """Form the product of a partial derivative and the derivative of the argument."""
        term, dag = partial * d_arg, node.dag
        if node.op not in SINGULAR or term.is_zero:
            return term
        condition = self._reached(node)
        if condition is None and self._may_be_constant(node):
            condition = -dag.function("abs", d_arg)
        return term if condition is None else dag.select(condition, dag.zero, term)

    def reverse(self, node: Node, partial: Node, weight: Node) -> Node:
        """Form the product of a partial derivative and the adjoint of the operation."""
        term, dag = partial * weight, node.dag
        if (node.op not in SINGULAR and node.op != "div") or term.is_zero:
            return term
        condition = self._reached(node) if node.op in SINGULAR else None
        if condition is None and any(branch.is_zero for branch in self._of(weight)):
            # If another branch is selected, the adjoint is zero: an infinite partial has no effect.
            condition = -dag.function("abs", weight)
        return term if condition is None else dag.select(condition, dag.zero, term)

    def select(self, node: Node, above: Node, below: Node) -> Node:
        """Form a selection between the derivatives of the two sides of the selection ``node``.

        At the zero of the condition, the side whose domain does not end there is selected.
        """
        condition, *sides = node.args
        ends = above is not below and self._ends_at(condition, sides[0])
        if ends and not self._ends_at(condition, sides[1]):
            return node.dag.select(-condition, below, above)
        return node.dag.select(condition, above, below)

    def reaches(self, node: Node) -> bool:
        """Return whether the plain chain rule fails at an operation: it may yield 0 * inf."""
        if node.op == "select":
            return self._ends_at(*node.args[:2])
        return node.op in SINGULAR and self._reached(node) is not None

    def _ends_at(self, condition: Node, side: Node) -> bool:
        """Return whether an operation becomes singular at the zero of a branch's condition."""
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
            except (ArithmeticError, ValueError):  # undefined at the boundary
                continue
        return False

    def _branches_of_args(self, node: Node) -> Iterable[tuple[Node, ...]]:
        """Return the combinations of the arguments' branches, or none if all are regular."""
        if node.op in _OF_POSITIVE and _is_nonnegative(node.args[0], is_strict=True):
            return ()
        branches = [self._of(arg) for arg in node.args]
        return () if all(len(found) == 1 for found in branches) else product(*branches)

    def _reached(self, node: Node) -> Node | None:
        """Return a condition that is >= 0 in a constant singular branch, or None if none exists."""
        found = any(is_singular(node.op, args) for args in self._branches_of_args(node))
        return SINGULAR[node.op](*node.args) if found else None

    def _may_be_constant(self, node: Node) -> bool:
        """Return whether an argument may be constant in one branch and variable in another one."""
        formed = [SINGULAR[node.op](*args) for args in self._branches_of_args(node)]
        sets = [set(symbols_in([excess])) for excess in formed if excess is not None]
        # Constant branches are not singular here: _reached has tested them.
        return any(own and own != set().union(*sets) for own in sets)

    def _of(self, root: Node) -> tuple[Node, ...]:
        """Return the branches of a value, as nodes of the separate graph."""
        known = self._branches
        if root not in known:
            for node in reachable([root], stop=known):
                if node not in known:
                    # Evaluate first: a replacement of a symbol may contain the same symbol.
                    found = self._formed(node)
                    known.setdefault(node, found)
        return known[root]

    def _formed(self, node: Node) -> tuple[Node, ...]:
        own = self._own
        if node.value is not None:
            return (own.constant(node.value),)
        if node.op == "symbol":
            value = self._replacements.get(node)
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
            except (ArithmeticError, ValueError):  # these branches are undefined
                continue
            is_sum = node.op in ("add", "sub") and len(given[0]) + len(given[1]) > 2
            made.append(own.zero if is_sum and self._cancels(branch) else branch)
        return _kept(made) or (own.symbol("undefined", node.index),)

    def _cancels(self, total: Node) -> bool:
        """Return whether the two terms of a sum cancel at all random points."""
        if total.op not in ("add", "sub"):
            return False
        terms = [self._valued(arg) for arg in total.args]
        sums = zip(self._valued(total), *terms, strict=True)
        return all(abs(c) <= _ROUNDING * (abs(a) + abs(b)) for c, a, b in sums)

    def _valued(self, root: Node) -> tuple[float, ...]:
        """Return the values of a branch at random points, or nan if it is undefined."""
        known = self._values
        for node in reachable([root], stop=known) if root not in known else ():
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


Partial = Callable[["Node"], "Node"]
#: Nonzero partial derivatives of each result, by argument index.
Jacobian = list[dict[int, "Node"]]


def _d_asin(node: Node) -> Node:
    x = node.args[0]
    return 1.0 / node.dag.function("sqrt", 1.0 - x * x)


def _d_pow_base(node: Node) -> Node:
    base, exponent = node.args
    # exponent * node / base would be undefined for a base of zero.
    return exponent * node.dag.pow(base, exponent - 1.0)


def _d_pow_exponent(node: Node) -> Node:
    dag = node.dag
    # At a base of zero the logarithm is undefined, but the derivative is zero for positive
    # exponents. Hill's law needs this, since the initial amount of a species may be zero.
    is_zero = -dag.function("abs", node)
    return dag.select(is_zero, dag.zero, node * dag.function("log", node.args[0]))


def _norm2(node: Node) -> Node:
    y, x = node.args
    return x * x + y * y


#: Partial derivatives of each operation with respect to its arguments; None if zero. A selection
#: has the derivative of the selected branch; events treat the jump between branches.
PARTIALS: dict[str, tuple[Partial | None, ...]] = {
    "add": (lambda n: n.dag.one, lambda n: n.dag.one),
    "sub": (lambda n: n.dag.one, lambda n: -n.dag.one),
    "mul": (lambda n: n.args[1], lambda n: n.args[0]),
    "div": (lambda n: 1.0 / n.args[1], lambda n: -(n / n.args[1])),
    "neg": (lambda n: -n.dag.one,),
    "sqrt": (lambda n: 0.5 / n,),
    "sin": (lambda n: n.dag.function("cos", n.args[0]),),
    "cos": (lambda n: -n.dag.function("sin", n.args[0]),),
    "tan": (lambda n: n * n + 1.0,),
    "asin": (_d_asin,),
    "acos": (lambda n: -_d_asin(n),),
    "atan": (lambda n: 1.0 / (n.args[0] * n.args[0] + 1.0),),
    "sinh": (lambda n: n.dag.function("cosh", n.args[0]),),
    "cosh": (lambda n: n.dag.function("sinh", n.args[0]),),
    "tanh": (lambda n: 1.0 - n * n,),
    "exp": (lambda n: n,),
    "log": (lambda n: 1.0 / n.args[0],),
    "erf": (lambda n: 2.0 / math.sqrt(math.pi) * n.dag.function("exp", -(n.args[0] * n.args[0])),),
    "abs": (lambda n: n.dag.function("sign", n.args[0]),),
    "sign": (None,),
    "floor": (None,),
    "atan2": (lambda n: n.args[1] / _norm2(n), lambda n: -(n.args[0] / _norm2(n))),
    "pow": (_d_pow_base, _d_pow_exponent),
}


def _of_lookup(node: Node) -> Jacobian:
    values = results(node, len(node.data.results))
    return [{i: values[k] for i, k in row.items()} for row in node.data.partials]


def _of_sines(node: Node) -> Jacobian:
    # The first n results are sines, the last n cosines.
    n = len(node.args)
    values = results(node, 2 * n)
    return [*({i: values[n + i]} for i in range(n)), *({i: -values[i]} for i in range(n))]


def _of_call(node: Node) -> Jacobian:
    function: Function = node.data
    if function.partials is None:
        raise ArithmeticError(f"the function '{function.name}' has no partial derivatives")
    # ``partials`` returns the rows of the Jacobian one after the other.
    flat, width = call(node.dag, function.partials, node.args), len(node.args)
    rows = (flat[width * i : width * (i + 1)] for i in range(function.n_results))
    return [dict(enumerate(row)) for row in rows]


#: Partial derivatives of operations with several results, except linear systems and maps.
_JACOBIANS: dict[str, Callable[[Node], Jacobian]] = {
    "table": lambda node: [{0: results(node, 2)[1]}, {}],  # the slope is piecewise constant
    "lookup": _of_lookup,
    "sines": _of_sines,
    "call": _of_call,
}


def _tangents_of_several(node: Node, along: Sequence[Node]) -> list[Node]:
    """Return the tangents of all results of a node from the tangents of its arguments."""
    if node.op == "solve":
        return _tangents_of_solution(node, along)
    if node.op == "map":
        return _tangents_of_map(node, along)
    zero = node.dag.zero
    return [
        sum((partial * along[i] for i, partial in row.items()), zero)
        for row in _JACOBIANS[node.op](node)
    ]


def _adjoints_of_several(node: Node, weights: Sequence[Node]) -> list[Node]:
    """Return the adjoints of a node's arguments from the weights of its results."""
    if node.op == "solve":
        return _adjoints_of_solution(node, weights)
    if node.op == "map":
        return _adjoints_of_map(node, weights)
    bar = [node.dag.zero] * len(node.args)
    for row, weight in zip(_JACOBIANS[node.op](node), weights, strict=True):
        for i, partial in row.items():
            bar[i] = bar[i] + partial * weight
    return bar


def _tangents_of_solution(node: Node, along: Sequence[Node]) -> list[Node]:
    """Solve A dx = db - dA x with the matrix of the node."""
    dag, n = node.dag, node.data.size
    # Arguments of a `solve` node: matrix by rows, right-hand side, sizes if any, reference.
    matrix = [node.args[n * i : n * (i + 1)] for i in range(n)]
    x = results(node, n)
    right = list(along[n * n : n * n + n])
    for i in range(n):
        for j in range(n):
            right[i] = right[i] - along[n * i + j] * x[j]
    # With an identical matrix, the generated code factorises once for the value and derivatives.
    solved = solve(dag, matrix, right, node.args[-1], node.data, sizes_of(node))
    return [*solved[:n], dag.zero, dag.zero]  # rank and acceptance have no derivative


def _adjoints_of_solution(node: Node, weights: Sequence[Node]) -> list[Node]:
    """Return the adjoints of A x = b: b_bar = A^-T x_bar, A_bar = -b_bar x^T."""
    dag, n = node.dag, node.data.size
    transposed = [[node.args[n * j + i] for j in range(n)] for i in range(n)]
    b_bar = solve(dag, transposed, weights[:n], node.args[-1], node.data, sizes_of(node))[:n]
    x = results(node, n)
    a_bar = [-(b_bar[i] * x[j]) for i in range(n) for j in range(n)]
    return [*a_bar, *b_bar, *(dag.zero for _ in sizes_of(node)), dag.zero]


def _tangents_of_map(node: Node, along: Sequence[Node]) -> list[Node]:
    """Return the tangents of a map's results: its differentiated statements, for each column."""
    linear: LinearMap = node.data
    changes = [node.dag.symbol(CHANGE, i) for i in range(len(linear.inputs))]
    # Differentiate the statements once for all columns.
    once = tangents(linear.results, dict(zip(linear.inputs, changes, strict=True)))
    symbols, found = [*linear.inputs, *changes], []
    for own, d in zip(linear.given_to(node.args), linear.given_to(along), strict=True):
        found += substitute(once, dict(zip(symbols, [*own, *d], strict=True)))
    return found


def _adjoints_of_map(node: Node, weights: Sequence[Node]) -> list[Node]:
    """Return the adjoints of a map's arguments by reverse differentiation of its statements."""
    linear: LinearMap = node.data
    n, n_shared = len(linear.results), linear.n_shared
    changes = [node.dag.symbol(CHANGE, i) for i in range(n)]
    once = adjoints(linear.results, changes, linear.inputs)
    symbols, shared, rest = [*linear.inputs, *changes], [node.dag.zero] * n_shared, []
    for j, own in enumerate(linear.given_to(node.args)):
        given = [*own, *weights[n * j : n * (j + 1)]]
        back = substitute(once, dict(zip(symbols, given, strict=True)))
        # The adjoint of a shared value is the sum over all columns.
        shared = [a + b for a, b in zip(shared, back[:n_shared], strict=True)]
        rest += back[n_shared:]
    return [*shared, *rest]


def tangents(
    roots: Sequence[Node],
    seed: Mapping[Node, Node],
    replacements: Mapping[Node, Node] = MappingProxyType({}),
) -> list[Node]:
    """Return the derivative of each root along the direction ``seed``.

    ``seed`` maps symbols to their derivatives. It may also contain other nodes, whose arguments are
    then ignored. ``replacements`` are nodes that will later be substituted for symbols; they may
    have constant branches. Raise ArithmeticError if a root calls an external function without
    partial derivatives.
    """
    if not roots:
        return []
    zero = roots[0].dag.zero
    return [row.get(0, zero) for row in tangents_along(roots, [seed], replacements)]


def tangents_along(
    roots: Sequence[Node],
    seeds: Sequence[Mapping[Node, Node]],
    replacements: Mapping[Node, Node] = MappingProxyType({}),
) -> list[dict[int, Node]]:
    """Return the nonzero derivatives of each root along several directions, by direction index.

    See :func:`tangents` for the parameters. A node that occurs in some seeds is constant along all
    other directions.
    """
    return Tangents(seeds, Clips(replacements)).of(roots)


class Tangents:
    """Derivatives of nodes along several directions; the derivative of each node is cached."""

    def __init__(self, seeds: Sequence[Mapping[Node, Node]], clips: Clips) -> None:
        # Nodes with a zero seed also get a row, so that their arguments are not differentiated.
        self._known: dict[Node, dict[int, Node]] = {}
        for i, seed in enumerate(seeds):
            for node, d in seed.items():
                row = self._known.setdefault(node, {})
                if not d.is_zero:
                    row[i] = d
        self._several: dict[Node, dict[int, list[Node]]] = {}
        self._clips = clips

    def of(self, roots: Sequence[Node]) -> list[dict[int, Node]]:
        """Return the nonzero derivatives of each root, by direction index."""
        known = self._known
        for node in reachable(roots, stop=known):
            if node not in known:
                known[node] = self._formed(node)
        return [known[root] for root in roots]

    def _formed(self, node: Node) -> dict[int, Node]:
        if node.op == "result":
            all_of = self._several.get(node.args[0], {})
            row = {i: found[node.data] for i, found in all_of.items()}
        else:
            rows = [self._known[arg] for arg in node.args]
            along = dict.fromkeys(i for row in rows for i in row)
            zero = node.dag.zero
            changes = {i: [row.get(i, zero) for row in rows] for i in along}
            if node.op in SEVERAL:
                found = {i: _tangents_of_several(node, d) for i, d in changes.items()}
                self._several[node] = found
                return {}
            row = {i: _tangent(node, d, self._clips) for i, d in changes.items()}
        return {i: d for i, d in row.items() if not d.is_zero}


def _tangent(node: Node, d_args: Sequence[Node], clips: Clips) -> Node:
    op, zero = node.op, node.dag.zero
    if op == "add":
        return d_args[0] + d_args[1]
    if op == "sub":
        return d_args[0] - d_args[1]
    if op == "div":  # one division instead of two
        return (d_args[0] - node * d_args[1]) / node.args[1]
    if op == "select":
        return clips.select(node, d_args[1], d_args[2])
    total = zero
    for partial, d_arg in zip(PARTIALS[op], d_args, strict=True):
        if partial is not None and d_arg is not zero:
            total = total + clips.forward(node, partial(node), d_arg)
    return total


def tangent(root: Node, seed: Mapping[Node, Node]) -> Node:
    """Return the derivative of one root along a direction; see :func:`tangents`."""
    return tangents([root], seed)[0]


def adjoints(roots: Sequence[Node], weights: Sequence[Node], wanted: Sequence[Node]) -> list[Node]:
    """Return derivatives of ``sum(weights * roots)`` by independent variables ``wanted``."""
    if not roots:
        return []
    zero, leaves = roots[0].dag.zero, set(wanted)
    bar: dict[Node, Node] = {}
    several: dict[Node, list[Node]] = {}
    clips = Clips({})
    order = reachable(roots, stop=leaves)
    for root, weight in zip(roots, weights, strict=True):
        bar[root] = bar.get(root, zero) + weight
    # In reverse order of evaluation, the adjoint of a node is complete before it is propagated,
    # because all nodes that use it come earlier. A node with several results comes after all of
    # them.
    for node in reversed(order):
        if node.op in SEVERAL:
            if node in several:
                back = _adjoints_of_several(node, several[node])
                for arg, d in zip(node.args, back, strict=True):
                    bar[arg] = bar.get(arg, zero) + d
            continue
        own = bar.get(node, zero)
        if own is zero or node in leaves or not node.args:
            continue
        if node.op == "result":
            target = node.args[0]
            if target not in several:
                n_results = SEVERAL[target.op].n_results(target.data)
                several[target] = [zero] * n_results
            several[target][node.data] = several[target][node.data] + own
            continue
        if node.op == "select":  # not a product with zero, since the other branch may be undefined
            _, accepted, refused = node.args
            bar[accepted] = bar.get(accepted, zero) + clips.select(node, own, zero)
            bar[refused] = bar.get(refused, zero) + clips.select(node, zero, own)
            continue
        for arg, partial in zip(node.args, PARTIALS[node.op], strict=True):
            if partial is not None:
                bar[arg] = bar.get(arg, zero) + clips.reverse(node, partial(node), own)
    return [bar.get(node, zero) for node in wanted]
