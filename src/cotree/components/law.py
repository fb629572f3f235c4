"""Laws: constitutive equations as graphs of their arguments, with derivatives formed once.

Sensitivity terminal equations (paper, Eq. (4)) are partial derivatives of laws times derivatives of
their arguments; assembled equations are never differentiated.
"""

from __future__ import annotations

import inspect
import operator
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

# Nodes are imported where they are formed: runs of cached models need none.

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.dag.nodes import Dag, Node

#: Function that returns the node, or the number, of an argument by its name.
_Lookup = Callable[[str], Any]


def _operator(apply: Callable[[Any, Any], Any], *, swaps: bool = False) -> Callable[..., Law]:
    def method(law: Law, other: Any) -> Law:
        first, second = (other, law) if swaps else (law, other)
        return _Formed(lambda at: apply(_at(first, at), _at(second, at)))

    return method


def _at(part: Any, at: _Lookup) -> Any:
    return part.form(at) if isinstance(part, Law) else part


@dataclass(frozen=True)
class Law:
    """A scalar constitutive law, given by a function; operators combine laws into a law.

    >>> law = Law(lambda length, stiffness, free_length: -stiffness * (length - free_length))
    >>> law.uses("stiffness"), law.slope("length").arguments
    (True, ('stiffness',))
    """

    #: Function that takes nodes and returns the law as a node or number.
    function: Callable[..., Any]
    #: Names of the arguments, if they differ from those in the function's signature.
    names: tuple[str, ...] | None = None
    #: The SymPy expression of the law, if a user registered it.
    expression: Any = None

    @cached_property
    def arguments(self) -> tuple[str, ...]:
        """Names of the arguments, in order."""
        names = self.names
        return tuple(inspect.signature(self.function).parameters) if names is None else names

    def form(self, at: _Lookup) -> Any:
        """Return the value of the law; ``at`` returns the value of each argument."""
        return self.function(*map(at, self.arguments))

    @classmethod
    def taking(cls, arguments: tuple[str, ...], function: Callable[..., Any]) -> Law:
        """Build a law whose arguments have these names instead of those in the signature."""
        return cls(function, arguments)

    @classmethod
    def of(cls, expression: Any, arguments: tuple[str, ...] | None = None) -> Law:
        """Build a law from a SymPy expression whose symbols are real."""
        from cotree.dag.from_sympy import from_sympy
        from cotree.dag.nodes import ARGUMENT, Dag

        # Symbols are an unordered set; sorting their names makes the C text reproducible.
        names = arguments
        if names is None:
            names = tuple(sorted(symbol.name for symbol in expression.free_symbols))
        dag = Dag()
        symbols = {name: dag.symbol(ARGUMENT, i) for i, name in enumerate(names)}
        root = from_sympy(expression, dag, symbols)
        return cls(
            lambda *given: _moved(root, dict(zip(symbols.values(), given, strict=True))),
            names,
            expression,
        )

    def where(self, **values: Any) -> Law:
        """Return the law with some arguments replaced by laws or numbers."""
        return _Formed(
            lambda at: self.form(lambda name: _at(values[name], at) if name in values else at(name))
        )

    def slope(self, name: str) -> Law:
        """Return the partial derivative with respect to an argument."""
        return self._of_arguments(self._partials.get(name, self._graph[0].dag.zero))

    def _of_arguments(self, root: Node) -> Law:
        """Return the law of another node in the graph of this law."""
        symbols = self._graph[1]
        return _Formed(lambda at: _moved(root, {s: at(n) for n, s in symbols.items()}))

    @cached_property
    def _graph(self) -> tuple[Node, dict[str, Node]]:
        """The law in its own graph, and the symbols of its arguments."""
        from cotree.dag.nodes import ARGUMENT, Dag, Node

        dag, symbols = Dag(), dict[str, Node]()

        def at(name: str) -> Node:
            return symbols.setdefault(name, dag.symbol(ARGUMENT, len(symbols)))

        value = self.form(at)
        return value if isinstance(value, Node) else dag.constant(value), symbols

    @cached_property
    def _partials(self) -> dict[str, Node]:
        from cotree.dag.derivative import tangents

        root, symbols = self._graph
        one = root.dag.one
        rows = {name: tangents([root], {symbol: one})[0] for name, symbol in symbols.items()}
        return {name: row for name, row in rows.items() if not row.is_zero}

    @cached_property
    def _has_root(self) -> bool:
        """Whether the law has an operation whose derivative is not finite everywhere."""
        from cotree.dag.derivative import SINGULAR
        from cotree.dag.nodes import reachable

        return any(node.op in SINGULAR for node in reachable([self._graph[0]]))

    @property
    def changing(self) -> tuple[str, ...]:
        """Arguments with a nonzero partial derivative; sign and floor count as constant."""
        return tuple(self._partials)

    @property
    def is_zero(self) -> bool:
        """Whether the law is the constant zero."""
        return self._graph[0].is_zero

    @cached_property
    def _used(self) -> frozenset[str]:
        """The arguments on which the law depends after cancellation."""
        from cotree.dag.nodes import symbols_in

        root, symbols = self._graph
        found = set(symbols_in([root]))
        return frozenset(name for name, symbol in symbols.items() if symbol in found)

    def uses(self, name: str) -> bool:
        """Return whether the law depends on an argument after cancellation."""
        return name in self._used

    def over(self, name: str) -> Law:
        """Return the law divided by the argument ``name``, if possible without a pole at zero."""
        root, symbols = self._graph
        quotient = _quotient(root, symbols[name]) if name in symbols else None
        return self / argument(name) if quotient is None else self._of_arguments(quotient)

    def value(self, dag: Dag, arguments: Mapping[str, Node]) -> Node:
        """Build the node of the law's value from its arguments, which may be dual numbers."""
        from cotree.dag.dual import is_varied, tangent_of, value_of, varied

        changing = {name for name, argument in arguments.items() if is_varied(argument)}
        if not changing:
            return self._value(dag, arguments)
        values = {name: value_of(argument) for name, argument in arguments.items()}
        # Store the derivatives of a law: all sensitivity directions share them.
        key = (self, *values.items())
        if key not in dag.formed:
            dag.formed[key] = self._value(dag, values), self.partial_values(dag, values)
        value: Node
        partials: dict[str, Node]
        value, partials = dag.formed[key]
        # Sensitivity terminal equation (Eq. (4)): partial derivatives times tangents.
        d = dag.zero
        for name, partial in partials.items():
            if name in changing:
                d = d + partial * tangent_of(arguments[name])
        return varied(value, d)

    def _value(self, dag: Dag, arguments: Mapping[str, Node]) -> Node:
        from cotree.dag.nodes import formed_in

        root, symbols = self._graph
        return formed_in(
            dag, root, {symbols[n]: node for n, node in arguments.items() if n in symbols}
        )

    def partial_value(self, dag: Dag, arguments: Mapping[str, Node], name: str) -> Node | None:
        """Build the node of one partial derivative; return None if it is zero."""
        return self.partial_values(dag, arguments, [name]).get(name)

    def partial_values(
        self, dag: Dag, arguments: Mapping[str, Node], names: Iterable[str] | None = None
    ) -> dict[str, Node]:
        """Build the nonzero partial derivatives with respect to some or all arguments.

        If the law has a root or a power of a clipped argument, the branch of the argument is chosen
        before differentiation (:mod:`cotree.dag.derivative`).
        """
        from cotree.dag.derivative import tangents
        from cotree.dag.nodes import formed_in

        (root, symbols), rows = self._graph, self._partials
        wanted = [name for name in names or rows if name in rows]
        known = {symbols[name]: node for name, node in arguments.items() if name in symbols}
        if self._has_root:
            one = root.dag.one
            rows = {name: tangents([root], {symbols[name]: one}, known)[0] for name in wanted}
        values = {name: formed_in(dag, rows[name], known) for name in wanted}
        return {name: value for name, value in values.items() if not value.is_zero}

    __add__ = _operator(operator.add)
    __radd__ = _operator(operator.add, swaps=True)
    __sub__ = _operator(operator.sub)
    __rsub__ = _operator(operator.sub, swaps=True)
    __mul__ = _operator(operator.mul)
    __rmul__ = _operator(operator.mul, swaps=True)
    __truediv__ = _operator(operator.truediv)
    __rtruediv__ = _operator(operator.truediv, swaps=True)
    __pow__ = _operator(operator.pow)

    def __neg__(self) -> Law:
        return _Formed(lambda at: -self.form(at))


