"""Tolerances that several rooms share, and rules that decide which of a user's are accepted.

Of the rules, in: a number. Out: the reason why it is refused, as a sentence without a capital and a
full stop. They are the same for runs, scenes, benches and C.
"""

from __future__ import annotations

import math
from typing import NamedTuple

#: From this relative tolerance on, a step may be wrong by all that it is.
LARGEST_RTOL = 1.0

#: Above this relative tolerance error estimates, which are leading terms of series, mean little.
LOOSE_RTOL = 1e-2

#: A step fails if the projection of its end moves it by more than this many tolerances in the mean.
FARTHEST_CORRECTION = 10.0

#: Added to sizes that are divided by, or a least size: changes none but zero. In another type of
#: numbers the constant is the same share of its range.
TINY = 1e-290

#: Time events closer than this fraction of their size are one: a few roundings.
SAME = 8 * 2.0**-52

#: Gradients of constraints whose singular values or pivots are below this share of the largest
#: follow from the others.
RANK = 1e-10


class Limits(NamedTuple):
    """Limits that hold in C and in Python alike: those of ``cotree_limits.h``."""

    #: A step fails if the projection of its end moves it by more than this many tolerances in the
    #: mean.
    max_projection: float = FARTHEST_CORRECTION
    #: A correction opposes the residual from which it is computed if their cosine is below minus
    #: this.
    opposed_cosine: float = 0.7
    #: The largest number of steps of a projection. A step below the small correction that is not
    #: half the one before is rounding, since Newton's method converges quadratically.
    most_projections: int = 10
    small_correction: float = 1e-8
    #: Constraints are not satisfied if a residual, in their own units, exceeds this share of the
    #: largest state (or of 1). Near a singular configuration, along directions that the constraints
    #: hardly determine, residuals of trial steps at a tolerance of 1e-8 stay below it.
    largest_residual: float = 1e-6
    #: Rates jump if they differ by more than this many times their change over the same time on
    #: one side of a breakpoint: less is rounding of its time.
    jump_noise: float = 1e3
    #: A step of at most this many units in the last place makes no progress. One is normal before
    #: a breakpoint, this many in a row are a stall.
    stall_spacings: int = 16
    stall_steps: int = 5
    #: A stiff problem changes its method only if more than this many steps remain: another method
    #: takes some hundred steps and evaluations of matrices, and has to be compiled.
    most_stiff_steps: int = 1000
    #: The largest number of events that one event may trigger at the same time.
    event_rounds: int = 50
    #: Points of the interpolation polynomial; and the bound of its estimated error with explicit
    #: methods, in tolerances.
    history_points: int = 6
    history_doubt: float = 4.0
    #: Planned pivots are accepted if the solution solves a system whose entries differ from the
    #: true ones by at most this share.
    planned_pivots: float = 1e-10
    #: The number of past times stored for each event: so many within a billionth of the span are
    #: chatter.
    event_crowd: int = 100


LIMITS = Limits()


def rtol_fault(rtol: float, least: float = math.ulp(0.0)) -> str:
    """Describe why a number is not accepted as a relative tolerance; empty if it is.

    The least is the smallest positive number, or zero if that means as little as can be tested.
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
    """Return a warning of a relative tolerance that is accepted but loose; empty for others."""
    if not LOOSE_RTOL < rtol < LARGEST_RTOL:
        return ""
    return (
        f"rtol is {rtol}: above {LOOSE_RTOL:g} estimates of errors mean little, and results may be "
        "wrong by far more"
    )
