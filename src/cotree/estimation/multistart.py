"""Multistart least squares, in which the ensemble engine simulates all starts together.

For normal noise of known standard deviation, the vector F consists of the residuals. Other terms of
the objective are not squares: logarithms of estimated standard deviations, and absolute values for
Laplace distributions. They are rewritten such that at every point 1/2 F^T F is the objective up to
a constant, J^T F is its exact gradient, and J^T J approximates its Hessian. An additional row, with
zeros in J, corrects the value. The usual rows sqrt(2 log(sigma) + constant) have only the first two
properties: their Gauss-Newton steps in a standard deviation are about twice too long and converge
slowly.

Each start runs SciPy's ``least_squares`` in its own thread. When all threads wait for predictions,
one batch computes them. The result of a start does not depend on the others.
"""

from __future__ import annotations

import math
import operator
import queue
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.arguments import check_choice, check_whole
from cotree.ensemble.run import stopped_by_interrupt
from cotree.report import counted
from cotree.scene.expressions import check_positive
from cotree.solvers.budgets import CountingBar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scipy.optimize import OptimizeResult

    from cotree.estimation.estimated import Array, Scaled
    from cotree.estimation.problem import Predictions, Problem

    #: Returns additional residuals and their Jacobian at ``theta``.
    MoreRows = Callable[[Array], tuple[Array, Array]]


class Stopped(BaseException):
    """Signal that ends a thread; a BaseException, so that no ``except Exception`` catches it."""


class Rendezvous:
    """Computes the predictions requested by threads, in one batch when all threads are waiting.

    Sequential starts would take 20 to 45 % more processor time for small models, and leave
    processors idle in fits of few experiments. ``compute`` maps an array with one row per request
    to predictions, in the thread that calls :meth:`run_all`, which receives Ctrl-C.
    """

    def __init__(self, compute: Callable[[Any], Sequence[Predictions]]) -> None:
        self._compute = compute
        # Requests (function number, point, queue for the answer), or None if a function returns.
        self._arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._asked: list[tuple[int, Any, queue.SimpleQueue[Any]]] = []
        self._n_working = 0

    def ask(self, number: int, theta: Any) -> Predictions:
        """Request predictions at ``theta`` from a thread, and wait for them."""
        answer: queue.SimpleQueue[Predictions | None] = queue.SimpleQueue()
        self._arrived.put((number, np.array(theta, dtype=float), answer))
        found = answer.get()
        if found is None:
            raise Stopped
        return found

    def run_all(
        self, works: Sequence[Callable[[], None]], report: Callable[[int, int], None]
    ) -> bool:
        """Run each function in its own thread; return whether Ctrl-C has stopped them.

        Functions call :meth:`ask` with their number. After each batch, ``report`` receives the
        number of functions that have returned and of predictions computed.
        """
        n_computed, self._n_working = 0, len(works)
        with stopped_by_interrupt() as stop, ThreadPoolExecutor(len(works)) as pool:
            ended = [pool.submit(self._work, work) for work in works]
            try:
                while self._gather() and not stop.is_set():
                    found = self._compute(np.array([theta for _, theta, _ in self._asked]))
                    n_computed += len(found)
                    self._answer(found)
                    report(len(works) - self._n_working, n_computed)
            finally:
                while self._gather():
                    self._answer([None] * len(self._asked))
        for future in ended:
            future.result()
        return stop.is_set()

    def _work(self, work: Callable[[], None]) -> None:
        try:
            work()
        finally:
            self._arrived.put(None)

    def _gather(self) -> bool:
        """Wait until all active threads have made a request; return whether any is active."""
        while len(self._asked) < self._n_working:
            request = self._arrived.get()
            if request is None:
                self._n_working -= 1
            else:
                self._asked.append(request)
        self._asked.sort(key=operator.itemgetter(0))
        return bool(self._asked)

    def _answer(self, found: Sequence[Predictions | None]) -> None:
        asked, self._asked = self._asked, []
        for (_, _, answer), row in zip(asked, found, strict=True):
            answer.put(row)


@dataclass(frozen=True, eq=False)
class StartRecord:
    """The outcome of one start of the optimiser.

    Attributes
    ----------
    began, theta : ndarray, shape (n_estimated,)
        Initial and best values of the estimated parameters on their scales.
    objective : float
        The objective at the best point; infinite if no run succeeded.
    n_evaluations : int
        Number of evaluations of the predictions.
    is_converged : bool
        Whether the optimiser met its tolerances.
    message : str
        Reason for termination.
    optimality : float
        Largest gradient entry at the final point. Each entry is multiplied by the distance to the
        bound in the direction of descent. nan if the optimiser was interrupted.
    """

    began: Array
    theta: Array
    objective: float
    n_evaluations: int
    is_converged: bool
    message: str
    optimality: float = math.nan


# Standard deviations may decrease by at most exp(-20), because larger ratios lose digits.
_SHRINKS = 20.0

# Below this residual, Laplace distributions use r^2 instead of |r|, which has a kink at zero.
_CORNER = 1e-3


