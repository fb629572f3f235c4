"""Uncertainty of estimates: covariance, standard errors, intervals and correlations.

Derivatives of the predictions, at the estimates and at nearby points, determine covariances,
quantiles, and undetermined directions, along which parameters can change together without changing
any prediction.

Directions are first expressed in relative changes, in which an identifiable product of powers has
integer exponents, then in absolute changes, in which an identifiable sum has integer coefficients.
Either form is accepted only if it also holds at nearby points, since close to the estimates every
curved manifold is almost a plane.

Let J^T J be the Fisher information at the estimates. The covariance is its inverse (the Cramer-Rao
bound), computed by a singular value decomposition of J in relative units. Parameters that change
along an undetermined direction have infinite standard errors; the others are not affected.

If standard deviations of the noise are also estimated, maximum likelihood underestimates them.
Variances are therefore multiplied by n/(n - p), with n values of unknown noise and p parameters
that influence predictions, and quantiles are those of Student's t with n - p degrees of freedom.
Both are exact for linear regression. If the noise is known, quantiles are normal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError
from cotree.estimation.estimated import LOGARITHMS
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.estimation.estimated import Array
    from cotree.estimation.multistart import Search, StartRecord
    from cotree.estimation.problem import Predictions, Problem

# Ratio of global errors to local tolerances; it is several hundred for long oscillations.
_GROWN = 1e3

# Tolerance of integer coefficients (sensitivities have about five digits), and largest integer.
_DIGITS, _LARGEST = 1e-3, 6

# Entries of a direction below this fraction of the largest entry count as zero.
_NOTHING = 1e-4

# Number of nearby points, and range of their relative distances from the estimates.
_N_BESIDE, _LEAST_BESIDE, _MOST_BESIDE = 3, 0.1, 0.3


@dataclass(frozen=True, eq=False)
class Split:
    """Determined and undetermined directions in parameter space at one point."""

    #: Change of each parameter, on its scale, that doubles its value to first order.
    sizes: Array
    values: Array  # the same changes in unscaled values
    open: Array  # undetermined directions in these units, as orthonormal columns
    #: Whether the unit of change is the parameter's value, which must not be zero.
    is_relative: npt.NDArray[np.bool_]

    @property
    def is_open(self) -> npt.NDArray[np.bool_]:
        """Whether each parameter changes along an undetermined direction."""
        return np.asarray(np.any(np.abs(self.open) > _NOTHING, axis=1))


def split(problem: Problem, theta: Array, found: Predictions, rows: Array) -> Split:
    """Find the directions that the Fisher information J^T J does not determine.

    ``rows`` is the matrix J, shape (n_rows, n), on the scales of the parameters. Changes of
    predictions below their accuracy count as zero.
    """
    settings = problem.settings
    slopes, values = problem.scaled.slopes(theta), problem.scaled.values(theta)
    is_relative = np.abs(values) > settings.atol
    width = problem.scaled.upper - problem.scaled.lower
    other = np.where(np.isfinite(width), width, 1.0)
    units = np.where(is_relative, values, other)
    sizes = units / np.where(slopes > 0.0, slopes, 1.0)
    # A parameter has no influence if its unit change alters predictions by less than their errors.
    deviations = np.abs(found.values) * settings.rtol + settings.atol
    slope = np.where(problem.likelihood.is_log, np.abs(found.values), 1.0)
    # Columns of estimated standard deviations are exact, since they do not depend on simulations.
    is_run = np.any(found.slopes != 0.0, axis=0)
    blur = np.where(is_run, _GROWN * np.linalg.norm(deviations / (found.sigma * slope)), 0.0)
    return Split(sizes, units, _null(rows * sizes, _GROWN * settings.rtol, blur), is_relative)


def _null(rows: Array, relative: float, blur: Array) -> Array:
    """Return an orthonormal null space for columns c with the error ``blur + relative * |c|``."""
    n = rows.shape[1]
    norms = np.linalg.norm(rows, axis=0)
    is_dead = norms <= blur
    found = [np.eye(n)[:, is_dead]]
    live = np.flatnonzero(~is_dead)
    if live.size:
        _, s, vh = np.linalg.svd(rows[:, live] / norms[live], full_matrices=True)
        s = np.concatenate([s, np.zeros(live.size - len(s))])
        # A perturbation changes singular values by at most its norm (Weyl).
        limit = float(np.linalg.norm(relative + blur[live] / norms[live]))
        along = np.zeros((n, int(np.sum(s <= limit))))
        # Reverse the normalisation of the columns.
        along[live] = (vh[s <= limit] / norms[live]).T
        found.append(along)
    basis = np.hstack(found)
    return np.asarray(np.linalg.qr(basis)[0]) if basis.shape[1] else basis


def neighbouring_points(problem: Problem, theta: Array) -> Array:
    """Return nearby points, at which structurally undetermined directions are also undetermined."""
    random = np.random.default_rng(0)
    share = random.uniform(_LEAST_BESIDE, _MOST_BESIDE, (_N_BESIDE, len(theta)))
    share *= random.choice([-1.0, 1.0], share.shape)
    values = problem.scaled.values(theta)
    beside = problem.scaled.scaled(np.where(values == 0.0, share, values * (1.0 + share)))
    return np.clip(beside, problem.scaled.lower, problem.scaled.upper)


def in_words(names: Sequence[str], here: Split, beside: Sequence[Split]) -> tuple[str, ...]:
    """Return one sentence on the undetermined directions of each parameter group."""
    sentences, idle = [], []
    for group in _groups(here.open):
        rows = here.open[group]
        rows = rows[:, np.linalg.norm(rows, axis=0) > _NOTHING]
        basis = _spanned(rows)
        chosen = [names[i] for i in group]
        if basis.shape[1] == len(group):
            idle += chosen
        else:
            sentences.append(_sentence(chosen, group, basis, here, beside))
    if idle:
        they = "it" if len(idle) == 1 else "they"
        sentences.insert(0, f"No measured value depends on {_listed(idle)}, so {they} cannot be "
                    "estimated.")  # fmt: skip
    return tuple(sentences)


def _sentence(
    names: list[str], group: list[int], basis: Array, here: Split, beside: Sequence[Split]
) -> str:
    others = [item for item in beside if item.open.shape[1] >= here.open.shape[1]]
    is_everywhere = bool(beside) and len(others) == len(beside)
    combinations: list[str] = []
    kind = ""
    if is_everywhere and here.is_relative[group].all():
        simple = _simple(_complement(basis))
        if simple is not None and _holds(simple, group, [item.open for item in others]):
            combinations = [_product(names, row) for row in simple]
    if is_everywhere and not combinations:
        simple = _simple(_complement(basis * here.values[group, None]))
        absolute = [item.open * item.values[:, None] for item in others]
        if simple is not None and _holds(simple, group, absolute):
            combinations = [_sum(names, row) for row in simple]
            positive = all(c >= 0 for row in simple for c in row)
            kind = "the sum " if positive and len(simple) == 1 else ""
    if combinations:
        verb = "is" if len(combinations) == 1 else "are"
        number = "one" if basis.shape[1] == 1 else str(basis.shape[1])
        return (
            f"Only {kind}{_listed(combinations)} {verb} determined, not {_listed(names)} "
            f"individually: fix {number} of them to estimate the rest."
        )
    where = "" if is_everywhere else " at these estimates"
    return (
        f"{_listed(names)} are not determined individually{where}: the measured quantities stay "
        f"the same if they change together by {_direction(names, group, basis[:, 0], here)}."
    )


def _holds(simple: list[list[int]], group: list[int], opens: Sequence[Array]) -> bool:
    """Return whether combinations are constant along undetermined directions at nearby points."""
    rows = np.array(simple, dtype=float)
    rows /= np.linalg.norm(rows, axis=1, keepdims=True)
    for item in opens:
        along = item[group]
        lengths = np.linalg.norm(along, axis=0)
        along = along[:, lengths > _NOTHING] / lengths[lengths > _NOTHING]
        if np.any(np.abs(rows @ along) > _DIGITS):
            return False
    return True


def _groups(basis: Array) -> list[list[int]]:
    """Group the parameters that share undetermined directions, by their reduced echelon form."""
    reduced = np.abs(_reduced(basis.T)) > _NOTHING
    groups: list[set[int]] = []
    for row in reduced:
        new = set(np.flatnonzero(row).tolist())
        groups = [g for g in groups if not g & new] + [new.union(*(g for g in groups if g & new))]
    return sorted(sorted(g) for g in groups if g)


def _spanned(columns: Array) -> Array:
    """Return an orthonormal basis of the column space."""
    u, s, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(u[:, s > _NOTHING])


def _complement(columns: Array) -> Array:
    """Return an orthonormal basis of the orthogonal complement of the column space, as rows."""
    u, s, _ = np.linalg.svd(columns / np.linalg.norm(columns, axis=0), full_matrices=True)
    return np.asarray(u[:, int(np.sum(s > _NOTHING)) :].T)


def _reduced(rows: Array) -> Array:
    """Return the reduced row echelon form."""
    a, top = rows.copy(), 0
    for j in range(a.shape[1]):
        if top == len(a):
            break
        pivot = top + int(np.argmax(np.abs(a[top:, j])))
        if abs(a[pivot, j]) <= _NOTHING:
            continue
        a[[top, pivot]] = a[[pivot, top]]
        a[top] /= a[top, j]
        for i in range(len(a)):
            if i != top:
                a[i] -= a[i, j] * a[top]
        top += 1
    return a[:top]


def _simple(rows: Array) -> list[list[int]] | None:
    """Scale rows to small integers; return None if that is not possible."""
    found = []
    for row in _reduced(rows):
        parts = [Fraction(float(x)).limit_denominator(_LARGEST) for x in row]
        near = all(abs(float(p) - x) <= _DIGITS for p, x in zip(parts, row, strict=True))
        common = math.lcm(*(p.denominator for p in parts))
        whole = [int(p * common) for p in parts]
        if not near or max(map(abs, whole)) > _LARGEST:
            return None
        found.append(whole)
    return found


def _product(names: Sequence[str], exponents: Sequence[int]) -> str:
    def power(name: str, exponent: int) -> str:
        return name if exponent == 1 else f"{name}**{exponent}"

    pairs = list(zip(names, exponents, strict=True))
    over = "*".join(power(name, e) for name, e in pairs if e > 0)
    below = [power(name, -e) for name, e in pairs if e < 0]
    if not below:
        return over
    return f"{over}/{below[0]}" if len(below) == 1 else f"{over}/({'*'.join(below)})"


def _sum(names: Sequence[str], coefficients: Sequence[int]) -> str:
    text = ""
    for name, c in zip(names, coefficients, strict=True):
        if c:
            term = name if abs(c) == 1 else f"{abs(c)}*{name}"
            sign = " - " if c < 0 else " + "
            text += f"{sign if text else ''}{term}"
    return text


def _direction(names: Sequence[str], group: list[int], along: Array, here: Split) -> str:
    """Return a text on the changes along a direction, in percent unless the value is zero."""
    along = along / np.abs(along).max() * (1.0 if along[0] >= 0 else -1.0)
    return _listed(
        [
            f"{x:+.3g} %" + f" ({name})" if relative else f"{0.01 * x * unit:+.3g} ({name})"
            for name, x, relative, unit in zip(
                names, along, here.is_relative[group], here.values[group], strict=True
            )
        ]
    )


def _listed(names: Sequence[str]) -> str:
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} and {names[-1]}"


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The uncertainty of estimates on the parameters' scales.

    Attributes
    ----------
    problem, theta : Problem, ndarray of shape (n,)
        The problem and the estimates.
    fisher : ndarray, shape (n, n)
        Fisher information, including the contribution of priors.
    covariance, correlation : ndarray, shape (n, n)
        Undetermined parameters have infinite variances and nan in other entries.
    errors : ndarray, shape (n,)
        Standard errors.
    root : ndarray, shape (n, n_determined)
        Matrix R such that R R^T is the covariance in the determined subspace.
    freedom : float
        Degrees of freedom of Student's t; infinite if the noise is known.
    spread : float
        Correction factor of variances for estimated noise and for robust losses.
    split : Split
        Determined and undetermined directions.
    """

    problem: Problem
    theta: Array
    fisher: Array
    covariance: Array
    correlation: Array
    errors: Array
    root: Array
    freedom: float
    spread: float
    split: Split

    def quantile(self, level: float) -> float:
        """Return half the width of a confidence interval, in standard errors."""
        from scipy import stats

        inside = 0.5 * (1.0 + check_level(level))
        law = stats.norm if math.isinf(self.freedom) else stats.t(self.freedom)
        return float(law.ppf(inside))

    def rise(self, level: float) -> float:
        """Return the rise of twice the objective at the limits of a profile-likelihood interval.

        For known noise this is the quantile of chi-squared with one degree of freedom. If the noise
        is estimated from n values, it is n log(1 + t^2 / freedom) with the quantile t of Student's
        t, which for linear models reproduces the intervals of linear regression.
        """
        squared = self.quantile(level) ** 2
        if math.isinf(self.freedom):
            return squared
        return self.freedom * self.spread * math.log1p(squared / self.freedom)

    def error_along(self, slopes: Array) -> Array:
        """Return standard errors of quantities with the derivatives ``slopes``, (n_quantities, n).

        Errors of quantities that change along an undetermined direction are infinite.
        """
        errors = np.linalg.norm(slopes @ self.root, axis=1)
        if not self.split.open.size:
            return np.asarray(errors)
        scaled = slopes * self.split.sizes
        length = np.linalg.norm(scaled, axis=1)
        # Smaller components count as zero, since sensitivities have about five correct digits.
        is_open = np.linalg.norm(scaled @ self.split.open, axis=1) > 1e-4 * length
        return np.where(is_open, np.inf, errors)


