"""Integration of initial value problems: methods, the C engine, and results."""

from __future__ import annotations

from cotree.model.bound import BoundModel
from cotree.solvers.problem import RunProblem, check_problem
from cotree.solvers.result import Drift, RunRecord, Statistics, Trajectory, UnknownNameError
from cotree.solvers.select import choose_method, integrate

__all__ = [
    "BoundModel",
    "Drift",
    "RunProblem",
    "RunRecord",
    "Statistics",
    "Trajectory",
    "UnknownNameError",
    "check_problem",
    "choose_method",
    "integrate",
]
