"""Statements of C as they are printed here, taken apart: what each declares and reads.

In: lines of the printer, or of the loops made of them. Out: what has to stay together, by the names
in it. Lines of a kind that is unknown here are not taken apart.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

NAME = re.compile(r"(?<![\w.])[A-Za-z_]\w*")
_OPERATION = re.compile(r" [-+*/<>?] |(?<=\w)\(|(?<![\w)\]]) ?-(?=[\w(])")
SCALAR = re.compile(r"const (double|int|VECTOR) (\w+) = (?:(\w+\[\d+\]) = )?(.*);$")
#: Beginning of the declaration of an array that vectors are read from.
ALIGNED = "COTREE_ALIGNED "
ARRAY = re.compile(
    rf"(?:const )?((?:{ALIGNED})?(?:double|int|VECTOR)) (\w+)\[(\d+)\](?:, (\w+)\[(\d+)\])?"
    r"(?: = \{(.*)\})?;$"
)
WRITTEN = re.compile(r"(\w+)\[.*?\] = ")


@dataclass
class Item:
    """Lines that stay together.

    Attributes
    ----------
    lines : list of str
        A statement, or a loop.
    names : set of str
        All that is named in them.
    group : str
        The comment that they stand under.
    makes : list of str
        The temporaries that they declare.
    n_operations : int
        Operations in their text.
    """

    lines: list[str]
    names: set[str]
    group: str
    makes: list[str] = field(default_factory=list)
    n_operations: int = 0

    @property
    def is_exit(self) -> bool:
        """Whether it may leave the function."""
        return any("return " in line for line in self.lines)


@dataclass
class Text:
    """The statements of a function, taken apart.

    Attributes
    ----------
    items : list of Item
        In their order; constant tables and arrays without values, which only declare, are not
        among them.
    tables : dict of str to list of str
        Lines of each constant table.
    arrays : dict of str to (str, int)
        Kind and length of each other array.
    kinds : dict of str to str
        Kind of each temporary.
    homes : dict of str to str
        Where a temporary is kept besides.
    """

    items: list[Item] = field(default_factory=list)
    tables: dict[str, list[str]] = field(default_factory=dict)
    arrays: dict[str, tuple[str, int]] = field(default_factory=dict)
    kinds: dict[str, str] = field(default_factory=dict)
    homes: dict[str, str] = field(default_factory=dict)

    @property
    def declared(self) -> set[str]:
        """Every name that is declared."""
        return {*self.tables, *self.arrays, *self.kinds}


def count_written(lines: Iterable[str]) -> int:
    """Count the operations that stand in some text, those of loops once."""
    return sum(len(_OPERATION.findall(line)) for line in lines if not line.startswith("/*"))


def take_apart(lines: Sequence[str]) -> Text | None:
    """Tell statements, loops, tables and arrays apart.

    Parameters
    ----------
    lines : sequence of str
        Statements of one function, as they are printed here.

    Returns
    -------
    Text or None
        None where a line is of no known kind.
    """
    text, group = Text(), ""
    remaining = iter(lines)
    for line in remaining:
        if line.startswith("/*"):
            group = line
            continue
        rows = [line]
        if line.endswith("{"):
            for row in remaining:
                rows.append(row)
                if row in ("}", "};"):
                    break
        names = {name for row in rows for name in NAME.findall(row)}
        if line.startswith("static const "):
            text.tables[line.split()[3].partition("[")[0]] = rows
            continue
        item = Item(rows, names, group, n_operations=count_written(rows))
        if not _declare(item, text):
            return None
        array = ARRAY.match(line)
        if array is None or array.group(6) is not None:
            text.items.append(item)
    return text


def _declare(item: Item, text: Text) -> bool:
    """Note what an item declares; False where it is of no known kind."""
    line = item.lines[0]
    scalar, array = SCALAR.match(line), ARRAY.match(line)
    if scalar:
        kind, made, home, _ = scalar.groups()
        text.kinds[made] = kind
        item.makes.append(made)
        if home:
            text.homes[made] = home
    elif array:
        kind, first, length, second, other, _ = array.groups()
        text.arrays[first] = (kind, int(length))
        if second:
            text.arrays[second] = (kind, int(other))
    elif not line.startswith(("for (", "if (", "cotree_")) and not WRITTEN.match(line):
        return False
    return True


def filled_arrays(item: Item) -> list[str]:
    """Name the array that an item declares."""
    match = ARRAY.match(item.lines[0])
    return [match.group(2)] if match else []


def between_commas(text: str) -> list[str]:
    """Split at the commas that stand in no parentheses."""
    parts, depth, start = [], 0, 0
    for i, char in enumerate(text):
        depth += (char == "(") - (char == ")")
        if char == "," and depth == 0:
            parts.append(text[start:i].strip())
            start = i + 1
    parts.append(text[start:].strip())
    return parts


class Counted:
    """A text of several functions whose operations are counted."""

    @property
    def n_written(self) -> int:
        """About how many operations the longest function has."""
        return max(self._written)

    @property
    def n_written_in_all(self) -> int:
        """About how many operations all functions have."""
        return sum(self._written)

    @property
    def _written(self) -> list[int]:
        raise NotImplementedError