def check_level(level: float) -> float:
    """Return the confidence level; raise an error unless it is between 0 and 1."""
    found = check_number(level, "level")
    if not 0.0 < found < 1.0:
        raise ParameterError(f"level is {found:g}: give a confidence level between 0 and 1")
    return found


def uncertainty_of(
    problem: Problem,
    theta: Array,
    found: Predictions,
    more_rows: Array | None = None,
    factor: float = 1.0,
) -> Uncertainty:
    """Return the uncertainty of estimates ``theta``, shape (n,), on their scales.

    ``more_rows``, shape (n_more, n), are the rows of J due to priors. ``factor``, which depends on
    the robust loss, multiplies variances.
    """
    rows = problem.likelihood.fisher_rows(found)
    if more_rows is not None:
        rows = np.vstack([rows, more_rows])
    parts = split(problem, theta, found, rows)
    freedom, spread = _freedom(problem, found)
    spread *= factor
    root = _root(rows, parts) * math.sqrt(spread)
    covariance = root @ root.T
    is_open = parts.is_open
    errors = np.where(is_open, np.inf, np.sqrt(np.diag(covariance)))
    covariance[is_open, :] = covariance[:, is_open] = np.nan
    covariance[is_open, is_open] = np.inf
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / np.outer(errors, errors)
    np.fill_diagonal(correlation, np.where(is_open, np.nan, 1.0))
    return Uncertainty(
        problem, theta, rows.T @ rows, covariance, correlation, errors, root, freedom, spread, parts
    )


