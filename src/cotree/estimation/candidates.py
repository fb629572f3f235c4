"""Optimal experimental design: choice of further measurements that reduce the intervals most.

The choice is based on the Fisher information of the existing measurements and of each candidate,
from exact sensitivities at the estimates. Candidates are first chosen greedily. Since the best
single measurement need not belong to the best pair, the set is then improved by exchanging one
element at a time (Fedorov 1972). The result lists the chosen candidates in order of benefit, with
the standard errors after each.

If the existing information is singular, sets are compared by the number of directions that remain
undetermined, and only then by the criterion, evaluated in the determined subspace.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.arguments import check_mapping, check_whole
from cotree.errors import ParameterError, nearest
from cotree.estimation import bands
from cotree.report import Report, Reported, Table, frame
from cotree.scene.variants import expressions_among

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.estimation.estimated import Array
    from cotree.estimation.uncertainty import Uncertainty

#: D: determinant of the covariance; A: mean relative variance; E: largest variance along any
#: direction. A parameter's name selects its variance as the criterion.
CRITERIA = ("D", "A", "E")

# Maximum number of exchange passes; two or three usually suffice.
_MOST_PASSES = 20

# Relative eigenvalues below this, the squared relative error of sensitivities, count as zero.
_SHARE = 1e-11


@dataclass(frozen=True)
class Candidates:
    """Possible measurements of one quantity in one experiment.

    Attributes
    ----------
    output : str
        A state or output of the model, or a column of the data.
    t : array_like, shape (n,)
        Times, [s].
    noise : float, str or None
        Standard deviation of the noise in SI units: a number, a state or output, or None for the
        noise of previous measurements of this quantity.
    experiment : int or str
        The experiment to repeat, by its index (from zero) or name.
    parameters, initial, inputs : mapping
        Changes to this experiment: numbers or names of estimated parameters; for inputs, numbers or
        (times, values).
    label : str
        Name of the changed experiment.
    """

    output: str
    t: Any
    noise: float | str | None = None
    experiment: int | str = 0
    parameters: Mapping[str, str | float] = field(default_factory=dict)
    initial: Mapping[str, str | float] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    label: str = ""


@dataclass(frozen=True, eq=False)
class NextMeasurement:
    """One proposed measurement.

    Attributes
    ----------
    output, experiment : str
        The quantity to measure, and the experiment.
    t : float
        Time, [s].
    noise : float
        Assumed standard deviation of the noise.
    errors : mapping of str to float
        Standard errors of the parameters, in their units, after this and all previous measurements.
    shrinks : float
        Ratio of standard errors after this measurement to those before it, as a geometric mean;
        nan if some parameters were undetermined before.
    determines : tuple of str
        Parameters that become determined by this measurement.
    """

    output: str
    experiment: str
    t: float
    noise: float
    errors: Mapping[str, float]
    shrinks: float
    determines: tuple[str, ...]


class NextMeasurements(Reported, tuple[NextMeasurement, ...]):
    """Proposed measurements, in order of benefit."""

    def report(self) -> Report:
        """Return a report with a table of the measurements."""
        names = list(self[0].errors) if self else []
        head = ("output", "experiment", "t [s]", *(f"error of {name}" for name in names), "")
        rows = [
            (
                *(row.output, row.experiment, f"{row.t:.6g}"),
                *(f"{row.errors[name]:.3g}" for name in names),
                f"determines {', '.join(row.determines)}" if row.determines else "",
            )
            for row in self
        ]
        return Report("Next measurements", Table(head, rows, align=f"ll{'r' * (len(names) + 1)}l"))

    def __repr__(self) -> str:
        return self.summary()

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with one row per measurement."""
        return frame(
            [
                {
                    "output": row.output, "experiment": row.experiment, "t": row.t,
                    "noise": row.noise, "shrinks": row.shrinks,
                    **{f"error of {name}": value for name, value in row.errors.items()},
                }
                for row in self
            ]
        )  # fmt: skip


