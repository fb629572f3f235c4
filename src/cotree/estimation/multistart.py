"""Multistart least squares, with the simulations of all starts batched in the ensemble engine.

Each start runs SciPy's ``least_squares`` in its own thread. Whenever all threads wait for
predictions, these are computed in one batch. The result of a start does not depend on the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError
from cotree.estimation.rendezvous import Rendezvous, Stopped
from cotree.estimation.squares import SquareRows
from cotree.estimation.start_record import StartRecord
from cotree.solvers.progress import CountingBar

if TYPE_CHECKING:
    from collections.abc import Callable

    from scipy.optimize import OptimizeResult

    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.problem import Problem

Array = npt.NDArray[np.float64]


# Number of starts that run concurrently, one thread each; results do not depend on it.
_SIDE_BY_SIDE = 256


# Residuals that MINPACK receives if a run fails; large, but their squares do not overflow.
_HIGH = 1e100


@dataclass(frozen=True)
class Search:
    """Settings of an optimiser; see ``scipy.optimize.least_squares``.

    Attributes
    ----------
    optimiser : str
        ``trf`` or ``dogbox``, which respect bounds, or ``lm``, which does not support them.
    loss : str
        ``linear``, or a robust loss, which requires a given noise.
    f_scale : float
        The residual, in standard deviations, beyond which values count as outliers.
    ftol, xtol, gtol : float
        Termination tolerances: relative change of the objective, relative step, and gradient.
    max_evaluations : int or None
        Largest number of evaluations per start.
    scale : str
        Scaling of the parameters: ``jacobian``, by the columns of the Jacobian, or ``bounds``, by
        the distance between finite bounds on the parameters' scales.

    Raises
    ------
    ParameterError
        If the scale is unknown.
    """

    optimiser: str = "trf"
    loss: str = "linear"
    f_scale: float = 1.0
    ftol: float = 1e-12
    xtol: float = 1e-10
    gtol: float = 1e-8
    max_evaluations: int | None = None
    scale: str = "jacobian"

    def __post_init__(self) -> None:
        if self.scale not in ("jacobian", "bounds"):
            raise ParameterError(
                f"the scale of a search is '{self.scale}': give 'jacobian' or 'bounds'"
            )


def minimise_from_starts(
    problem: Problem,
    starts: Any,
    search: Search | None = None,
    *,
    more_rows: Callable[[Array], tuple[Array, Array]] | None = None,
    progress: bool = True,
) -> tuple[StartRecord, ...]:
    """Minimise the negative log-likelihood, or a loss, from several starts.

    Parameters
    ----------
    problem : Problem
        What is estimated; points stay within its bounds.
    starts : array_like, shape (n_starts, n_estimated)
        Where to begin, on the scales of the estimated parameters, within the bounds.
    search : Search, optional
        Settings of the optimiser.
    more_rows : callable, optional
        Returns further residuals and their Jacobian for ``theta``, shapes (n,) and
        (n, n_estimated), such as those of priors; half the sum of their squares is added to the
        objective.
    progress : bool
        Whether a progress bar may be shown, on terminals only.

    Returns
    -------
    tuple of StartRecord
        Sorted by objective, with failed starts last. The objective is the negative log-likelihood,
        or half the sum of the losses if the loss is not linear. After Ctrl-C, the records hold the
        best points so far and are marked as not converged.
    """
    points = np.atleast_2d(np.asarray(starts, dtype=float))
    how = search or Search()
    records: list[StartRecord] = []
    n_evaluations, is_stopped = 0, False
    with CountingBar("starts", len(points), progress) as bar:
        for first in range(0, len(points), _SIDE_BY_SIDE):
            meeting = Rendezvous(problem.predict)
            block = [
                Start(problem, i, x, how, more_rows, meeting)
                for i, x in enumerate(points[first : first + _SIDE_BY_SIDE])
            ]

            def count(done: int, n: int, first: int = first, before: int = n_evaluations) -> None:
                label = f" ended, {before + n} evaluations"
                bar.count(first + done, lambda elapsed: label)

            if not is_stopped:
                is_stopped = meeting.meet([one.run for one in block], count)
            records += [one.record() for one in block]
            n_evaluations = sum(row.n_evaluations for row in records)
    # The sort is stable, so of equal starts the first one comes first.
    return tuple(sorted(records, key=lambda row: (not math.isfinite(row.objective), row.objective)))


class Start:
    """One start: runs the optimiser and keeps the best of the points it evaluates."""

    def __init__(
        self,
        problem: Problem,
        number: int,
        began: Array,
        search: Search,
        more_rows: Callable[[Array], tuple[Array, Array]] | None,
        meeting: Rendezvous,
    ) -> None:
        self._problem, self._number, self._search = problem, number, search
        self._began, self._more, self._meeting = began, more_rows, meeting
        self._rows = SquareRows(problem)
        self._n_evaluations = 0
        # The point evaluated last, with its residuals and their Jacobian.
        self._at: tuple[Array, Array, Array] | None = None
        self._best, self._least = began, math.inf
        self._ended: OptimizeResult | None = None
        self._message = "interrupted before its first point"

    def run(self) -> None:
        """Run the optimiser; called in a separate thread."""
        from scipy.optimize import least_squares

        scaled, how = self._problem.scaled, self._search
        lm = how.optimiser == "lm"
        try:
            first = self._values(self._inside(self._began))
            if not np.all(np.isfinite(first)):
                return
            self._ended = least_squares(
                self._high_values if lm else self._values,
                self._inside(self._began),
                self._slopes,
                bounds=(-np.inf, np.inf) if lm else (scaled.lower, scaled.upper),
                method=how.optimiser,
                x_scale=self._scale(),
                loss=how.loss,
                f_scale=how.f_scale,
                ftol=how.ftol,
                xtol=how.xtol,
                gtol=how.gtol,
                max_nfev=how.max_evaluations,
            )
        except Stopped:
            if self._n_evaluations:
                self._message = f"interrupted after {_counted(self._n_evaluations)}"

    def record(self) -> StartRecord:
        """Return the outcome."""
        is_converged = self._ended is not None and self._ended.status > 0
        ended = self._ended
        return StartRecord(
            self._began,
            self._best,
            self._least,
            self._n_evaluations,
            is_converged,
            self._message if ended is None else self._why(ended),
            math.nan if ended is None else float(ended.optimality),
        )

    def _scale(self) -> str | Array:
        width = self._problem.scaled.upper - self._problem.scaled.lower
        use_bounds = self._search.scale == "bounds" and np.all(np.isfinite(width) & (width > 0.0))
        return width if use_bounds else "jac"

    def _inside(self, theta: Array) -> Array:
        return np.clip(theta, self._problem.scaled.lower, self._problem.scaled.upper)

    def _values(self, theta: Array) -> Array:
        if self._at is not None and np.array_equal(self._at[0], theta):
            return self._at[1]
        found = self._meeting.ask(self._number, theta)
        self._n_evaluations += 1
        rows, slopes = self._rows.at(found)
        if self._more is not None:
            more, along = self._more(theta)
            rows, slopes = np.concatenate([rows, more]), np.vstack([slopes, along])
        # A point without derivatives is useless to the optimiser, so the step is rejected.
        if found.message or not np.all(np.isfinite(slopes)):
            rows = np.full_like(rows, np.nan)
        if not np.all(np.isfinite(rows)) and self._least == math.inf:
            self._message = found.message or "predictions are not finite"
        self._at = theta.copy(), rows, slopes
        self._note(theta, found, rows)
        return rows

    def _high_values(self, theta: Array) -> Array:
        """Return large residuals if a run fails, since MINPACK mistakes nan for convergence."""
        rows = self._values(theta)
        return rows if np.all(np.isfinite(rows)) else np.full_like(rows, _HIGH)

    def _slopes(self, theta: Array) -> Array:
        if self._at is None or not np.array_equal(self._at[0], theta):
            self._values(theta)
        assert self._at is not None
        return self._at[2]

    def _note(self, theta: Array, found: Predictions, rows: Array) -> None:
        """Update the best point."""
        if not np.all(np.isfinite(rows)):
            return
        if self._search.loss == "linear":
            objective = -self._problem.likelihood.log_likelihood(found)
            if self._more is not None:
                objective += 0.5 * float(np.sum(self._more(theta)[0] ** 2))
        else:
            objective = _robust(rows, self._search)
        if objective < self._least:
            self._best, self._least = theta.copy(), objective

    def _why(self, ended: OptimizeResult) -> str:
        """Return the reason for termination."""
        found = {
            1: "converged: the gradient vanishes",
            2: "converged: the objective no longer changes",
            3: "converged: the parameters no longer change",
            4: "converged: neither the objective nor the parameters change",
        }
        limit = (
            f"it stopped after {_counted(self._n_evaluations)}, the limit, with an optimality of "
            f"{ended.optimality:.1e}, more than {self._search.gtol:.0e}: raise max_evaluations"
        )
        return found.get(int(ended.status), limit)


def _robust(rows: Array, search: Search) -> float:
    """Return half the sum of losses as SciPy defines it."""
    from scipy.optimize import least_squares

    # SciPy does not export its loss functions, so a problem with zero Jacobian evaluates the cost.
    there = least_squares(
        lambda x: rows,
        [0.0],
        lambda x: np.zeros((len(rows), 1)),
        loss=search.loss,
        f_scale=search.f_scale,
    )
    return float(there.cost)


def _counted(n: int) -> str:
    return f"{n} evaluation{'s' if n != 1 else ''}"
