"""Numbers of one column of members, checked one by one."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray


def column_values(values: Any, what: str) -> FloatArray:
    """Read a number, or numbers for each member.

    Parameters
    ----------
    values : float or array_like of one dimension
        As users give them.
    what : str
        Where they stand, for messages.

    Returns
    -------
    ndarray, shape (n,) or ()

    Raises
    ------
    ParameterError
        If they have more dimensions, or one is no finite number; the message tells its row.
    """
    if hasattr(values, "magnitude"):
        raise ParameterError(f"{what} has units of its own: give plain numbers in SI units")
    try:
        # Values that are masked are missing.
        array = (
            np.ma.filled(np.ma.asarray(values, dtype=None), np.nan)
            if np.ma.isMA(values)
            else np.asarray(values)
        )
    except ValueError:  # rows of several lengths
        raise ParameterError(f"{what} is no sequence of numbers") from None
    if array.ndim > 1:
        raise ParameterError(f"{what} has shape {array.shape}: give one value for each member")
    if array.ndim == 0:
        return np.array(check_number(array.item(), what))
    if array.dtype.kind not in "fiu":
        # Each value is looked at, so that the first wrong one can be named.
        listed = [
            check_number(value, f"{what}, row {i},") for i, value in enumerate(array.tolist())
        ]
        return np.array(listed, dtype=float)
    numbers = array.astype(float)
    wrong = np.flatnonzero(~np.isfinite(numbers))
    if wrong.size:
        check_number(float(numbers[wrong[0]]), f"{what}, row {wrong[0]},")
    return numbers
