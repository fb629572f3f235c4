"""Interned scalar nodes of an expression graph, which are simplified when they are formed.

A :class:`Dag` is a graph. A node is formed by an operator on nodes (``a * b + c``) or by a method
of the graph (``dag.function("sin", a)``). Forming the same value twice returns the same node, so
there are no repeated subexpressions. Constants are folded, ``x*0`` becomes zero, ``x+0`` becomes
``x``, ``x*(1/x)`` one and ``x+(y-x)`` ``y``; negations move towards the result. Arguments have
smaller indices than the nodes that use them, so ascending indices are a valid order of evaluation.

The symbols of :data:`ARGUMENT_OF` are kernel arguments. All others are placeholders for values that
are substituted later.
"""

from __future__ import annotations

import io
import math
import pickle
from contextlib import contextmanager
from operator import attrgetter
from typing import TYPE_CHECKING, Any

from cotree.dag.operations import OPERATIONS, folded

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Iterator, Mapping, Sequence


_ODD = frozenset({"sin", "tan", "asin", "atan", "sinh", "tanh", "erf", "sign"})
_EVEN = frozenset({"cos", "cosh", "abs"})


class Node:
    """One scalar value of a :class:`Dag`.

    ``index`` is larger than the indices of all arguments ``args``. ``op`` is ``constant``,
    ``symbol``, a row of :data:`cotree.dag.operations.OPERATIONS`, a node with several results
    (``solve``, ``table``, ``call``), or ``result``, one value of such a node. ``data`` is
    ``(kind, position)`` of a symbol, the number of a result, or the description of a node with
    several results. ``value`` is the number of a constant; ``section`` labels the generated code.
    """

    __slots__ = ("args", "dag", "data", "index", "op", "section", "value")

    def __init__(
        self, dag: Dag, op: str, args: tuple[Node, ...], data: Any, value: float | None
    ) -> None:
        self.dag = dag
        self.op = op
        self.args = args
        self.data = data
        self.value = value
        self.section = dag.section  # label of the section in which the value was first formed
        self.index = len(dag.nodes)
        dag.nodes.append(self)

    def __add__(self, other: Node | float) -> Node:
        if other.__class__ is not Node:
            other = self.dag.constant(other)  # type: ignore[arg-type]
        return self.dag.add(self, other)

    def __radd__(self, other: float) -> Node:
        return self.dag.add(self.dag.constant(other), self)

    def __sub__(self, other: Node | float) -> Node:
        if other.__class__ is not Node:
            other = self.dag.constant(other)  # type: ignore[arg-type]
        return self.dag.sub(self, other)

    def __rsub__(self, other: float) -> Node:
        return self.dag.sub(self.dag.constant(other), self)

    def __mul__(self, other: Node | float) -> Node:
        if other.__class__ is not Node:
            other = self.dag.constant(other)  # type: ignore[arg-type]
        return self.dag.mul(self, other)

    def __rmul__(self, other: float) -> Node:
        return self.dag.mul(self.dag.constant(other), self)

    def __truediv__(self, other: Node | float) -> Node:
        return self.dag.div(self, other if isinstance(other, Node) else self.dag.constant(other))

    def __rtruediv__(self, other: float) -> Node:
        return self.dag.div(self.dag.constant(other), self)

    def __neg__(self) -> Node:
        return self.dag.neg(self)

    def __pow__(self, other: Node | float) -> Node:
        return self.dag.pow(self, other if isinstance(other, Node) else self.dag.constant(other))

    @property
    def is_zero(self) -> bool:
        """Whether this is the constant zero."""
        return self is self.dag.zero

    def __repr__(self) -> str:
        if self.op == "constant":
            return f"Node({self.value!r})"
        if self.op == "symbol":
            return f"Node({self.data[0]}[{self.data[1]}])"
        return f"Node({self.op} of {', '.join(str(a.index) for a in self.args)})"


