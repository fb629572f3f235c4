"""The maximum of an output over a run, with its derivatives.

In: values and sensitivities on a fine grid of times. Out: the value at the peak. The time
derivative of the output vanishes there, so the derivative of the peak with respect to a parameter
is the sensitivity at the time of the peak. Between the grid points the output is interpolated by
the polynomial through nine of them; if a polynomial of lower degree disagrees with it, a finer grid
is requested. Interpolation windows end at events, where the output may have a kink or a jump.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import SolveError

if TYPE_CHECKING:
    from cotree.model.arrays import Array

#: Interpolation points on either side of the largest value, and their minimum number in total.
_REACH, _FEWEST = 4, 5

#: Largest difference between the two interpolants, relative to the range of the output.
_AGREE = 1e-7

#: Rounding errors of the interpolants, relative to the largest magnitude of the output.
_ROUNDING = 1e-13


class CoarseError(SolveError):
    """The grid of times is too coarse for the output."""


def peak(t: Array, value: Array, slopes: Array, events: Array) -> tuple[float, Array]:
    """Find the maximum and its derivatives.

    Parameters
    ----------
    t : ndarray, shape (n_t,)
        Equidistant times in ascending order.
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
        If the grid does not resolve the output.
    SolveError
        If the peak is next to an event.
    """
    k = int(np.argmax(value))
    # A maximum at an end of the run stays there, so its derivative is the sensitivity.
    if k in (0, len(t) - 1):
        return float(value[k]), slopes[:, k].copy()
    before, after = events[events <= t[k]], events[events > t[k]]
    first = int(np.searchsorted(t, before.max(), "right")) if before.size else 0
    last = int(np.searchsorted(t, after.min(), "left")) if after.size else len(t)
    low, high = max(first, k - _REACH), min(last, k + _REACH + 1)
    if high - low < _FEWEST or k in (low, high - 1):
        raise CoarseError(
            f"the maximum lies next to an event at t = {t[k]:.6g}, where it is not differentiable"
        )
    step = t[k + 1] - t[k]
    s = (t[low:high] - t[k]) / step  # in grid steps from the largest value
    at, top = _top(s, value[low:high])
    # An output that is constant but for rounding has its maximum everywhere.
    allowed = _AGREE * float(np.ptp(value)) + _ROUNDING * float(np.max(np.abs(value)))
    inner = slice(1, -1)
    if abs(top - _top(s[inner], value[low:high][inner])[1]) > allowed:
        raise CoarseError(
            f"the output changes too fast near its maximum at t = {t[k]:.6g} to be resolved"
        )
    return top, _interpolated(s, slopes[:, low:high], at)


def _top(s: Array, value: Array) -> tuple[float, float]:
    """Find the maximum of the interpolating polynomial on [-1, 1]: where, and its value."""
    polynomial = np.polynomial.Polynomial.fit(s, value, len(s) - 1, domain=[-1.0, 1.0])
    roots = polynomial.deriv().roots()
    near = roots[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) <= 1.0)].real
    candidates = np.append(near, 0.0)
    values = polynomial(candidates)
    best = int(np.argmax(values))
    return float(candidates[best]), float(values[best])


def _interpolated(s: Array, rows: Array, at: float) -> Array:
    """Evaluate the Lagrange polynomials through rows of values at a point."""
    weights = np.array(
        [np.prod([(at - b) / (a - b) for j, b in enumerate(s) if j != i]) for i, a in enumerate(s)]
    )
    found: Array = rows @ weights
    return found
