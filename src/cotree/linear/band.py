"""An order of unknowns that makes a sparse matrix narrow.

In: a pattern, compressed by columns. Out: the bandwidths, and the places of the unknowns.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

# Matrices up to this size are dense, whatever their pattern: an order for them costs more.
_SMALL = 40


def narrow_band(
    n: int, column_starts: Sequence[int], row_indices: Sequence[int]
) -> tuple[int, int, Any]:
    """Give the bandwidths of a matrix, and the places of unknowns that make them narrow.

    Parameters
    ----------
    n : int
        Number of unknowns.
    column_starts, row_indices : sequence of int
        The pattern, compressed by columns.

    Returns
    -------
    lower, upper : int
        How many diagonals there are below and above the main one.
    places : ndarray or None
        The place of each unknown; None where the matrix is small or not sparse.
    """
    if n > _SMALL:
        from scipy.sparse import csc_matrix
        from scipy.sparse.csgraph import reverse_cuthill_mckee

        starts, rows = np.array(column_starts), np.array(row_indices, dtype=np.int64)
        pattern = csc_matrix((np.ones(len(rows)), rows, starts), shape=(n, n)).tocsr()
        # The order lists unknowns by their new places; its inverse gives the new place of each.
        places = np.empty(n, dtype=np.intc)
        places[reverse_cuthill_mckee(pattern, symmetric_mode=False)] = np.arange(n)
        # How far each entry stands below the diagonal once unknowns are reordered.
        below = places[rows] - np.repeat(places, np.diff(starts))
        lower, upper = int(max(below.max(initial=0), 0)), int(max((-below).max(initial=0), 0))
        # Banded storage with row pivoting has so many diagonals: from n on a dense matrix is
        # smaller.
        if 2 * lower + upper + 1 < n:
            return lower, upper, places
    return n - 1, n - 1, None
