"""The consistent start: initial states and sensitivities that satisfy every constraint.

What the user gave is kept, and the rest follows by Gauss-Newton steps of least length. Where that
cannot be but the given values are nearly consistent, the last of them move as little as they can,
with a warning; else the start is refused with the residual of each joint. Sensitivities are
derivatives of what is done: what was given last moves with a parameter, too, where nothing else can
follow it. A run's own values come before those of the scene, which come in its order.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from cotree.errors import ParameterError, listed
from cotree.model.finder import Finder, Level, spread
from cotree.model.linear import SMALL
from cotree.model.roots import NewtonLimits, iterate
from cotree.quiet import level_of_user
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from cotree.model.arrays import Array
    from cotree.model.finder import Way
    from cotree.model.model import Moment

_LARGEST_ITERATIONS = 50

#: Residuals below this share of the states' size are met.
_MET = 1e-11

#: Those below this are nothing but rounding.
_ROUNDING = 1e-15

#: Given values that would have to move by more than this contradict each other: radians, lengths
#: of the scene, or shares of the largest speed.
_FARTHEST = 0.1

#: Given values that change by more than this are named in a warning.
_NOTICED = 1e-4

#: How far, and how often, to look aside where constraints have no gradient.
_ASIDE, _TRIES = 0.1, 4

#: A derivative of a residual counts as made up for when what is left of it is below the first share
#: of the largest one, or below the second share of the terms that it sums.
_FOLLOWED, _ROUNDING_OF_SUMS = 1e-8, 1e-13

_LEVELS = ("positions", "velocities")


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
    told : str
        A sentence on the given values that move with a parameter; empty where none does.
    is_mended : bool
        Whether given values had to change.
    """

    y: Array
    s: Array
    is_chosen: bool = False
    told: str = ""
    is_mended: bool = False

    @cached_property
    def z(self) -> Array:
        """States and then sensitivities, parameter by parameter, as integrations hold them."""
        found = np.concatenate([self.y, self.s.T.ravel()])
        found.flags.writeable = False  # runs that begin alike share it
        return found


def consistent_start(
    at: Moment,
    y: Array,
    s: Array,
    kept: Collection[int],
    *,
    is_initial: bool = True,
    is_probe: bool = False,
    anew: Sequence[int] = (),
) -> Start:
    """Move initial states and sensitivities onto the constraints.

    Parameters
    ----------
    at : Moment
        The model at the start, with the scene's inputs.
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        Initial states and sensitivities as given.
    kept : collection of int
        The states that the user gave.
    is_initial : bool
        Whether initial values of what is no state are to hold, too, and what was given may be
        mended; later on neither.
    is_probe : bool
        Whether only the states are wanted, next to a start that was found.
    anew : sequence of int
        Those of ``kept`` whose values a run gives in place of the scene's, in its order. Where they
        are all coordinates, or all speeds, the scene's initial values of what is no state give way.

    Raises
    ------
    ParameterError
        If the given values violate a constraint that nothing else can mend, or the start has no
        derivative by a parameter.
    """
    if not at.model.layout.has_conditions:
        return Start(y, s)
    finder = Finder(at, y, frozenset(kept), anew, is_initial=is_initial)
    search = _Search(finder, is_initial=is_initial, is_probe=is_probe)
    # Positions first: the gradients that velocities obey are those at the positions found.
    found = search.settle(search.settle(finder.normalised(y), 0), 1)
    if at.model.sensitivities and not is_probe:
        s = search.sensitivities(found, s)
    is_mended = search.is_mended
    return Start(found, s, search.is_chosen(y, found), search.told(anew), is_mended)