def read_candidates(given: Any) -> list[Candidates]:
    """Convert candidates in any accepted form to a list."""
    if isinstance(given, Candidates):
        return [given]
    if isinstance(given, Mapping):
        found = []
        for output, entry in given.items():
            if isinstance(entry, Mapping):
                wrong = {str(name) for name in entry} - {row.name for row in fields(Candidates)[1:]}
                if wrong or "t" not in entry:
                    fault = f"have the field '{min(wrong)}'" if wrong else "have no times 't'"
                    raise ParameterError(f"candidates of '{output}' {fault}: give fields of "
                                         "cotree.Candidates")  # fmt: skip
                found.append(Candidates(str(output), **entry))
            elif isinstance(entry, tuple) and len(entry) == 2 and np.ndim(entry[0]) == 1:
                found.append(Candidates(str(output), entry[0], entry[1]))
            else:
                found.append(Candidates(str(output), entry))
        return found
    try:
        listed = list(given)
    except TypeError:
        listed = [None]  # not a list: the check below raises an error
    if not all(isinstance(row, Candidates) for row in listed):
        raise ParameterError(
            "candidates must be a mapping of outputs to times, to (times, noise) or to the fields "
            "of Candidates, or a list of Candidates"
        )
    return listed


def choose(
    found: Uncertainty, given: Any, n: int, *, criterion: str = "D", repeat: bool = True
) -> NextMeasurements:
    """Choose further measurements; see :meth:`FitResult.next_measurements`."""
    names = found.problem.scaled.names
    if criterion not in CRITERIA and criterion not in names:
        listed = ", ".join(CRITERIA)
        raise ParameterError(
            f"the criterion '{criterion}' is none of {listed}, nor an estimated parameter"
            f"{nearest(criterion, (*CRITERIA, *names))}"
        )
    n = check_whole(n, "n", 1)
    rows, labels = _rows(found, read_candidates(given))
    if not repeat and n > len(labels):
        raise ParameterError(
            f"{n} measurements cannot be chosen from {len(labels)} candidates with repeat=False"
        )
    # Negative parameters have negative sizes, whose signs cancel in the standard errors.
    present = np.outer(found.split.sizes, found.split.sizes) * found.fisher
    rating = _Rating(present, found.split.open.shape[1], criterion, names)
    chosen = _improved(_greedy(rows, n, rating, range(len(rows)), repeat), rows, rating, repeat)
    # Sort the final set by benefit.
    return _described(found, rows, labels, _greedy(rows, n, rating, chosen, False), rating)


class _Rating:
    """Rates additional information by a criterion. Ratings are tuples; a larger one is better."""

    def __init__(self, present: Array, n_open: int, criterion: str, names: Sequence[str]) -> None:
        self.present, self._criterion = present, criterion
        self.index = names.index(criterion) if criterion in names else -1
        s, v = np.linalg.eigh(present)
        # Undetermined directions carry no information; their eigenvalues are rounding errors.
        s[:n_open] = 0.0
        self.present = (v * s) @ v.T

    def inverse(self, added: Array) -> tuple[Array, Array, int]:
        """Return the inverse information matrix, the undetermined directions, and their number."""
        whole = self.present + added
        norms = np.sqrt(np.where(np.diag(whole) > 0.0, np.diag(whole), 1.0))
        s, v = np.linalg.eigh(whole / np.outer(norms, norms))
        is_open = s <= _SHARE
        inverse = (v[:, ~is_open] / s[~is_open]) @ v[:, ~is_open].T / np.outer(norms, norms)
        return inverse, v[:, is_open] / norms[:, None], int(np.sum(is_open))

    def __call__(self, added: Array) -> tuple[float, float]:
        inverse, opened, n_open = self.inverse(added)
        if self.index >= 0:
            is_open = bool(np.any(np.abs(opened[self.index]) > 1e-6)) if n_open else False
            if is_open:
                return -float(n_open) - 1.0, self._log_determinant(added)
            return 0.0, -float(inverse[self.index, self.index])
        if self._criterion == "D":
            return -float(n_open), self._log_determinant(added)
        if self._criterion == "A":
            return -float(n_open), -float(np.trace(inverse))
        return -float(n_open), -float(np.linalg.eigvalsh(inverse)[-1])

    def _log_determinant(self, added: Array) -> float:
        """Return the log-determinant of the information in the determined subspace."""
        s = np.linalg.eigvalsh(self.present + added)[self.inverse(added)[2] :]
        return float(np.sum(np.log(s))) if s.size and s[0] > 0.0 else -math.inf


