"""Tables of which pieces are held, on single numbers and on arrays of them."""

from __future__ import annotations

import numpy as np
import pytest

from cotree.dag.lookup import HeldPlane, HeldTable

AT = (-1.0, 0.3, 1.7, 5.0)
LINE = HeldTable((0.0, 1.0, 4.0), (0.0, 2.0, 1.0))
PLANE = HeldPlane((0.0, 1.0, 4.0), (0.0, 2.0, 3.0), (0.0, 1.0, 2.0, 5.0, 3.0, -1.0, 4.0, 0.5, 7.0))


@pytest.mark.parametrize("table", [LINE, PLANE])
@pytest.mark.parametrize("piece", [0.0, 1.0, 2.0])
def test_single_numbers_give_what_arrays_give(table, piece):
    n = len(table.axes)
    rows = np.array(table.evaluate([np.array(AT)] * n + [np.full(len(AT), piece)] * n))
    for at, row in zip(AT, rows.T, strict=True):
        for kind in (float, complex, np.float64):
            found = table.evaluate([kind(at)] * n + [kind(piece)] * n)
            assert np.array_equal(np.array(found), row)  # the same operations


@pytest.mark.parametrize("at", AT)
def test_a_held_piece_goes_on_beyond_its_ends(at):
    value, slope, low, high, piece = LINE.evaluate([at, 2.0])
    assert (value, slope, low, high, piece) == (2.0 * at, 2.0, 0.0, 1.0, 2.0)
