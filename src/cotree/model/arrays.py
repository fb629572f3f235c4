"""Arrays as users give them: checked, copied, contiguous."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Sequence

Array = npt.NDArray[np.float64]


def as_array(value: Any, shape: Sequence[int], what: str) -> Array:
    """Make a contiguous array of doubles of a given shape."""
    try:
        array = np.array(value, dtype=float, order="C")  # always a copy: callers change theirs
    except (TypeError, ValueError):
        raise ParameterError(
            f"{what} must be an array of numbers of shape {tuple(shape)}"
        ) from None
    if array.shape != tuple(shape):
        raise ParameterError(
            f"{what} must be an array of shape {tuple(shape)}, not of shape {array.shape}"
        )
    return array
