"""Conversion of nodes to statements, and storage of the inputs and results of maps."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cotree.codegen.ir import (
    WHOLE,
    Array,
    Assign,
    Call,
    Comment,
    SetStatus,
    apply,
    call,
    element,
    named,
    number,
    temporary,
    whole,
)
from cotree.codegen.ir import tolerance as tolerance_of
from cotree.codegen.printing import Constants, int_table
from cotree.dag.multi_output import SEVERAL, LinearMap, is_symmetric, sizes_of
from cotree.dag.multi_output import results as results_of
from cotree.dag.nodes import ARGUMENT_OF, TIME, reachable

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

    from cotree.codegen.ir import CExpression, Statement
    from cotree.dag.nodes import Node
    from cotree.program.program import Kernel


#: Maximum number of lanes in a SIMD vector on any machine.
_WIDEST = 8
#: Maximum number of values stored as full rows, including zeros: half of the level-1 cache.
_MOST_WHOLE = 2048


def padded(n: int) -> int:
    """Round a number up to a multiple of the widest vector."""
    return -(-n // _WIDEST) * _WIDEST


@dataclass(frozen=True)
class OwnRows:
    """Storage in C of a map's inputs as sparse rows, without the sensitivities.

    Rows are stored in pieces of eight columns, the width of the widest vectors. The first piece
    contains zeros and represents all zero pieces; a table has the start of each piece. Short rows
    of constants are stored in full, including zeros.
    """

    linear: LinearMap  # the map that is applied
    first: int  # index of the first input that is stored in these rows
    is_whole: bool  # whether rows are stored contiguously, including their zeros

    @cached_property
    def _pieces(self) -> dict[tuple[int, int], int]:
        """Number of each nonzero piece, counted from one, by first column and row."""
        given = self.linear.given
        # Piece zero represents all pieces of zeros.
        found = (
            (at, i)
            for at in range(0, len(given), _WIDEST)
            for i in range(self.first, self.linear.n_inputs)
            if any(bits >> i & 1 for bits in given[at : at + _WIDEST])
        )
        return {piece: number for number, piece in enumerate(found, 1)}

    @property
    def n_rows(self) -> int:
        """Number of rows."""
        return self.linear.n_inputs - self.first

    @property
    def width(self) -> int:
        """Length of a row that is stored in full."""
        return padded(self.linear.n_columns)

    @property
    def length(self) -> int:
        """Total number of stored values."""
        if self.is_whole:
            return max(1, self.n_rows * self.width)
        return _WIDEST * (1 + len(self._pieces))

    @cached_property
    def places(self) -> list[list[int]]:
        """Start of each row's piece, in one list per group of eight columns."""
        rows = range(self.first, self.linear.n_inputs)
        groups = range(0, self.linear.n_columns, _WIDEST)
        return [[_WIDEST * self._pieces.get((at, i), 0) for i in rows] for at in groups]

    def place(self, i: int, j: int) -> int:
        """Return the index at which input i of column j is stored if it may be nonzero."""
        if self.is_whole:
            return self.width * (i - self.first) + j
        lane = j % _WIDEST
        return _WIDEST * self._pieces[j - lane, i] + lane

    def values(self, node: Node) -> dict[int, Node]:
        """Return the nonzero values that an application of the map stores, by index."""
        return {
            self.place(i, j): value
            for j, column in enumerate(self.linear.columns(node.args))
            for i, value in enumerate(column)
            if i >= self.first and not value.is_zero
        }


def own_rows(node: Node) -> OwnRows:
    """Return the storage of the inputs that the columns of a map application do not share."""
    linear: LinearMap = node.data
    first = linear.n_sensitive(node.args)
    rows = OwnRows(linear, first, is_whole=True)
    if rows.length <= _MOST_WHOLE and all(
        value.value is not None for value in rows.values(node).values()
    ):
        return rows
    return OwnRows(linear, first, is_whole=False)


@dataclass(frozen=True)
class Starts:
    """Start of each column of a map in the result array of a kernel."""

    array: str
    places: tuple[int, ...]

    def place(self, i: int, n_rows: int) -> CExpression:
        """Return the array element that contains result i of the map."""
        # Results are numbered column by column.
        column, row = divmod(i, n_rows)
        return element(self.array, self.places[column] + row)


