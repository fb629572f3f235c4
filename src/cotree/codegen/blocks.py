"""Long kernels cut into blocks.

In: the statements of one C function. Out: several functions, each of which keeps its temporaries
to itself, and a short one that calls them. A compiler's time, and how well it allots registers,
depend on the longest function; so cuts are made where few values cross. What crosses stands in
arrays of the function that calls. Values and the order in which they are computed stay.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from heapq import heappop, heappush
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING

import numpy as np

from cotree.codegen.c_statements import (
    ALIGNED,
    ARRAY,
    NAME,
    SCALAR,
    WRITTEN,
    between_commas,
    count_written,
    filled_arrays,
    take_apart,
)
from cotree.codegen.heads import function_head

if TYPE_CHECKING:
    import re
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cotree.codegen.c_statements import Item, Text

#: Operations of a block at most. Measured with gcc 12: longer blocks compile slower and run no
#: faster, shorter ones pass more values through memory.
LONGEST_BLOCK = 1_000

#: Text before the name of a block.
_HEAD = "COTREE_APART static void"

#: Arrays that hold what crosses, by its kind.
_FRAMES = {"double": "w", "int": "ranks", "VECTOR": "vectors"}


@dataclass(frozen=True)
class Block:
    """A function that computes some of a kernel's statements.

    Attributes
    ----------
    signature : str
        Its head.
    lines : list of str
        Its statements.
    """

    signature: str
    lines: list[str]


@dataclass(frozen=True)
class Blocks:
    """A kernel, cut where it is long.

    Attributes
    ----------
    functions : list of Block
        In the order of their calls; none where it is not cut.
    lines : list of str
        The statements of the kernel itself.
    """

    functions: list[Block]
    lines: list[str]


def cut_into_blocks(
    names: str,
    lines: Sequence[str],
    arguments: Mapping[str, str],
    results: Collection[str] = (),
    longest: int = LONGEST_BLOCK,
    head: str = _HEAD,
) -> Blocks:
    """Cut the statements of a kernel.

    Parameters
    ----------
    names : str
        Name of each block in C, its number left open.
    lines : sequence of str
        Its statements, one a line; loops and tables as :func:`cotree.codegen.loops.roll` writes
        them.
    arguments : mapping of str to str
        C declaration of each argument, in order.
    results : collection of str
        Arrays that no statement reads; each of their values is then written where it is known.
    longest : int
        Operations that a block has at most, but for loops and single statements that are longer.
    head : str
        What stands before the name of each block.

    Returns
    -------
    Blocks
        Not cut where the statements are few, or of a kind that is unknown here.
    """
    whole = Blocks([], list(lines))
    text = take_apart(lines) if count_written(lines) > longest else None
    if text is None or not text.declared.isdisjoint((*arguments, *_FRAMES.values())):
        return whole
    n_exits = sum(item.is_exit for item in text.items)
    body, exits = text.items[: len(text.items) - n_exits], text.items[len(text.items) - n_exits :]
    if any(item.is_exit for item in body):
        return whole
    if results:
        body = _written_early(body, results, text)
    cuts = _choose_cuts(body, exits, text, longest)
    if len(cuts) < 3:
        return whole
    blocks = [body[a:b] for a, b in pairwise(cuts)]
    return _Writer(names, head, arguments, text).write(blocks, exits)


def _written_early(items: Sequence[Item], results: Collection[str], text: Text) -> list[Item]:
    """Move each result to where all that it reads is known."""
    known: dict[str, int] = {}
    moved: list[list[Item]] = [[] for _ in items]
    for i, item in enumerate(items):
        written = WRITTEN.match(item.lines[0])
        if written and written.group(1) in results:
            place = max((known.get(name, 0) for name in item.names), default=0)
            moved[place].append(item)
            continue
        moved[i].insert(0, item)
        known.update(dict.fromkeys(item.makes, i))
        known.update(dict.fromkeys(item.names & text.arrays.keys(), i))
    return [item for row in moved for item in row]


def _choose_cuts(
    items: Sequence[Item], exits: Sequence[Item], text: Text, longest: int
) -> list[int]:
    """Choose where blocks begin and end: each as long as may be, then where fewest values cross."""
    n = len(items)
    crossing = np.zeros(n + 2, dtype=np.intp)
    made = {name: i for i, item in enumerate(items) for name in item.makes}
    last = {name: i for i, item in enumerate([*items, *exits]) for name in item.names}
    for name, i in made.items():
        if name not in text.homes:
            crossing[i + 1] += 1
            crossing[min(last[name], n) + 1] -= 1
    # An array that may be the block's own is better not shared either.
    first = {name: i for i, item in reversed([*enumerate(items)]) for name in item.names}
    for name in text.arrays.keys() & first.keys():
        crossing[first[name] + 1] += 1
        crossing[min(last[name], n) + 1] -= 1
    crossing = np.cumsum(crossing)
    sums = np.array([0, *accumulate(item.n_operations for item in items)])
    cuts = [0]
    while sums[-1] - sums[cuts[-1]] > longest:
        start = cuts[-1]
        end = max(start + 1, int(np.searchsorted(sums, sums[start] + longest, "right")) - 1)
        begin = int(np.searchsorted(sums, sums[start] + longest // 2))
        begin = min(max(begin, start + 1), end)
        window = crossing[begin : end + 1]
        cuts.append(end - int(np.argmin(window[::-1])))
    if cuts[-1] < n:
        cuts.append(n)
    return cuts


class _Writer:
    """Writes the functions."""

    def __init__(self, names: str, head: str, arguments: Mapping[str, str], text: Text) -> None:
        self._names = names
        self._head = head
        self._arguments = arguments
        self._text = text
        self._place: dict[str, str] = {}  # of what crosses
        self._shared: list[str] = []  # arrays that several blocks use
        self._length = dict.fromkeys(_FRAMES, 0)  # of the arrays that hold what crosses

    def write(self, blocks: Sequence[Sequence[Item]], exits: Sequence[Item]) -> Blocks:
        groups = [*blocks, exits]
        self._share_arrays(groups)
        self._allot_places(groups)
        functions, calls = [], []
        for number, items in enumerate(blocks, 1):
            function, call = self._function(self._names.format(number), items)
            functions.append(function)
            calls.append(call)
        kinds, arrays = self._length, self._text.arrays
        lines = [f"{kind} {_FRAMES[kind]}[{n}];" for kind, n in kinds.items() if n]
        lines += [f"{arrays[name][0]} {name}[{arrays[name][1]}];" for name in self._shared]
        lines += calls
        for item in exits:
            lines += self._placed(item)
        return Blocks(functions, lines)

    def _share_arrays(self, groups: Sequence[Sequence[Item]]) -> None:
        """Find the arrays that more than one block uses."""
        users: dict[str, set[int]] = {}
        for number, items in enumerate(groups):
            for item in items:
                for name in item.names & self._text.arrays.keys():
                    users.setdefault(name, set()).add(number)
        self._shared = [name for name in self._text.arrays if len(users.get(name, ())) > 1]

    def _allot_places(self, groups: Sequence[Sequence[Item]]) -> None:
        """Give what crosses a place; one whose value is read no more serves again."""
        made: dict[str, int] = {}
        last: dict[str, int] = {}
        for number, items in enumerate(groups):
            for item in items:
                made.update(dict.fromkeys(item.makes, number))
                last.update(dict.fromkeys(item.names, number))
        leaving: dict[int, list[tuple[str, int]]] = {}
        free: dict[str, list[int]] = {kind: [] for kind in _FRAMES}
        for number, items in enumerate(groups):
            for item in items:
                for name in item.makes:
                    if last[name] == number:
                        continue
                    if name in self._text.homes:
                        self._place[name] = self._text.homes[name]
                        continue
                    kind = self._text.kinds[name]
                    if free[kind]:
                        slot = heappop(free[kind])
                    else:
                        slot = self._length[kind]
                        self._length[kind] += 1
                    self._place[name] = f"{_FRAMES[kind]}[{slot}]"
                    leaving.setdefault(last[name], []).append((kind, slot))
            for kind, slot in leaving.pop(number, ()):
                heappush(free[kind], slot)

    def _function(self, name: str, items: Sequence[Item]) -> tuple[Block, str]:
        """Write one block, and its call."""
        lines: list[str] = []
        reads = Counter(name for item in items for name in item.names)
        # What only later blocks read has no name here.
        own = {made for item in items for made in item.makes if reads[made] > 1}
        names = {name for item in items for name in item.names}
        filled = {name for item in items for name in filled_arrays(item)}
        lines += [
            f"{kind} {array}[{length}];"
            for array, (kind, length) in self._text.arrays.items()
            if array in names and array not in filled and array not in self._shared
        ]
        for table, rows in self._text.tables.items():
            if table in names:
                lines += rows
        group = ""
        for item in items:
            written = self._own(item, own)
            if written and item.group != group:
                lines.append(item.group)
                group = item.group
            lines += written
        used = {found for line in lines for found in NAME.findall(line)}
        given = {key: (head, key) for key, head in self._arguments.items()}
        for kind, frame in _FRAMES.items():
            given[frame] = (f"{kind} *COTREE_RESTRICT {frame}", frame)
        for array in self._shared:
            kind = self._text.arrays[array][0].removeprefix(ALIGNED)
            given[array] = (f"{kind} *COTREE_RESTRICT {array}", array)
        given["status"] = ("int *status", "&status")
        taken = [pair for key, pair in given.items() if key in used]
        heads = [head for head, _ in taken] or ["void"]
        signature = function_head(self._head, name, heads)
        return Block(signature, lines), f"{name}({', '.join(call for _, call in taken)});"

    def _own(self, item: Item, own: set[str]) -> list[str]:
        """Write an item inside a block, which makes some of its temporaries itself."""
        line = item.lines[0]
        array = ARRAY.match(line)
        if array:
            return self._own_array(item, own, array)
        scalar = SCALAR.match(line)
        if not scalar or (name := scalar.group(2)) not in self._place:
            return self._placed(item, own)
        head = f"const {scalar.group(1)} {name} = " if name in own else ""
        return [f"{head}{self._place[name]} = {self._replaced(scalar.group(4), own)};"]

    def _own_array(self, item: Item, own: set[str], array: re.Match[str]) -> list[str]:
        """Fill an array, which the caller may have declared."""
        name, values = array.group(2), array.group(6)
        if name not in self._shared:
            return self._placed(item, own)
        filled = enumerate(between_commas(values))
        return [f"{name}[{i}] = {self._replaced(value, own)};" for i, value in filled]

    def _placed(self, item: Item, own: Iterable[str] = ()) -> list[str]:
        return [self._replaced(line, own) for line in item.lines]

    def _replaced(self, text: str, own: Iterable[str]) -> str:
        """Read what other blocks made from its place, and tell a status to the caller."""

        def placed(match: re.Match[str]) -> str:
            name = match.group()
            if name == "status":
                return "*status"
            return self._place.get(name, name) if name not in own else name

        return NAME.sub(placed, text)
