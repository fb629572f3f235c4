"""Dual numbers: a value with its derivative along one direction.

Formulas written with operators serve values and derivatives alike: with nodes they give values,
with duals both.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from cotree.dag.derivative import tangents
from cotree.dag.nodes import Node
from cotree.dag.traverse import substitute

if TYPE_CHECKING:
    from cotree.dag.nodes import Dag
    from cotree.dag.vector import Vector


@dataclass(frozen=True)
class Dual:
    """A value and its derivative."""

    value: Node
    d: Node

    @property
    def dag(self) -> Dag:
        """The arena of both."""
        return self.value.dag

    def __add__(self, other: Dual | float) -> Dual:
        other = self._dual(other)
        return Dual(self.value + other.value, self.d + other.d)

    __radd__ = __add__

    def __sub__(self, other: Dual | float) -> Dual:
        other = self._dual(other)
        return Dual(self.value - other.value, self.d - other.d)

    def __rsub__(self, other: float) -> Dual:
        return self._dual(other) - self

    def __mul__(self, other: Dual | float) -> Dual:
        other = self._dual(other)
        return Dual(self.value * other.value, self.d * other.value + self.value * other.d)

    __rmul__ = __mul__

    def __truediv__(self, other: Dual | float) -> Dual:
        other = self._dual(other)
        value = self.value / other.value
        return Dual(value, (self.d - value * other.d) / other.value)

    def __rtruediv__(self, other: float) -> Dual:
        return self._dual(other) / self

    def __neg__(self) -> Dual:
        return Dual(-self.value, -self.d)

    def _dual(self, other: Dual | float) -> Dual:
        if isinstance(other, Dual):
            return other
        return Dual(self.dag.constant(other), self.dag.zero)


Scalar = TypeVar("Scalar", Node, Dual)


def function(name: str, *args: Scalar) -> Scalar:
    """Form a function of nodes or of duals."""
    first = args[0]
    if isinstance(first, Node):
        return first.dag.function(name, *args)
    dag = first.dag
    symbols = [dag.symbol("argument", i) for i in range(len(args))]
    known = dict(zip(symbols, (arg.value for arg in args), strict=True))
    formula = dag.function(name, *symbols)
    (d,) = tangents([formula], dict(zip(symbols, (arg.d for arg in args), strict=True)))
    value, slope = substitute([formula, d], known)
    return Dual(value, slope)


def paired(values: Vector, tangent: Vector) -> tuple[Dual, Dual, Dual]:
    """Join a vector and its derivative."""
    x, y, z = (Dual(a, b) for a, b in zip(values, tangent, strict=True))
    return (x, y, z)