class _Formed(Law):
    """A law whose function looks up its arguments; arguments that cancel are not listed."""

    @cached_property
    def arguments(self) -> tuple[str, ...]:
        return tuple(sorted(self._used))

    def form(self, at: _Lookup) -> Any:
        return self.function(at)


def argument(name: str) -> Law:
    """Return the law that equals a single argument, such as a field."""
    return Law(lambda given: given, (name,))


#: The law of ports whose through or across variable is zero.
ZERO = Law(lambda: 0.0)


def _moved(root: Node, known: Mapping[Node, Any]) -> Any:
    """Form a node in the graph of the nodes that replace its symbols."""
    from cotree.dag.nodes import Dag, Node, formed_in

    dag = next((node.dag for node in known.values() if isinstance(node, Node)), None)
    own = Dag() if dag is None else dag
    nodes = {s: v if isinstance(v, Node) else own.constant(v) for s, v in known.items()}
    made = formed_in(own, root, nodes)
    return made.value if dag is None else made


def _quotient(root: Node, by: Node) -> Node | None:
    """Divide by a symbol without a pole at zero; return None if no term contains the symbol."""
    dag, args = root.dag, root.args
    if root is by:
        return dag.one
    if root.is_zero:
        return root
    parts = [_quotient(arg, by) for arg in args]
    match root.op:
        case "neg" if parts[0] is not None:
            return -parts[0]
        case "add" | "sub" if parts != [None, None]:
            found = [
                arg / by if part is None else part for arg, part in zip(args, parts, strict=True)
            ]
            return dag.rebuild(root, tuple(found))
        case "select" if None not in parts[1:]:
            return dag.rebuild(root, (args[0], *parts[1:]))  # type: ignore[arg-type]
        case "mul" if parts[0] is not None:
            return parts[0] * args[1]
        case "mul" if parts[1] is not None:
            return args[0] * parts[1]
        case "div" if parts[0] is not None:
            return parts[0] / args[1]
        case "pow" if args[0] is by:
            return dag.pow(by, args[1] - 1.0)
        case "abs" if args[0] is by:
            return dag.function("sign", by)
    return None