def _root(rows: Array, parts: Split) -> Array:
    """Return R such that R R^T is the inverse information in the determined subspace."""
    n = rows.shape[1]
    basis = np.linalg.qr(np.hstack([parts.open, np.eye(n)]))[0][:, parts.open.shape[1] :]
    scaled = rows * parts.sizes @ basis
    norms = np.linalg.norm(scaled, axis=0)
    norms = np.where(norms > 0.0, norms, 1.0)
    _, s, vh = np.linalg.svd(scaled / norms, full_matrices=False)
    return np.asarray(parts.sizes[:, None] * (basis @ ((vh.T / norms[:, None]) / s)))


def _freedom(problem: Problem, found: Predictions) -> tuple[float, float]:
    """Return degrees of freedom, and the correction factor of variances for estimated noise."""
    acts_on_noise = np.any(found.sigma_slopes != 0.0, axis=0)
    acts_on_values = np.any(found.slopes != 0.0, axis=0)
    if not acts_on_noise.any():
        return math.inf, 1.0
    n = int(np.sum(np.any(found.sigma_slopes != 0.0, axis=1)))
    freedom = n - int(np.sum(acts_on_values))
    if freedom < 1:
        # no degrees of freedom remain for estimating the noise
        return 1.0, float(n)
    return float(freedom), n / freedom


