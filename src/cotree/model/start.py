"""The consistent start: initial states and sensitivities that satisfy every constraint.

What the user gave is kept, and the rest follows by Gauss-Newton steps of least length. Where that
cannot be but the given values are nearly consistent, everything moves a little, with a warning;
else the start is refused with the residual of each joint.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from cotree.model.model import CompiledModel

Array = npt.NDArray[np.float64]

_LARGEST_ITERATIONS = 50

#: Residuals below this share of the states' size are met.
_MET = 1e-11

#: Those below this are nothing but rounding.
_ROUNDING = 1e-15

#: Given values whose residual is below this share of their size are meant to be nearly consistent.
_NEARLY = 0.05

#: Given values that change by more than this are worth a word.
_NOTICED = 1e-4

#: How far, and how often, to look aside where constraints have no gradient.
_ASIDE, _TRIES = 0.1, 4

#: Singular values below this share of the largest are redundant constraints.
_RANK = 1e-10


@dataclass(frozen=True)
class Start:
    """A consistent start.

    Attributes
    ----------
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        Initial states and their sensitivities.
    is_chosen : bool
        Whether something moved that neither the constraints nor what was given fix: the least move
        was chosen, and ``s`` does not know how that choice depends on the parameters.
    """

    y: Array
    s: Array
    is_chosen: bool = False


def consistent_start(
    model: CompiledModel,
    t: float,
    p: Array,
    y: Array,
    s: Array,
    kept: Collection[int],
    *,
    is_initial: bool = True,
) -> Start:
    """Move initial states and sensitivities onto the constraints.

    Parameters
    ----------
    model : CompiledModel
        The model.
    t : float
        Start time, [s].
    p : ndarray, shape (n_parameters,)
        Parameters.
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        Initial states and sensitivities as given.
    kept : collection of int
        The states that the user gave.
    is_initial : bool
        Whether initial values of what is no state are to hold, too; later on they do not.

    Raises
    ------
    ParameterError
        If the given values violate a constraint that nothing else can mend.
    """
    if not model.layout.constraints and not model.layout.start_rows:
        return Start(y, s)
    finder = _Finder(model, t, p, frozenset(kept), is_initial)
    given = y
    y = finder.normalised(y)
    y = finder.settle(y, 0)
    y = finder.settle(y, 1)
    if model.sensitivities:
        s = finder.sensitivities(y, s)
    return Start(y, s, finder.is_chosen(given, y))


def start_by_differences(
    model: CompiledModel, t: float, p: Array, initial: Mapping[str, float], start: Start
) -> Array:
    """Differentiate a start that was chosen as the least move, shape (n_states, n_parameters).

    The choice depends on the parameters through the constraints' gradients, whose derivatives no
    kernel has: five points give it to ten digits.
    """
    s = start.s.copy()
    for j, name in enumerate(model.sensitivities):
        if name in model.states:
            size = max(1.0, abs(start.y[model.states.index(name)]))
        else:
            size = max(abs(p[model.parameters.index(name)]), 1e-3)
        step, total = 1e-3 * size, np.zeros(len(model.states))
        for place, weight in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):
            moved, given = p.copy(), dict(initial)
            if name in model.states:
                own = start.y[model.states.index(name)]
                given[name] = float(own + place * step)
            else:
                moved[model.parameters.index(name)] += place * step
            total += weight * model.start(t, moved, given, _is_probe=True).y
        s[:, j] = total / (12.0 * step)
    return np.where(model.sensitivity_pattern, s, 0.0)  # of what does not depend, rounding is left


class _Finder:
    """The residuals of one start, at the levels of position (0) and velocity (1)."""

    def __init__(
        self, model: CompiledModel, t: float, p: Array, kept: frozenset[int], is_initial: bool
    ) -> None:
        layout = model.layout
        self.model, self.t, self.p, self.kept = model, t, p, kept
        self.n_coordinates = layout.n_coordinates
        self.n_speeds = layout.n_speeds
        #: Places of the states of each level.
        self.own = (
            slice(0, self.n_coordinates),
            slice(self.n_coordinates, self.n_coordinates + self.n_speeds),
        )
        self.n_rows = len(layout.constraint_edges)
        self.n_norms = len(layout.quaternions)
        names = [row.name for row in layout.constraints]
        self.n_values = len(names) - self.n_rows - self.n_norms
        rates = names[self.n_values : self.n_values + self.n_rows]
        self.with_value = list(layout.value_rows)
        is_rate = layout.start_is_rate if is_initial else ()
        self.conditions = [
            [i for i, rate in enumerate(is_rate) if rate == bool(level)] for level in (0, 1)
        ]
        self.names = [
            [*names[: self.n_values], *(layout.start_rows[i] for i in self.conditions[0])],
            [*rates, *(layout.start_rows[i] for i in self.conditions[1])],
        ]
        self.columns = [self._free(level) for level in (0, 1)]

    def _free(self, level: int) -> list[int]:
        """List the directions of motion that nothing given fixes."""
        if level == 1:
            states = range(self.own[1].start, self.own[1].stop)
            return [i for i, state in enumerate(states) if state not in self.kept]
        return [i for i, group in enumerate(self.groups()) if not self.kept.intersection(group)]

    def groups(self) -> list[tuple[int, ...]]:
        """List the coordinates that each speed moves."""
        found: list[tuple[int, ...]] = []
        state = 0
        while state < self.n_coordinates:
            if state in self.model.layout.quaternions:
                found += [tuple(range(state, state + 4))] * 3
                state += 4
            else:
                found.append((state,))
                state += 1
        return found

    def _places(self, level: int) -> slice:
        """Say where the constraints of a level stand among the results of their kernel."""
        if level == 0:
            return slice(0, self.n_values)
        return slice(self.n_values, self.n_values + self.n_rows)

    def _call(self, name: str, y: Array, s: Array | None = None) -> Array:
        kernel = self.model.bound(name, self.p)
        along = np.zeros(0) if s is None else np.ascontiguousarray(s.T).ravel()
        return kernel(self.t, y, along, None).copy()

    def residual(self, y: Array, level: int) -> Array:
        """Evaluate what is to be zero at a level."""
        held = self._call("constraints", y) if self.model.layout.constraints else np.zeros(0)
        own = held[self._places(level)]
        start = self._call("start", y) if self.model.layout.start_rows else np.zeros(0)
        return np.concatenate([own, start[self.conditions[level]]])

    def gradient(self, y: Array, level: int) -> Array:
        """Evaluate its derivatives by the directions of motion."""
        rows = np.zeros((0, self.n_speeds))
        if self.n_rows:
            rows = self._call("gradient", y).reshape(self.n_rows, self.n_speeds)
            rows = rows[self.with_value] if level == 0 else rows
        start = np.zeros((0, self.n_speeds))
        if self.model.layout.start_rows:
            start = self._call("start_gradient", y).reshape(-1, self.n_speeds)
        return np.vstack([rows, start[self.conditions[level]]])

    def normalised(self, y: Array) -> Array:
        """Give quaternions the norm one.

        Raises
        ------
        ParameterError
            If one is zero.
        """
        y = y.copy()
        for first in self.model.layout.quaternions:
            length = float(np.linalg.norm(y[first : first + 4]))
            if not length > 0.0:
                raise ParameterError(
                    f"the initial quaternion from '{self.model.states[first]}' on is zero: give "
                    "it a length, or angles"
                )
            y[first : first + 4] /= length
        return y

    def moved(self, y: Array, step: Array, level: int) -> Array:
        """Move coordinates or speeds along directions of motion."""
        y = y.copy()
        if level == 1:
            y[self.own[1]] += step
            return y
        y[: self.n_coordinates] += self.shift(y, step)
        return self.normalised(y)

    def shift(self, y: Array, step: Array) -> Array:
        """Give the change of the coordinates for a step along the directions of motion."""
        change = np.zeros(self.n_coordinates)
        i = 0
        for group in dict.fromkeys(self.groups()):
            if len(group) == 1:
                change[group[0]] = step[i]
                i += 1
                continue
            q0, q1, q2, q3 = y[list(group)]
            turn = np.array([[-q1, -q2, -q3], [q0, -q3, q2], [q3, q0, -q1], [-q2, q1, q0]])
            change[list(group)] = 0.5 * turn @ step[i : i + 3]
            i += 3
        return change

    def settle(self, y: Array, level: int) -> Array:
        """Solve one level, keeping what was given; mend nearly consistent values."""
        size = 1.0 + float(np.max(np.abs(y), initial=0.0))
        found, residual = self._iterate(y, level, self.columns[level], self.n_all(level))
        rng = np.random.default_rng(0)
        for _ in range(_TRIES if level == 0 and self.columns[0] else 0):
            if residual <= _MET * size:
                break
            # Where a gradient vanishes, as that of a length does across it, a step aside shows it.
            aside = np.zeros(self.n_speeds)
            aside[self.columns[0]] = _ASIDE * rng.standard_normal(len(self.columns[0]))
            other = self._iterate(self.moved(y, aside, 0), 0, self.columns[0], self.n_all(0))
            if other[1] < residual:
                found, residual = other
        if residual <= _MET * size:
            return found
        everything = list(range(self.n_speeds))
        given = float(np.max(np.abs(self.residual(found, level)), initial=0.0))
        if given <= _NEARLY * size:
            found, residual = self._iterate(found, level, everything, self.n_constraints(level))
            if residual <= _MET * size:
                self._tell(y, found, level)
                return found
        self._refuse(found, level)
        raise AssertionError  # unreachable

    def _tell(self, y: Array, found: Array, level: int) -> None:
        """Say what was given and had to change."""
        places = range(self.own[level].start, self.own[level].stop)
        moved = [i for i in places if i in self.kept and abs(found[i] - y[i]) > _NOTICED]
        if moved:
            names = ", ".join(
                f"'{self.model.states[i]}' from {y[i]:.6g} to {found[i]:.6g}" for i in moved[:6]
            )
            warnings.warn(
                f"initial values were changed to satisfy the constraints: {names}",
                RuntimeWarning,
                stacklevel=6,
            )

    def n_all(self, level: int) -> int:
        """Count the rows of a level."""
        return len(self.names[level])

    def n_constraints(self, level: int) -> int:
        """Count the rows of a level that are constraints."""
        return self.n_all(level) - len(self.conditions[level])

    def _iterate(
        self, y: Array, level: int, columns: list[int], n_rows: int
    ) -> tuple[Array, float]:
        """Take Gauss-Newton steps of least length until the residual no longer shrinks."""
        best, smallest = y, float(np.max(np.abs(self.residual(y, level)[:n_rows]), initial=0.0))
        longest = 0.5
        scale = 1.0 + float(np.max(np.abs(y), initial=0.0))
        for _ in range(_LARGEST_ITERATIONS):
            if not columns or not n_rows or smallest <= _ROUNDING * scale:
                break
            rows = self.gradient(y, level)[:n_rows, columns]
            step = np.zeros(self.n_speeds)
            target = self.residual(y, level)[:n_rows]
            if not np.all(np.isfinite(rows)) or not np.all(np.isfinite(target)):
                break
            if np.max(np.abs(rows)) < _RANK:  # nothing moves what is left
                break
            step[columns] = -np.linalg.lstsq(rows, target, rcond=_RANK)[0]
            length = float(np.max(np.abs(step)))
            if level == 0 and length > longest:  # angles: a long step may leave the branch
                step *= longest / length
            y = self.moved(y, step, level)
            size = float(np.max(np.abs(self.residual(y, level)[:n_rows]), initial=0.0))
            if size < smallest:
                best, smallest = y, size
            elif smallest < 1e-9:
                break
        return best, smallest

    def _refuse(self, y: Array, level: int) -> None:
        residual = self.residual(y, level)
        order = np.argsort(-np.nan_to_num(np.abs(residual), nan=np.inf))[:6]
        worst = [i for i in order if not abs(residual[i]) <= 1e-10]
        listed = ", ".join(f"{self.names[level][i]} = {residual[i]:.3g}" for i in worst)
        what = "positions" if level == 0 else "velocities"
        raise ParameterError(
            f"the initial {what} violate the constraints and what was given leaves no way to mend "
            f"that; residuals: {listed}. Change initial values or lengths of these joints, or give "
            "fewer initial values"
        )

    def is_chosen(self, given: Array, y: Array) -> bool:
        """Whether the least of several moves was taken."""
        for level, places in enumerate(self.own):
            if np.max(np.abs(y[places] - given[places]), initial=0.0) <= _MET:
                continue
            columns = self.columns[level]
            if not columns:  # all that was given moved a little
                return True
            rows = self.gradient(y, level)[:, columns]
            if len(columns) > np.linalg.matrix_rank(rows, tol=_RANK * max(1.0, np.abs(rows).max())):
                return True
        return False

    def sensitivities(self, y: Array, s: Array) -> Array:
        """Let the sensitivities of what was not given follow from the constraints."""
        s = s.copy()
        for first in self.model.layout.quaternions:
            q = y[first : first + 4]
            s[first : first + 4] -= np.outer(q, q @ s[first : first + 4])
        m = s.shape[1]
        for level in (0, 1):
            d = self._residual_sensitivity(y, s, level)
            columns = self.columns[level]
            rows = self.gradient(y, level)[:, columns]
            step = np.zeros((self.n_speeds, m))
            if columns and len(rows):
                step[columns] = -np.linalg.lstsq(rows, d, rcond=_RANK)[0]
            if level == 1:
                s[self.own[1]] += step
            else:
                for j in range(m):
                    s[: self.n_coordinates, j] += self.shift(y, step[:, j])
        return s

    def _residual_sensitivity(self, y: Array, s: Array, level: int) -> Array:
        """Evaluate the sensitivities of the residuals, shape (n_rows, n_parameters)."""
        m = s.shape[1]
        own = np.zeros((0, m))
        if self.model.layout.constraints:
            whole = self._call("constraint_sensitivity", y, s).reshape(m, -1).T
            own = whole[self._places(level)]
        start = np.zeros((0, m))
        if self.model.layout.start_rows:
            start = self._call("start_sensitivity", y, s).reshape(m, -1).T
        return np.vstack([own, start[self.conditions[level]]])
