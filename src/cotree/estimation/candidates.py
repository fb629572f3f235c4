"""The next measurements: which outputs and times shrink the intervals most.

In: the information of present measurements, and rows of information of candidates, each by exact
sensitivities at the estimates. Out: the chosen ones in the order in which they help, with the
standard errors after each. A set is chosen greedily and then improved by exchanges of one at a time
(Fedorov 1972), since the best first one need not belong to the best pair.

Where the present information is singular, candidates that make something determined come first: a
choice is compared by the number of directions that it determines, then by its criterion there.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError, nearest
from cotree.estimation import bands
from cotree.estimation.conditions import spread
from cotree.scene.given import check_mapping, check_whole
from cotree.scene.replaced import expressions_among

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.estimation.problem import Problem
    from cotree.estimation.uncertainty import Uncertainty

Array = npt.NDArray[np.float64]

#: Criteria: the determinant of the covariance, the mean of relative variances, the largest variance
#: of any direction. The name of a parameter is a criterion, too: its own variance.
CRITERIA = ("D", "A", "E")

# Passes of exchanges at most; two or three are usual.
_MOST_PASSES = 20

# Eigenvalues below this share of the largest one are none: squares of errors of sensitivities.
_SHARE = 1e-11


@dataclass(frozen=True)
class Candidates:
    """Measurements that could be made.

    Attributes
    ----------
    output : str
        A state or output of the model, or a column of the data.
    t : array_like, shape (n,)
        Times, [s].
    noise : float, str or None
        Standard deviation of the noise in SI: a number, a state or output, or None for that of the
        values of this quantity that were measured.
    experiment : int or str
        The experiment that is repeated, by its number (from zero) or name.
    parameters, initial, inputs : mapping
        Changes to this experiment. Values are numbers, or names of estimated parameters; inputs are
        numbers or (times, values).
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
    """One of the measurements that are proposed.

    Attributes
    ----------
    output, experiment : str
        What to measure, and in which experiment.
    t : float
        When, [s].
    noise : float
        Standard deviation that was reckoned with.
    errors : mapping of str to float
        Standard errors of the parameters, in their units, once this one and those before it are
        made.
    shrinks : float
        The mean factor (D: of the geometric mean) by which it makes standard errors smaller; nan
        where it makes something determined first.
    determines : tuple of str
        Parameters that are determined from here on.
    """

    output: str
    experiment: str
    t: float
    noise: float
    errors: Mapping[str, float]
    shrinks: float
    determines: tuple[str, ...]