def robust_factor(residuals: Array, loss: str, f_scale: float, n_estimated: int) -> float:
    """Return an M-estimator's variance factor, mean(psi^2) / mean(psi')^2 (Huber 1981)."""
    z = (residuals / f_scale) ** 2
    size = np.sqrt(np.maximum(z, 1e-300))
    weight, slope = {
        "soft_l1": ((1 + z) ** -0.5, (1 + z) ** -1.5),
        "huber": (np.minimum(1.0, 1.0 / size), np.where(z <= 1.0, 1.0, 0.0)),
        "cauchy": (1 / (1 + z), (1 - z) / (1 + z) ** 2),
        "arctan": (1 / (1 + z**2), (1 - 3 * z**2) / (1 + z**2) ** 2),
    }[loss]
    n = len(z)
    squares = float(np.sum((weight * residuals) ** 2)) / max(n - n_estimated, 1)
    return squares / float(np.mean(slope)) ** 2


# An estimate is at a bound if their distance, relative to the range or the value, is smaller.
_AT_BOUND = 1e-6

# Starts reached the same optimum if objectives differ by less. One standard error adds 0.5.
SAME_OPTIMUM = 0.005

# If a tail probability of chi-squared is below this, the model or the noise is wrong.
_IMPROBABLE = 1e-3

