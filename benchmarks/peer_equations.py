"""A model's equations, operation by operation, for other tools' expressions."""

from __future__ import annotations

from typing import Any

import numpy as np

from cotree.dag.nodes import reachable
from cotree.export.symbolic import ARITHMETIC

_PLAIN = ("sin", "cos", "tan", "exp", "log", "sqrt", "sinh", "cosh", "tanh", "asin", "acos", "atan")


def apply(op: str, args: list[Any], room: Any) -> Any:
    """Apply an operation to numbers, or to expressions with the functions of a module."""
    if op in ARITHMETIC:
        return ARITHMETIC[op](*args)
    if op == "abs":
        return apply("sqrt", [args[0] * args[0]], room)
    if op not in _PLAIN:
        raise NotImplementedError(f"there is no '{op}' for other tools")
    numbers = all(isinstance(arg, (int, float)) for arg in args)
    return (
        float(getattr(np, op.replace("asin", "arcsin"))(*args))
        if numbers
        else getattr(room, op)(*args)
    )


class Equations:
    """Rates of all states, and residuals for algebraic unknowns, as expressions.

    Parameters
    ----------
    model : cotree.Model
        The model; parameters without expressions become numbers.
    room : module
        Has ``sin`` and its like for expressions.
    states, parameters : sequences of expressions
        For the states, and for the parameters that have sensitivities.
    time : expression
        For the time.
    free : sequence of str, optional
        The parameters that have expressions, if not those with sensitivities.
    """

    def __init__(
        self, model: Any, room: Any, states: Any, parameters: Any, time: Any, free: Any = None
    ) -> None:
        program = model.kernels.program
        free = list(model.sensitivities if free is None else free)
        values = dict(zip(model.parameters, program.layout.parameter_values, strict=True))
        self.room = room
        self.values = [float(values[name]) for name in free]
        start = model.start().y
        known: dict[Any, Any] = {("t", 0): (time, 0.0)}
        for i, name in enumerate(model.parameters):
            value = float(values[name])
            known["p", i] = (parameters[free.index(name)] if name in free else value, value)
        known |= {("x", i): (x, float(start[i])) for i, x in enumerate(states)}
        for i, pair in enumerate(self._convert(program.kernels["inputs"].results, known)):
            known["u", i] = pair
        self.rates = [rate for rate, _ in self._convert(program.kernels["rhs"].results, known)]

    def _convert(self, roots: Any, known: Any) -> list[tuple[Any, float]]:
        """Return the expression and the initial value of each node."""
        found: dict[Any, Any] = {}
        for node in reachable(roots):
            if node.op == "symbol":
                found[node] = known[node.data]
            elif node.value is not None:
                found[node] = (float(node.value), float(node.value))
            elif node.op == "solve":
                found[node] = _solved(node.data.size, [found[arg] for arg in node.args])
            elif node.op == "sines":
                found[node] = [
                    (apply(name, [angle], self.room), apply(name, [value], np))
                    for name in ("sin", "cos")
                    for angle, value in (found[arg] for arg in node.args)
                ]
            elif node.op == "result":
                found[node] = found[node.args[0]][node.data]
            else:
                expressions, numbers = zip(*(found[arg] for arg in node.args), strict=True)
                found[node] = (
                    apply(node.op, list(expressions), self.room),
                    apply(node.op, list(numbers), np),
                )
        return [found[root] for root in roots]


def _solved(n: int, args: list[Any]) -> list[Any]:
    """Solve by elimination, with the pivots that are largest at the start."""
    rows = [[*args[i * n : (i + 1) * n], args[n * n + i]] for i in range(n)]
    for k in range(n):
        best = max(range(k, n), key=lambda i: abs(rows[i][k][1]))
        rows[k], rows[best] = rows[best], rows[k]
        for i in range(k + 1, n):
            factor = _both(lambda a, b: a / b, rows[i][k], rows[k][k])
            for j in range(k + 1, n + 1):
                rows[i][j] = _both(lambda a, f, b: a - f * b, rows[i][j], factor, rows[k][j])
    x: list[Any] = [None] * n
    for k in reversed(range(n)):
        total = rows[k][n]
        for j in range(k + 1, n):
            total = _both(lambda a, f, b: a - f * b, total, rows[k][j], x[j])
        x[k] = _both(lambda a, b: a / b, total, rows[k][k])
    return [*x, (float(n), float(n)), (1.0, 1.0)]


def _both(operation: Any, *pairs: Any) -> tuple[Any, float]:
    expressions, numbers = zip(*pairs, strict=True)
    return operation(*expressions), operation(*numbers)


def slopes(rates: list[Any], states: list[Any], m: int, time: Any, diff: Any) -> list[Any]:
    """Return rates of algebraic unknowns by elimination: g_z z' = -(g_x x' + g_t)."""
    cut = len(states) - m
    matrix = [[diff(row, z) for z in states[cut:]] for row in rates[cut:]]
    right = []
    for row in rates[cut:]:
        total = -diff(row, time)
        for x, rate in zip(states[:cut], rates[:cut], strict=True):
            total = total - diff(row, x) * rate
        right.append(total)
    for k in range(m):
        for i in range(k + 1, m):
            factor = matrix[i][k] / matrix[k][k]
            for j in range(k + 1, m):
                matrix[i][j] = matrix[i][j] - factor * matrix[k][j]
            right[i] = right[i] - factor * right[k]
    found: list[Any] = [None] * m
    for k in reversed(range(m)):
        total = right[k]
        for j in range(k + 1, m):
            total = total - matrix[k][j] * found[j]
        found[k] = total / matrix[k][k]
    return found