class Dag:
    """An expression graph of interned nodes.

    ``section`` is the label of new nodes; ``suffix`` is appended to the labels. ``origins`` maps
    nodes to descriptions for messages, such as "resistance of edge 'R1'"; ``formed`` is the cache
    of :func:`cotree.dag.dual.formed`.
    """

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.section = ""
        self.origins: dict[Node, str] = {}
        self.formed: dict[Any, Any] = {}
        self.suffix = ""
        self._interned: dict[Any, Node] = {}
        self.zero = self.constant(0.0)
        self.one = self.constant(1.0)

    def __len__(self) -> int:
        return len(self.nodes)

    @contextmanager
    def labelled(self, section: str) -> Iterator[None]:
        """Label the nodes that are formed inside the ``with`` block."""
        previous, self.section = self.section, section + self.suffix
        try:
            yield
        finally:
            self.section = previous

    def note_origin(self, node: Node, origin: str) -> None:
        """Record the origin of a value for messages, unless it already has one."""
        if node.args:  # constants and symbols are skipped: many edges share them
            self.origins.setdefault(node, origin)

    def constant(self, value: float) -> Node:
        """Return the node of a finite number."""
        value = float(value) + 0.0  # turns -0.0 into 0.0, so that zero is a single node
        node = self._interned.get(value)
        if node is None:
            if not math.isfinite(value):
                raise ArithmeticError(f"the constant {value} is not finite")
            node = self._interned[value] = Node(self, "constant", (), None, value)
        return node

    def symbol(self, kind: str, position: int) -> Node:
        """Return the symbol with the number ``position`` of a kind."""
        key = (kind, position)
        node = self._interned.get(key)
        if node is None:
            node = self._interned[key] = Node(self, "symbol", (), key, None)
        return node

    def _intern(self, op: str, args: tuple[Node, ...], data: Any = None) -> Node:
        key = (op, *[arg.index for arg in args], data)
        node = self._interned.get(key)
        if node is None:
            node = self._interned[key] = Node(self, op, args, data, None)
        return node

    @staticmethod
    def key(node: Node) -> Any:
        """Return the key under which a node is interned."""
        if not node.args and node.op in ("constant", "symbol"):
            return node.data if node.value is None else node.value
        key = (node.op, *[arg.index for arg in node.args])
        return key if node.op in ("add", "sub", "mul") else (*key, node.data)

    def add(self, a: Node, b: Node) -> Node:
        """Form a + b."""
        if a is self.zero:
            return b
        if b is self.zero:
            return a
        if a.value is not None and b.value is not None:
            return self.constant(a.value + b.value)
        if b.op == "neg":
            return self.sub(a, b.args[0])
        if a.op == "neg":
            return self.sub(b, a.args[0])
        if a is b:
            return self.mul(self.constant(2.0), a)
        if a.index > b.index:  # a + b and b + a are the same node
            a, b = b, a
        if b.op == "sub" and b.args[1] is a:  # a + (c - a) = c
            return b.args[0]
        key = ("add", a.index, b.index)
        node = self._interned.get(key)
        if node is None:
            node = self._interned[key] = Node(self, "add", (a, b), None, None)
        return node

    def sub(self, a: Node, b: Node) -> Node:
        """Form a - b."""
        if b is self.zero:
            return a
        if a is b:
            return self.zero
        if a is self.zero:
            return self.neg(b)
        if b.value is not None:
            if a.value is not None:
                return self.constant(a.value - b.value)
            if b.value < 0.0:
                return self.add(a, self.constant(-b.value))
        if b.op == "neg":
            return self.add(a, b.args[0])
        if a.op == "neg":
            return self.neg(self.add(a.args[0], b))
        if a in b.args or b in a.args:
            rest = self._rest(a, b)
            if rest is not None:
                return rest
        key = ("sub", a.index, b.index)
        node = self._interned.get(key)
        if node is None:
            node = self._interned[key] = Node(self, "sub", (a, b), None, None)
        return node

    def _rest(self, a: Node, b: Node) -> Node | None:
        """Return a - b if one operand is a sum or difference that contains the other, else None."""
        if a.op == "add" and b in a.args:
            return a.args[0] if a.args[1] is b else a.args[1]
        if a.op == "sub" and a.args[0] is b:
            return self.neg(a.args[1])
        if b.op == "sub" and b.args[0] is a:
            return b.args[1]
        if b.op == "add" and a in b.args:
            return self.neg(b.args[0] if b.args[1] is a else b.args[1])
        return None

    def mul(self, a: Node, b: Node) -> Node:
        """Form a * b."""
        zero = self.zero
        if a is zero or b is zero:
            return zero
        if a is self.one:
            return b
        if b is self.one:
            return a
        if a.op == "neg":
            return self.neg(self.mul(a.args[0], b))
        if b.op == "neg":
            return self.neg(self.mul(a, b.args[0]))
        if b.value is not None:  # _scale requires that constants are the first factor
            a, b = b, a
        if a.value is not None:
            return self._scale(a.value, a, b)
        if a.index > b.index:
            a, b = b, a
        if b.op == "div" and b.args[1] is a and b.args[0] is self.one:  # a * (1 / a) = 1
            return b.args[0]
        key = ("mul", a.index, b.index)
        node = self._interned.get(key)
        if node is None:
            node = self._interned[key] = Node(self, "mul", (a, b), None, None)
        return node

    def _scale(self, factor: float, a: Node, b: Node) -> Node:
        """Form the product of ``b`` and the constant ``a``, whose value is ``factor``."""
        if b.value is not None:
            return self.constant(factor * b.value)
        if factor < 0.0:
            return self.neg(self.mul(self.constant(-factor), b))
        if b.op == "mul" and b.args[0].value is not None:
            return self.mul(self.constant(factor * b.args[0].value), b.args[1])
        key = ("mul", a.index, b.index)
        node = self._interned.get(key)
        if node is None:
            node = self._interned[key] = Node(self, "mul", (a, b), None, None)
        return node

    def div(self, a: Node, b: Node) -> Node:
        """Form a / b."""
        if b.value is not None:
            if b.value == 0.0:
                raise ZeroDivisionError("division by zero")
            if a.value is not None:
                return self.constant(a.value / b.value)
            return self.mul(self.constant(1.0 / b.value), a)  # faster, but rounds twice
        if a is self.zero:
            return a
        if a is b:
            return self.one
        if a.op == "neg":
            return self.neg(self.div(a.args[0], b))
        if b.op == "neg":
            return self.neg(self.div(a, b.args[0]))
        return self._intern("div", (a, b))

    def neg(self, a: Node) -> Node:
        """Form -a."""
        if a.value is not None:
            return self.constant(-a.value)
        if a.op == "neg":
            return a.args[0]
        if a.op == "sub":  # -(c - d) = d - c, without a negation
            return self.sub(a.args[1], a.args[0])
        return self._intern("neg", (a,))

    def pow(self, a: Node, exponent: Node) -> Node:
        """Form a**exponent: products for integer exponents, a square root for one half."""
        power = exponent.value
        if power is not None:
            if a.value is not None:
                return self.constant(folded("pow", a.value, power))
            if power == int(power) and abs(power) <= 64:  # at most ten products
                return self._integer_power(a, int(power))
            if power == 0.5:
                return self.function("sqrt", a)
        return self._intern("pow", (a, exponent))

    def _integer_power(self, a: Node, power: int) -> Node:
        if power < 0:
            return self.div(self.one, self._integer_power(a, -power))
        result, square = self.one, a
        while power:
            if power & 1:
                result = self.mul(result, square)
            power >>= 1
            if power:
                square = self.mul(square, square)
        return result

    def function(self, name: str, *args: Node) -> Node:
        """Build a node that applies a function of :data:`OPERATIONS`, with constants folded.

        Raise ValueError or OverflowError if its value at constants is nan or infinite.
        """
        values = [arg.value for arg in args if arg.value is not None]
        if len(values) == len(args):
            return self.constant(folded(name, *values))
        if args[0].op == "neg":
            if name in _ODD:
                return self.neg(self.function(name, args[0].args[0]))
            if name in _EVEN:
                return self.function(name, args[0].args[0])
        return self._intern(name, args)

    def select(self, condition: Node, accepted: Node, refused: Node) -> Node:
        """Form ``accepted`` if ``condition >= 0``, else ``refused``."""
        if accepted is refused:
            return accepted
        if condition.value is not None:
            return accepted if condition.value >= 0.0 else refused
        return self._intern("select", (condition, accepted, refused))

    def several(self, op: str, args: Sequence[Node], data: Any, n_results: int) -> tuple[Node, ...]:
        """Form a node with several results, described by ``data``, and return the results."""
        node = self._intern(op, tuple(args), data)
        return tuple(self._intern("result", (node,), position) for position in range(n_results))

    def rebuild(self, node: Node, args: tuple[Node, ...]) -> Node:
        """Form the operation of ``node`` with other arguments."""
        op = node.op
        if op in ("add", "sub", "mul", "div", "pow", "neg", "select"):
            made: Node = getattr(self, op)(*args)
            return made
        if op in OPERATIONS:
            return self.function(op, *args)
        return self._intern(op, args, node.data)