# An interval on a logarithmic scale is uninformative if the ratio of its limits is larger.
_WIDE = 1e3


def at_bounds(problem: Problem, theta: Array) -> dict[str, str]:
    """Return "lower" or "upper" for each parameter at a bound, by name."""
    found, scaled = {}, problem.scaled
    for name, x, low, high in zip(scaled.names, theta, scaled.lower, scaled.upper, strict=True):
        near = _AT_BOUND * (high - low if math.isfinite(high - low) else max(1.0, abs(x)))
        if x - low <= near or high - x <= near:
            found[name] = "lower" if x - low <= near else "upper"
    return found


def of_optimiser(starts: Sequence[StartRecord]) -> tuple[str, ...]:
    """Report lack of convergence, failed starts, and an optimum that only one start reached."""
    best, sentences = starts[0], []
    if not math.isfinite(best.objective):
        return (f"No start succeeded: {best.message}.",)
    if not best.is_converged:
        sentences.append(f"The optimiser did not converge: {best.message}.")
    n_same = sum(row.objective - best.objective <= SAME_OPTIMUM for row in starts)
    if len(starts) > 1 and n_same == 1:
        sentences.append(
            f"Only one of {len(starts)} starts reached the best objective, so there may be a "
            "better optimum: increase the number of starts."
        )
    failed = sum(not math.isfinite(row.objective) for row in starts)
    if failed:
        sentences.append(
            f"{failed} of {len(starts)} starts failed; starts_table() gives the reasons."
        )
    return tuple(sentences)