class _Search:
    """Looks for one start."""

    def __init__(self, finder: Finder, *, is_initial: bool, is_probe: bool) -> None:
        self.model, self.finder = finder.model, finder
        self._mends, self._is_probe = is_initial, is_probe
        self._mended = [False, False]
        #: Given values that move, with the parameters that they do with.
        self._following: dict[str, list[str]] = {}

    @property
    def is_mended(self) -> bool:
        """Whether given values had to change."""
        return any(self._mended)

    def settle(self, y: Array, level: int) -> Array:
        """Solve one level, keeping what was given; mend nearly consistent values."""
        finder, size = self.finder, self.finder.size(y, level)
        found, residual = self._iterate(y, level)
        free, n = finder.columns[level], finder.n_speeds
        # Constraints of velocities are linear in the speeds: only positions may need another start.
        for i in range(_TRIES if level == 0 and free else 0):
            if residual <= _MET * size:
                break
            # Where a gradient vanishes, as that of a length does across it, a step aside shows it.
            aside = np.zeros(n)
            aside[free] = _ASIDE * spread(i * n, n)[free]
            other = self._iterate(finder.moved(y, aside, 0), 0)
            # A residual that is smaller only by rounding is the same one, perhaps a full turn away.
            if other[1] < (1.0 - SMALL) * residual:
                found, residual = other
        if residual <= _MET * size:
            return found
        mended, residual = found, np.inf
        # Given values move only where nothing else can, and only the last ones where these suffice.
        rows, ways = finder.gradient(found, level), [finder.any_way(level)]
        if np.all(np.isfinite(rows)):
            ways.insert(0, finder.way(rows, level))
        for way in ways if self._mends else []:
            gives = bool(way.columns) or len(way.rows) < len(rows)
            if gives and not residual <= _MET * size:
                mended, residual = self._iterate(found, level, way)
        if not residual <= _MET * size:
            self._refuse(found, level)
        self._mended[level] = True
        if not self._is_probe:
            self._check_mended(y, found, mended, level)
        return mended

    def _iterate(self, y: Array, level: int, way: Way | None = None) -> tuple[Array, float]:
        """Take Gauss-Newton steps of least length until the residual no longer shrinks."""
        limits = NewtonLimits(
            _LARGEST_ITERATIONS, slow=SMALL, met=_ROUNDING * self.finder.size(y, level)
        )
        root = iterate(Level(self.finder, level, way), y, limits)
        return root.z, float(np.max(np.abs(root.g), initial=0.0))

    def _check_mended(self, y: Array, found: Array, mended: Array, level: int) -> None:
        """Warn of given values that had to change; refuse changes that are not small."""
        finder = self.finder
        places = range(finder.own[level].start, finder.own[level].stop)
        change = np.abs(finder.scaled(mended, level) - finder.scaled(y, level))
        if level == 1:
            # A speed is small or large beside the others of the motion, not beside one.
            change /= float(np.max(np.abs(finder.scaled(mended, 1)), initial=0.0)) or 1.0
        moved = {
            f"'{self.model.states[i]}' from {y[i]:.6g} to {mended[i]:.6g}": change[i - places.start]
            for i in places
            if i in finder.kept and change[i - places.start] > _NOTICED
        }
        left = finder.residual(mended, level)
        for row, value, size in zip(finder.rows[level], left, finder.sizes[level], strict=True):
            # Values of what is no state may have given way, too; all else holds.
            if abs(value) > _NOTICED * size:
                moved[f"'{row.name}' by {value:.3g}"] = abs(value) / size
        names = ", ".join([*moved][:6])
        if any(far > _FARTHEST for far in moved.values()):
            self._refuse(found, level, f". The nearest that do not would move {names}")
        if moved:
            warnings.warn(
                f"initial values were changed to satisfy the constraints: {names}",
                RuntimeWarning,
                stacklevel=8,
            )

    def _refuse(self, y: Array, level: int, nearest: str = "") -> NoReturn:
        residual = self.finder.residual(y, level)
        order = np.argsort(-np.nan_to_num(np.abs(residual), nan=np.inf))[:6]
        worst = [i for i in order if not abs(residual[i]) <= 1e-10 * self.finder.sizes[level][i]]
        listed = ", ".join(f"{self.finder.rows[level][i].name} = {residual[i]:.3g}" for i in worst)
        raise ParameterError(
            f"the initial {_LEVELS[level]} violate the constraints and what was given leaves no "
            f"way to mend that; residuals: {listed}{nearest}. Change initial values or lengths of "
            "these joints, or give fewer initial values"
        )

    def is_chosen(self, given: Array, y: Array) -> bool:
        """Return whether the start was chosen as the least of several possible moves."""
        finder = self.finder
        for level in (0, 1):
            change = finder.scaled(y, level) - finder.scaled(given, level)
            if np.max(np.abs(change), initial=0.0) <= _MET * finder.size(y, level):
                continue
            columns = finder.columns[level]
            if self._mended[level]:
                return True
            rows = finder.gradient(y, level)[:, columns]
            size = max(1.0, float(np.max(np.abs(rows), initial=0.0)))
            # More directions may move than constraints decide, and the least step chose among them.
            if len(columns) > np.linalg.matrix_rank(rows, tol=RANK * size):
                return True
        return False

    def sensitivities(self, y: Array, s: Array) -> Array:
        """Project the sensitivities onto the constraints, as the states are.

        Raises
        ------
        ParameterError
            If no motion makes up for what a parameter changes of the constraints.
        """
        s, finder = s.copy(), self.finder
        for first in self.model.layout.quaternions:
            q = y[first : first + 4]
            # Changes of a quaternion of norm one are orthogonal to it.
            s[first : first + 4] -= np.outer(q, q @ s[first : first + 4])
        for level in (0, 1):
            # From C(y(p), p) = 0 follows C_y s + C_p = 0. With s as it is given, d is what is left
            # of that, and a motion makes up for it.
            d, rows = finder.residual_sensitivity(y, s, level), finder.gradient(y, level)
            # Without residuals at this level sensitivities stay as they are given.
            if not d.size:
                continue
            step, rounding = np.zeros((finder.n_speeds, s.shape[1])), self._rounding(rows, s)
            for columns, n in self._columns(level):
                step[:, columns] = self._followed(
                    rows[:n], d[:n, columns], level, rounding, columns
                )
            if level == 1:
                s[finder.own[1]] += step * finder.units[:, None]
            else:
                for j in range(s.shape[1]):
                    s[: finder.n_coordinates, j] += finder.shift(y, step[:, j])
        return s

    def _columns(self, level: int) -> list[tuple[list[int], int]]:
        """List the columns of sensitivities, each group with the number of rows that hold for it.

        Along the initial value of a state, initial values that the scene gives of joints that are
        no states give way; constraints do not.
        """
        finder, names = self.finder, self.model.sensitivities
        n = len(finder.rows[level])
        # Rows of joints that are no states come last, and the second group leaves them out.
        groups: list[tuple[list[int], int]] = [([], n), ([], n - len(finder.conditions[level]))]
        for j, name in enumerate(names):
            groups[name in self.model.states][0].append(j)
        return [group for group in groups if group[0]]

    def _followed(
        self, rows: Array, d: Array, level: int, rounding: Array, columns: list[int]
    ) -> Array:
        """Find the motions that make up for derivatives of residuals.

        Given values move, too, along parameters that the others cannot follow.
        """
        finder = self.finder
        step = finder.step(rows, d, level)
        if not self._mends or not d.size:
            return step
        allowed = _FOLLOWED * np.max(np.abs(d), axis=0) + rounding[columns]
        missed = np.max(np.abs(d + rows @ step), axis=0) > allowed
        for k in np.flatnonzero(missed):
            name, own = self.model.sensitivities[columns[k]], d[:, k]
            # A value that derivatives are taken to is not to follow itself.
            way = finder.way(rows, level, name)
            step[:, k] = finder.step(rows[way.rows], own[way.rows], level, way.columns)
            left = own + rows @ step[:, k]
            # No motion follows this parameter: constraints depend on each other.
            if np.max(np.abs(left[way.rows]), initial=0.0) > allowed[k]:
                left[np.setdiff1d(np.arange(len(left)), way.rows)] = 0.0
                self._refuse_derivative(left, level, columns[k])
            if name in self.model.parameters:
                far = np.abs(step[:, k]) > _FOLLOWED * np.max(np.abs(step[:, k]))
                moved = [finder.given(i, level) for i in way.columns if far[i]]
                moved += [
                    finder.rows[level][i].name for i in np.flatnonzero(abs(left) > allowed[k])
                ]
                for value in dict.fromkeys(moved):
                    self._following.setdefault(value, []).append(name)
        return step

    def told(self, anew: Sequence[int]) -> str:
        """Name the given values that move with parameters; warn where the run gives none itself."""
        if not self._following:
            return ""
        shown = listed(
            f"'{value}' with {listed(repr(name) for name in dict.fromkeys(names))}"
            for value, names in self._following.items()
        )
        said = (
            f"given initial values move with parameters, so that those given before them are kept: "
            f"{shown}. Give them as expressions of these parameters, or leave them out"
        )
        if not anew:
            warnings.warn(said, RuntimeWarning, stacklevel=level_of_user())
        return f"{said[0].upper()}{said[1:]}."

    def _rounding(self, rows: Array, s: Array) -> Array:
        """Bound the rounding errors of residuals' derivatives that should vanish, shape (m,)."""
        finder = self.finder
        largest = [
            np.max(np.abs(np.array([finder.scaled(column, level) for column in s.T])), axis=1)
            for level in (0, 1)
        ]
        values = dict(zip(self.model.parameters, np.abs(finder.at.p), strict=True))
        # A length or an angle of one, divided by a parameter, is the size of a derivative by it.
        own = np.array([1.0 / (values.get(name) or 1.0) for name in self.model.sensitivities])
        reach = max(1.0, float(np.max(np.abs(rows), initial=0.0)))
        return np.asarray(_ROUNDING_OF_SUMS * (reach * np.maximum(*largest) + own))

    def _refuse_derivative(self, left: Array, level: int, j: int) -> NoReturn:
        rows = self.finder.rows[level]
        least = 0.1 * float(np.max(np.abs(left)))
        order = [i for i in np.argsort(-np.abs(left))[:4] if abs(left[i]) > least]
        named = ", ".join(f"'{rows[i].name}'" for i in order)
        raise ParameterError(
            f"the start has no derivative by '{self.model.sensitivities[j]}': it changes the "
            f"{_LEVELS[level]} that the constraints ask for, and no motion follows to first order: "
            f"{named} would be violated. Constraints depend on each other there: begin elsewhere, "
            "let all that has to change with it depend on that parameter, or compile without this "
            "sensitivity"
        )
