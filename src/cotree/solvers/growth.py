"""The state that grows without bound, as the likely cause of a run that did not reach its end.

In: a ``Problem`` and its ``Trajectory``. Out: the trajectory, whose message names the state. No run
is stopped by what is said here: budgets and values that are not finite end it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import listed

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray, Trajectory
    from cotree.solvers.problem import Problem

# The share of the elapsed time that counts as the beginning, and the one that counts as the end.
_EARLY, _LATE = 0.1, 0.9

# Growth by less than this has other reasons: in ten times the time a steady motion covers ten times
# the way, and an accelerated one a hundred times.
_LEAST = 1e3

# Nor does what grows more slowly than this power of time, as counts and angles do: an exponential
# that has grown a thousandfold grows as the power of 7.7 at its end.
_LEAST_POWER = 7.0

# Unknowns whose determinant is formed, and those that a message names; how far aside it is formed.
_MOST_UNKNOWNS, _MOST_NAMED, _ASIDE = 50, 4, 1e-3


def with_growth(problem: Problem, trajectory: Trajectory) -> Trajectory:
    """Add to the message of a run that stopped early which state grows, or that a fold ended it."""
    if trajectory.status == 0:
        return trajectory
    said = growth(problem, trajectory) or fold(problem, trajectory)
    if not said:
        return trajectory
    return replace(trajectory, message=f"{trajectory.message} {said}")


def fold(problem: Problem, trajectory: Trajectory) -> str:
    """Report a fold of the algebraic equations where a run ended early, as a sentence, or empty.

    Two solutions meet at a fold, and none goes on: the determinant of the derivatives by the
    unknowns has different signs on either side of it.
    """
    m, n = problem.n_algebraic, problem.n_states
    if not (0 < m <= _MOST_UNKNOWNS and trajectory.t.size) or problem.jacobian is None:
        return ""
    t, y = float(trajectory.t[-1]), trajectory.z[:n, -1].copy()
    signs = set()
    # A kink may be near rather than at the last point.
    for i in range(n - m, n):
        for aside in (-_ASIDE, _ASIDE):
            there = y.copy()
            there[i] += aside * max(abs(y[i]), float(problem.state_atol[i]))
            slopes = np.asarray(problem.jacobian(t, there))[n - m :, n - m :]
            if not np.all(np.isfinite(slopes)):
                return ""
            signs.add(float(np.linalg.slogdet(slopes)[0]))
    if len(signs) < 2:
        return ""
    unknowns = listed(f"'{name}'" for name in list(problem.names[n - m : n])[:_MOST_NAMED])
    return (
        f"The algebraic equations have a fold at t = {t:.6g}: two of their solutions for "
        f"{unknowns} meet there, and none goes on. Let a mode switch there by events, or put a "
        "storage, such as a small capacitor, into the loop."
    )


def growth(problem: Problem, trajectory: Trajectory) -> str:
    """Name the state that has grown most, as a sentence; empty where none has grown much.

    A state has grown if it has left the range of the first tenth of the run a thousandfold, is as
    large as ever in the last one, and grows there faster than any power of time below the seventh.
    The range is at least the size below which the absolute tolerance decides.
    """
    n, start = problem.n_states, float(problem.settings.t_span[0])
    if not trajectory.t.size or not n:
        return ""
    # The start may not be among the times that were asked for.
    t = np.abs(np.concatenate([[start], trajectory.t]) - start)
    y = np.abs(np.column_stack([problem.z0[:n], trajectory.z[:n]]))
    early, late = t <= _EARLY * t[-1], t >= _LATE * t[-1]
    with np.errstate(all="ignore"):
        floor = problem.state_atol / problem.settings.rtol
        # The unknowns that the run began with may have been guesses.
        ranges = np.maximum(np.max(y[:, early], axis=1), floor)
        ranges[n - problem.n_algebraic :] = np.inf
        last, most = np.max(y[:, late], axis=1), np.max(y, axis=1)
        # The power of time by which each grows at the end, and has grown since the last time before
        # the last tenth: what swings may be at rest at the end.
        rate = (problem.state_rhs or problem.rhs)(float(trajectory.t[-1]), trajectory.z[:, -1])[:n]
        power = problem.direction * t[-1] * np.asarray(rate) / trajectory.z[:n, -1]
        before = np.flatnonzero(~late)
        if before.size and t[before[-1]] > 0.0:
            size = np.maximum(np.max(y[:, before], axis=1), floor)
            power = np.fmax(power, np.log(last / size) / np.log(t[-1] / t[before[-1]]))
        is_growing = (last >= most) & (power >= _LEAST_POWER)
        factors = np.where(is_growing, last / ranges, 0.0)
    worst = int(np.argmax(factors))
    if not factors[worst] >= _LEAST:
        return ""
    since = start + _left(problem.direction, t, y[worst], ranges[worst])
    name = f"'{problem.names[worst]}'" if problem.names else f"State {worst}"
    return (
        f"{name} grows without bound: since t = {since:.4g} it has left the range of its beginning "
        f"and reached {last[worst]:.3g}, {factors[worst]:.2g} times as much; look at the signs of "
        "what feeds it."
    )


def _left(direction: float, t: FloatArray, y: FloatArray, largest: float) -> float:
    """Return the time, from the start on, at which a value last was within its first range."""
    return direction * float(t[np.flatnonzero(y <= largest)[-1]])