def of_bounds(problem: Problem, sides: Mapping[str, str]) -> tuple[str, ...]:
    """Report estimates at a bound."""
    sentences = []
    for row in problem.estimated:
        side = sides.get(row.name)
        if side == "lower" and row.name in problem.measured.noise:
            sentences.append(
                f"'{row.name}' is at its lower bound {row.lower:g}: the model reproduces the data "
                "almost exactly, so the noise cannot be estimated and the intervals are "
                "meaningless; specify the noise."
            )
        elif side:
            value = row.lower if side == "lower" else row.upper
            sentences.append(
                f"'{row.name}' is at its {side} bound {value:g}: its standard error ignores the "
                f"bound; profile('{row.name}') gives the interval that the data allow."
            )
    return tuple(sentences)


def of_directions(found: Uncertainty, more_rows: Array | None = None) -> tuple[str, ...]:
    """Report undetermined directions; ``more_rows`` of priors are assumed constant nearby."""
    if not found.split.open.shape[1]:
        return ()
    problem = found.problem
    points = neighbouring_points(problem, found.theta)
    beside = []
    for point, there in zip(points, problem.predict(points), strict=True):
        if there.message:
            continue
        rows = problem.likelihood.fisher_rows(there)
        if more_rows is not None:
            rows = np.vstack([rows, more_rows])
        if np.all(np.isfinite(rows)):
            beside.append(split(problem, point, there, rows))
    return in_words(problem.scaled.names, found.split, beside)


def of_widths(found: Uncertainty) -> tuple[str, ...]:
    """Report intervals that are too wide to be informative."""
    sentences, scaled = [], found.problem.scaled
    reach = found.quantile(0.95) * found.errors
    for i, row in enumerate(found.problem.estimated):
        if not math.isfinite(reach[i]):
            continue
        x = found.theta[i]
        if x - reach[i] < scaled.lower[i] and x + reach[i] > scaled.upper[i]:
            sentences.append(
                f"The data hardly determine '{row.name}': its 95 % interval is wider than its "
                f"bounds {row.lower:g} and {row.upper:g}."
            )
        elif row.scale != "lin":
            ratio = 2.0 * reach[i] * LOGARITHMS[row.scale]
            if ratio > math.log(_WIDE):
                sentences.append(
                    f"The data hardly determine '{row.name}': the ends of its 95 % interval differ "
                    f"by a factor of {math.exp(min(ratio, 700.0)):.1g}."
                )
    return tuple(sentences)


def of_agreement(
    problem: Problem, found: Predictions, freedom: int, search: Search | None = None
) -> tuple[str, ...]:
    """Report residuals that contradict the known noise; robust losses allow for outliers."""
    is_given = not any(isinstance(v, str) for v in problem.measured.noise)
    is_robust = search is not None and search.loss != "linear"
    if is_robust or not is_given or not problem.likelihood.is_normal.all() or freedom < 1:
        return ()
    from scipy import stats

    chi2 = problem.likelihood.chi2(found)
    statistic = f"chi-squared is {chi2:.4g} at {freedom} degrees of freedom"
    if stats.chi2.sf(chi2, freedom) < _IMPROBABLE:
        return (
            f"The residuals are larger than the given noise explains ({statistic}): the model does "
            "not fit the data, or the noise is underestimated, and the intervals are too narrow.",
        )
    if stats.chi2.cdf(chi2, freedom) < _IMPROBABLE:
        return (
            f"The residuals are smaller than the given noise explains ({statistic}): the noise is "
            "overestimated, and the intervals are too wide.",
        )
    return ()
