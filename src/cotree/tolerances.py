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

#: A step whose end constraints would move by so many tolerances, in the mean, has failed.
FARTHEST_CORRECTION = 10.0

#: Added to sizes that are divided by, or a least size: changes none but zero. In another type of
#: numbers the constant is the same share of its range.
TINY = 1e-290

#: Gradients of constraints whose singular values or pivots are below this share of the largest
#: follow from the others.
RANK = 1e-10


class Limits(NamedTuple):
    """Limits that hold in C and in Python alike: C is printed with those that Python has."""

    #: A step whose end constraints would move by so many tolerances, in the mean, has failed.
    farthest: float = FARTHEST_CORRECTION
    #: The cosine of corrections that go against what is left of the equations that they solve.
    turned: float = 0.7
    #: Steps of a projection at most. One below ``small_correction`` that no longer halves is
    #: rounding, since Newton's method squares its errors.
    most_projections: int = 10
    small_correction: float = 1e-8
    #: Residuals, in the constraints' own units, above this share of the largest state (or of 1) are
    #: not met. Near a singular configuration, along what the constraints hardly see, those of trial
    #: steps at a tolerance of 1e-8 still lie below it.
    largest_residual: float = 1e-6
    #: Rates jump where they differ by more than this many times what they change by within as much
    #: time on one side of a breakpoint: that is rounding of its time.
    noise: float = 1e3
    #: Steps of a few units in the last place get nowhere; one of them is normal before a
    #: breakpoint, so many in a row are not.
    stall_spacings: int = 16
    stall_steps: int = 5
    #: Of a stiff problem fewer steps than these are not worth another method, which takes some
    #: hundred steps and evaluations of matrices, too, and has to be made.
    most_stiff_steps: int = 1000
    #: How often one event may make others happen at the same time.
    event_rounds: int = 50
    #: Points of a run that interpolation reads from. Estimated errors of what an explicit method
    #: reads are kept below so many tolerances.
    history_points: int = 6
    history_doubt: float = 4.0
    #: Planned pivots do where they solve a system that differs from the true one by at most this
    #: share of each entry.
    planned_pivots: float = 1e-10
    #: So many of one event within a billionth of the span are too many.
    event_crowd: int = 100


LIMITS = Limits()


def rtol_fault(rtol: float, least: float = math.ulp(0.0)) -> str:
    """Say why a number is not accepted as a relative tolerance; empty where it is.

    Parameters
    ----------
    rtol : float
        The number.
    least : float
        The least that is accepted: the smallest positive number, or zero where that means as
        little as can be tested.
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
