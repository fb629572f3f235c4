"""Dual numbers: a value with its derivative along one direction.

A formula applied to nodes forms a value; applied to duals, it also forms the derivative. The value
of a dual may be a node, a vector or a matrix. Values that are constant along the direction remain
plain nodes. For type checkers, a dual has the type of its value.
"""

from __future__ import annotations

from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar, cast

from cotree.dag.derivative import tangents
from cotree.dag.nodes import Node, substitute

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from cotree.dag.nodes import Dag

T = TypeVar("T")
Form = TypeVar("Form", bound="Callable[..., Any]")


class Dual(Node):
    """A value and its derivative: nodes, or vectors or matrices of nodes.

    The operators are defined for scalars only. Dual is a subclass of Node because Python then calls
    the operators of Dual in mixed expressions, even if the left operand is a Node.
    """

    __slots__ = ("d",)
    value: Any
    d: Any

    def __init__(self, value: Any, d: Any) -> None:
        self.value = value
        self.d = d  # a dual belongs to no graph, only its value and derivative do

    def __getitem__(self, i: int) -> Any:
        return varied(self.value[i], self.d[i])

    def __iter__(self) -> Iterator[Any]:
        return (varied(value, d) for value, d in zip(self.value, self.d, strict=True))

    @property
    def is_zero(self) -> bool:
        """Return False: a dual is never the constant zero."""
        return False

    def __add__(self, other: Any) -> Any:
        if other.__class__ is Dual:
            return varied(self.value + other.value, self.d + other.d)
        # The derivative of a dual is never structurally zero, so varied() is not needed here.
        return Dual(self.value + other, self.d)

    def __radd__(self, other: Any) -> Any:
        return Dual(other + self.value, self.d)

    def __sub__(self, other: Any) -> Any:
        if other.__class__ is Dual:
            return varied(self.value - other.value, self.d - other.d)
        return Dual(self.value - other, self.d)

    def __rsub__(self, other: Any) -> Any:
        return Dual(other - self.value, -self.d)

    def __mul__(self, other: Any) -> Any:
        if other.__class__ is Dual:
            return varied(self.value * other.value, self.d * other.value + self.value * other.d)
        # A zero factor makes the derivative zero.
        return varied(self.value * other, self.d * other)

    def __rmul__(self, other: Any) -> Any:
        return varied(other * self.value, other * self.d)

    def __truediv__(self, other: Any) -> Any:
        if other.__class__ is Dual:
            value = self.value / other.value
            # (u/w)' = (u' - (u/w) w') / w reuses the quotient.
            return varied(value, (self.d - value * other.d) / other.value)
        return Dual(self.value / other, self.d / other)

    def __rtruediv__(self, other: Any) -> Any:
        value = other / self.value
        return varied(value, -(value * self.d) / self.value)

    def __neg__(self) -> Any:
        return Dual(-self.value, -self.d)


def varied(value: T, d: T) -> T:
    """Return a dual, or only the value if the derivative is zero."""
    return value if _is_zero(d) else Dual(value, d)  # type: ignore[return-value]


def is_varied(*parts: Any) -> bool:
    """Return whether any part is a dual."""
    # A list is faster than a generator for so few elements.
    return any([part.__class__ is Dual for part in parts])


def value_of(a: T) -> T:
    """Return the value of a dual, or any other value unchanged."""
    value: T = a.value if isinstance(a, Dual) else a
    return value


def tangent_of(a: T) -> T:
    """Return the derivative of a dual; for other values, return zeros of the same shape."""
    d: T = a.d if isinstance(a, Dual) else _zeros(a)
    return d


def _is_zero(d: Any) -> bool:
    if d.__class__ is Node:
        return bool(d is d.dag.zero)
    for part in d:  # faster than a generator; this is called for every derivative
        if part is not part.dag.zero if part.__class__ is Node else not _is_zero(part):
            return False
    return True


def _dag_of(value: Any) -> Dag:
    while value.__class__ is not Node:
        value = value[0]
    dag: Dag = value.dag
    return dag


def _zeros(value: Any) -> Any:
    if value.__class__ is Node:
        return value.dag.zero
    return tuple([_zeros(part) for part in value])


def formed(form: Callable[..., T], a: Any, b: Any) -> T:
    """Return ``form(a, b)`` from a cache in the graph of ``a``, which all directions share."""
    known: dict[Any, T] = _dag_of(a).formed
    key = (form, a, b)
    if key in known:
        return known[key]
    found = known[key] = form(a, b)
    return found


def linear(form: Form) -> Form:
    """Extend a function that is linear in all its arguments to duals."""

    @wraps(form)
    def taking(*args: Any) -> Any:
        if is_varied(*args):
            value = form(*[value_of(arg) for arg in args])
            return varied(value, form(*[tangent_of(arg) for arg in args]))
        return form(*args)

    return cast("Form", taking)


def additive(form: Form) -> Form:
    """Extend a sum or a difference to duals."""

    @wraps(form)
    def taking(a: Any, b: Any) -> Any:
        if a.__class__ is Dual:
            if b.__class__ is Dual:
                return varied(formed(form, a.value, b.value), form(a.d, b.d))
            return Dual(formed(form, a.value, b), a.d)
        if b.__class__ is Dual:
            # Applied to zero and b', a sum yields b' and a difference -b'.
            return Dual(formed(form, a, b.value), form(_zeros(a), b.d))
        return form(a, b)

    return cast("Form", taking)


def bilinear(form: Form) -> Form:
    """Extend a bilinear function to duals."""

    @wraps(form)
    def taking(a: Any, b: Any) -> Any:
        if a.__class__ is Dual:
            if b.__class__ is Dual:
                d = _plus(form(a.d, b.value), form(a.value, b.d))
                return varied(formed(form, a.value, b.value), d)
            return varied(formed(form, a.value, b), form(a.d, b))
        if b.__class__ is Dual:
            return varied(formed(form, a, b.value), form(a, b.d))
        return form(a, b)

    return cast("Form", taking)


def _plus(a: Any, b: Any) -> Any:
    if a.__class__ is Node:
        return a + b
    return tuple([x + y if x.__class__ is Node else _plus(x, y) for x, y in zip(a, b, strict=True)])


def function(name: str, *args: Node) -> Node:
    """Form a function of nodes or duals."""
    dag = _dag_of(value_of(args[0]))
    if not is_varied(*args):
        return dag.function(name, *args)
    # Differentiating a function of placeholders, then substituting the arguments, lets nodes and
    # duals share one table of partial derivatives.
    symbols = [dag.symbol("argument", i) for i in range(len(args))]
    return formula(dag.function(name, *symbols), dict(zip(symbols, args, strict=True)), {})


def formula(node: Node, arguments: Mapping[Node, Node], seed: Mapping[Node, Node]) -> Node:
    """Substitute nodes or duals for symbols; ``seed`` has the derivatives of other symbols."""
    along = {**seed, **{symbol: tangent_of(arg) for symbol, arg in arguments.items()}}
    values = {symbol: value_of(arg) for symbol, arg in arguments.items()}
    # Value and derivative are substituted together, since they share most of their nodes.
    value, d = substitute([node, tangents([node], along)[0]], values)
    return varied(value, d)
