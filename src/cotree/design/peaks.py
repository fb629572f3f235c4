"""The largest value of an output over a run, with its derivatives.

In: values and sensitivities at close times. Out: the value at the peak, where the output's rate is
zero: so its derivative by a parameter is the sensitivity at the peak's time, held. Between the
times the polynomial through nine of them stands for the output; where one of lower degree disagrees
with it, closer times are asked for. Windows end at events, beyond which another curve begins.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import SolveError

if TYPE_CHECKING:
    from cotree.model.arrays import Array

#: Points on either side of the largest one, and the least number of points of a polynomial.
_REACH, _FEWEST = 4, 5

#: Polynomials of two degrees agree to this share of the output's range.
_AGREE = 1e-7


class CoarseError(SolveError):
    """The times are too far apart for the output."""


def peak(t: Array, value: Array, slopes: Array, events: Array) -> tuple[float, Array]:
    """Find the largest value and its derivatives.

    Parameters
    ----------
    t : ndarray, shape (n_t,)
        Times, evenly spaced, rising.
    value : ndarray, shape (n_t,)
        The output.
    slopes : ndarray, shape (n_parameters, n_t)
        Its sensitivities.
    events : ndarray, shape (n_events,)
        Times of events.

    Returns
    -------
    float, and ndarray of shape (n_parameters,)

    Raises
    ------
    CoarseError
        If the output changes too fast for these times.
    SolveError
        If the peak is next to an event.
    """
    k = int(np.argmax(value))
    # At an end of the run the time is held, and the derivative is the sensitivity there.
    if k in (0, len(t) - 1):
        return float(value[k]), slopes[:, k].copy()
    before, after = events[events <= t[k]], events[events > t[k]]
    first = int(np.searchsorted(t, before.max(), "right")) if before.size else 0
    last = int(np.searchsorted(t, after.min(), "left")) if after.size else len(t)
    low, high = max(first, k - _REACH), min(last, k + _REACH + 1)
    if high - low < _FEWEST or k in (low, high - 1):
        raise CoarseError(
            f"the largest value lies next to an event at t = {t[k]:.6g}, where it has no derivative"
        )
    step = t[k + 1] - t[k]
    own = (t[low:high] - t[k]) / step
    at, top = _top(own, value[low:high])
    range_ = float(np.ptp(value)) or 1.0
    inner = slice(1, -1)
    if abs(top - _top(own[inner], value[low:high][inner])[1]) > _AGREE * range_:
        raise CoarseError(
            f"the output changes too fast near its largest value at t = {t[k]:.6g} to find it"
        )
    return top, _interpolated(own, slopes[:, low:high], at)


def _top(own: Array, value: Array) -> tuple[float, float]:
    """Find the largest value of the polynomial within one step of zero."""
    polynomial = np.polynomial.Polynomial.fit(own, value, len(own) - 1, domain=[-1.0, 1.0])
    roots = polynomial.deriv().roots()
    near = roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) <= 1.0)].real
    candidates = np.append(near, 0.0)
    values = polynomial(candidates)
    best = int(np.argmax(values))
    return float(candidates[best]), float(values[best])


def _interpolated(own: Array, rows: Array, at: float) -> Array:
    """Evaluate at a point the polynomials through rows of values."""
    weights = np.array(
        [
            np.prod([(at - b) / (a - b) for j, b in enumerate(own) if j != i])
            for i, a in enumerate(own)
        ]
    )
    found: Array = rows @ weights
    return found
