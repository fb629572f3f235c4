"""Numbers of a scene's expressions, evaluated apart from the library's own lowering."""

from __future__ import annotations

import ast
import math
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

# numpy's take arrays and complex times too
_FUNCTIONS: dict[str, Callable[..., Any]] = {
    **{name: getattr(np, name) for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh")},
    **{name: getattr(np, name) for name in ("exp", "log", "sqrt", "abs", "sign")},
    **{f"a{name}": getattr(np, f"arc{name}") for name in ("sin", "cos", "tan", "tan2")},
    "min": np.minimum,
    "max": np.maximum,
}
_BINARY: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: lambda a, b: a + b,
    ast.Sub: lambda a, b: a - b,
    ast.Mult: lambda a, b: a * b,
    ast.Div: lambda a, b: a / b,
    ast.Pow: lambda a, b: a**b,
}


def value(tree: ast.expr, names: Mapping[str, Any]) -> Any:
    """Evaluate a parsed expression."""
    match tree:
        case ast.Constant(value=number):
            return float(number)  # type: ignore[arg-type]
        case ast.Name(id="pi"):
            return math.pi
        case ast.Name(id=name):
            return names[name]
        case ast.Attribute(value=ast.Name(id=edge), attr=attribute):
            return names[f"{edge}.{attribute}"]
        case ast.UnaryOp(op=op, operand=operand):
            return -value(operand, names) if isinstance(op, ast.USub) else value(operand, names)
        case ast.BinOp(left=left, op=op, right=right):
            return _BINARY[type(op)](value(left, names), value(right, names))
        case ast.Call(func=ast.Name(id=function), args=args):
            return _FUNCTIONS[function](*(value(arg, names) for arg in args))
    raise NotImplementedError(f"the oracle does not evaluate '{ast.unparse(tree)}'")


def numbers(field: Any, names: Mapping[str, Any]) -> Any:
    """Evaluate a field: a number, or an array whose last axes are three or three rows of three.

    Names may stand for arrays, whose axes come first.
    """
    if isinstance(field, tuple):
        parts = [np.asarray(numbers(part, names)) for part in field]
        n_inner = 1 if isinstance(field[0], tuple) else 0
        return np.stack(np.broadcast_arrays(*parts), axis=-1 - n_inner)
    return value(field.tree, names)


def names_of(field: Any) -> set[str]:
    """Every name in a field."""
    if isinstance(field, tuple):
        return set().union(*(names_of(part) for part in field))
    return set(field.names) - {"pi"}


def constants(fields: Mapping[str, Any], parameters: Mapping[str, float]) -> dict[str, Any]:
    """The values of those fields that depend on parameters only."""
    return {
        name: numbers(field, parameters)
        for name, field in fields.items()
        if names_of(field) <= set(parameters)
    }


def signal(given: Any, names: Mapping[str, float]) -> float:
    """Evaluate an input: an expression, or a table that is linear between its times."""
    if hasattr(given, "tree"):
        return value(given.tree, names)
    return float(np.interp(names["t"], given.x, given.y))