class NextMeasurements(tuple[NextMeasurement, ...]):
    """Measurements that are proposed, in the order in which they help."""

    def __str__(self) -> str:
        """Write them as a table."""
        from cotree.estimation.report import columns

        names = list(self[0].errors) if self else []
        head = ["output", "experiment", "t [s]", *(f"error of {name}" for name in names), ""]
        rows = [
            [
                row.output,
                row.experiment,
                f"{row.t:.6g}",
                *(f"{row.errors[name]:.3g}" for name in names),
                f"determines {', '.join(row.determines)}" if row.determines else "",
            ]
            for row in self
        ]
        return "\n".join(columns(head, rows, (0, 1, len(head) - 1)))

    __repr__ = __str__

    def _repr_html_(self) -> str:
        from cotree import markup

        names = list(self[0].errors) if self else []
        head = ["output", "experiment", "t [s]", *(f"error of {name}" for name in names)]
        rows = [[r.output, r.experiment, r.t, *(r.errors[name] for name in names)] for r in self]
        return markup.block("Next measurements", markup.table("", head, rows, n_rows=len(rows)))

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row for each."""
        from cotree.estimation.report import frame

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
    """Read candidates in any of the forms that users write.

    Raises
    ------
    ParameterError
        If they are no mapping and no sequence of ``Candidates``.
    """
    if isinstance(given, Candidates):
        return [given]
    if isinstance(given, Mapping):
        found = []
        for output, own in given.items():
            if isinstance(own, Mapping):
                wrong = {str(name) for name in own} - {row.name for row in fields(Candidates)[1:]}
                if wrong or "t" not in own:
                    told = f"have the field '{min(wrong)}'" if wrong else "have no times 't'"
                    raise ParameterError(f"candidates of '{output}' {told}: give fields of "
                                         "cotree.Candidates")  # fmt: skip
                found.append(Candidates(str(output), **own))
            elif isinstance(own, tuple) and len(own) == 2 and np.ndim(own[0]) == 1:
                found.append(Candidates(str(output), own[0], own[1]))
            else:
                found.append(Candidates(str(output), own))
        return found
    try:
        listed = list(given)
    except TypeError:
        listed = [None]
    if not all(isinstance(row, Candidates) for row in listed):
        raise ParameterError(
            "candidates are a mapping of outputs to times, to (times, noise) or to the fields of "
            "Candidates, or a list of Candidates"
        )
    return listed


def choose(
    problem: Problem,
    theta: Array,
    found: Uncertainty,
    given: Any,
    n: int,
    *,
    criterion: str = "D",
    repeat: bool = True,
) -> NextMeasurements:
    """Choose measurements; see :meth:`FitResult.next_measurements`."""
    names = problem.scaled.names
    if criterion not in CRITERIA and criterion not in names:
        listed = ", ".join(CRITERIA)
        raise ParameterError(
            f"the criterion '{criterion}' is none of {listed}, and no estimated parameter"
            f"{nearest(criterion, (*CRITERIA, *names))}"
        )
    n = check_whole(n, "n", 1)
    rows, labels = _rows(problem, theta, read_candidates(given), found)
    if not repeat and n > len(labels):
        raise ParameterError(
            f"{n} measurements cannot be chosen from {len(labels)} candidates with repeat=False"
        )
    # Sizes are signed; squares do not know it.
    present = np.outer(found.split.sizes, found.split.sizes) * found.fisher
    weigh = _Weigh(present, found.split.open.shape[1], criterion, names)
    chosen = _improved(_greedy(rows, n, weigh, repeat, []), rows, weigh, repeat)
    # Those of the improved set that help most come first.
    order = _greedy(rows, n, weigh, False, [], among=chosen)
    return _told(problem, theta, found, rows, labels, order, weigh)


class _Weigh:
    """Rates information by a criterion; larger is better, compared as tuples."""

    def __init__(self, present: Array, n_open: int, criterion: str, names: Sequence[str]) -> None:
        self.present, self._criterion = present, criterion
        self.index = names.index(criterion) if criterion in names else -1
        s, v = np.linalg.eigh(present)
        # Directions that are not determined have no information, not that of rounding.
        s[:n_open] = 0.0
        self.present = (v * s) @ v.T

    def inverse(self, added: Array) -> tuple[Array, Array, int]:
        """Give the inverse along what is determined, the open directions, and their number."""
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
        """Give that of the information along what is determined."""
        s = np.linalg.eigvalsh(self.present + added)[self.inverse(added)[2] :]
        return float(np.sum(np.log(s))) if s.size and s[0] > 0.0 else -math.inf


def _rows(
    problem: Problem, theta: Array, given: Sequence[Candidates], found: Uncertainty
) -> tuple[list[Array], list[tuple[str, str, float, float]]]:
    """Give rows of information of all candidates, in units of the estimates, and their names."""
    rows: list[Array] = []
    labels: list[tuple[str, str, float, float]] = []
    for item in given:
        number = bands.find_condition(problem, item.experiment)
        base = problem.conditions[number]
        for name in expressions_among(check_mapping(item.inputs, "inputs of candidates")):
            raise ParameterError(
                f"input '{name}' of candidates is an expression, which needs a model of its own: "
                "give a number or (times, values)"
            )
        own = replace(
            base,
            name=item.label or base.name,
            parameters={**base.parameters, **item.parameters},
            initial={**base.initial, **item.initial},
            inputs={**base.inputs, **item.inputs} if item.inputs else base.inputs,
        )
        quantity = own.quantity(item.output)
        like = bands.measured_like(problem, number, quantity)
        noise = bands.noise_like(problem, quantity, like) if item.noise is None else item.noise
        kind = "lin"
        if like is not None:
            kind = spread(problem.measured.transformation, len(problem.measured))[like]
        t = bands.read_times(item.t, own)
        at = bands.at_times(problem, own, quantity, t, noise, kind)
        (there,) = at.predict([theta])
        if there.message:
            raise ParameterError(f"'{item.output}' cannot be predicted: {there.message}")
        information = at.likelihood.fisher_rows(there) * found.split.sizes
        for i in range(len(t)):
            # A value and, where its deviation is estimated, what it tells about that.
            rows.append(information[[i, i + len(t)]])
            labels.append((item.output, own.name, float(t[i]), float(there.sigma[i])))
    if not rows:
        raise ParameterError("there are no candidates to choose from")
    return rows, labels


def _greedy(
    rows: Sequence[Array],
    n: int,
    weigh: _Weigh,
    repeat: bool,
    taken: list[int],
    among: Sequence[int] | None = None,
) -> list[int]:
    """Take one after the other, each time the one that helps most."""
    left = list(range(len(rows))) if among is None else list(among)
    chosen = list(taken)
    added = sum((rows[i].T @ rows[i] for i in chosen), np.zeros_like(weigh.present))
    while len(chosen) < n:
        best = max(dict.fromkeys(left), key=lambda i: weigh(added + rows[i].T @ rows[i]))
        chosen.append(best)
        added = added + rows[best].T @ rows[best]
        if not repeat:
            left.remove(best)
    return chosen


def _improved(chosen: list[int], rows: Sequence[Array], weigh: _Weigh, repeat: bool) -> list[int]:
    """Exchange one at a time for a better one, as long as that helps."""
    chosen = list(chosen)
    for _ in range(_MOST_PASSES):
        has_changed = False
        for k in range(len(chosen)):
            others = chosen[:k] + chosen[k + 1 :]
            free = [i for i in range(len(rows)) if repeat or i not in others]
            added = sum((rows[i].T @ rows[i] for i in others), np.zeros_like(weigh.present))
            now = weigh(added + rows[chosen[k]].T @ rows[chosen[k]])
            best = max(free, key=lambda i: weigh(added + rows[i].T @ rows[i]))
            value = weigh(added + rows[best].T @ rows[best])
            # Equal ones, up to rounding, are not exchanged for ever.
            if value[0] > now[0] or value[1] > now[1] + 1e-9 * abs(now[1]):
                chosen[k], has_changed = best, True
        if not has_changed:
            break
    return chosen


def _told(
    problem: Problem,
    theta: Array,
    found: Uncertainty,
    rows: Sequence[Array],
    labels: Sequence[tuple[str, str, float, float]],
    order: Sequence[int],
    weigh: _Weigh,
) -> NextMeasurements:
    """Say what each one brings, after those before it."""
    names = problem.scaled.names
    # The noise that was estimated keeps its factor.
    scale = np.abs(found.split.sizes) * problem.scaled.slopes(theta) * math.sqrt(found.spread)
    added = np.zeros_like(weigh.present)
    before, is_open = _errors(weigh, added)
    told = []
    for i in order:
        added = added + rows[i].T @ rows[i]
        errors, now_open = _errors(weigh, added)
        in_units = np.where(now_open, np.inf, errors * scale)
        output, experiment, t, noise = labels[i]
        with np.errstate(invalid="ignore"):
            ratio = errors / before
        shrinks = math.nan
        if not is_open.any():
            shrinks = float(np.exp(np.mean(np.log(ratio))))
        opened = [name for name, a, b in zip(names, is_open, now_open, strict=True) if a and not b]
        told.append(
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
    return NextMeasurements(told)


def _errors(weigh: _Weigh, added: Array) -> tuple[Array, npt.NDArray[np.bool_]]:
    """Give standard errors in units of the estimates, and who has none yet."""
    inverse, opened, _ = weigh.inverse(added)
    is_open = np.any(np.abs(opened) > 1e-4 * np.max(np.abs(opened), initial=1e-300), axis=1)
    return np.sqrt(np.diag(inverse)), np.asarray(is_open)
