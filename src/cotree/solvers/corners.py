"""Breakpoints within one integration: segments between them, and what C says at their ends.

At a breakpoint whose time t* depends on the parameters, rates jump from f- to f+ where a source
does, or where its own rate is among them. Sensitivities of the states then jump, too, by
``(f- - f+) dt*/dp``: the states themselves are continuous, and what moves the breakpoint by dt* has
f- act for longer, in place of f+.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from cotree.solvers.problem import describe_entry

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray
    from cotree.solvers.problem import Problem


def corner_times(problem: Problem) -> FloatArray:
    """List start, breakpoints inside the span, and end, in the order of the run."""
    start, end = map(float, problem.settings.t_span)
    if not len(problem.breakpoints):
        return np.array([start, end])
    low, high = min(start, end), max(start, end)
    inside = np.unique(np.asarray(problem.breakpoints, dtype=float))
    # Both ends are strict: a breakpoint there cuts nothing, but may make the end sharp.
    inside = inside[(low < inside) & (inside < high)]
    return np.concatenate([[start], inside[:: int(problem.direction)], [end]])


def segments(problem: Problem) -> list[tuple[float, float]]:
    """Cut the span at the breakpoints inside it."""
    return list(itertools.pairwise(corner_times(problem).tolist()))


def turn_tolerances(problem: Problem) -> FloatArray:
    """Return the absolute tolerance of sensitivities to each parameter, shape (..., m).

    Sizes may have rows; see :class:`cotree.solvers.augmented.Tolerances`.
    """
    # The tolerance of the state divided by the size of the parameter, as the error test has it.
    least = np.min(problem.state_atol, axis=-1, keepdims=True, initial=np.inf)
    found: FloatArray = least / np.array(
        [1.0] * problem.n_sensitivities if problem.scales is None else problem.scales
    )
    return found


def turning(problem: Problem, t: float, entry: int) -> str:
    """Describe which sensitivity does not exist after a breakpoint, as a sentence without its end.

    Parameters
    ----------
    problem : Problem
        The problem.
    t : float
        The breakpoint, [s].
    entry : int
        The place of the sensitivity in z.
    """
    what = describe_entry(problem, entry)
    if t == problem.settings.t_span[0]:
        return (
            f"{what} does not exist: a source has a corner at the start, t = {t:.10g}, that moves "
            "with the parameter; begin the run before it, or compile without this sensitivity"
        )
    return (
        f"{what} does not exist from t = {t:.10g} on: corners of sources meet there that move "
        "differently with the parameter; choose values that keep them apart, or compile without "
        "this sensitivity"
    )
