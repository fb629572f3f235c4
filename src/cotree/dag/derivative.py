"""Derivatives of a program: forward (tangents) and reverse (adjoints) over its nodes.

They serve component laws, expressions, and the independent check of the sensitivity graphs; the
sensitivity equations themselves come from the graphs (:mod:`cotree.sensitivity`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from cotree.dag.multi_output import SEVERAL
from cotree.dag.traverse import reachable

if TYPE_CHECKING:
    from cotree.dag.nodes import Node

Partial = Callable[["Node"], "Node"]


def _d_abs(node: Node) -> Node:
    return node.dag.function("sign", node.args[0])


def _d_tan(node: Node) -> Node:
    return node * node + 1.0


def _d_asin(node: Node) -> Node:
    x = node.args[0]
    return 1.0 / node.dag.function("sqrt", 1.0 - x * x)


def _d_pow_base(node: Node) -> Node:
    base, exponent = node.args
    return exponent * node.dag.pow(base, exponent - 1.0)


def _d_pow_exponent(node: Node) -> Node:
    return node * node.dag.function("log", node.args[0])


def _d_erf(node: Node) -> Node:
    x = node.args[0]
    return 2.0 / math.sqrt(math.pi) * node.dag.function("exp", -(x * x))


def _norm2(node: Node) -> Node:
    y, x = node.args
    return x * x + y * y


#: Partial derivatives by operation, one for each argument; None where it is zero.
PARTIALS: dict[str, tuple[Partial | None, ...]] = {
    "add": (lambda n: n.dag.one, lambda n: n.dag.one),
    "sub": (lambda n: n.dag.one, lambda n: -n.dag.one),
    "mul": (lambda n: n.args[1], lambda n: n.args[0]),
    "div": (lambda n: 1.0 / n.args[1], lambda n: -(n / n.args[1])),
    "neg": (lambda n: -n.dag.one,),
    "sqrt": (lambda n: 0.5 / n,),
    "sin": (lambda n: n.dag.function("cos", n.args[0]),),
    "cos": (lambda n: -n.dag.function("sin", n.args[0]),),
    "tan": (_d_tan,),
    "asin": (_d_asin,),
    "acos": (lambda n: -_d_asin(n),),
    "atan": (lambda n: 1.0 / (n.args[0] * n.args[0] + 1.0),),
    "sinh": (lambda n: n.dag.function("cosh", n.args[0]),),
    "cosh": (lambda n: n.dag.function("sinh", n.args[0]),),
    "tanh": (lambda n: 1.0 - n * n,),
    "exp": (lambda n: n,),
    "log": (lambda n: 1.0 / n.args[0],),
    "erf": (_d_erf,),
    "abs": (_d_abs,),
    "sign": (None,),
    "floor": (None,),
    "atan2": (lambda n: n.args[1] / _norm2(n), lambda n: -(n.args[0] / _norm2(n))),
    "pow": (_d_pow_base, _d_pow_exponent),
    "select": (
        None,
        lambda n: n.dag.select(n.args[0], n.dag.one, n.dag.zero),
        lambda n: n.dag.select(n.args[0], n.dag.zero, n.dag.one),
    ),
}


def tangents(roots: Sequence[Node], seed: Mapping[Node, Node]) -> list[Node]:
    """Differentiate forward: the derivative of each root in the direction of the seed.

    Parameters
    ----------
    roots : sequence of Node
        The values to differentiate.
    seed : mapping of Node to Node
        Derivative of each symbol; symbols that are absent are constant. Other values may be
        seeded too: their own arguments are then not followed.

    Returns
    -------
    list of Node
        Derivatives of the roots.

    Raises
    ------
    ArithmeticError
        If a root calls an external function without partial derivatives.
    """
    if not roots:
        return []
    zero = roots[0].dag.zero
    return [row.get(0, zero) for row in tangents_along(roots, [seed])]


def tangents_along(
    roots: Sequence[Node], seeds: Sequence[Mapping[Node, Node]]
) -> list[dict[int, Node]]:
    """Differentiate forward along several directions at once, each where anything changes.

    Parameters
    ----------
    roots : sequence of Node
        The values to differentiate.
    seeds : sequence of mapping of Node to Node
        For each direction, what :func:`tangents` takes. What one direction seeds, the others hold,
        unless they seed it, too.

    Returns
    -------
    list of dict of int to Node
        For each root, its derivatives by number of the direction, those that vanish left out.

    Raises
    ------
    ArithmeticError
        If a root calls an external function without partial derivatives.
    """
    seeded: dict[Node, dict[int, Node]] = {}
    for i, seed in enumerate(seeds):
        for node, d in seed.items():
            seeded.setdefault(node, {})
            if not d.is_zero:
                seeded[node][i] = d
    known = {node: row for node, row in seeded.items() if row}
    several: dict[Node, dict[int, tuple[Node, ...]]] = {}
    for node in reachable(roots, stop=seeded):
        if node in seeded or not node.args:
            continue
        if node.op == "result":
            all_of = several.get(node.args[0], {})
            row = {i: found[node.data] for i, found in all_of.items()}
        else:
            rows = [known.get(arg, {}) for arg in node.args]
            along = dict.fromkeys(i for row in rows for i in row)
            if not along:
                continue
            zero = node.dag.zero
            changes = {i: [row.get(i, zero) for row in rows] for i in along}
            if node.op in SEVERAL:
                tangent_of = SEVERAL[node.op].tangent
                several[node] = {i: tangent_of(node, d) for i, d in changes.items()}
                continue
            row = {i: _tangent(node, d) for i, d in changes.items()}
        row = {i: d for i, d in row.items() if not d.is_zero}
        if row:
            known[node] = row
    return [known.get(root, {}) for root in roots]


def _tangent(node: Node, d_args: Sequence[Node]) -> Node:
    op, zero = node.op, node.dag.zero
    if op == "add":
        return d_args[0] + d_args[1]
    if op == "sub":
        return d_args[0] - d_args[1]
    if op == "div":  # one division where the two partials would need two
        return (d_args[0] - node * d_args[1]) / node.args[1]
    if op == "select":
        return node.dag.select(node.args[0], d_args[1], d_args[2])
    total = zero
    for partial, d_arg in zip(PARTIALS[op], d_args, strict=True):
        if partial is not None and d_arg is not zero:
            total = total + partial(node) * d_arg
    return total


def tangent(root: Node, seed: Mapping[Node, Node]) -> Node:
    """Differentiate one value forward; see :func:`tangents`."""
    return tangents([root], seed)[0]


def adjoints(roots: Sequence[Node], weights: Sequence[Node], wanted: Sequence[Node]) -> list[Node]:
    """Differentiate in reverse: the derivative of ``sum(weights * roots)``.

    Parameters
    ----------
    roots, weights : sequences of Node
        The values and what each is weighted with.
    wanted : sequence of Node
        The nodes to differentiate with respect to, usually symbols.

    Returns
    -------
    list of Node
        One derivative for each node of ``wanted``.
    """
    if not roots:
        return []
    zero = roots[0].dag.zero
    bar: dict[Node, Node] = {}
    several: dict[Node, list[Node]] = {}
    order = reachable(roots)
    for root, weight in zip(roots, weights, strict=True):
        bar[root] = bar.get(root, zero) + weight
    for node in reversed(order):
        if node.op in SEVERAL:
            if node in several:
                for arg, d in zip(
                    node.args, SEVERAL[node.op].reverse(node, several[node]), strict=True
                ):
                    bar[arg] = bar.get(arg, zero) + d
            continue
        own = bar.get(node, zero)
        if own is zero or not node.args:
            continue
        if node.op == "result":
            target = node.args[0]
            if target not in several:
                n_results = SEVERAL[target.op].n_results(target.data)
                several[target] = [zero] * n_results
            several[target][node.data] = several[target][node.data] + own
            continue
        for arg, partial in zip(node.args, PARTIALS[node.op], strict=True):
            if partial is not None:
                bar[arg] = bar.get(arg, zero) + partial(node) * own
    return [bar.get(node, zero) for node in wanted]