def starts_of_maps(kernel: Kernel) -> dict[Node, Starts]:
    """Return the maps whose columns are results of a kernel, with the start of each column."""
    first: dict[Node, int] = {}
    for i, root in enumerate(kernel.results):
        first.setdefault(root, i)
    found = {}
    for node in kernel.order:
        if node.op != "map":
            continue
        n, own = len(node.data.results), results_of(node, node.data.n_results)
        # First results of columns are starts only if the further results of the columns follow.
        places = tuple(first.get(root, 0) for root in own[::n])
        if all(
            kernel.results[place : place + n] == own[n * j : n * (j + 1)]
            for j, place in enumerate(places)
        ):
            found[node] = Starts(kernel.spec.result, places)
    return found


def name_starts(kernels: Iterable[Kernel]) -> Mapping[tuple[int, ...], Constants]:
    """Return a table of constants for each different list of column starts."""
    tables = dict.fromkeys(
        starts.places for kernel in kernels for starts in starts_of_maps(kernel).values()
    )
    return {places: int_table(f"cotree_starts{i}", places) for i, places in enumerate(tables)}


_LARGEST_SYSTEM = 12  # maximum number of unknowns of a system without loops: 300 statements
_LONGEST_INLINE = 72  # maximum number of characters of an inlined expression

#: Key, in a mapping of names, of the function that computes several sines.
SINES = "sines"


def symbol(kind: str, position: int) -> CExpression:
    """Return the C expression of a symbol: a kernel argument, or an element of one."""
    array = ARGUMENT_OF.get(kind, kind)
    return named(array) if kind == TIME else element(array, position)


@dataclass(frozen=True)
class Printed:
    """Statements that compute the requested values."""

    #: Statements with comments, in one list for each requested part.
    parts: list[list[Statement]]
    values: list[CExpression]  # C expression of each requested value
    n_statements: int  # number of values that have their own statement
    uses_status: bool  # whether a statement may set ``status``
    #: Names of arrays that are filled for maps.
    filled: list[str] = field(default_factory=list)

    @property
    def statements(self) -> list[Statement]:
        """All statements of all parts."""
        return [statement for part in self.parts for statement in part]


def print_nodes(
    roots: Sequence[Node],
    prepared: Mapping[Node, int],
    names: Mapping[Any, str],
    parts: Sequence[Sequence[Node]] | None = None,
    places: Mapping[Node, Starts] = MappingProxyType({}),
    *,
    kept: Collection[Node] = (),
    has_groups: bool = True,
    symbols: Callable[[str, int], CExpression] = symbol,
) -> Printed:
    """Return the statements that compute the nodes ``roots``.

    ``prepared`` maps nodes that are read from ``k`` to their indices in ``k``. ``names`` has the C
    names of tables, of maps by their rows of inputs, and of tables of column starts. ``parts``
    contains all nodes on which the roots depend, in order of evaluation and divided into parts; by
    default there is one part. ``places`` has the maps whose results are stored in the result array
    of the kernel. Nodes in ``kept`` are not inlined even if they are used once. With
    ``has_groups``, comments name the groups of statements, which are then consecutive. ``symbols``
    returns the expression of a symbol from its kind and position.
    """
    parts = [reachable(roots, stop=prepared)] if parts is None else parts
    printer = _StatementWriter(prepared, names, places, has_groups, symbols)
    printer.count_uses([*roots, *kept], chain.from_iterable(parts))
    found, done = [], 0
    for part in parts:
        for node in part:
            printer.visit(node)
        found.append(printer.statements[done:])
        done = len(printer.statements)
    return printer.printed(roots, found)


def is_written_out(node: Node) -> bool:
    """Return whether a definite linear system is solved by straight-line code."""
    return (
        node.op == "solve"
        and node.data.size <= _LARGEST_SYSTEM
        and bool(sizes_of(node))
        and is_symmetric(node)
    )


