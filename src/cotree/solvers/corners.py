"""Breakpoints within one integration: segments between them, and what sensitivities do there.

At a breakpoint whose time t* depends on the parameters, rates jump from f- to f+ where a source
does, or where its own rate is among them. Sensitivities of the states then jump, too, by
``(f- - f+) dt*/dp``: the states themselves are continuous, and what moves the breakpoint by dt* has
f- act for longer, in place of f+.
"""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING

import numpy as np

from cotree.solvers.evaluate import FAILED, IntegrationStopError
from cotree.solvers.problem import describe_entry

if TYPE_CHECKING:
    from cotree.solvers.evaluate import Evaluator
    from cotree.solvers.problem import FloatArray, Problem

# Rates jump where they differ by more than this many times what they change by within as much time
# on one side of a breakpoint: that is rounding of its time.
_NOISE = 1e3


def segments(problem: Problem) -> list[tuple[float, float]]:
    """Cut the span at the breakpoints inside it."""
    start, end = (float(t) for t in problem.t_span)
    low, high = min(start, end), max(start, end)
    inside = sorted({float(b) for b in problem.breakpoints if low < b < high})
    if problem.direction < 0:
        inside.reverse()
    corners = [start, *inside, end]
    return list(itertools.pairwise(corners))


class Turns:
    """Lets sensitivities jump at breakpoints; it is mutable and belongs to one integration."""

    def __init__(self, evaluator: Evaluator) -> None:
        self._evaluator, self._problem = evaluator, evaluator.problem
        self._left: FloatArray | None = None

    def leave(self, t: float, z: FloatArray) -> None:
        """Remember the rates at the end of a segment, which is still open."""
        self._left = None
        if t in self._problem.shifts:
            rhs, margin = self._evaluator.rhs, self._evaluator.margin
            self._left = _beside(rhs(t, z), rhs(t - 3.0 * margin, z))

    def slopes(self, t: float) -> FloatArray:
        """Tell how the time of a breakpoint depends on the parameters."""
        corner = self._problem.shifts.get(t)
        return np.array(corner.slopes if corner else [0.0] * self._problem.n_sensitivities)

    def enter(self, t: float, z: FloatArray) -> FloatArray:
        """Give z behind a breakpoint, at which the next segment is open.

        Raises
        ------
        IntegrationStopError
            If what meets there depends differently on a parameter, and rates jump.
        """
        problem, evaluator = self._problem, self._evaluator
        corner = problem.shifts.get(t)
        if corner is None:
            return z
        n, m = problem.n_states, problem.n_sensitivities
        margin, near = evaluator.margin, evaluator.rhs(t, z)
        further = evaluator.rhs(t + 3.0 * margin, z)
        right, left = _beside(near, further), self._left
        if (
            left is None
        ):  # at the start nothing was before: the rates just before it are taken there
            before = (evaluator.outside(t - k * margin, z) for k in (1.0, 3.0))
            left = _beside(*before)
        jump = (left - right)[:n]
        shift = np.zeros_like(z)
        shift[n:] = np.outer(corner.slopes, jump).ravel()
        self._left = None
        if any(corner.spreads):
            noise = np.abs(further - near)[:n]
            allowed = problem.rtol * np.abs(z[n:].reshape(m, n)) + turn_tolerances(problem)[:, None]
            unknown = np.abs(np.outer(corner.spreads, jump)) > allowed
            unknown &= np.abs(jump) > _NOISE * noise
            if np.any(unknown):
                j, i = (int(k) for k in np.argwhere(unknown)[0])
                raise IntegrationStopError(FAILED, turning(problem, t, n * (1 + j) + i))
        passed: FloatArray = z.copy()
        passed[problem.integrated] += shift[problem.integrated]
        return passed


def _beside(near: FloatArray, further: FloatArray) -> FloatArray:
    """Give the rates at a breakpoint as they are on one side, from those one and three margins off.

    A source with steep edges changes within rounding of its time.
    """
    found: FloatArray = near + 0.5 * (near - further)
    return found


def turn_tolerances(problem: Problem) -> FloatArray:
    """Give what sensitivities to each parameter are uncertain by where they are zero."""
    least = float(np.min(problem.state_atol, initial=np.inf))
    found: FloatArray = least / np.array(
        [1.0] * problem.n_sensitivities if problem.scales is None else problem.scales
    )
    return found


def turning(problem: Problem, t: float, entry: int) -> str:
    """Say which sensitivity does not exist from a breakpoint on, as a sentence without its end."""
    what = describe_entry(problem, entry)
    if t == problem.t_span[0]:
        return (
            f"{what} does not exist: a source has a corner at the start, t = {t:.10g}, that moves "
            "with the parameter; begin the run before it, or compile without this sensitivity"
        )
    return (
        f"{what} does not exist from t = {t:.10g} on: corners of sources meet there that move "
        "differently with the parameter; choose values that keep them apart, or compile without "
        "this sensitivity"
    )
