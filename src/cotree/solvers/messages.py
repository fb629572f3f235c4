"""What an integration says of itself in the end."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.solvers.augmented import RTOL_FLOOR, augmented_tolerances

if TYPE_CHECKING:
    from cotree.solvers.problem import Problem


def summary(problem: Problem, method: str, t: float, reason: str) -> list[str]:
    """Say in sentences where a method arrived, or why it stopped, and with which tolerance."""
    sentences = [f"{method} reached t = {t:.10g}."]
    if reason:
        end = problem.t_span[1]
        sentences = [f"{method} stopped at t = {t:.10g} of {end:.10g}: {reason}."]
    rtol, _ = augmented_tolerances(problem)
    if rtol > problem.rtol:
        sentences.append(
            f"rtol = {problem.rtol:.3g} is below what double precision can test; "
            f"{RTOL_FLOOR:.3g} was used."
        )
    return sentences
