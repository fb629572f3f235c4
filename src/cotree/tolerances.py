"""Tolerances that several rooms share, and rules that decide which of a user's are accepted.

Of the rules, in: a number. Out: the reason why it is refused, as a sentence without a capital and a
full stop. They are the same for runs, scenes, benches and C.
"""

from __future__ import annotations

import math

#: From this relative tolerance on, a step may be wrong by all that it is.
LARGEST_RTOL = 1.0

#: Above this relative tolerance error estimates, which are leading terms of series, mean little.
LOOSE_RTOL = 1e-2

#: A step whose end constraints would move by so many tolerances, in the mean, has failed.
FARTHEST_CORRECTION = 10.0

#: Gradients of constraints whose singular values or pivots are below this share of the largest
#: follow from the others.
RANK = 1e-10


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
