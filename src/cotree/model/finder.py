"""Residuals of a consistent start, their gradients, and steps that take them away.

In: a model, and states. Out: numbers free of units: shifts count in lengths of the scene, turns in
radians, constraints in either. So neither steps nor what is decided by them depends on units. The
length by which a turn counts as a shift follows from gradients of constraints alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import numpy.typing as npt

from cotree.equations import Quantity
from cotree.errors import ParameterError
from cotree.model.linear import Linear, least_step, spanning, vanishing_combinations
from cotree.naming import split_name
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.model.arrays import Array
    from cotree.model.model import Moment
    from cotree.program import Layout


# Parts of gradients below this share of the others are rounding.
_ROUNDING_PART = 1e-12

# Where all levers are shorter than this, [m], they are rounding: of hinges in one line, say.
_NO_LENGTH = 1e-9

# Lever arms vanish in one position and are large in others: some are looked at, with joints turned
# by so many radians.
_POSITIONS, _TURNED = 3, 0.5


def turning_speeds(layout: Layout) -> npt.NDArray[np.bool_]:
    """Return which speeds of the multibody system are angular, shape (n_speeds,)."""
    first = layout.n_coordinates
    rows = layout.states[first : first + layout.n_speeds]
    return np.array([row.unit.startswith("rad") for row in rows], dtype=np.bool_)


def gradient_groups(layout: Layout) -> list[tuple[str, str]]:
    """Return edge and unit of each row of the kernel ``gradient``."""
    n = len(layout.constraint_edges)
    # Rates stand before the norms of quaternions, which come last.
    first = len(layout.constraints) - len(layout.quaternions) - n
    rates = layout.constraints[first : first + n]
    return [(edge, row.unit) for edge, row in zip(layout.constraint_edges, rates, strict=True)]


def scene_length(
    layout: Layout,
    gradient: Callable[[Array], Array],
    groups: Sequence[tuple[str, str]],
    y: Array,
    gaps: Sequence[float] | Array = (),
) -> float:
    """Return the characteristic length of the constraints of a scene: translation per rotation.

    Parameters
    ----------
    layout : Layout
        The model's.
    gradient : callable
        ``gradient(y)`` gives the gradients, shape (n_rows, n_speeds).
    groups : sequence of (str, str)
        Edge and unit of each row.
    y : ndarray, shape (n_states,)
        States to look around at.
    gaps : array_like
        Residuals of constraints, [m].

    Returns
    -------
    float
        [m]; where no constraint has turns and shifts, the longest lever, or how far things are.
    """
    turns = turning_speeds(layout)
    # The gradients of several positions are stacked, with the position as part of each row's group.
    rows = np.vstack([gradient(turned(layout, y, i)) for i in range(_POSITIONS)])
    places = [(i, *group) for i in range(_POSITIONS) for group in groups]
    shifts = np.array([row.unit == "m" for row in layout.states[: layout.n_coordinates]])
    far = float(np.max(np.abs([*y[: len(shifts)][shifts], *gaps]), initial=0.0))
    found = length_of_turns(rows, places, turns)
    if found > _ROUNDING_PART * far:
        return found
    # No row has both turns and shifts: the longest lever stands in, or the farthest distance.
    of_length = [unit.startswith("m") for *_, unit in places]
    longest = max(float(np.max(np.abs(rows[of_length][:, turns]), initial=0.0)), far)
    return longest if longest > _NO_LENGTH else 1.0


def spread(first: int, n: int) -> Array:
    """Return n numbers spread evenly about zero, with the standard deviation one.

    They are those of ``cotree_assembly.c``, from the place ``first`` on in their sequence.
    """
    golden = 0.6180339887498949 * np.arange(first + 1, first + n + 1)
    return np.asarray(1.7320508075688772 * (2.0 * np.fmod(golden, 1.0) - 1.0))


def turned(layout: Layout, y: Array, place: int) -> Array:
    """Turn all joints a little; shifts stay.

    Parameters
    ----------
    layout : Layout
        The model's.
    y : ndarray, shape (n_states,)
        States.
    place : int
        The number of the position: turns differ, with a standard deviation of half a radian.
    """
    y, n = y.copy(), layout.n_coordinates
    is_turn = np.array([row.unit != "m" for row in layout.states[:n]], dtype=bool)
    y[:n] += _TURNED * spread(place * n, n) * is_turn
    for first in layout.quaternions:
        y[first : first + 4] /= np.linalg.norm(y[first : first + 4])
    return y


def length_of_turns(rows: Array, groups: Sequence[object], turns: npt.NDArray[np.bool_]) -> float:
    """Return the median lever arm (translation per rotation) of the constraint gradients.

    The quotient of both parts of a row is a length whatever the row's own unit. Rows of one edge
    are taken together, since axes across which a joint holds are arbitrary.

    Parameters
    ----------
    rows : ndarray, shape (n_rows, n_speeds)
        Gradients.
    groups : sequence, one for each row
        Rows of the same are taken together.
    turns : ndarray of bool, shape (n_speeds,)
        True for angular speeds.

    Returns
    -------
    float
        [m]; zero where no row has both parts.
    """
    squares: dict[object, Array] = {}
    for row, group in zip(rows, groups, strict=True):
        parts = np.array([np.sum(row[turns] ** 2), np.sum(row[~turns] ** 2)])
        squares[group] = squares.get(group, np.zeros(2)) + parts
    parts = np.array(list(squares.values())).reshape(-1, 2)
    # Squares are compared, hence the square of the share.
    seen = parts > _ROUNDING_PART**2 * np.max(parts, axis=0, initial=0.0)
    turned, shifted = parts[np.all(seen, axis=1)].T
    # The median: a single lever, however long or short, does not decide.
    lengths = np.sort(np.sqrt(turned / shifted))
    return float(lengths[len(lengths) // 2]) if lengths.size else 0.0


#: No step turns by more than this, [rad], which might leave the branch, nor shifts by so many
#: lengths of the scene.
_LONGEST = 0.5


class Finder:
    """The residuals of one start, at the levels of position (0) and velocity (1).

    Parameters
    ----------
    at : Moment
        The model at the start, with the scene's inputs.
    y : ndarray, shape (n_states,)
        States, which the scene's length is taken from.
    kept : frozenset of int
        The states that were given.
    anew : sequence of int
        Those of them that a run gives in place of the scene's values, in its order.
    is_initial : bool
        Whether initial values of what is no state are to hold, too. Later on they do not, and a
        metre counts as a radian does, as in what C settles after events.
    """

    def __init__(
        self,
        at: Moment,
        y: Array,
        kept: frozenset[int],
        anew: Sequence[int] = (),
        *,
        is_initial: bool,
    ) -> None:
        layout = at.model.layout
        self.at, self.model, self.kept = at, at.model, kept
        self.n_coordinates, self.n_speeds = layout.n_coordinates, layout.n_speeds
        #: Places of the states of each level.
        self.own = (
            slice(0, self.n_coordinates),
            slice(self.n_coordinates, self.n_coordinates + self.n_speeds),
        )
        # The kernel `constraints` gives positions, then rates of all constraints, then the norms of
        # quaternions. Constraints of speeds alone, such as rolling, have no row among the
        # positions.
        self.n_rows = len(layout.constraint_edges)
        self.n_values = len(layout.constraints) - self.n_rows - len(layout.quaternions)
        # A run that gives every coordinate, or every speed, says where all that is no state begins.
        holds = [
            is_initial and not set(anew).issuperset(range(*own.indices(own.stop)))
            for own in self.own
        ]
        self.conditions = [
            [
                i
                for i, rate in enumerate(layout.start_is_rate)
                if holds[level] and rate == bool(level)
            ]
            for level in (0, 1)
        ]
        start = [Quantity(*row) for row in zip(layout.start_rows, layout.start_units, strict=True)]
        #: Residuals at each level, by name and unit.
        self.rows = [
            [*layout.constraints[self._places(level)], *(start[i] for i in self.conditions[level])]
            for level in (0, 1)
        ]
        self.columns = [self._free(level) for level in (0, 1)]
        names = [*(self.model.states[i] for i in anew), *layout.given_names, *self.model.states]
        #: Places of initial values by name: a run's own first, then the scene's in its order.
        self.order = {name: i for i, name in enumerate(dict.fromkeys(names))}
        self.turns = turning_speeds(layout)
        # Events settle in metres and radians, as their C does.
        self.length = self._length(y) if is_initial else 1.0
        #: Units of speeds, and of changes of coordinates, in the units of the states.
        self.units = np.where(self.turns, 1.0, self.length)
        #: Units of residuals, in the residuals' own units.
        self.sizes = [
            np.array([self.length if row.unit.startswith("m") else 1.0 for row in rows])
            for rows in self.rows
        ]

    def _length(self, y: Array) -> float:
        """Return the unit of lengths in the scene, [m]."""
        layout = self.model.layout
        # Names of these rows begin with their edge; rows of one edge form a group.
        names = [split_name(name)[0] for name in layout.start_rows]
        groups = [*gradient_groups(layout), *zip(names, layout.start_units, strict=True)]
        of_length = [row.unit.startswith("m") for row in self.rows[0]]
        return scene_length(layout, self._gradient, groups, y, self.residual(y, 0)[of_length])

    def _shifts(self) -> npt.NDArray[np.bool_]:
        """Return which coordinates are lengths."""
        rows = self.model.layout.states[: self.n_coordinates]
        return np.array([row.unit == "m" for row in rows], dtype=np.bool_)

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
                # Three angular velocities move the four entries of a quaternion together.
                found += [tuple(range(state, state + 4))] * 3
                state += 4
            else:
                found.append((state,))
                state += 1
        return found

    def _places(self, level: int) -> slice:
        """Return the slice of the constraints of a level among the results of their kernel."""
        if level == 0:
            return slice(0, self.n_values)
        return slice(self.n_values, self.n_values + self.n_rows)

    def scaled(self, y: Array, level: int) -> Array:
        """Return coordinates, or speeds, free of units of length."""
        if level == 1:
            return np.asarray(y[self.own[1]] / self.units)
        return np.asarray(y[self.own[0]] / np.where(self._shifts(), self.length, 1.0))

    def size(self, y: Array, level: int) -> float:
        """Return the size of the states that residuals of a level are made of, at least 1."""
        found = [self.scaled(y, own) for own in range(level + 1)]
        return 1.0 + float(np.max(np.abs(np.concatenate(found)), initial=0.0))

    def residual(self, y: Array, level: int) -> Array:
        """Evaluate the residuals of a level, each in its own unit."""
        held = self.at.call("constraints", y) if self.model.layout.constraints else np.zeros(0)
        own = held[self._places(level)]
        start = self.at.call("start", y) if self.model.layout.start_rows else np.zeros(0)
        return np.concatenate([own, start[self.conditions[level]]])

    def _gradient(self, y: Array) -> Array:
        """Evaluate the derivatives of all rates by the speeds, those of the start last."""
        rows = np.zeros((0, self.n_speeds))
        if self.n_rows:
            rows = self.at.call("gradient", y).reshape(self.n_rows, self.n_speeds)
        if not self.model.layout.start_rows:
            return rows
        return np.vstack([rows, self.at.call("start_gradient", y).reshape(-1, self.n_speeds)])

    def gradient(self, y: Array, level: int) -> Array:
        """Evaluate the derivatives of residuals by the directions of motion, free of units."""
        rows = self._gradient(y)
        # A position's gradient by speeds is that of its rate, so rows of rates are taken.
        values = list(self.model.layout.value_rows) if level == 0 else list(range(self.n_rows))
        rows = rows[[*values, *(self.n_rows + i for i in self.conditions[level])]]
        # Columns become derivatives by unit-free directions, rows those of unit-free residuals.
        return np.asarray(rows * self.units / self.sizes[level][:, None])

    def normalised(self, y: Array) -> Array:
        """Normalise quaternions."""
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
        """Move coordinates or speeds along directions of motion.

        Parameters
        ----------
        y : ndarray, shape (n_states,)
            States.
        step : ndarray, shape (n_speeds,)
            The move along each direction, free of units.
        level : int
            0 moves coordinates, 1 speeds.
        """
        y = y.copy()
        if level == 1:
            y[self.own[1]] += step * self.units
            return y
        y[: self.n_coordinates] += self.shift(y, step)
        return self.normalised(y)

    def shift(self, y: Array, step: Array) -> Array:
        """Return the change of the coordinates for a step, free of units, along the directions."""
        step = step * self.units
        change = np.zeros(self.n_coordinates)
        i = 0
        for group in dict.fromkeys(self.groups()):
            if len(group) == 1:
                change[group[0]] = step[i]
                i += 1
                continue
            # dq = q (0, e) / 2, a product of quaternions; the rotation e is along turned axes.
            q0, q1, q2, q3 = y[list(group)]
            turn = np.array([[-q1, -q2, -q3], [q0, -q3, q2], [q3, q0, -q1], [-q2, q1, q0]])
            change[list(group)] = 0.5 * turn @ step[i : i + 3]
            i += 3
        return change

    def way(self, rows: Array, level: int, ahead: str = "") -> Way:
        """Choose the given values that give way where no free motion takes residuals away.

        Those that come last are the first to, until what is left of the residuals can be anything.

        Parameters
        ----------
        rows : ndarray, shape (n_rows, n_speeds)
            The gradient of all residuals of a level, free of units.
        level : int
            0 for positions, 1 for velocities.
        ahead : str
            A state whose value is kept before all others.
        """
        free = self.columns[level]
        # Candidates by name: columns of given states, and rows of values of what is no state.
        found: dict[str, tuple[list[int], int | None]] = {}
        for column in sorted(set(range(self.n_speeds)) - set(free)):
            found.setdefault(self.given(column, level), ([], None))[0].append(column)
        n_held = len(self.rows[level]) - len(self.conditions[level])
        for row in range(n_held, len(rows)):
            found[self.rows[level][row].name] = [], row
        last = sorted(found, key=lambda name: self.order.get(name, 0), reverse=True)
        if ahead in last:
            last = [*(name for name in last if name != ahead), ahead]
        across = vanishing_combinations(rows[:, free], rows)
        moves = {
            name: across[:, [row]] if row is not None else across @ rows[:, columns]
            for name, (columns, row) in found.items()
        }
        chosen = spanning([(name, moves[name]) for name in last], float(np.linalg.norm(rows, 2)))
        columns = [column for name in chosen for column in found[name][0]]
        dropped = {found[name][1] for name in chosen}
        return Way(sorted(columns), [i for i in range(len(rows)) if i not in dropped])

    def given(self, column: int, level: int) -> str:
        """Name the value that fixes a direction of motion."""
        if level == 1:
            return self.model.states[self.own[1].start + column]
        names = [self.model.states[i] for i in self.groups()[column] if i in self.kept]
        return min(names, key=self.order.__getitem__)

    def any_way(self, level: int) -> Way:
        """Free all given values, and keep all residuals."""
        free = set(self.columns[level])
        columns = [i for i in range(self.n_speeds) if i not in free]
        return Way(columns, list(range(len(self.rows[level]))))

    def step(self, rows: Array, target: Array, level: int, giving: Sequence[int] = ()) -> Array:
        """Find the least step that takes residuals away, or as much of them as can be.

        Parameters
        ----------
        rows : ndarray, shape (n_rows, n_speeds)
            Their gradient, free of units.
        target : ndarray, shape (n_rows,) or (n_rows, m)
            The residuals.
        level : int
            0 for positions, 1 for velocities.
        giving : sequence of int
            The columns of given values that move, too: as little as they can, however far the
            others move.

        Returns
        -------
        ndarray, shape (n_speeds,) or (n_speeds, m)
        """
        # Newton's step solves rows @ step = -target in the sense of least squares, of least length.
        step = np.zeros((self.n_speeds, *target.shape[1:]))
        free = self.columns[level]
        # First what is given makes up for what no free motion can; then the free ones follow.
        if giving:
            own, across = list(giving), vanishing_combinations(rows[:, free], rows)
            step[own] = -least_step(across @ rows[:, own], across @ target, rows)
            target = target + rows @ step
        step[free] = -least_step(rows[:, free], target, rows)
        return step

    def residual_sensitivity(self, y: Array, s: Array, level: int) -> Array:
        """Evaluate the derivatives of the residuals, free of units, shape (n_rows, m).

        Parameters
        ----------
        y, s : ndarray, shapes (n_states,) and (n_states, m)
            States and their sensitivities.
        level : int
            0 for positions, 1 for velocities.
        """
        m = s.shape[1]
        own = np.zeros((0, m))
        if self.model.layout.constraints:
            whole = self.at.call("constraint_sensitivity", y, s).reshape(m, -1).T
            own = whole[self._places(level)]
        start = np.zeros((0, m))
        if self.model.layout.start_rows:
            start = self.at.call("start_sensitivity", y, s).reshape(m, -1).T
        found = np.vstack([own, start[self.conditions[level]]])
        return np.asarray(found / self.sizes[level][:, None])


class Way(NamedTuple):
    """The given values of one level that a start may change."""

    columns: list[int]  # the directions of motion whose given values move
    rows: list[int]  # the residuals that hold: initial values of what is no state may be left out


class Level:
    """The residuals of a level as :func:`cotree.model.roots.iterate` takes them.

    Parameters
    ----------
    finder : Finder
        The residuals.
    level : int
        0 for positions, 1 for velocities.
    way : Way or None
        The given values that may change; none if absent.
    """

    n_carried = 0

    def __init__(self, finder: Finder, level: int, way: Way | None = None) -> None:
        self._finder, self._level = finder, level
        self._giving = way.columns if way else []
        self._rows = way.rows if way else slice(None)

    def value(self, y: Array) -> Array:
        """Return the residuals, free of units."""
        finder, level = self._finder, self._level
        return np.asarray((finder.residual(y, level) / finder.sizes[level])[self._rows])

    def linearised(self, y: Array) -> Linear:
        """Return the least step from a point, free of units."""
        finder, level = self._finder, self._level
        moving = [*finder.columns[level], *self._giving]
        if not moving:
            raise np.linalg.LinAlgError("nothing may move")
        rows = finder.gradient(y, level)[self._rows]
        # Without a gradient to speak of, the pseudo-inverse would only enlarge rounding.
        if not np.all(np.isfinite(rows)) or np.max(np.abs(rows[:, moving])) < RANK:
            raise np.linalg.LinAlgError("nothing moves what is left")
        scale = np.full(finder.n_speeds, finder.size(y, level))
        return Linear(lambda g: -finder.step(rows, g, level, self._giving), scale)

    def moved(self, y: Array, step: Array) -> Array:
        """Move along a step, shortened so that positions stay on their branch."""
        length = float(np.max(np.abs(step)))
        if self._level == 0 and length > _LONGEST:
            step = step * (_LONGEST / length)
        return self._finder.moved(y, step, self._level)