_by_index = attrgetter("index")


def reachable(roots: Iterable[Node], stop: Container[Node] = ()) -> list[Node]:
    """Return the roots and all nodes they depend on, in order; ``stop`` nodes are not expanded."""
    found = set(roots)
    stack = list(found)
    while stack:
        node = stack.pop()
        if node in stop:
            continue
        for arg in node.args:
            if arg not in found:
                found.add(arg)
                stack.append(arg)
    # A node has a larger index than its arguments.
    return sorted(found, key=_by_index)


def dependent(nodes: Iterable[Node], sources: Iterable[Node]) -> set[Node]:
    """Return the sources and the nodes that depend on them; ``nodes`` is in evaluation order."""
    marked = set(sources)
    for node in nodes:
        if any(arg in marked for arg in node.args):
            marked.add(node)
    return marked


def substitute(roots: Iterable[Node], replacement: Mapping[Node, Node]) -> list[Node]:
    """Return the roots with nodes replaced; nodes that do not depend on them are not copied."""
    roots = list(roots)
    new: dict[Node, Node] = dict(replacement)
    # Replaced nodes are not expanded, so only the required part of the graph is rebuilt.
    for node in reachable(roots, stop=replacement):
        if node in replacement:
            continue
        made = rebuilt(node, new)
        if made is not node:
            new[node] = made
    return [new.get(root, root) for root in roots]


