"""Sentences in which an integration reports its outcome."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.statuses import SENTENCES
from cotree.errors import listed
from cotree.solvers.augmented import RTOL_FLOOR, tested_rtol
from cotree.solvers.rescue import Rescue
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.solvers.base import FloatArray
    from cotree.solvers.job import Job
    from cotree.solvers.problem import Problem

#: Reason given where a method stops because its steps no longer change t.
ROUNDING_LEVEL = SENTENCES["STEP_TOO_SMALL"]

# Where the spacing of floating-point times exceeds this share of the span, it may be too coarse.
_FINE = 1e-12

# Rates without a value made the steps short if they lie ahead within this share of the elapsed
# time; at the start, within the square of this share of the span.
_SOON = 1e-3


def summary(problem: Problem, method: str, t: float, reason: str) -> list[str]:
    """Describe in sentences where a method arrived, or why it stopped, and with which tolerance.

    Parameters
    ----------
    problem : Problem
        The problem.
    method : str
        The method that ran.
    t : float
        The last time that it reached, [s].
    reason : str
        The reason why it stopped early, without a capital and a full stop; or empty.
    """
    sentences = [f"{method} reached t = {t:.10g}."]
    if reason:
        end = problem.settings.t_span[1]
        sentences = [f"{method} stopped at t = {t:.10g} of {end:.10g}: {reason}."]
    if reason == ROUNDING_LEVEL:
        sentences.append(_rounding_of_time(problem, t))
    rtol = tested_rtol(problem)
    if rtol > problem.settings.rtol:
        sentences.append(
            f"rtol = {problem.settings.rtol:.3g} is below what double precision can test; "
            f"{RTOL_FLOOR:.3g} was used."
        )
    return [sentence for sentence in sentences if sentence]


def stiffness_note(job: Any) -> str:
    """Describe what an explicit method found out about stiffness; empty where that is nothing."""
    if not (job.is_stiff and job.n_stiff_steps > LIMITS.most_stiff_steps):
        return ""
    return (
        f"The problem is stiff from t = {float(job.stiff_since):.6g} on: about "
        f"{int(job.n_stiff_steps)} steps were as short as stability asks, and a method for "
        "stiff problems such as rodas5 may take far fewer."
    )


def undefined_ahead(problem: Problem, t: float, z: FloatArray) -> str:
    """Describe why rates have no value just beyond the point where a method stopped; else empty.

    C reports that the rates fail, but not why: they are evaluated here along the tangent of the
    motion.

    Parameters
    ----------
    problem : Problem
        The problem.
    t : float
        Time of the last good point, [s].
    z : ndarray, shape (n_states * (1 + n_sensitivities),)
        The point.
    """
    if problem.undefined is None or problem.state_rhs is None:
        return ""
    start, end = problem.settings.t_span
    y = np.array(z[: problem.n_states])
    why = _undefined(problem, t, y)
    if why:
        return why
    rates = np.array(problem.state_rhs(t, y))
    # Entries of algebraic unknowns are residuals, not rates: the unknowns stay where they are.
    rates[problem.n_states - problem.n_algebraic :] = 0.0
    reach = min(abs(end - t), _SOON * max(abs(t - start), _SOON * abs(end - start)))
    # Distances grow fourfold from a few units in the last place, so the nearest fault is found.
    step = 4.0 * float(np.spacing(max(abs(t), float(np.finfo(np.float64).tiny))))
    while step <= reach and not why:
        ahead = math.copysign(step, end - start)
        why = _undefined(problem, t + ahead, y + ahead * rates)
        step *= 4.0
    return why


def _undefined(problem: Problem, t: float, y: FloatArray) -> str:
    """Describe why rates, or the algebraic unknowns in them, have no value at a point."""
    assert problem.undefined is not None  # or nobody would have asked
    why = problem.undefined(t, y)
    if why or not problem.n_algebraic:
        return why
    rescue = Rescue(problem)
    return "" if rescue.find_unknowns(t, y) else rescue.complaint


def _rounding_of_time(problem: Problem, t: float) -> str:
    """Report that rounding of a large t, not the motion, made steps short; empty otherwise."""
    spacing, (start, end) = float(np.spacing(abs(t))), problem.settings.t_span
    if spacing <= _FINE * abs(end - start):
        return ""
    return (
        f"Near t = {t:.17g} times are {spacing:.2g} s apart, too far for the steps that are "
        "needed: let the run begin nearer to t = 0."
    )


def singular_positions(problem: Problem, job: Job, *, has_failed: bool) -> list[str]:
    """Return sentences on the singular positions that a job crossed, or at which it failed.

    Parameters
    ----------
    problem : Problem
        The problem.
    job : Job
        Its job, which has ended or waits.
    has_failed : bool
        Whether the job failed where it stands.
    """
    if problem.singular is None:
        return []
    sentences = []
    lost = problem.singular(float(job.job.t), job.z) if has_failed else ()
    if lost:
        sentences.append(
            f"There the constraints of {_quoted(lost)} nearly lose rank, which enlarges rounding, "
            "most of all in sensitivities: loosen rtol."
        )
    crossings = job.crossings
    if crossings:
        places = ", ".join(f"{t:.6g}" for t, _ in crossings[:4])
        more = ", ..." if len(crossings) > 4 else ""
        names = dict.fromkeys(name for t, y in crossings for name in problem.singular(t, y))
        sentences.append(
            f"Singular configurations were crossed with a looser tolerance after t = {places}"
            f"{more}: there the constraints of {_quoted(names)} lose rank."
        )
    return sentences


def _quoted(names: Iterable[str]) -> str:
    return listed(f"'{name}'" for name in names)
