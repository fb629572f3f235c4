"""Fields of a scene as formulas: the user's own text, and its derivative along one parameter."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.dag.nodes import Dag
from cotree.export.blackboard import NOTHING, ONE, SUM, ZERO, Formula, Pair, scalar
from cotree.export.to_sympy import to_sympy

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.scene.expressions import Expression


@dataclass(frozen=True)
class FieldWriter:
    """Writes fields and their derivatives.

    Attributes
    ----------
    name : str or None
        The parameter, or the state whose initial value is meant; None gives no derivatives.
    moving : mapping of str to str
        How the derivative of each coordinate, rate and input that has one is written, by name.
    """

    name: str | None
    moving: Mapping[str, str]

    def pair(self, field: Expression | None) -> Pair:
        """Write a field that is one expression; without it, zero."""
        if field is None:
            return NOTHING
        return Pair(_own_text(field), self._derivative(field))

    def _derivative(self, field: Expression) -> Formula:
        """Differentiate a field; coordinates in it move along."""
        import sympy

        changing = [n for n in sorted(field.names) if n == self.name or n in self.moving]
        if self.name is None or not changing:
            return ZERO
        dag = Dag()
        numbers = {name: i for i, name in enumerate(sorted(field.names))}
        node = field.lower(dag, lambda name: dag.symbol("name", numbers[name]))
        symbols = {name: sympy.Symbol(name, real=True) for name in numbers}
        known = {dag.symbol("name", i): symbols[name] for name, i in numbers.items()}
        (value,) = to_sympy([node], known)
        total = sympy.Integer(0)
        for name in changing:
            along = sympy.Symbol(self.moving[name]) if name in self.moving else 1
            total += value.diff(symbols[name]) * along
        return sympy_formula(total)


def sympy_formula(value: Any) -> Formula:
    """Write a SymPy expression as a scalar."""
    if value == 0:
        return ZERO
    if value == 1:
        return ONE
    if value.is_Add:
        return scalar(str(value), SUM)
    if value.could_extract_minus_sign():
        return -sympy_formula(-value)
    return scalar(str(value))


def _own_text(field: Expression) -> Formula:
    """Write an expression as the user did; numbers in their shortest form."""
    if isinstance(field.tree, ast.Constant):
        return _number(float(field.tree.value))  # type: ignore[arg-type]
    text = field.text.strip()
    is_sum = isinstance(field.tree, ast.BinOp) and isinstance(field.tree.op, ast.Add | ast.Sub)
    # A leading minus belongs to the first factor, so to the whole of a product.
    if text.startswith("-") and not is_sum:
        return -scalar(text[1:].strip())
    return scalar(text, SUM) if is_sum else scalar(text)


def _number(value: float) -> Formula:
    if value < 0.0:
        return -_number(-value)
    if value in (0.0, 1.0):
        return ONE if value else ZERO
    short = f"{value:.12g}"
    return scalar(short if float(short) == value else repr(value))