def ways_to_zero(value: Node) -> list[dict[Node, Node]]:
    """Return alternative substitutions, each of which makes a value zero."""
    dag = value.dag
    ways: list[dict[Node, Node]] = [{value: dag.zero}]
    while value.op == "neg" or (value.op == "mul" and value.args[0].value is not None):
        value = value.args[-1]
        ways.append({value: dag.zero})
    if value.op in ("add", "sub"):
        a, b = value.args
        for one, other in ((a, b), (b, a)):
            # Replace a term by the other one, unless the other one contains it.
            if one.value is None and one not in reachable([other]):
                ways.append({value: dag.zero, one: -other if value.op == "add" else other})
    return ways


def formed_in(dag: Dag, root: Node, replacement: Mapping[Node, Node]) -> Node:
    """Return a node of another graph as a node of ``dag``, with its symbols replaced."""
    new = dict(replacement)
    for node in reachable([root]):
        if node.value is not None:
            new[node] = dag.constant(node.value)
        elif node not in new:
            new[node] = dag.rebuild(node, tuple([new[arg] for arg in node.args]))
    return new[root]


def rebuilt(node: Node, new: Mapping[Node, Node]) -> Node:
    """Return a node with its arguments replaced, and the same origin."""
    args = tuple([new.get(arg, arg) for arg in node.args])
    if args == node.args:
        return node
    made = node.dag.rebuild(node, args)
    if node in node.dag.origins:
        node.dag.note_origin(made, node.dag.origins[node])
    return made


def supports_of(order: Iterable[Node], own: Mapping[Node, int]) -> dict[Node, int]:
    """Return the bits of each node: its own and its arguments'; ``order`` is evaluation order."""
    found = dict(own)
    for node in order:
        bits = found.get(node, 0)
        for arg in node.args:
            bits |= found.get(arg, 0)
        found[node] = bits
    return found


def symbols_of_each(
    roots: Sequence[Node], among: Container[Node] | None = None
) -> list[list[Node]]:
    """Return the symbols on which each root depends; only those in ``among`` unless it is None."""
    walk = reachable(roots)
    symbols = [node for node in walk if node.op == "symbol" and (among is None or node in among)]
    masks = supports_of(walk, {node: 1 << i for i, node in enumerate(symbols)})
    known: dict[int, list[Node]] = {}
    for root in roots:
        mask = masks.get(root, 0)
        if mask not in known:
            digits = bin(mask)[:1:-1]  # lowest bit first
            known[mask] = [symbols[i] for i, digit in enumerate(digits) if digit == "1"]
    return [known[masks.get(root, 0)] for root in roots]


def symbols_in(roots: Iterable[Node]) -> list[Node]:
    """Return the symbols on which the roots depend."""
    return [node for node in reachable(roots) if node.op == "symbol"]


TIME = "t"
STATE = "x"
INPUT = "u"
PARAMETER = "p"
#: Symbol of the derivative of state i with respect to parameter or initial value j; index j n + i.
SENSITIVITY = "s"
#: Symbol of a sensitivity, numbered without those that are identically zero.
PACKED_SENSITIVITY = "packed"
#: Symbol of the rate of a state, in derivatives along the motion.
STATE_RATE = "rate"
#: Symbol of a component of the direction in directional derivatives.
DIRECTION = "v"
#: Symbol of a branch that is frozen during a step: sign of a condition, or number of an interval of
#: a table; zero if it is not frozen. Kernels read it from the prepared values.
PIECE = "piece"

