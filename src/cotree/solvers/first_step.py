"""A first step for a method whose own is a share of the span.

LSODA fails where nothing moves at the start, but will soon, as a stiff circuit does that a source
of sine feeds: it begins far too long and may shorten a step only a few times.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.solvers.base import FloatArray

_SHARE = 0.01


def first_step(
    rates_at: Callable[[float, FloatArray], FloatArray],
    t: float,
    z: FloatArray,
    t_end: float,
    longest: float,
    tolerances: tuple[float, FloatArray],
) -> float:
    """Choose a first step from the rates and their change along a tiny one.

    E. Hairer, S. P. Norsett, G. Wanner, Solving Ordinary Differential Equations I, second edition,
    section II.4, for a method that begins with order 1.

    Parameters
    ----------
    rates_at : callable
        ``rates_at(t, z)`` gives the rates.
    t : float
        Start, [s].
    z : ndarray
        Values there.
    t_end : float
        End, [s].
    longest : float
        The longest step, [s].
    tolerances : float, ndarray
        Relative and absolute.

    Returns
    -------
    float
        Positive, [s], no more than the longest step.
    """
    rtol, atol = tolerances
    weights = 1.0 / (atol + rtol * np.abs(z))
    rates = rates_at(t, z)
    # d0, d1 and h0 of the reference: norms of values and rates in tolerances, and a step that
    # changes the values by a hundredth of themselves.
    size, slope = _norm(z * weights), _norm(rates * weights)
    # A shorter step would be lost in the rounding of t.
    least = 4.0 * float(np.spacing(max(abs(t), abs(t_end))))
    trial = 1e-6 if min(size, slope) < 1e-5 else _SHARE * size / slope
    trial = min(max(trial, least), longest)
    direction = 1.0 if t_end > t else -1.0
    # An explicit Euler step of h0 gives the norm d2 of the second derivative.
    ahead = rates_at(t + direction * trial, z + direction * trial * rates)
    bend = _norm((ahead - rates) * weights) / trial
    steepest = max(slope, bend) if np.isfinite(bend) else slope
    if steepest <= 1e-15:
        return min(max(1e-6, 1e-3 * trial), longest)
    # h1 of the reference, for order 1: the error of a step grows with its square.
    return min(100.0 * trial, max(float(np.sqrt(_SHARE / steepest)), least), longest)


def _norm(scaled: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.square(scaled)))) if scaled.size else 0.0