def _function(name: str) -> Callable[[Any], Any]:
    def apply(x: Any) -> Any:
        if isinstance(x, Law):
            return _Formed(lambda at: apply(x.form(at)))
        from cotree.dag.nodes import Node
        from cotree.dag.operations import folded

        return x.dag.function(name, x) if isinstance(x, Node) else folded(name, x)

    return apply


exp, log, sqrt, sin, tanh, floor, magnitude = map(
    _function, ("exp", "log", "sqrt", "sin", "tanh", "floor", "abs")
)


def select(condition: Any, accepted: Any, refused: Any) -> Any:
    """Return ``accepted`` if ``condition >= 0``, else ``refused``."""
    parts = (condition, accepted, refused)
    if any(isinstance(part, Law) for part in parts):
        return _Formed(lambda at: select(*(_at(part, at) for part in parts)))
    from cotree.dag.nodes import Node

    dag = next((part.dag for part in parts if isinstance(part, Node)), None)
    if dag is None:
        return accepted if condition >= 0 else refused
    return dag.select(*(part if isinstance(part, Node) else dag.constant(part) for part in parts))


def larger(a: Any, b: Any) -> Any:
    """Return the larger of two values."""
    return select(a - b, a, b)


def smaller(a: Any, b: Any) -> Any:
    """Return the smaller of two values."""
    return select(b - a, a, b)