def _rows(
    found: Uncertainty, given: Sequence[Candidates]
) -> tuple[list[Array], list[tuple[str, str, float, float]]]:
    """Return each candidate's information rows, in relative units, and its label."""
    problem = found.problem
    rows: list[Array] = []
    labels: list[tuple[str, str, float, float]] = []
    for item in given:
        number = bands.find_condition(problem, item.experiment)
        base = problem.conditions[number]
        for name in expressions_among(check_mapping(item.inputs, "inputs of candidates")):
            raise ParameterError(
                f"input '{name}' of candidates is an expression, which is not supported: give "
                "a number or (times, values)"
            )
        run = replace(
            base,
            name=item.label or base.name,
            parameters={**base.parameters, **item.parameters},
            initial={**base.initial, **item.initial},
            inputs={**base.inputs, **item.inputs} if item.inputs else base.inputs,
        )
        quantity = run.quantity(item.output)
        noise, kind = bands.like_measured(problem, number, quantity, item.noise)
        t = bands.read_times(item.t, run)
        at, there = bands.predicted_at(found, run, item.output, t, noise, kind)
        information = at.likelihood.fisher_rows(there) * found.split.sizes
        for i in range(len(t)):
            # Rows of the value and, if it is estimated, of its standard deviation.
            rows.append(information[[i, i + len(t)]])
            labels.append((item.output, run.name, float(t[i]), float(there.sigma[i])))
    if not rows:
        raise ParameterError("there are no candidates to choose from")
    return rows, labels


def _greedy(
    rows: Sequence[Array], n: int, rating: _Rating, among: Sequence[int], repeat: bool
) -> list[int]:
    """Choose candidates one at a time, always the one with the best rating."""
    left, chosen = list(among), list[int]()
    added = np.zeros_like(rating.present)
    while len(chosen) < n:
        best = max(dict.fromkeys(left), key=lambda i: rating(added + rows[i].T @ rows[i]))
        chosen.append(best)
        added = added + rows[best].T @ rows[best]
        if not repeat:
            left.remove(best)
    return chosen


def _improved(chosen: list[int], rows: Sequence[Array], rating: _Rating, repeat: bool) -> list[int]:
    """Replace one candidate at a time by a better one until no replacement improves the set."""
    chosen = list(chosen)
    for _ in range(_MOST_PASSES):
        has_changed = False
        for k in range(len(chosen)):
            others = chosen[:k] + chosen[k + 1 :]
            free = [i for i in range(len(rows)) if repeat or i not in others]
            added = sum((rows[i].T @ rows[i] for i in others), np.zeros_like(rating.present))
            now = rating(added + rows[chosen[k]].T @ rows[chosen[k]])
            best = max(free, key=lambda i: rating(added + rows[i].T @ rows[i]))
            value = rating(added + rows[best].T @ rows[best])
            # Without the margin, candidates equal up to rounding would be exchanged endlessly.
            if value[0] > now[0] or value[1] > now[1] + 1e-9 * abs(now[1]):
                chosen[k], has_changed = best, True
        if not has_changed:
            break
    return chosen


def _described(
    found: Uncertainty,
    rows: Sequence[Array],
    labels: Sequence[tuple[str, str, float, float]],
    order: Sequence[int],
    rating: _Rating,
) -> NextMeasurements:
    """Describe the chosen measurements in order, each with the errors that remain after it."""
    scaled = found.problem.scaled
    names = scaled.names
    # If the noise was estimated, variances include the small-sample correction.
    scale = np.abs(found.split.sizes) * scaled.slopes(found.theta) * math.sqrt(found.spread)
    added = np.zeros_like(rating.present)
    before, is_open = _errors(rating, added)
    described = []
    for i in order:
        added = added + rows[i].T @ rows[i]
        errors, now_open = _errors(rating, added)
        in_units = np.where(now_open, np.inf, errors * scale)
        output, experiment, t, noise = labels[i]
        with np.errstate(invalid="ignore"):
            ratio = errors / before
        shrinks = math.nan
        if not is_open.any():
            shrinks = float(np.exp(np.mean(np.log(ratio))))
        opened = [name for name, a, b in zip(names, is_open, now_open, strict=True) if a and not b]
        described.append(
            NextMeasurement(
                output,
                experiment,
                t,
                noise,
                dict(zip(names, in_units.tolist(), strict=True)),
                shrinks,
                tuple(opened),
            )
        )
        before, is_open = errors, now_open
    return NextMeasurements(described)


def _errors(rating: _Rating, added: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Return relative standard errors, and whether each parameter remains undetermined."""
    inverse, opened, _ = rating.inverse(added)
    is_open = np.any(np.abs(opened) > 1e-4 * np.max(np.abs(opened), initial=1e-300), axis=1)
    return np.sqrt(np.diag(inverse)), np.asarray(is_open)
