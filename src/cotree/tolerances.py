"""Tolerances shared by several packages, and checks of a user's tolerances.

Checks return the reason why a number is rejected, without a capital and a full stop.
"""

from __future__ import annotations

import math
from typing import NamedTuple

#: At this relative tolerance, the error of a step may equal the solution.
LARGEST_RTOL = 1.0

#: Above this relative tolerance, error estimates are unreliable: they are leading terms of series.
LOOSE_RTOL = 1e-2

#: A step fails if projection changes its end by more than this many tolerances on average.
FARTHEST_CORRECTION = 10.0

#: Lower bound of divisors, or added to them, so that only zeros are affected. It is scaled to the
#: range of the floating-point type.
TINY = 1e-290

#: Relative distance, a few rounding errors, within which time events are one event.
SAME = 8 * 2.0**-52

#: A gradient is redundant if its pivot or singular value is below this fraction of the largest.
RANK = 1e-10


class Limits(NamedTuple):
    """Limits shared by Python and C, where ``cotree_limits.h`` declares them."""

    #: A step fails if projection changes its end by more than this many tolerances on average.
    max_projection: float = FARTHEST_CORRECTION
    #: A correction opposes its residual if the cosine between them is below the negative of this.
    opposed_cosine: float = 0.7
    #: Maximum number of steps of a projection. A correction below the other limit is a rounding
    #: error if it is over half the previous one, since Newton's method converges quadratically.
    most_projections: int = 10
    small_correction: float = 1e-8
    #: Constraints are violated if a residual, in its unit, exceeds this fraction of max(1, largest
    #: state). At a tolerance of 1e-8, trial steps near singular configurations do not exceed it.
    largest_residual: float = 1e-6
    #: Rates jump at a breakpoint if their difference across it exceeds their change over the same
    #: time on one side by this factor. Smaller differences are due to rounding of the time.
    jump_noise: float = 1e3
    #: A step of at most this many units in the last place of the time makes no progress. One such
    #: step may occur before a breakpoint; ``stall_steps`` in a row are a stall.
    stall_spacings: int = 16
    stall_steps: int = 5
    #: A stiff run changes its method only if more than this many steps remain, because the other
    #: method must first be compiled and needs a few hundred steps and matrices itself.
    most_stiff_steps: int = 1000
    #: Maximum length of a chain of simultaneous events that trigger each other.
    event_rounds: int = 50
    #: Explicit methods: number of points of the interpolation polynomial, and its largest estimated
    #: error as a multiple of the tolerance.
    history_points: int = 6
    history_doubt: float = 4.0
    #: A pivot chosen in advance is accepted up to this relative error of matrix entries.
    planned_pivots: float = 1e-10
    #: Number of stored times of an event. If all are within 1e-9 of the span, the event chatters.
    event_crowd: int = 100


LIMITS = Limits()


def rtol_fault(rtol: float, least: float = math.ulp(0.0)) -> str:
    """Return the reason why a relative tolerance, at least ``least``, is rejected, or ""."""
    if not (math.isfinite(rtol) and rtol >= least):
        return f"rtol is {rtol}; give a positive finite number"
    if rtol >= LARGEST_RTOL:
        return (
            f"rtol is {rtol}: errors as large as the values themselves would pass; give a number "
            "below 1, such as 1e-6"
        )
    return ""


def loose_rtol(rtol: float) -> str:
    """Return a warning about a tolerance that is accepted but loose, or an empty string."""
    if not LOOSE_RTOL < rtol < LARGEST_RTOL:
        return ""
    return (
        f"rtol is {rtol}: above {LOOSE_RTOL:g} error estimates are unreliable, and errors may be "
        "much larger"
    )
