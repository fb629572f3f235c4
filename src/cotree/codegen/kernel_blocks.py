"""Division of long kernels into blocks, and a bound of the stack size of a function.

Compile time and register allocation depend on the longest function. Blocks are functions with their
own temporaries. They end where few values cross to later blocks; the caller's arrays pass these on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from heapq import heappop, heappush
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

import numpy as np

from cotree.codegen.ir import (
    REAL,
    WHOLE,
    Argument,
    Array,
    Assign,
    Call,
    Comment,
    ConstantTable,
    LeaveUnless,
    Loop,
    SetStatus,
    changed,
    declared_by,
    element,
    function_of,
    kind_of,
    n_operations,
    named,
    read_from,
    simple,
    uses,
)
from cotree.dag.operations import OPERATIONS

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cotree.codegen.ir import CExpression, Form, FunctionPart, Statement, Temporary


#: Sizes of a number and of the widest vector on any machine, [byte].
NUMBER, VECTOR = 8, 64

#: Sizes of the return address with frame pointer, and of a word, pointer or argument, [byte].
_LINK, _WORD = 16, 8
#: Frame sizes are multiples of this, [byte]; arrays loaded into vectors are aligned to vectors.
_ALIGNMENT = 16
#: Size of a saved register, with padding, in a function that makes calls, [byte].
_SAVED = 16
#: Number of intermediate values that may be stored during calls of other functions.
_MOST_WAITING = 3

# Stack sizes of the functions for elimination in loops and table lookup, [byte]. This and the next
# stack sizes are those of gcc 12 (-O0 -mno-red-zone -fstack-usage).
_HELPERS = {"cotree_factorise": 112, "cotree_table": 72, "cotree_cubic": 152, "cotree_plane": 192}
_HELPERS |= {"cotree_held_table": 96, "cotree_held_plane": 256}
#: Stack size of the function that computes several sines, [byte].
_SINES = 896
#: Stack sizes of the straight-line elimination of one to three unknowns, [byte].
_SMALLEST_SYSTEMS = {1: 224, 2: 272, 3: 368}


def n_bytes(blocks: Blocks, called: Mapping[str, int], n_arguments: int, real: int = NUMBER) -> int:
    """Return an upper bound on the stack that a function and its callees use, [byte].

    The bound holds for gcc on 64-bit machines without optimisation, when every declared value and
    every argument is stored on the stack. Optimised frames are smaller, usually by a third.
    ``called`` has the stack sizes of the functions it may call; functions of the C library and of
    users are not counted. ``real`` is the size of a number, [byte].
    """
    inner = [(function.body, len(function.arguments)) for function in blocks.functions]
    own = [(blocks.statements, n_arguments), *inner]
    # A function is called if its name occurs in a statement.
    names = {key for rows, _ in own for row in rows for key in uses(row)}
    sizes = [size for name, size in called.items() if name in names]
    sizes += [_of_helper(name) for name in names if isinstance(name, str)]
    # Blocks are called one after another: only the largest frame counts.
    deepest = max((_frame(*rows, real) for rows in inner), default=0)
    return _frame(blocks.statements, n_arguments, real) + deepest + max(*sizes, 0, 0)


def _of_helper(name: str) -> int:
    """Return the stack size of a shared function and its callees; zero for all other functions."""
    base, _, size = name.rpartition("_")
    if base == "cotree_factorise" and size.isdecimal():
        n = int(size)
        return _SMALLEST_SYSTEMS.get(n, 144 + NUMBER * n * (n + 1))
    return _SINES if name == "cotree_sines" else _HELPERS.get(name, 0)


def _frame(statements: Iterable[Statement], n_arguments: int, real: int) -> int:
    """Return the size of one stack frame, [byte]."""
    rows = list(statements)
    # Each loop needs a counter and parts of indices.
    declared = _WORD * (n_arguments + 4 * any(isinstance(row, Loop) for row in rows))
    n_calls, is_aligned, is_computed = 0, False, False
    for row in simple(rows):
        if isinstance(row, Array):
            size = row.length * _size_of(row.kind, real)
            declared += _rounded(size, VECTOR) if row.is_aligned else size
            is_aligned |= row.is_aligned
        elif isinstance(row, Assign) and row.declares is not None:
            declared += _size_of(kind_of(row.declares), real)
        n_calls += sum(_calls_in(e.form) for e in row.expressions)
        is_computed |= any(e.form.n_operations > 1 for e in row.expressions)
    declared += real * (min(n_calls, _MOST_WAITING) + is_computed)
    # Alignment adds up to one vector, since the caller aligns the stack to less.
    return _LINK + _rounded(declared, _ALIGNMENT) + _SAVED * (n_calls > 0) + VECTOR * is_aligned


def _size_of(kind: str, real: int) -> int:
    return real if kind == REAL else 4 if kind == WHOLE else NUMBER


def _rounded(size: int, unit: int) -> int:
    return -(-size // unit) * unit


@lru_cache(maxsize=1 << 12)
def _calls_in(form: Form) -> int:
    """Return the number of function calls in an expression."""
    row = OPERATIONS.get(form.op)
    is_call = form.op in ("call", "part") or (row is not None and row.is_call)
    return is_call + sum(_calls_in(arg) for arg in form.args)


#: Names of the arrays for values that cross between groups of statements, by kind of value.
FRAMES = {REAL: "w", WHOLE: "ranks"}


class Crossing:
    """Storage of values that cross between groups of statements, which run in order.

    Temporaries are local to a group, which is a block of a kernel or a segment of a map. A value
    that a later group reads is also stored in an array: ``places`` maps the value to an element,
    which is reused after the last read. ``lengths`` has the array length of each kind.
    """

    def __init__(self, groups: Sequence[Sequence[Statement]]) -> None:
        self.places: dict[Temporary, CExpression] = {}
        self.lengths = dict.fromkeys(FRAMES, 0)
        self._groups = groups
        self._reads: list[set[str | Temporary]] = []  # values read by each group
        last: dict[str | Temporary, int] = {}
        for i, group in enumerate(groups):
            reads: set[str | Temporary] = set()
            for row in group:
                used = uses(row)
                last.update(dict.fromkeys(used, i))
                reads |= used - {declared_by(row)}
            self._reads.append(reads)
        free: dict[str, list[int]] = {kind: [] for kind in FRAMES}
        leaving: dict[int, list[tuple[str, int]]] = {}
        for i, group in enumerate(groups):
            for row in group:
                made = declared_by(row)
                # Temporaries that are read only within their group are not stored.
                if made is None or last[made] == i:
                    continue
                if isinstance(row, Assign) and len(row.to) > 1:  # already stored in an array
                    self.places[made] = row.to[1]
                    continue
                kind = kind_of(made)
                if not free[kind]:
                    free[kind].append(self.lengths[kind])
                    self.lengths[kind] += 1
                # Using the lowest free element keeps the array short.
                slot = heappop(free[kind])
                self.places[made] = element(FRAMES[kind], slot)
                leaving.setdefault(last[made], []).append((kind, slot))
            # All statements of a group may read the elements, so they are released after the group.
            for kind, slot in leaving.pop(i, ()):
                heappush(free[kind], slot)

    def written(self, number: int) -> list[Statement]:
        """Return the statements of a group, with loads and stores of crossing values."""
        rows, reads = self._groups[number], self._reads[number]
        makes = set(map(declared_by, rows))
        places = {key: self.places[key] for key in reads - makes if key in self.places}

        def placed(expression: CExpression) -> CExpression:
            return read_from(expression, places)

        found: list[Statement] = []
        for row in rows:
            if isinstance(row, Assign) and (made := row.declares) in self.places:
                # Declare the temporary only if the same group also reads it.
                own = row.to[:1] if made in reads else ()
                found.append(Assign((*own, self.places[made]), placed(row.value)))
            else:
                found.append(changed(row, placed) if places else row)
        return found


#: Maximum number of operations in a block. With gcc 12, longer blocks compile more slowly but run
#: no faster; shorter blocks pass more values through memory.
LONGEST_BLOCK = 1_000

#: A block receives a pointer to the caller's status, hence the asterisk.
_BY_POINTER = named("*status")
_STATUS = Argument("*status", WHOLE, is_array=False, given="&status")


@dataclass(frozen=True)
class Blocks:
    """A kernel, divided into functions if it is long."""

    functions: list[FunctionPart]  # in calling order; empty if the kernel is not divided
    statements: list[Statement]  # statements that remain in the kernel


@dataclass(frozen=True, slots=True)
class _Item:
    """A statement, the comment that applies to it, and the names that it contains."""

    row: Statement
    comment: str
    names: set[str | Temporary]
    n_operations: int

    @property
    def makes(self) -> Temporary | None:
        """The temporary that the statement declares."""
        return declared_by(self.row)

    @property
    def is_kept(self) -> bool:
        """Whether the statement stores the declared value in an array, too."""
        return isinstance(self.row, Assign) and len(self.row.to) > 1

    @property
    def is_exit(self) -> bool:
        """Whether the statement may return from the function."""
        rows = self.row.body if isinstance(self.row, Loop) else (self.row,)
        return any(isinstance(row, LeaveUnless) for row in rows)


def cut_into_blocks(
    names: str,
    statements: Sequence[Statement],
    arguments: Sequence[Argument],
    results: Collection[str] = (),
    longest: int = LONGEST_BLOCK,
) -> Blocks:
    """Divide the statements of a kernel into blocks, unless they are few.

    ``names`` is the C name of the blocks, with ``{}`` for the number. ``results`` are arrays that
    no statement reads; their elements are written as soon as they are known. ``longest`` is the
    maximum number of operations in a block; a loop or a single statement may exceed it.
    """
    whole = Blocks([], list(statements))
    if n_operations(statements) <= longest:
        return whole
    writer = _BlockCutter(names, arguments, statements)
    items = list(_items(statements))
    # Statements that may return must stay in the kernel, after the calls of blocks. If such a
    # statement is not at the end, the kernel is not divided.
    n_exits = sum(item.is_exit for item in items)
    body, exits = items[: len(items) - n_exits], items[len(items) - n_exits :]
    if any(item.is_exit for item in body):
        return whole
    if results:
        body = _written_early(body, results, writer.arrays)
    cuts = _choose_cuts(body, exits, writer.arrays, longest)
    # A single block would only add a call.
    if len(cuts) < 3:
        return whole
    return writer.write([body[a:b] for a, b in pairwise(cuts)], exits)


def _items(statements: Iterable[Statement]) -> Iterable[_Item]:
    """Yield all statements, with their comments, except pure declarations."""
    comment = ""
    for row in statements:
        if isinstance(row, Comment):
            comment = row.text
        # Each block declares its arrays and tables; the kernel declares those of several blocks.
        elif not isinstance(row, ConstantTable) and not (isinstance(row, Array) and not row.values):
            yield _Item(row, comment, uses(row), n_operations((row,)))


def _written_early(
    items: Sequence[_Item], results: Collection[str], arrays: Collection[str]
) -> list[_Item]:
    """Move each assignment of a result to the point at which all its arguments are known."""
    known: dict[str | Temporary, int] = {}
    moved: list[list[_Item]] = [[] for _ in items]
    for i, item in enumerate(items):
        if isinstance(item.row, Assign) and item.row.to[0].form.name in results:
            place = max((known.get(name, 0) for name in item.names), default=0)
            moved[place].append(item)
            continue
        # Assignments that are moved to this statement follow it.
        moved[i].insert(0, item)
        if item.makes:
            known[item.makes] = i
        known.update((name, i) for name in item.names if name in arrays)
    return [item for row in moved for item in row]


def _choose_cuts(
    items: Sequence[_Item], exits: Sequence[_Item], arrays: Collection[str], longest: int
) -> list[int]:
    """Return the ends of blocks of similar length, chosen such that the fewest values cross."""
    n = len(items)
    # Number of live names at each cut: sum of +1 after first uses and -1 after last uses.
    crossing = np.zeros(n + 2, dtype=np.intp)
    last = {name: i for i, item in enumerate([*items, *exits]) for name in item.names}
    first = {name: i for i, item in reversed([*enumerate(items)]) for name in item.names}
    # Stored temporaries do not count. Arrays do: a cut between two uses makes them shared.
    counted: list[str | Temporary] = [name for name in arrays if name in first]
    counted += [item.makes for item in items if item.makes and not item.is_kept]
    for name in counted:
        crossing[first[name] + 1] += 1
        crossing[min(last[name], n) + 1] -= 1
    crossing = np.cumsum(crossing)
    sums = np.array([0, *accumulate(item.n_operations for item in items)])
    cuts = [0]
    while sums[-1] - sums[cuts[-1]] > longest:
        # Cut where the fewest values cross, at the last of several such positions.
        start = cuts[-1]
        end = max(start + 1, int(np.searchsorted(sums, sums[start] + longest, "right")) - 1)
        begin = int(np.searchsorted(sums, sums[start] + longest // 2))
        begin = min(max(begin, start + 1), end)
        window = crossing[begin : end + 1]
        cuts.append(end - int(np.argmin(window[::-1])))
    if cuts[-1] < n:
        cuts.append(n)
    return cuts


class _BlockCutter:
    """Writer of the functions of a divided kernel."""

    def __init__(
        self, names: str, arguments: Sequence[Argument], statements: Sequence[Statement]
    ) -> None:
        self._names = names
        self._arguments = arguments
        self.arrays = {row.name: row for row in statements if isinstance(row, Array)}
        self._tables = {row.name: row for row in statements if isinstance(row, ConstantTable)}
        self._shared: list[str] = []  # arrays used by several blocks

    def write(self, blocks: Sequence[Sequence[_Item]], exits: Sequence[_Item]) -> Blocks:
        # The statements that stay in the kernel are the last group.
        groups = [*blocks, exits]
        users: dict[str | Temporary, set[int]] = {}
        for number, items in enumerate(groups):
            for item in items:
                for name in item.names:
                    users.setdefault(name, set()).add(number)
        self._shared = [name for name in self.arrays if len(users.get(name, ())) > 1]
        crossing = Crossing([[item.row for item in items] for items in groups])
        frames = [Array(FRAMES[kind], n, kind) for kind, n in crossing.lengths.items() if n]
        # The kernel only declares shared arrays; the block that computes their values assigns them.
        shared = [replace(self.arrays[name], values=(), is_constant=False) for name in self._shared]
        arguments = [
            *self._arguments,
            *(Argument(row.name, row.kind, is_constant=False) for row in (*frames, *shared)),
            _STATUS,
        ]
        functions, calls = [], []
        for number, items in enumerate(blocks, 1):
            body = self._body(items, crossing.written(number - 1))
            function, called = function_of(self._names.format(number), body, arguments)
            functions.append(function)
            calls.append(Call(called))
        return Blocks(functions, [*frames, *shared, *calls, *crossing.written(len(blocks))])

    def _body(self, items: Sequence[_Item], rows: Sequence[Statement]) -> list[Statement]:
        """Return the statements of a block, preceded by its declarations of arrays and tables."""
        names = {name for item in items for name in item.names}
        filled = {item.row.name for item in items if isinstance(item.row, Array)}
        body: list[Statement] = [
            array
            for key, array in self.arrays.items()
            if key in names and key not in filled and key not in self._shared
        ]
        body += [table for key, table in self._tables.items() if key in names]
        comment = ""
        for item, row in zip(items, rows, strict=True):
            if item.comment != comment:
                comment = item.comment
                body.append(Comment(comment))
            body += self._own(row)
        return body

    def _own(self, row: Statement) -> list[Statement]:
        """Replace declarations of shared arrays by assignments, and the status by its pointer."""
        if isinstance(row, SetStatus):
            return [replace(row, status=_BY_POINTER)]
        if isinstance(row, Array) and row.name in self._shared:
            return [Assign((element(row.name, i),), v) for i, v in enumerate(row.values)]
        return [row]
