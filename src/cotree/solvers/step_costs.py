"""Costs of a step of implicit methods, estimated from counts.

In: a problem. Out: the time of ``rodas5`` divided by that of ``cvode`` for the same error.

The coefficients were fitted by least squares to the times of a step on 20 networks of 6 to 200
species with up to 20 sensitivities (``benchmarks/stiff_choice.py`` makes such networks); estimates
are 0.6 to 1.3 times the measured times. Only their ratios matter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cotree.model.kernels import StepWork
    from cotree.solvers.problem import Problem

# Steps that cvode takes for each step of rodas5 at the same error. Medians over these networks at
# errors from 1e-3 to 1e-9 are 2.3 to 2.9; half of all values are between 1.6 and 3.5.
_STEPS = 2.5

# Stages of rodas5, and how many sensitivities it solves for at a time where elimination is long.
_STAGES, _AT_A_TIME = 8, 8

# Per step of cvode: evaluations of the rates, evaluations of all rates with those of
# sensitivities, and linear solves for each block.
_RATES, _ALL, _SOLUTIONS = 1.6, 1.3, 1.5

# With sensitivities, cvode factorises in each step if that takes at most this many multiplications
# (FEW_MULTIPLICATIONS in C); otherwise in one step out of ten.
_FEW_MULTIPLICATIONS, _SELDOM = 8000, 0.1


def share_of_rodas5(problem: Problem) -> float | None:
    """Estimate the time of rodas5 divided by that of cvode; None where costs are unknown.

    Parameters
    ----------
    problem : Problem
        One without algebraic unknowns, constraints and events.
    """
    work = None if problem.native is None else problem.native.model.work()
    if work is None:
        return None
    n, m = problem.n_states, problem.n_sensitivities
    return _of_rodas5(work, m) / (_STEPS * _of_cvode(work, n, m))


def _of_rodas5(work: StepWork, m: int) -> float:
    """Estimate the time of a step, [ns]."""
    evaluation = 0.43 * (work.augmented if m else work.rates)
    if work.is_unrolled:
        solution = 1.1 * work.n_factors * (1 + m)
        factorisation = 0.5 * work.n_products
    else:
        # One solve for the states, then one for each group of sensitivities.
        solution = 2.2 * work.n_factors * (1 - (-m // _AT_A_TIME))
        factorisation = 0.19 * work.n_products
    own = 300.0 + factorisation + 0.5 * work.jacobian
    return own + _STAGES * (evaluation + solution)


def _of_cvode(work: StepWork, n: int, m: int) -> float:
    """Estimate the time of a step, [ns]."""
    evaluation = 0.25 * (_RATES * work.rates + (_ALL * work.augmented if m else 0.0))
    solution = 0.34 * _SOLUTIONS * work.n_banded * (1 + m)
    is_fresh = m > 0 and work.n_banded_products <= _FEW_MULTIPLICATIONS
    factorisation = 0.32 * work.n_banded_products * (1.0 if is_fresh else _SELDOM)
    # SUNDIALS' vectors: prediction, error test and history.
    vectors = 27.0 * n * (1 + m)
    return 600.0 + evaluation + solution + factorisation + vectors
