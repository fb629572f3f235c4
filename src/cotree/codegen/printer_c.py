"""Nodes to C statements.

A value that is used once stands where it is used; the others become constants in the order of
evaluation. Comments name the group that a statement belongs to.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cotree.codegen.c_statements import ALIGNED
from cotree.codegen.own_rows import own_rows, padded
from cotree.dag.operations import OPERATIONS
from cotree.dag.several import SEVERAL, is_symmetric, sizes_of
from cotree.dag.traverse import reachable
from cotree.naming import c_comment

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.codegen.places import Starts
    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node

_LARGEST_SYSTEM = 12  # that is written out: 300 statements
_LONGEST_INLINE = 72  # characters of an expression that may stand inside another
_ATOM = 9
_SIGNS = {"add": "+", "sub": "-", "mul": "*", "div": "/"}
_PRECEDENCE = {"add": 1, "sub": 1, "mul": 2, "div": 2, "neg": 3}
_OUTER = {"sign": _ATOM, "select": 3}  # arguments that do not stand between commas


#: The key of the function that takes several angles.
SINES = "sines"


@dataclass(frozen=True)
class Printed:
    """C statements that compute some values.

    Attributes
    ----------
    lines : list of str
        The statements, with comments.
    values : list of str
        An expression for each value asked for.
    n_statements : int
        Number of statements.
    uses_status : bool
        Whether a statement may set ``status``.
    filled : list of str
        Arrays that statements fill and only maps read.
    """

    lines: list[str]
    values: list[str]
    n_statements: int
    uses_status: bool
    filled: list[str] = field(default_factory=list)


def literal(value: float) -> str:
    """Write a double as the shortest C literal that reads back equal."""
    text = repr(float(value))
    return text if any(char in text for char in ".en") else f"{text}.0"


def print_nodes(
    roots: Sequence[Node],
    prepared: Mapping[Node, int],
    names: Mapping[Any, str],
    order: Sequence[Node] | None = None,
    places: Mapping[Node, Starts] = MappingProxyType({}),
    *,
    has_groups: bool = True,
) -> Printed:
    """Print the statements that some values need.

    Parameters
    ----------
    roots : sequence of Node
        The values wanted.
    prepared : mapping of Node to int
        Values to read from ``k``, with their place there.
    names : mapping of Table, OwnRows or tuple of int to str
        C name of each table, of each map by what its columns do not share, and of each table of
        places where columns of results begin.
    order : sequence of Node, optional
        What the values depend on, in order of evaluation, where it is known already.
    places : mapping of Node to Starts
        Where the results of a map are to be written, if not to an array of its own.
    has_groups : bool
        Whether values of a group stand together, so that comments name it.
    """
    order = reachable(roots, stop=prepared) if order is None else order
    printer = _Printer(prepared, names, places, has_groups)
    printer.count_uses(roots, order)
    for node in order:
        printer.visit(node)
    values = [printer.operand(root, 0) for root in roots]
    n = printer.n_statements
    return Printed(printer.lines, values, n, printer.uses_status, printer.filled)


@dataclass(frozen=True)
class PrintedParts:
    """C statements in parts, and an expression for each value asked for."""

    parts: list[list[str]]
    values: list[str]


def print_parts(
    roots: Sequence[Node], parts: Sequence[Sequence[Node]], kept: Collection[Node]
) -> PrintedParts:
    """Print statements in parts, in an order of evaluation that is given.

    Parameters
    ----------
    roots : sequence of Node
        The values wanted.
    parts : sequence of sequence of Node
        All that they depend on, but symbols and constants.
    kept : collection of Node
        What gets a statement even if it is used once.
    """
    printer = _Printer({}, {}, {}, has_groups=False)
    order = [node for part in parts for node in part]
    printer.count_uses([*roots, *kept], order)
    for node in reachable(roots):
        if not node.args:
            printer.visit(node)
    found, done = [], 0
    for part in parts:
        for node in part:
            printer.visit(node)
        found.append(printer.lines[done:])
        done = len(printer.lines)
    return PrintedParts(found, [printer.operand(root, 1) for root in roots])


def is_written_out(node: Node) -> bool:
    """Tell whether a linear system, if it is definite, is solved by statements without loops."""
    return (
        node.op == "solve"
        and node.data.size <= _LARGEST_SYSTEM
        and bool(sizes_of(node))
        and is_symmetric(node)
    )


@dataclass
class _Printer:
    prepared: Mapping[Node, int]
    names: Mapping[Any, str]
    places: Mapping[Node, Starts]
    has_groups: bool
    lines: list[str] = field(default_factory=list)
    uses_status: bool = False
    filled: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._text: dict[Node, tuple[str, int]] = {}  # expression and its precedence
        self._number: dict[Node, int] = {}  # of the values that have a statement
        self._uses: dict[Node, int] = {}
        self._factors: dict[Any, str] = {}  # number of each factorised matrix
        self._section = ""

    def count_uses(self, roots: Sequence[Node], order: Sequence[Node]) -> None:
        """Count how often each value is read."""
        uses = self._uses
        for node in order:
            if node not in self.prepared:
                for arg in node.args:
                    uses[arg] = uses.get(arg, 0) + 1
        for root in roots:
            uses[root] = uses.get(root, 0) + 1

    @property
    def n_statements(self) -> int:
        return len(self._number)

    def operand(self, node: Node, precedence: int) -> str:
        """Give an expression, in parentheses where it binds less than asked for."""
        text, own = self._text[node]
        return text if own >= precedence else f"({text})"

    def visit(self, node: Node) -> None:
        op = node.op
        if node in self.prepared:
            self._text[node] = (f"k[{self.prepared[node]}]", _ATOM)
        elif op == "constant":
            assert node.value is not None
            self._text[node] = (literal(node.value), _ATOM if node.value >= 0.0 else 3)
        elif op == "symbol":
            kind, position = node.data
            self._text[node] = (kind if kind == "t" else f"{kind}[{position}]", _ATOM)
        elif op in SEVERAL:
            self._several(node)
        elif op == "result":
            owner, i = node.args[0], node.data
            if owner in self.places:
                self._text[node] = (self.places[owner].place(i, len(owner.data.results)), _ATOM)
                return
            if owner.op == "sines" and i >= owner.data:
                i += padded(owner.data) - owner.data  # cosines begin with a vector of their own
            if owner.op == "map":
                column, row = divmod(i, len(owner.data.results))
                i = row * padded(owner.data.n_columns) + column
            self._text[node] = (f"v{self._number[owner]}[{i}]", _ATOM)
        else:
            self._scalar(node)

    def _declare(self, node: Node) -> str:
        """Give a statement its name, after a comment where a group begins."""
        if self.has_groups and node.section and node.section != self._section:
            self.lines.append(f"/* {c_comment(node.section)} */")
        self._section = node.section
        self._number[node] = len(self._number)
        return f"v{self._number[node]}"

    def _scalar(self, node: Node) -> None:
        op = node.op
        sign = _SIGNS.get(op)
        if sign is not None:
            level = _PRECEDENCE[op]
            # The right operand binds tighter, so that values are computed in the program's order
            # and not regrouped; the left one may share the level.
            a, b = node.args
            text = f"{self.operand(a, level)} {sign} {self.operand(b, level + 1)}"
        elif op == "neg":
            level = _PRECEDENCE[op]
            text = f"-{self.operand(node.args[0], level + 1)}"
        else:
            level, outer = _ATOM, _OUTER.get(op, 0)
            text = OPERATIONS[op].c.format(*(self.operand(arg, outer) for arg in node.args))
        if self._uses[node] == 1 and len(text) <= _LONGEST_INLINE:
            self._text[node] = (text, level)
            return
        name = self._declare(node)
        self.lines.append(f"const double {name} = {text};")
        self._text[node] = (name, _ATOM)

    def _several(self, node: Node) -> None:
        getattr(self, f"_{node.op}")(node)

    def _array(self, name: str, args: Sequence[Node]) -> str:
        return f"double {name}[{len(args)}] = {{{', '.join(self.operand(a, 0) for a in args)}}};"

    def _solve(self, node: Node) -> None:
        """Print a solution; a matrix that several solutions share is factorised once."""
        n, name = node.data.size, self._declare(node)
        matrix, rhs = node.args[: n * n], node.args[n * n : n * n + n]
        sizes, reference, is_apart = sizes_of(node), node.args[-1], is_written_out(node)
        key, own = (matrix, sizes, reference, node.data), f"_{n}" if is_apart else ""
        if key not in self._factors:
            self._factors[key] = number = name[1:]
            self.lines.append(self._array(f"a{number}", matrix))
            if sizes:
                self.lines.append(self._array(f"s{number}", sizes))
                if not is_apart:
                    self.lines.append(f"cotree_scale({n}, s{number}, a{number});")
            given = f"s{number}, " if is_apart else ""
            self.lines += [
                f"int r{number}[{n}], c{number}[{n}];",
                f"const int rank{number} = cotree_factorise{own}({n}, "
                f"{self.operand(reference, 0)}, {literal(node.data.tolerance)}, "
                f"a{number}, {given}r{number}, c{number});",
                f"const int accepted{number} = cotree_complete{own}({n}, {node.data.n_determined}, "
                f"rank{number}, a{number}, c{number});",
            ]
        number = self._factors[key]
        values = [self.operand(arg, 0) for arg in rhs]
        values += [f"(double)rank{number}", f"(double)accepted{number}"]
        given = f"s{number}, " if is_apart else ""
        scaling = [f"cotree_multiply({n}, s{number}, {name});"] if sizes and not is_apart else []
        self.lines += [
            f"double {name}[{n + 2}] = {{{', '.join(values)}}};",
            *scaling,
            f"cotree_substitute{own}({n}, rank{number}, a{number}, {given}r{number}, c{number}, "
            f"{name});",
            *scaling,
            f"if (!accepted{number}) status = COTREE_SINGULAR;",
        ]
        self.uses_status = True

    def _table(self, node: Node) -> None:
        name, table = self._declare(node), self.names[node.data]
        n = len(node.data.x)
        self.lines += [
            f"double {name}[2];",
            f"cotree_table({n}, {table}_x, {table}_y, {self.operand(node.args[0], 0)}, {name});",
        ]

    def _call(self, node: Node) -> None:
        name = self._declare(node)
        self.lines += [
            f"const {self._array(f'a{name[1:]}', node.args)}",
            f"double {name}[{node.data.n_results}];",
            f"if ({node.data.name}(a{name[1:]}, {name}) != 0) status = COTREE_FAILED_CALL;",
        ]
        self.uses_status = True

    def _sines(self, node: Node) -> None:
        """Print sines and cosines, one after the other where no function takes them together."""
        name, n, width = self._declare(node), node.data, padded(node.data)
        angles = [self.operand(angle, 0) for angle in node.args]
        if SINES in self.names:
            filled = ", ".join([*angles, *["0.0"] * (width - n)])
            self.lines += [
                f"const double a{name[1:]}[{width}] = {{{filled}}};",
                f"double {name}[{2 * width}];",
                f"{self.names[SINES]}({n}, a{name[1:]}, {name}, {name} + {width});",
            ]
            return
        self.lines.append(f"double {name}[{2 * width}];")
        for i, angle in enumerate(angles):
            self.lines.append(f"{name}[{i}] = sin({angle});")
            self.lines.append(f"{name}[{width + i}] = cos({angle});")

    def _map(self, node: Node) -> None:
        """Gather what the columns share and what each has of its own, row by row, and call it."""
        linear: LinearMap = node.data
        name = self._declare(node)
        rows, width = own_rows(node), padded(linear.n_columns)
        shared, given = f"shared{name[1:]}", self.names.get(node, f"own{name[1:]}")
        self._fill(shared, max(1, linear.n_shared), dict(enumerate(node.args[: linear.n_shared])))
        if node not in self.names:
            self.lines.insert(0, f"cotree_clear({given}, {rows.length});")
            self._fill(given, rows.length, rows.values(node), ALIGNED)
        to, starts = name, "NULL"
        if node in self.places:
            to, starts = self.places[node].array, self.names[self.places[node].places]
        else:
            self.lines.append(f"double {name}[{max(1, width * len(linear.results))}];")
        own = "s" if rows.first else given
        self.lines.append(f"{self.names[rows]}({shared}, {own}, {given}, {starts}, {to});")

    def _fill(
        self, array: str, length: int, values: Mapping[int, Node], qualifier: str = ""
    ) -> None:
        """Declare an array at the top, and fill it here."""
        self.filled.append(array)
        self.lines.insert(0, f"{qualifier}double {array}[{length}];")
        self.lines += [f"{array}[{i}] = {self.operand(v, 0)};" for i, v in values.items()]
