"""The length that makes a turn and a shift comparable, from gradients of constraints alone.

In: gradients by speeds, some of them angular. Out: the length by which a turn counts as a shift, so
that lengths and angles between gradients are those of a scene of any size, in any unit of length.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.model.arrays import Array
    from cotree.program import Layout


# Parts of gradients below this share of the others are rounding.
_ROUNDING_PART = 1e-12

# Where all levers are shorter than this, [m], they are rounding: of hinges in one line, say.
_NO_LENGTH = 1e-9

# Lever arms vanish in one position and are large in others: some are looked at, with joints turned
# by so many radians.
_POSITIONS, _TURNED = 3, 0.5


def turning_speeds(layout: Layout) -> npt.NDArray[np.bool_]:
    """Tell which speeds of the multibody system are angular, shape (n_speeds,)."""
    first = layout.n_coordinates
    rows = layout.states[first : first + layout.n_speeds]
    return np.array([row.unit.startswith("rad") for row in rows], dtype=np.bool_)


def gradient_groups(layout: Layout) -> list[tuple[str, str]]:
    """Give edge and unit of each row of the kernel ``gradient``."""
    n = len(layout.constraint_edges)
    # Rates stand before the norms of quaternions, which come last.
    first = len(layout.constraints) - len(layout.quaternions) - n
    rates = layout.constraints[first : first + n]
    return [(edge, row.unit) for edge, row in zip(layout.constraint_edges, rates, strict=True)]


def scene_length(
    layout: Layout,
    gradient: Callable[[Array], Array],
    groups: Sequence[tuple[str, str]],
    y: Array,
    gaps: Sequence[float] | Array = (),
) -> float:
    """Give how far constraints reach in a scene: what a turn moves for what a shift does.

    Parameters
    ----------
    layout : Layout
        The model's.
    gradient : callable
        ``gradient(y)`` gives the gradients, shape (n_rows, n_speeds).
    groups : sequence of (str, str)
        Edge and unit of each row.
    y : ndarray, shape (n_states,)
        States to look around at.
    gaps : array_like
        Residuals of constraints, [m].

    Returns
    -------
    float
        [m]; where no constraint has turns and shifts, the longest lever, or how far things are.
    """
    turns = turning_speeds(layout)
    # The gradients of several positions are stacked, with the position as part of each row's group.
    rows = np.vstack([gradient(turned(layout, y, i)) for i in range(_POSITIONS)])
    places = [(i, *group) for i in range(_POSITIONS) for group in groups]
    shifts = np.array([row.unit == "m" for row in layout.states[: layout.n_coordinates]])
    far = float(np.max(np.abs([*y[: len(shifts)][shifts], *gaps]), initial=0.0))
    found = length_of_turns(rows, places, turns)
    if found > _ROUNDING_PART * far:
        return found
    # No row has both turns and shifts: the longest lever stands in, or the farthest distance.
    of_length = [unit.startswith("m") for *_, unit in places]
    longest = max(float(np.max(np.abs(rows[of_length][:, turns]), initial=0.0)), far)
    return longest if longest > _NO_LENGTH else 1.0


def spread(first: int, n: int) -> Array:
    """Return n numbers spread evenly about zero, with the standard deviation one.

    They are those of ``cotree_assembly.c``, from the place ``first`` on in their sequence.
    """
    golden = 0.6180339887498949 * np.arange(first + 1, first + n + 1)
    return np.asarray(1.7320508075688772 * (2.0 * np.fmod(golden, 1.0) - 1.0))


def turned(layout: Layout, y: Array, place: int) -> Array:
    """Turn all joints a little; shifts stay.

    Parameters
    ----------
    layout : Layout
        The model's.
    y : ndarray, shape (n_states,)
        States.
    place : int
        The number of the position: turns differ, with a standard deviation of half a radian.
    """
    y, n = y.copy(), layout.n_coordinates
    is_turn = np.array([row.unit != "m" for row in layout.states[:n]], dtype=bool)
    y[:n] += _TURNED * spread(place * n, n) * is_turn
    for first in layout.quaternions:
        y[first : first + 4] /= np.linalg.norm(y[first : first + 4])
    return y


def length_of_turns(rows: Array, groups: Sequence[object], turns: npt.NDArray[np.bool_]) -> float:
    """Give what a turn moves for what a shift does, in the middle of all gradients.

    The quotient of both parts of a row is a length whatever the row's own unit. Rows of one edge
    are taken together, since axes across which a joint holds are arbitrary.

    Parameters
    ----------
    rows : ndarray, shape (n_rows, n_speeds)
        Gradients.
    groups : sequence, one for each row
        Rows of the same are taken together.
    turns : ndarray of bool, shape (n_speeds,)
        True for angular speeds.

    Returns
    -------
    float
        [m]; zero where no row has both parts.
    """
    squares: dict[object, Array] = {}
    for row, group in zip(rows, groups, strict=True):
        parts = np.array([np.sum(row[turns] ** 2), np.sum(row[~turns] ** 2)])
        squares[group] = squares.get(group, np.zeros(2)) + parts
    parts = np.array(list(squares.values())).reshape(-1, 2)
    # Squares are compared, hence the square of the share.
    seen = parts > _ROUNDING_PART**2 * np.max(parts, axis=0, initial=0.0)
    turned, shifted = parts[np.all(seen, axis=1)].T
    # The median: a single lever, however long or short, does not decide.
    lengths = np.sort(np.sqrt(turned / shifted))
    return float(lengths[len(lengths) // 2]) if lengths.size else 0.0