#: Symbol of a lower or upper bound of a quantity, or of its rate, within part of a step.
RANGE = "range"

#: Name of the kernel argument that contains the symbols of each kind.
ARGUMENT_OF = {
    TIME: "t",
    STATE: "x",
    INPUT: "u",
    PARAMETER: "p",
    SENSITIVITY: "s",
    PACKED_SENSITIVITY: "s",
    STATE_RATE: "s",
    RANGE: "s",
    DIRECTION: "v",
    PIECE: "k",
}

#: Symbol of the change of state i or sensitivity parameter j along a direction.
STATE_CHANGE = "dx"
PARAMETER_CHANGE = "dp"
#: Symbol of the change of an input or of a tunable parameter in a linearisation.
INPUT_CHANGE = "du"
TUNED_CHANGE = "dtuned"
#: Symbol of an explicit derivative with respect to a parameter, at constant states.
SOURCE = "source"
#: Symbol of an acceleration or multiplier, or of its derivative along a direction.
UNKNOWN = "w"
UNKNOWN_CHANGE = "dw"
#: Symbol of a right-hand side entry of which a map or a sparsity pattern is formed.
ENTRY = "own"
#: Symbol of an argument of a law.
ARGUMENT = "argument"
#: Symbol of the Newton step of an algebraic unknown.
STEP = "step"
#: Symbol of an across variable that occurs in a field.
MEASURED = "measured"
#: Symbols of a value that all columns of a map share, and of a value of one column.
SHARED = "shared"
COLUMN = "column"
#: Symbol of the change of a map's input, or of the weight of a map's result.
CHANGE = "change"


def kinds_in(roots: Iterable[Node]) -> set[str]:
    """Return the kinds of symbols on which the roots depend."""
    return {symbol.data[0] for symbol in symbols_in(roots)}


class _Writer(pickle.Pickler):
    """Pickler that writes nodes as indices, and collects them."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self.found: dict[Node, None] = {}

    def persistent_id(self, value: Any) -> int | None:
        if value.__class__ is Node:
            self.found[value] = None
            return value.index
        return -1 if value.__class__ is Dag else None


class _NodeUnpickler(pickle.Unpickler):
    """Unpickler that creates nodes without content, which their rows then fill."""

    def __init__(self, file: io.BytesIO) -> None:
        super().__init__(file)
        self.dag, self.found = Dag(), dict[int, Node]()
        self.dag.nodes.clear()
        self.dag._interned.clear()

    def persistent_load(self, index: int) -> Any:
        if index < 0:
            return self.dag
        if index not in self.found:
            # Every graph begins with the constants zero and one, which are also attributes.
            first = (self.dag.zero, self.dag.one)
            self.found[index] = first[index] if index < 2 else Node.__new__(Node)
        return self.found[index]


def pickled_graph(value: Any, dag: Dag) -> bytes:
    """Pickle a value whose nodes belong to ``dag``, with only those nodes that it needs.

    Nodes keep their order. They are written as rows, because recursive pickling of a deep graph
    would exceed Python's stack limit.
    """
    file = io.BytesIO()
    writer, rows = _Writer(file), dict[Node, tuple[Any, ...]]()
    writer.dump(value)
    writer.found |= {dag.zero: None, dag.one: None}
    # Data of nodes may contain further nodes, as those of maps do.
    while fresh := [node for node in reachable(writer.found) if node not in rows]:
        for node in fresh:
            args = tuple([arg.index for arg in node.args])
            rows[node] = (node.index, node.op, args, node.value, node.section, node.data)
        writer.dump([rows[node] for node in fresh])
    writer.dump(None)
    writer.dump({node.index: text for node, text in dag.origins.items() if node in rows})
    return file.getvalue()


def unpickled_graph(data: bytes) -> Any:
    """Return the value of :func:`pickled_graph`; its nodes belong to a new graph."""
    reader = _NodeUnpickler(io.BytesIO(data))
    value, dag = reader.load(), reader.dag
    while (rows := reader.load()) is not None:
        for index, op, args, number, section, own in rows:
            node = reader.persistent_load(index)
            node.dag, node.op, node.value, node.section, node.data = dag, op, number, section, own
            node.args = tuple(map(reader.persistent_load, args))
    for i, (_, node) in enumerate(sorted(reader.found.items())):
        node.index = i
        dag.nodes.append(node)
        dag._interned[dag.key(node)] = node
    dag.origins = {reader.found[index]: origin for index, origin in reader.load().items()}
    return value