class SquareRows:
    """Computes F and J, defined in the module docstring, from the predictions of one start."""

    def __init__(self, problem: Problem) -> None:
        self._likelihood = problem.likelihood
        self._is_normal = problem.likelihood.is_normal
        self._with_noise = np.array([isinstance(v, str) for v in problem.measured.noise])
        self._is_plain = bool(self._is_normal.all()) and not self._with_noise.any()
        self._first: Array | None = None

    def at(self, found: Predictions) -> tuple[Array, Array]:
        """Return F, (n,), and J, (n, n_estimated); the first call sets the constant for noise."""
        r = self._likelihood.residuals(found)
        slopes = self._likelihood.residual_slopes(found)
        if self._is_plain:
            return r, slopes
        # Squares of these rows are r^2 for normal and |r| for Laplace distributions.
        weights = np.where(self._is_normal, 1.0, np.maximum(np.abs(r), _CORNER) ** -0.5)
        rows, missing = r * weights, np.where(self._is_normal, 0.0, 2.0 * np.abs(r))
        missing = missing - np.where(self._is_normal, 0.0, rows**2)
        noisy, normal = self._with_noise, self._is_normal[self._with_noise]
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(found.sigma)
        if self._first is None:
            self._first = logs
        # The second derivative with respect to log(sigma) is 2 r^2, expected 2. For normal
        # distributions, the rows above contribute r^2 to J^T J; for Laplace, almost all.
        weight = np.where(normal, np.maximum(1.0, np.abs(r[noisy])), 0.5)
        by_sigma = found.sigma_slopes[noisy] / found.sigma[noisy, None]
        rest = np.sum(missing) + np.sum(
            2.0 * (logs - self._first + _SHRINKS)[noisy] - weight**-2.0 + 4.0
        )
        with np.errstate(invalid="ignore"):
            # nan, which rejects the step, if a standard deviation has decreased too far
            last = np.sqrt(rest)
        return (
            np.concatenate([rows, 1.0 / weight, [last]]),
            np.vstack(
                [slopes * weights[:, None], weight[:, None] * by_sigma, np.zeros(slopes.shape[1])]
            ),
        )


# Number of starts that run concurrently, each in a thread; it does not affect results.
_SIDE_BY_SIDE = 256


# Value of all residuals passed to MINPACK if a run fails; its square does not overflow.
_HIGH = 1e100


@dataclass(frozen=True)
class Search:
    """Settings of an optimiser; see ``scipy.optimize.least_squares``."""

    #: ``trf`` or ``dogbox``, which support bounds, or ``lm``, which does not.
    optimiser: str = "trf"
    loss: str = "linear"  # ``linear``, or a robust loss, which requires known noise
    #: Residual, in standard deviations, beyond which a robust loss treats a value as an outlier.
    f_scale: float = 1.0
    #: Termination tolerances: relative change of the objective, relative step, gradient.
    ftol: float = 1e-12
    xtol: float = 1e-10
    gtol: float = 1e-8
    max_evaluations: int | None = None  # maximum number of evaluations per start
    #: Parameter scaling by norms of Jacobian columns (``jacobian``) or finite ``bounds``.
    scale: str = "jacobian"

    def __post_init__(self) -> None:
        check_choice(self.optimiser, "optimiser", ("trf", "dogbox", "lm"))
        check_choice(self.loss, "loss", ("linear", "soft_l1", "huber", "cauchy", "arctan"))
        check_positive(self.f_scale, "f_scale")
        if self.max_evaluations is not None:
            check_whole(self.max_evaluations, "max_evaluations", 1)
        check_choice(self.scale, "the scale of a search", ("jacobian", "bounds"))


def minimise_from_starts(
    problem: Problem,
    starts: Any,
    search: Search | None = None,
    *,
    more_rows: MoreRows | None = None,
    progress: bool = True,
) -> tuple[StartRecord, ...]:
    """Minimise the negative log-likelihood, or a robust loss, from several starts.

    ``starts``, (n_starts, n_estimated), contains points within the bounds, on the parameters'
    scales. ``more_rows`` returns additional residuals, (n,), such as those of priors, and their
    Jacobian, (n, n_estimated); half the sum of their squares is added to the objective. A progress
    bar is shown on terminals only.

    Records are sorted by objective, with failed starts last. The objective is the negative
    log-likelihood, or for other losses half the sum of the losses. After Ctrl-C, records contain
    the best points so far and are marked as not converged.
    """
    points = np.atleast_2d(np.asarray(starts, dtype=float))
    how = search or Search()
    records: list[StartRecord] = []
    n_evaluations, is_stopped = 0, False
    with CountingBar("starts", len(points), progress) as bar:
        for first in range(0, len(points), _SIDE_BY_SIDE):
            meeting = Rendezvous(problem.predict)
            block = [
                StartRun(problem, problem.scaled, x, how, more_rows, partial(meeting.ask, i))
                for i, x in enumerate(points[first : first + _SIDE_BY_SIDE])
            ]

            def count(done: int, n: int, first: int = first, before: int = n_evaluations) -> None:
                label = f" ended, {before + n} evaluations"
                bar.count(first + done, lambda elapsed: label)

            if not is_stopped:
                is_stopped = meeting.run_all([one.run for one in block], count)
            records += [one.record() for one in block]
            n_evaluations = sum(row.n_evaluations for row in records)
    # The sort is stable, so equal starts keep their order.
    return tuple(sorted(records, key=lambda row: (not math.isfinite(row.objective), row.objective)))


