"""Laws: constitutive equations in SymPy, whose derivatives are formed once in advance.

Sensitivity terminal equations (paper, Eq. (4)) are partial derivatives of laws times derivatives of
their arguments; assembled equations are never differentiated.
"""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from cotree.dag.nodes import Dag, Node


def law_symbol(name: str) -> Any:
    """Return the SymPy symbol for an argument of a law, and import SymPy if necessary."""
    import sympy

    return sympy.Symbol(name, real=True)


@dataclass(frozen=True)
class Law:
    """A scalar constitutive law, given by a function of symbols.

    >>> law = Law(lambda length, stiffness, free_length: -stiffness * (length - free_length))
    >>> law.partials["stiffness"]
    free_length - length
    """

    #: Function that takes SymPy symbols and returns the law as an expression. The names of its
    #: arguments are those of the law.
    function: Callable[..., Any]

    @cached_property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments, in order."""
        return tuple(inspect.signature(self.function).parameters)

    @cached_property
    def expression(self) -> Any:
        """The law as a SymPy expression of real symbols named like the arguments."""
        import sympy

        return sympy.sympify(
            self.function(*(sympy.Symbol(name, real=True) for name in self.arguments))
        )

    @classmethod
    def taking(cls, arguments: tuple[str, ...], function: Callable[..., Any]) -> Law:
        """Build a law whose argument names replace those in the function's signature."""
        made = cls(function)
        # Setting the cached property prevents the signature from being inspected.
        made.__dict__["arguments"] = arguments
        return made

    @classmethod
    def field(cls, name: str) -> Law:
        """Build the law that is equal to a single argument, such as a field."""
        return cls.taking((name,), lambda given: given)

    @classmethod
    def of(cls, expression: Any) -> Law:
        """Build a law from a SymPy expression whose symbols are real."""
        # A set of symbols is unordered; sorting the names makes the C text reproducible.
        names = tuple(sorted(symbol.name for symbol in expression.free_symbols))
        return cls.taking(names, lambda *_: expression)

    @classmethod
    def formed_by(cls, form: Callable[[], Any]) -> Law:
        """Build a law whose expression is formed on first use; SymPy is imported only then."""
        return _Deferred(form)

    def uses(self, name: str) -> bool:
        """Return whether the law depends on an argument after cancellation."""
        return any(symbol.name == name for symbol in self.expression.free_symbols)

    def over(self, name: str) -> Law:
        """Return the law divided by the argument ``name``, simplified to remove a pole at zero."""
        import sympy

        divided = sympy.simplify(self.expression / sympy.Symbol(name, real=True))
        # Without conditions for zero, the expression beside zero holds there, too.
        divided = divided.replace(sympy.Ne, lambda *_: sympy.true)
        divided = divided.replace(sympy.Eq, lambda *_: sympy.false)
        made = Law(self.function)
        made.__dict__["expression"] = divided  # takes precedence over the function
        return made

    @cached_property
    def partials(self) -> dict[str, Any]:
        """Partial derivatives that are not zero, by argument; sign and floor count as constant."""
        import sympy

        # SymPy does not differentiate floor, nor the remainder, which contains it.
        whole = self.expression.replace(sympy.Mod, lambda a, b: a - b * sympy.floor(a / b))
        jumps = whole.atoms(sympy.floor, sympy.ceiling, sympy.sign)
        # Functions that are constant between jumps are differentiated as constants.
        constants = {item: sympy.Dummy(real=True) for item in jumps}
        fixed = whole.subs(constants)
        back = {dummy: item for item, dummy in constants.items()}
        derivatives = {
            name: _derivative(fixed, sympy.Symbol(name, real=True))
            # SymPy's derivative of a step contains an impulse. Events handle it, so it is removed.
            .replace(sympy.DiracDelta, lambda *_: sympy.Integer(0))
            .subs(back)
            for name in self.arguments
        }
        return {name: value for name, value in derivatives.items() if value != 0}

    def value(self, dag: Dag, arguments: Mapping[str, Node]) -> Node:
        """Build the node of the law's value from its arguments, which may be dual numbers."""
        from cotree.dag.dual import is_varied, tangent_of, value_of, varied
        from cotree.dag.from_sympy import from_sympy

        changing = {name for name, argument in arguments.items() if is_varied(argument)}
        if not changing:
            return from_sympy(self.expression, dag, arguments)
        values = {name: value_of(argument) for name, argument in arguments.items()}
        # All sensitivity directions share the derivatives of a law, which are therefore stored.
        key = (self.expression, *values.items())
        if key not in dag.formed:
            formed = from_sympy(self.expression, dag, values)
            dag.formed[key] = formed, self.partial_values(dag, values)
        value: Node
        partials: dict[str, Node]
        value, partials = dag.formed[key]
        # Chain rule of the sensitivity terminal equation (Eq. (4)): partial derivatives times
        # tangents.
        d = dag.zero
        for name, partial in partials.items():
            if name in changing:
                d = d + partial * tangent_of(arguments[name])
        return varied(value, d)

    def partial_value(self, dag: Dag, arguments: Mapping[str, Node], name: str) -> Node | None:
        """Build the node of one partial derivative; return None if it is zero."""
        return self.partial_values(dag, arguments, [name]).get(name)

    def partial_values(
        self, dag: Dag, arguments: Mapping[str, Node], names: Iterable[str] | None = None
    ) -> dict[str, Node]:
        """Build the nonzero partial derivatives with respect to some or all arguments.

        If the law has a root or a power of a clipped argument, its branch is chosen before
        differentiation (:mod:`cotree.dag.derivative`).
        """
        from cotree.dag.derivative import Clips, tangents
        from cotree.dag.from_sympy import from_sympy
        from cotree.dag.nodes import ARGUMENT, reachable, substitute

        wanted = [name for name in names or self.partials if name in self.partials]
        symbols = {name: dag.symbol(ARGUMENT, i) for i, name in enumerate(self.arguments)}
        known = {symbols[name]: arguments[name] for name in symbols if name in arguments}
        if self._has_root:
            whole, clips = from_sympy(self.expression, dag, symbols), Clips(known)
            if any(clips.reaches(node) for node in reachable([whole])):
                rows = (tangents([whole], {symbols[name]: dag.one}, known) for name in wanted)
                values = [substitute(row, known)[0] for row in rows]
                pairs = zip(wanted, values, strict=True)
                return {name: value for name, value in pairs if not value.is_zero}
        values = [from_sympy(self.partials[name], dag, arguments) for name in wanted]
        return {n: value for n, value in zip(wanted, values, strict=True) if not value.is_zero}

    @cached_property
    def _has_root(self) -> bool:
        """Return whether the law has an operation whose derivative is not finite everywhere."""
        from cotree.dag.derivative import SINGULAR
        from cotree.dag.from_sympy import from_sympy
        from cotree.dag.nodes import ARGUMENT, Dag, reachable

        dag = Dag()
        symbols = {name: dag.symbol(ARGUMENT, i) for i, name in enumerate(self.arguments)}
        return any(
            node.op in SINGULAR for node in reachable([from_sympy(self.expression, dag, symbols)])
        )


class _Deferred(Law):
    """A law whose function takes no arguments and returns the expression."""

    @cached_property
    def expression(self) -> Any:
        return self.function()

    @cached_property
    def arguments(self) -> tuple[str, ...]:
        return tuple(sorted(symbol.name for symbol in self.expression.free_symbols))


def _derivative(expression: Any, symbol: Any) -> Any:
    """Differentiate; roots of sums yield powers, as SymPy's quotient is undefined at zero."""
    import sympy

    def is_root(item: Any) -> bool:
        exponent = item.exp
        return exponent.is_number and not exponent.is_integer and not item.base.is_Symbol

    found = [root for root in expression.atoms(sympy.Pow) if is_root(root) and root.has(symbol)]
    roots = {root: sympy.Function(f"root_{i}", real=True)(symbol) for i, root in enumerate(found)}
    total = expression.xreplace(roots).diff(symbol)
    slopes = {
        made.diff(symbol): root.exp * root.base ** (root.exp - 1) * _derivative(root.base, symbol)
        for root, made in roots.items()
    }
    return total.xreplace(slopes).xreplace({made: root for root, made in roots.items()})
