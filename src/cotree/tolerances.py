"""Tolerances shared by several rooms, and checks of a user's tolerances.

Checks take a number and return the reason why it is rejected, as a sentence without a capital and a
full stop. They are the same for runs, scenes, benches and C.
"""

from __future__ import annotations

import math
from typing import NamedTuple

#: At this relative tolerance the error of a step may be as large as the solution.
LARGEST_RTOL = 1.0

#: Above this relative tolerance, error estimates are unreliable, since they are leading terms of
#: series.
LOOSE_RTOL = 1e-2

#: A step fails if the projection of its end changes it by more than this many tolerances on
#: average.
FARTHEST_CORRECTION = 10.0

#: Added to divisors, or used as their lower bound: it only affects zeros. In other floating-point
#: types it is the same fraction of the range.
TINY = 1e-290

#: Relative distance within which time events are regarded as one: a few rounding errors.
SAME = 8 * 2.0**-52

#: Gradients of constraints whose singular values or pivots are below this fraction of the largest
#: are redundant.
RANK = 1e-10


class Limits(NamedTuple):
    """Limits shared by C and Python: those of ``cotree_limits.h``."""

    #: A step fails if the projection of its end changes it by more than this many tolerances on
    #: average.
    max_projection: float = FARTHEST_CORRECTION
    #: A correction opposes the residual from which it is computed if the cosine of their angle is
    #: below minus this.
    opposed_cosine: float = 0.7
    #: Maximum number of steps of a projection. A step below the limit of small corrections that is
    #: more than half the previous one is at rounding level, since Newton's method converges
    #: quadratically.
    most_projections: int = 10
    small_correction: float = 1e-8
    #: Constraints are violated if a residual, in its own unit, exceeds this fraction of max(1,
    #: largest state). Near a singular configuration, residuals of trial steps at a tolerance of
    #: 1e-8 stay below it in directions that the constraints hardly determine.
    largest_residual: float = 1e-6
    #: Rates jump at a breakpoint if they differ by more than this many times their change over the
    #: same time on one side. Smaller differences are rounding errors of the time.
    jump_noise: float = 1e3
    #: A step of at most this many units in the last place makes no progress. One such step may
    #: occur before a breakpoint; this many in a row are a stall.
    stall_spacings: int = 16
    stall_steps: int = 5
    #: Stiffness changes the method only if more than this many steps remain: another method takes
    #: some hundred steps and matrix evaluations, and must be compiled.
    most_stiff_steps: int = 1000
    #: Maximum number of simultaneous events that one event may trigger.
    event_rounds: int = 50
    #: Number of points of the interpolation polynomial, and limit of its estimated error with
    #: explicit methods, in tolerances.
    history_points: int = 6
    history_doubt: float = 4.0
    #: Planned pivots are accepted if the solution solves a system whose entries differ from the
    #: exact ones by at most this fraction.
    planned_pivots: float = 1e-10
    #: Number of past times stored for each event. As many events within a billionth of the span are
    #: chatter.
    event_crowd: int = 100


LIMITS = Limits()


def rtol_fault(rtol: float, least: float = math.ulp(0.0)) -> str:
    """Describe why a relative tolerance is rejected; empty if it is accepted.

    The smallest one is the smallest positive number, or zero if tolerances as small as can be
    tested are allowed.
    """
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
        f"rtol is {rtol}: above {LOOSE_RTOL:g} estimates of errors mean little, and results may be "
        "wrong by far more"
    )