class StartRun:
    """Runs the optimiser from one start; ``ask`` predicts for values of the varied parameters."""

    def __init__(
        self,
        problem: Problem,
        scaled: Scaled,
        began: Array,
        search: Search,
        more_rows: MoreRows | None,
        ask: Callable[[Array], Predictions],
    ) -> None:
        self._likelihood, self._scaled, self._search = problem.likelihood, scaled, search
        self._began, self._more, self._ask = began, more_rows, ask
        self._rows = SquareRows(problem)
        self._n_evaluations = 0
        # last evaluated point, with residuals and Jacobian
        self._at: tuple[Array, Array, Array] | None = None
        self._best, self._least = began, math.inf
        self._ended: OptimizeResult | None = None
        self._message = "interrupted before its first point"

    def run(self) -> None:
        """Run the optimiser in the calling thread."""
        from scipy.optimize import least_squares

        lower, upper, how = self._scaled.lower, self._scaled.upper, self._search
        is_lm, width = how.optimiser == "lm", upper - lower
        by_bounds = how.scale == "bounds" and np.all(np.isfinite(width) & (width > 0.0))
        first = np.clip(self._began, lower, upper)
        try:
            if not np.all(np.isfinite(self._values(first))) or not first.size:
                return
            self._ended = least_squares(
                self._high_values if is_lm else self._values,
                first,
                self._slopes,
                bounds=(-np.inf, np.inf) if is_lm else (lower, upper),
                method=how.optimiser,
                x_scale=width if by_bounds else "jac",
                loss=how.loss,
                f_scale=how.f_scale,
                ftol=how.ftol,
                xtol=how.xtol,
                gtol=how.gtol,
                max_nfev=how.max_evaluations,
            )
        except Stopped:
            if self._n_evaluations:
                self._message = f"interrupted after {counted(self._n_evaluations, 'evaluation')}"

    def record(self) -> StartRecord:
        """Return the outcome of the start."""
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

    def _values(self, theta: Array) -> Array:
        if self._at is not None and np.array_equal(self._at[0], theta):
            return self._at[1]
        found = self._ask(theta)
        self._n_evaluations += 1
        rows, slopes = self._rows.at(found)
        if self._more is not None:
            more, along = self._more(theta)
            rows, slopes = np.concatenate([rows, more]), np.vstack([slopes, along])
        # A point without derivatives is useless to the optimiser: nan rejects the step.
        if found.message or not np.all(np.isfinite(slopes)):
            rows = np.full_like(rows, np.nan)
        if not np.all(np.isfinite(rows)) and self._least == math.inf:
            self._message = found.message or "predictions are not finite"
        self._at = theta.copy(), rows, slopes
        self._note(theta, found, rows)
        return rows

    def _high_values(self, theta: Array) -> Array:
        """Return residuals, or large values if a run fails: MINPACK treats nan as convergence."""
        rows = self._values(theta)
        return rows if np.all(np.isfinite(rows)) else np.full_like(rows, _HIGH)

    def _slopes(self, theta: Array) -> Array:
        self._values(theta)
        assert self._at is not None
        return self._at[2]

    def _note(self, theta: Array, found: Predictions, rows: Array) -> None:
        """Store a point if it is the best so far."""
        if not np.all(np.isfinite(rows)):
            return
        if self._search.loss == "linear":
            objective = -self._likelihood.log_likelihood(found)
            if self._more is not None:
                objective += 0.5 * float(np.sum(self._more(theta)[0] ** 2))
        else:
            objective = _robust(rows, self._search)
        if objective < self._least:
            self._best, self._least = theta.copy(), objective

    def _why(self, ended: OptimizeResult) -> str:
        if ended.status < 1:
            return (
                f"it stopped after {counted(self._n_evaluations, 'evaluation')}, the limit, with "
                f"an optimality of {ended.optimality:.1e}, more than {self._search.gtol:.0e}: "
                "raise max_evaluations"
            )
        return f"converged: {_CONVERGED[int(ended.status)]}"


# Reasons for termination, by the status of ``least_squares``.
_CONVERGED = {
    1: "the gradient vanishes",
    2: "the objective no longer changes",
    3: "the parameters no longer change",
    4: "neither the objective nor the parameters change",
}


def _robust(rows: Array, search: Search) -> float:
    """Return the cost as defined by SciPy, half the sum of losses."""
    from scipy.optimize import least_squares

    # SciPy does not export its loss functions, so a problem with zero Jacobian computes the cost.
    there = least_squares(
        lambda x: rows,
        [0.0],
        lambda x: np.zeros((len(rows), 1)),
        loss=search.loss,
        f_scale=search.f_scale,
    )
    return float(there.cost)
