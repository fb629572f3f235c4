"""Multistart least squares, with the simulations of all starts batched in the ensemble engine.

For a given normal noise, F consists of the residuals. The other terms, logarithms of estimated
standard deviations and absolute values for Laplace distributions, are not squares. They are
rewritten such that at every point 1/2 F^T F is the objective up to a constant, J^T F is its exact
gradient, and J^T J approximates its Hessian. To this end a last row, whose row of J is zero,
corrects the value. The usual rows sqrt(2 log(sigma) + constant) have only the first two properties:
Gauss-Newton steps in a standard deviation are then about twice too long and converge slowly.

Each start runs SciPy's ``least_squares`` in its own thread. Whenever all threads wait for
predictions, these are computed in one batch. The result of a start does not depend on the others.
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
    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.problem import Problem

    #: Function that returns additional residuals at ``theta`` and their Jacobian.
    Rows = Callable[[Array], tuple[Array, Array]]


class Stopped(BaseException):
    """Computation was stopped; a ``BaseException``, so that no handler catches it by accident."""


class Rendezvous:
    """Computes the requests of threads in batches, each when all active ones are waiting.

    Starts one after another would take 20 to 45 % more processor time for small models, and leave
    processors idle if a fit has few experiments. ``compute`` returns the predictions of a batch, an
    array with a row for each request; it runs in the thread that :meth:`meet` was called in, which
    receives Ctrl-C.
    """

    def __init__(self, compute: Callable[[Any], Sequence[Predictions]]) -> None:
        self._compute = compute
        # Run numbers, points and queues for answers; None if a function has returned.
        self._arrived: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._asked: list[tuple[int, Any, queue.SimpleQueue[Any]]] = []
        self._n_working = 0

    def ask(self, number: int, theta: Any) -> Predictions:
        """Request predictions for a thread, and wait for them."""
        answer: queue.SimpleQueue[Predictions | None] = queue.SimpleQueue()
        self._arrived.put((number, np.array(theta, dtype=float), answer))
        found = answer.get()
        if found is None:
            raise Stopped
        return found

    def run_all(
        self, works: Sequence[Callable[[], None]], report: Callable[[int, int], None]
    ) -> bool:
        """Run functions in one thread each; return whether Ctrl-C has stopped them.

        They call :meth:`ask` with their number. ``report`` is called after each batch with the
        numbers of functions that have returned and of predictions computed.
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
        """Wait until all active threads have made a request; return whether there are any."""
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
        First and best values of the estimated parameters on their scales.
    objective : float
        The objective at the best point; infinite if no run succeeded.
    n_evaluations : int
        Number of evaluations of the predictions.
    is_converged : bool
        Whether the optimiser met its tolerances.
    message : str
        Reason for termination.
    optimality : float
        The largest entry of the gradient where the optimiser ended, each times the distance to the
        bound that it points to; nan if it was interrupted.
    """

    began: Array
    theta: Array
    objective: float
    n_evaluations: int
    is_converged: bool
    message: str
    optimality: float = math.nan


# A standard deviation may shrink by a factor exp(-20) = 2e-9 from its initial value. A larger
# exponent would cost digits of the objective.
_SHRINKS = 20.0

# Below this, residuals of a Laplace distribution count quadratically: it smooths the kink at zero.
_CORNER = 1e-3


class SquareRows:
    """Computes F and J from the predictions of one start."""

    def __init__(self, problem: Problem) -> None:
        self._likelihood = problem.likelihood
        self._is_normal = problem.likelihood.is_normal
        self._with_noise = np.array([isinstance(v, str) for v in problem.measured.noise])
        self._is_plain = bool(self._is_normal.all()) and not self._with_noise.any()
        self._first: Array | None = None

    def at(self, found: Predictions) -> tuple[Array, Array]:
        """Return F, shape (n,), and J, shape (n, n_estimated).

        The first call fixes the additive constant of the terms of standard deviations.
        """
        r = self._likelihood.residuals(found)
        slopes = self._likelihood.residual_slopes(found)
        if self._is_plain:
            return r, slopes
        # The squares of these rows are r^2 for normal and |r| for Laplace distributions.
        weights = np.where(self._is_normal, 1.0, np.maximum(np.abs(r), _CORNER) ** -0.5)
        rows, missing = r * weights, np.where(self._is_normal, 0.0, 2.0 * np.abs(r))
        missing = missing - np.where(self._is_normal, 0.0, rows**2)
        noisy, normal = self._with_noise, self._is_normal[self._with_noise]
        with np.errstate(divide="ignore", invalid="ignore"):
            logs = np.log(found.sigma)
        if self._first is None:
            self._first = logs
        # With respect to log(sigma), J^T J of the rows above contributes r^2, but the Hessian of
        # the objective is 2 r^2, with expectation 2. For Laplace distributions little is missing.
        weight = np.where(normal, np.maximum(1.0, np.abs(r[noisy])), 0.5)
        by_sigma = found.sigma_slopes[noisy] / found.sigma[noisy, None]
        rest = np.sum(missing) + np.sum(
            2.0 * (logs - self._first + _SHRINKS)[noisy] - weight**-2.0 + 4.0
        )
        with np.errstate(invalid="ignore"):
            # If a standard deviation shrinks too far, this is nan, and the step is rejected.
            last = np.sqrt(rest)
        return (
            np.concatenate([rows, 1.0 / weight, [last]]),
            np.vstack(
                [slopes * weights[:, None], weight[:, None] * by_sigma, np.zeros(slopes.shape[1])]
            ),
        )


# Number of starts that run concurrently, one thread each; results do not depend on it.
_SIDE_BY_SIDE = 256


# Residuals that MINPACK receives if a run fails; large, but their squares do not overflow.
_HIGH = 1e100


@dataclass(frozen=True)
class Search:
    """Settings of an optimiser; see ``scipy.optimize.least_squares``."""

    #: ``trf`` or ``dogbox``, which respect bounds, or ``lm``, which does not support them.
    optimiser: str = "trf"
    loss: str = "linear"  # ``linear``, or a robust loss, which requires a given noise
    #: Residual, in standard deviations, beyond which a value counts as an outlier.
    f_scale: float = 1.0
    #: Termination tolerances: relative change of the objective, relative step, and gradient.
    ftol: float = 1e-12
    xtol: float = 1e-10
    gtol: float = 1e-8
    max_evaluations: int | None = None  # maximum number of evaluations per start
    #: Scaling of the parameters: ``jacobian``, by the columns of the Jacobian, or ``bounds``, by
    #: the distance between finite bounds on the parameters' scales.
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
    more_rows: Rows | None = None,
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
                Start(problem, problem.scaled, x, how, more_rows, partial(meeting.ask, i))
                for i, x in enumerate(points[first : first + _SIDE_BY_SIDE])
            ]

            def count(done: int, n: int, first: int = first, before: int = n_evaluations) -> None:
                label = f" ended, {before + n} evaluations"
                bar.count(first + done, lambda elapsed: label)

            if not is_stopped:
                is_stopped = meeting.run_all([one.run for one in block], count)
            records += [one.record() for one in block]
            n_evaluations = sum(row.n_evaluations for row in records)
    # The sort is stable, so of equal starts the first one comes first.
    return tuple(sorted(records, key=lambda row: (not math.isfinite(row.objective), row.objective)))


class Start:
    """One start: runs the optimiser and keeps the best of the points it evaluates.

    ``scaled`` are the parameters that vary, and ``ask`` returns predictions at values of them.
    """

    def __init__(
        self,
        problem: Problem,
        scaled: Scaled,
        began: Array,
        search: Search,
        more_rows: Rows | None,
        ask: Callable[[Array], Predictions],
    ) -> None:
        self._likelihood, self._scaled, self._search = problem.likelihood, scaled, search
        self._began, self._more, self._ask = began, more_rows, ask
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

    def _values(self, theta: Array) -> Array:
        if self._at is not None and np.array_equal(self._at[0], theta):
            return self._at[1]
        found = self._ask(theta)
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
        self._values(theta)
        assert self._at is not None
        return self._at[2]

    def _note(self, theta: Array, found: Predictions, rows: Array) -> None:
        """Update the best point."""
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
        """Return the reason for termination."""
        if ended.status < 1:
            return (
                f"it stopped after {counted(self._n_evaluations, 'evaluation')}, the limit, with "
                f"an optimality of {ended.optimality:.1e}, more than {self._search.gtol:.0e}: "
                "raise max_evaluations"
            )
        return f"converged: {_CONVERGED[int(ended.status)]}"


# Reasons by the status of `least_squares`.
_CONVERGED = {
    1: "the gradient vanishes",
    2: "the objective no longer changes",
    3: "the parameters no longer change",
    4: "neither the objective nor the parameters change",
}


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