@dataclass
class _StatementWriter:
    prepared: Mapping[Node, int]
    names: Mapping[Any, str]
    places: Mapping[Node, Starts]
    has_groups: bool
    symbols: Callable[[str, int], CExpression]
    statements: list[Statement] = field(default_factory=list)
    uses_status: bool = False
    filled: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        self._known: dict[Node, CExpression] = {}
        self._number: dict[Node, int] = {}  # number of each value that has a statement
        self._uses: dict[Node, int] = {}
        self._factors: dict[Any, int] = {}  # number of each factorised matrix in the C text
        self._section = ""

    def count_uses(self, roots: Iterable[Node], order: Iterable[Node]) -> None:
        """Count the uses of each value."""
        uses = self._uses
        for node in order:
            # Prepared values are read from an array and do not use their arguments.
            if node not in self.prepared:
                for arg in node.args:
                    uses[arg] = uses.get(arg, 0) + 1
        # A root is itself a use: if another value also reads the root, it is not inlined.
        for root in roots:
            uses[root] = uses.get(root, 0) + 1

    def printed(self, roots: Sequence[Node], parts: list[list[Statement]]) -> Printed:
        """Return the statements, and the expressions of the roots."""
        values = [self._known[root] for root in roots]
        return Printed(parts, values, len(self._number), self.uses_status, self.filled)

    def visit(self, node: Node) -> None:
        op = node.op
        if node in self.prepared:
            self._known[node] = element("k", self.prepared[node])
        elif op == "constant":
            assert node.value is not None
            self._known[node] = number(node.value)
        elif op == "symbol":
            self._known[node] = self.symbols(*node.data)
        elif op in SEVERAL:
            getattr(self, f"_{op}")(node)
        elif op == "result":
            self._known[node] = self._result(node.args[0], node.data)
        else:
            self._scalar(node)

    def _result(self, owner: Node, i: int) -> CExpression:
        if owner in self.places:
            return self.places[owner].place(i, len(owner.data.results))
        if owner.op == "sines" and i >= owner.data:
            i += padded(owner.data) - owner.data  # cosines start at a whole vector
        # C stores the results of maps in padded rows, while nodes number them column by column.
        if owner.op == "map":
            column, row = divmod(i, len(owner.data.results))
            i = row * padded(owner.data.n_columns) + column
        return element(f"v{self._number[owner]}", i)

    def _declare(self, node: Node) -> int:
        """Return the number of a new statement; a comment precedes it if a new group begins."""
        if self.has_groups and node.section and node.section != self._section:
            self.statements.append(Comment(node.section))
        self._section = node.section
        self._number[node] = found = len(self._number)
        return found

    def _scalar(self, node: Node) -> None:
        value = apply(node.op, *[self._known[arg] for arg in node.args])
        # Inline a value that is used once, unless the expression becomes too long to read.
        if self._uses[node] == 1 and value.width <= _LONGEST_INLINE:
            self._known[node] = value
            return
        own = temporary("v", self._declare(node))
        self.statements.append(Assign((own,), value))
        self._known[node] = own

    def _values(self, args: Iterable[Node]) -> tuple[CExpression, ...]:
        return tuple(self._known[arg] for arg in args)

    def _solve(self, node: Node) -> None:
        """Append statements that solve a system; each matrix is factorised once."""
        n, at = node.data.size, self._declare(node)
        matrix, rhs = node.args[: n * n], node.args[n * n : n * n + n]
        sizes, is_apart = sizes_of(node), is_written_out(node)
        # Solutions may share factors only if their rank decisions agree.
        key = (matrix, sizes, node.args[-1], node.data)
        if key not in self._factors:
            self._factors[key] = at
            self._factorise(node, at)
        f = self._factors[key]
        own, x = f"_{n}" if is_apart else "", named(f"v{at}")
        rank, accepted = temporary("rank", f), temporary("accepted", f)
        given = [named(f"s{f}")] if is_apart else []
        read = [rank, named(f"a{f}"), *given, named(f"r{f}"), named(f"c{f}"), x]
        # Rows and columns are divided by the square roots of the sizes: S A S y = S b and x = S y.
        # The functions for small systems scale the right-hand side and the solution themselves.
        scaling = [Call(call("cotree_multiply", whole(n), named(f"s{f}"), x))]
        scaling = scaling if sizes and not is_apart else []
        values = (*self._values(rhs), apply("real", rank), apply("real", accepted))
        self.statements += [
            Array(f"v{at}", n + 2, values=values),
            *scaling,
            Call(call(f"cotree_substitute{own}", whole(n), *read)),
            *scaling,
            SetStatus(apply("not", accepted), "COTREE_SINGULAR"),
        ]
        self.uses_status = True

    def _factorise(self, node: Node, f: int) -> None:
        n, sizes, is_apart = node.data.size, sizes_of(node), is_written_out(node)
        a, s, rows, columns = (named(f"{prefix}{f}") for prefix in "asrc")
        own, given = (f"_{n}", [s]) if is_apart else ("", [])
        self.statements.append(Array(f"a{f}", n * n, values=self._values(node.args[: n * n])))
        if sizes:
            self.statements.append(Array(f"s{f}", n, values=self._values(sizes)))
            if not is_apart:
                self.statements.append(Call(call("cotree_scale", whole(n), s, a)))
        reference, tolerance = self._known[node.args[-1]], tolerance_of(node.data.tolerance)
        rank, accepted = temporary("rank", f), temporary("accepted", f)
        factorised = [whole(n), reference, tolerance, a, *given, rows, columns]
        completed = [whole(n), whole(node.data.n_determined), rank, a, columns]
        self.statements += [
            Array(f"r{f}", n, WHOLE),
            Array(f"c{f}", n, WHOLE),
            Assign((rank,), call(f"cotree_factorise{own}", *factorised)),
            Assign((accepted,), call(f"cotree_complete{own}", *completed)),
        ]

    def _table(self, node: Node) -> None:
        at, table = self._declare(node), self.names[node.data]
        x, y = named(f"{table}_x"), named(f"{table}_y")
        given = [whole(len(node.data.x)), x, y, self._known[node.args[0]], named(f"v{at}")]
        self.statements += [Array(f"v{at}", 2), Call(call("cotree_table", *given))]

    def _lookup(self, node: Node) -> None:
        at, table, data = self._declare(node), self.names[node.data], node.data
        sizes = [whole(len(axis)) for axis in data.axes]
        rows = [named(f"{table}_{row}") for row in data.arrays]
        given = [*sizes, *rows, *(self._known[arg] for arg in node.args), named(f"v{at}")]
        self.statements += [Array(f"v{at}", len(data.results)), Call(call(data.function, *given))]

    def _call(self, node: Node) -> None:
        at = self._declare(node)
        args = self._values(node.args)
        called = call(node.data.name, named(f"a{at}"), named(f"v{at}"))
        self.statements += [
            Array(f"a{at}", len(args), values=args, is_constant=True),
            Array(f"v{at}", node.data.n_results),
            SetStatus(apply("fails", called), "COTREE_FAILED_CALL"),
        ]
        self.uses_status = True

    def _sines(self, node: Node) -> None:
        """Append statements for sines and cosines; a single call if a function exists."""
        at, n, width = self._declare(node), node.data, padded(node.data)
        angles, v = self._values(node.args), f"v{at}"
        if SINES in self.names:
            # Vectors read the padding too, so it must be defined.
            filled = (*angles, *[number(0.0)] * (width - n))
            cosines = apply("add", named(v), whole(width))
            given = [whole(n), named(f"a{at}"), named(v), cosines]
            self.statements += [
                Array(f"a{at}", width, values=filled, is_constant=True),
                Array(v, 2 * width),
                Call(call(self.names[SINES], *given)),
            ]
            return
        self.statements.append(Array(v, 2 * width))
        for i, angle in enumerate(angles):
            self.statements.append(Assign((element(v, i),), apply("sin", angle)))
            self.statements.append(Assign((element(v, width + i),), apply("cos", angle)))

    def _map(self, node: Node) -> None:
        """Append statements that fill the input arrays of a map, and the map's call."""
        linear: LinearMap = node.data
        at = self._declare(node)
        rows, width = own_rows(node), padded(linear.n_columns)
        shared, given = f"shared{at}", self.names.get(node, f"own{at}")
        self._fill(
            Array(shared, max(1, linear.n_shared)), dict(enumerate(node.args[: linear.n_shared]))
        )
        if node not in self.names:
            # If the array has a name, it is a constant table at file scope and is not filled here.
            self.statements.insert(0, Call(call("cotree_clear", named(given), whole(rows.length))))
            self._fill(Array(given, rows.length, is_aligned=True), rows.values(node))
        to, starts = f"v{at}", "NULL"
        if node in self.places:
            to, starts = self.places[node].array, self.names[self.places[node].places]
        else:
            self.statements.append(Array(to, max(1, width * len(linear.results))))
        # Sensitivities in the order of ``s`` are read directly from ``s``.
        own = "s" if rows.first else given
        args = map(named, (shared, own, given, starts, to))
        self.statements.append(Call(call(self.names[rows], *args)))

    def _fill(self, array: Array, values: Mapping[int, Node]) -> None:
        """Declare an array at the start of the function, and fill it at the current position."""
        self.filled.append(array.name)
        self.statements.insert(0, array)
        self.statements += [
            Assign((element(array.name, i),), self._known[v]) for i, v in values.items()
        ]
