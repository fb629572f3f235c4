"""Storage of the inputs that columns of a map do not share: rows of mostly zeros.

Rows are kept in pieces of eight columns, as many as the widest vectors hold. All pieces that are
entirely zero share one copy, the first; a table gives the places of the pieces of each row. Rows
that are known beforehand need not be filled at each call, and are kept whole if they are short.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Node

#: Numbers in a vector, on any machine.
_WIDEST = 8
#: Numbers in rows that are kept whole, at most: half of the nearest cache.
_MOST_WHOLE = 2048


def padded(n: int) -> int:
    """Round a count of numbers up to whole vectors of any width."""
    return -(-n // _WIDEST) * _WIDEST


@dataclass(frozen=True)
class OwnRows:
    """Places in C of the inputs of a map that follow its sensitivities.

    Attributes
    ----------
    linear : LinearMap
        The map.
    first : int
        The first of these inputs.
    is_whole : bool
        Whether zeros are written out, and each row follows the one before.
    """

    linear: LinearMap
    first: int
    is_whole: bool

    @cached_property
    def _pieces(self) -> dict[tuple[int, int], int]:
        """Number the pieces that are not all zeros, by their columns and row, from one on."""
        given = self.linear.given
        # Piece zero is the common copy of zeros, so that a place of 0 serves every row that
        # vanishes.
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
        """Length of a whole row."""
        return padded(self.linear.n_columns)

    @property
    def length(self) -> int:
        """Total length of all rows, in numbers."""
        if self.is_whole:
            return max(1, self.n_rows * self.width)
        return _WIDEST * (1 + len(self._pieces))

    @cached_property
    def places(self) -> list[list[int]]:
        """Start of each row, in one list for every eight columns."""
        rows = range(self.first, self.linear.n_inputs)
        groups = range(0, self.linear.n_columns, _WIDEST)
        return [[_WIDEST * self._pieces.get((at, i), 0) for i in rows] for at in groups]

    def place(self, i: int, j: int) -> int:
        """Return the place of input i of column j, which may be nonzero."""
        if self.is_whole:
            return self.width * (i - self.first) + j
        lane = j % _WIDEST
        return _WIDEST * self._pieces[j - lane, i] + lane

    def values(self, node: Node) -> dict[int, Node]:
        """Return the nonzero values that an application of the map stores, by place."""
        return {
            self.place(i, j): value
            for j, column in enumerate(self.linear.columns(node.args))
            for i, value in enumerate(column)
            if i >= self.first and not value.is_zero
        }


def own_rows(node: Node) -> OwnRows:
    """Assign places to the inputs that columns do not share, for one application of a map."""
    linear: LinearMap = node.data
    first = linear.n_sensitive(node.args)
    rows = OwnRows(linear, first, is_whole=True)
    # Short rows of constants need neither filling nor a table of places.
    if rows.length <= _MOST_WHOLE and all(
        value.value is not None for value in rows.values(node).values()
    ):
        return rows
    return OwnRows(linear, first, is_whole=False)
