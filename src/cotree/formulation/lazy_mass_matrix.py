"""Trees so deep that their mass matrix is not worth forming.

Elimination along the tree does not need the mass matrix and takes O(n) operations; the matrix of a
chain has n^2 entries. The matrix is formed only when its rows are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, overload

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion

# Squared depth of speeds, on average: elimination by the matrix costs that many operations a speed,
# and along the tree 90 (in a plane) to 600.
_DEEP = 1000.0


def is_deep(motion: Motion) -> bool:
    """Tell whether elimination along the tree is bound to cost less than by the matrix."""
    depths, squares = {0: 0}, []
    for geometry in motion.geometry:
        branch = geometry.branch
        below = depths[branch.parent]
        depths[branch.child] = below + len(branch.speeds)
        # A speed at depth d couples with all d above it; eliminating it touches d^2 entries.
        squares += [depth**2 for depth in range(below + 1, depths[branch.child] + 1)]
    return sum(squares) > _DEEP * len(squares)


class LateMatrix(Sequence[Sequence["Node"]]):
    """A bordered mass matrix, of which the rows of the mass matrix are formed when asked for.

    Parameters
    ----------
    form : callable
        Forms the mass matrix and its border to the right.
    n : int
        Number of its rows.
    border : sequence of rows of Node
        The rows below.
    """

    def __init__(
        self,
        form: Callable[[], Sequence[Sequence[Node]]],
        n: int,
        border: Sequence[Sequence[Node]],
    ) -> None:
        self._form = form
        self._upper: Sequence[Sequence[Node]] | None = None
        self._n = n
        self._border = border

    def __len__(self) -> int:
        return self._n + len(self._border)

    @overload
    def __getitem__(self, at: int) -> Sequence[Node]: ...
    @overload
    def __getitem__(self, at: slice) -> Sequence[Sequence[Node]]: ...
    def __getitem__(self, at: int | slice) -> Sequence[Node] | Sequence[Sequence[Node]]:
        places = range(len(self))[at]
        if isinstance(places, range):
            return [self._row(i) for i in places]
        return self._row(places)

    def _row(self, i: int) -> Sequence[Node]:
        if i >= self._n:
            return self._border[i - self._n]
        if self._upper is None:
            self._upper = self._form()
        return self._upper[i]
