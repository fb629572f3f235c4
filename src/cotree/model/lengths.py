"""The length that makes a turn and a shift comparable, from gradients of constraints alone.

In: gradients by speeds, some of them angular. Out: gradients by the same speeds as velocities, so
that lengths and angles between them are those of a scene of any size, in any unit of length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.program import Layout

Array = npt.NDArray[np.float64]

# Parts of gradients below this share of the others are rounding.
_ROUNDING_PART = 1e-12


def turning_speeds(layout: Layout) -> npt.NDArray[np.bool_]:
    """Tell which speeds of the multibody system are angular, shape (n_speeds,)."""
    first = layout.n_coordinates
    rows = layout.states[first : first + layout.n_speeds]
    return np.array([row.unit.startswith("rad") for row in rows], dtype=np.bool_)


def gradient_groups(layout: Layout) -> list[tuple[str, str]]:
    """Give edge and unit of each row of the kernel ``gradient``."""
    n = len(layout.constraint_edges)
    first = len(layout.constraints) - len(layout.quaternions) - n
    rates = layout.constraints[first : first + n]
    return [(edge, row.unit) for edge, row in zip(layout.constraint_edges, rates, strict=True)]


def length_of_turns(rows: Array, groups: Sequence[object], turns: npt.NDArray[np.bool_]) -> float:
    """Give how far a constraint's gradients reach: what a turn moves for what a shift does.

    The quotient of both parts of a row is a length whatever the row's own unit. Rows of one edge
    are taken together, since axes across which a joint holds are arbitrary; of all edges the
    middle one decides, so that none at a dead point does.

    Parameters
    ----------
    rows : ndarray, shape (n_rows, n_speeds)
        Gradients.
    groups : sequence, one for each row
        Rows of the same are taken together.
    turns : ndarray of bool, shape (n_speeds,)
        Which speeds are angular.

    Returns
    -------
    float
        [m]; one where no row has both parts, so that its size does not matter.
    """
    squares: dict[object, Array] = {}
    for row, group in zip(rows, groups, strict=True):
        parts = np.array([np.sum(row[turns] ** 2), np.sum(row[~turns] ** 2)])
        squares[group] = squares.get(group, np.zeros(2)) + parts
    parts = np.array(list(squares.values())).reshape(-1, 2)
    seen = parts > _ROUNDING_PART**2 * np.max(parts, axis=0, initial=0.0)
    turned, shifted = parts[np.all(seen, axis=1)].T
    lengths = np.sort(np.sqrt(turned / shifted))
    return float(lengths[len(lengths) // 2]) if lengths.size else 1.0


def as_velocities(rows: Array, groups: Sequence[object], turns: npt.NDArray[np.bool_]) -> Array:
    """Give gradients by speeds that are all velocities, shape (n_rows, n_speeds)."""
    length = length_of_turns(rows, groups, turns)
    return np.asarray(rows / np.where(turns, length, 1.0), dtype=np.float64)
