"""A method for stiff problems goes on where an explicit one finds that its problem became stiff.

In: a ``Problem`` and the job of the explicit method, which waits at the end of a step. Out: the
trajectory of both methods, or None where the explicit one is to go on, with the reason.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.codegen.tableaus import TABLEAUS
from cotree.solvers.base import Drift, Statistics, Trajectory
from cotree.solvers.evaluate import FAILED
from cotree.solvers.methods import beyond_scipy, refusal
from cotree.solvers.step_costs import share_of_rodas5
from cotree.solvers.stiffness_probe import largest_decaying
from cotree.solvers.sundials_library import has_sundials

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.solvers.base import FloatArray
    from cotree.solvers.job import Job
    from cotree.solvers.problem import Problem

# Beyond it, factors that are kept for many steps win over eight stages that are cheap.
_MOST_STATES = 150

# A corner costs a multistep method some thirty short steps, of hundreds that a run takes.
_MOST_CORNERS = 3

# The test of the integrator looks at differences that rounding may spoil: what it finds is believed
# where the Jacobian has a mode of at least this share of the bound of stability.
_CONFIRMED = 0.5

# Where the value that an event looks at is within so many absolute tolerances of zero, a method
# that begins there might find an event that has already happened, or one of a value that rests at
# zero.
_AT_ZERO = 10.0


def stiff_method(problem: Problem) -> str:
    """Name the method for a stiff problem.

    Returns
    -------
    str
        "rodas5"; "cvode" where its steps cost so much less that a run does. For many states, loops,
        which "rodas5" does not bring through singular configurations, and where C cannot take
        that, "cvode"; without scikit-sundae "BDF", or what C takes where SciPy's methods do not.
    """
    is_wide = problem.n_states > _MOST_STATES and not problem.n_algebraic
    if problem.singular is None and not is_wide and not refusal("rodas5", problem):
        return "cvode" if cost_of_rodas5(problem) > 1.0 else "rodas5"
    if has_sundials():
        return "cvode"
    if not beyond_scipy(problem):
        return "BDF"
    return "rodas5" if not refusal("rodas5", problem) else "dop853"


def cost_of_rodas5(problem: Problem) -> float:
    """Estimate how many times as long "rodas5" takes as "cvode", where that can take its place.

    A multistep method restarts at order one after each event and each corner, and where constraints
    move what it remembers; algebraic unknowns it would solve for at each evaluation. There, and
    without scikit-sundae, the number is zero.
    """
    # How often a run passes corners of its rates is known as little as how often events happen.
    locates = problem.events is not None or (problem.has_corners and problem.direction > 0)
    has_restarts = locates or len(problem.breakpoints) > _MOST_CORNERS
    is_wide = problem.n_states > _MOST_STATES  # an elimination of it takes long to plan
    if has_restarts or is_wide or problem.n_algebraic or problem.held is not None:
        return 0.0
    if not has_sundials() or refusal("cvode", problem):
        return 0.0
    return share_of_rodas5(problem) or 0.0


@dataclass
class Succession:
    """Lets a method for stiff problems take a run over; it is mutable and belongs to one run."""

    #: ``solve(problem, method)`` integrates with a named method.
    solve: Callable[[Problem, str], Trajectory]
    #: Steps before this one are taken without asking whether the problem is stiff: the method was
    #: chosen by them, whether they are taken for this run or were for an equal one.
    first_step: int = 0
    note: str = ""  # the outcome as a sentence; empty while no other method was asked for
    _has_failed: bool = False

    def take_over(self, problem: Problem, first: Trajectory, job: Job) -> Trajectory | None:
        """Go on from where a job waits, to the end of the span.

        Parameters
        ----------
        problem : Problem
            The whole problem.
        first : Trajectory
            The values that the job has stored.
        job : Job
            It waits because it finds the problem stiff.

        Returns
        -------
        Trajectory or None
            That of both; None where the job is to go on by itself.
        """
        c, method = job.job, first.statistics.method
        # A copy, since the job may go on from this point after all.
        t, z, since = float(c.t), job.z.copy(), float(c.stiff_since)
        if self._has_failed or not is_confirmed(problem, t, z, float(c.last_step), method):
            return None
        self.note = _obstacle(problem, t, z, method)
        if self.note:
            return None
        rest = _rest(problem, first, t, z)
        if rest is None:
            return None
        other = stiff_method(problem)
        second = self.solve(rest, other)
        became = f"from t = {since:.6g} on its steps were as short as stability asks"
        # A method that fails is not asked again: each attempt would integrate up to the same place.
        if second.status == FAILED:
            self._has_failed = True
            self.note = f"{method} went on by itself, although {became}: {second.message}"
            return None
        note = f"{other} took over from {method} at t = {t:.10g}: stiff, {became}."
        return _joined(problem, first, replace(second, message=f"{second.message} {note}"))


def is_confirmed(problem: Problem, t: float, z: FloatArray, step: float, method: str) -> bool:
    """Return whether there is a mode that limits a step.

    Parameters
    ----------
    problem : Problem
        The problem.
    t : float
        Time, [s].
    z : ndarray
        States and sensitivities there.
    step : float
        The step, [s].
    method : str
        The explicit method that takes it.
    """
    # The method is stable up to |lambda| h = bound; the modes that count are those that decay.
    bound = float(TABLEAUS[method].stable)
    return step * largest_decaying(problem, t, z) >= _CONFIRMED * bound


def _obstacle(problem: Problem, t: float, z: FloatArray, method: str) -> str:
    """Describe why no other method can begin at a point; nothing where one can."""
    if problem.events is None:
        return ""
    values = np.abs(problem.events.values(t, z))
    near = np.flatnonzero(values <= _AT_ZERO * float(np.min(problem.settings.atol)))
    if not near.size:
        return ""
    name = problem.events.rows[int(near[0])].name
    return (
        f"{method} went on by itself, although the problem is stiff at t = {t:.6g}: what event "
        f"'{name}' looks at is zero there, where nothing can take over."
    )


def _rest(problem: Problem, first: Trajectory, t: float, z: FloatArray) -> Problem | None:
    """Return the problem of the rest of the run; None if a budget is spent."""
    own = problem.settings
    wanted = own.t_eval
    if wanted is not None:
        # Points are stored in the order of t_eval, so the rest of it is still wanted.
        wanted = wanted[len(first.t) :]
        # Without any wanted point left the end is asked for, to have something to integrate to.
        wanted = wanted if len(wanted) else np.array([own.t_span[1]])
    work, steps, events, limit = first.statistics, None, None, None
    taken = problem.steps_taken + work.n_steps
    # Only to be checked: `steps_taken` counts these steps in the budget of the rest.
    if own.max_steps is not None:
        steps = own.max_steps - taken
    if own.max_events is not None:
        events = own.max_events - len(first.events)
    if own.time_limit is not None:
        limit = own.time_limit - work.seconds
    if any(left is not None and left <= 0 for left in (steps, events, limit)):
        return None
    rest = problem.with_settings(
        t_span=(t, own.t_span[1]), t_eval=wanted, max_events=events, time_limit=limit
    )
    return replace(rest, z0=z, steps_taken=taken)


def _joined(problem: Problem, first: Trajectory, second: Trajectory) -> Trajectory:
    """Put two trajectories together: the second begins where the first ends."""
    skipped = 0
    if problem.settings.t_eval is None:
        # Where every step is stored, the second run repeats the point where the first one ended.
        skipped = int(bool(first.t.size and second.t.size and first.t[-1] == second.t[0]))
    elif len(first.t) == len(problem.settings.t_eval) and second.status == 0:
        skipped = len(second.t)  # the end of the run, which nobody asked for
    t, z = second.t[skipped:], second.z[:, skipped:]
    return replace(
        second,
        t=np.concatenate([first.t, t]),
        z=np.hstack([first.z, z]),
        statistics=summed(first.statistics, second.statistics),
        drift=_joined_drift(first.drift, second.drift, skipped),
        # Methods that take no events give no columns for them either.
        events=np.vstack([first.events, second.events]) if len(first.events) else second.events,
    )


def summed(first: Statistics, second: Statistics) -> Statistics:
    """Add up the work of two integrations of one run."""
    return replace(
        second,
        began_with=first.method,
        nfev=first.nfev + second.nfev,
        njev=first.njev + second.njev,
        nlu=first.nlu + second.nlu,
        n_steps=first.n_steps + second.n_steps,
        seconds=first.seconds + second.seconds,
        compile_seconds=first.compile_seconds + second.compile_seconds,
    )


def _joined_drift(first: Drift | None, second: Drift | None, skipped: int) -> Drift | None:
    if first is None or second is None:
        return second
    return Drift(
        second.names,
        np.hstack([first.residual, second.residual[:, skipped:]]),
        max(first.correction, second.correction),
    )
