"""Equilibria and steady motions: unknowns that satisfy prescribed rates and outputs.

In: a model, the states, inputs and parameters that are unknown, and prescribed rates and outputs.
Out: a ``TrimPoint``. The equations are those of the rates, the outputs, the constraints and the
norms of quaternions. They may be redundant, so each Newton step is the least-squares solution of
least norm. The iteration is that of :mod:`cotree.model.roots`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, NoReturn

import numpy as np

from cotree.errors import Error, ParameterError, SolveError, brief, listed, nearest
from cotree.model.damped_newton import Equation
from cotree.model.linear import Linear
from cotree.model.moment import Moment
from cotree.model.roots import find_near
from cotree.model.start import find_start
from cotree.model.trim_point import TrimPoint
from cotree.model.unknowns import settle_jumps
from cotree.model.variation import Direction
from cotree.scene.expressions import check_number
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array
    from cotree.model.linearize import Linearizer
    from cotree.model.model import CompiledModel

#: No step turns a coordinate by more than this, [rad]: it might leave its branch.
_LONGEST_TURN = 1.0

#: Conditions are met by less than a thousandth of this share of the terms that they sum.
_MET = 1e-6

#: Modes may settle, each time with another point, in so many rounds.
_MOST_ROUNDS = 20

#: Entries of a direction below this share of its largest are not involved.
_INVOLVED = 0.1


class Wishes(NamedTuple):
    """The conditions on a point; see :meth:`cotree.Model.trim`."""

    solve: Sequence[str]
    fixed: Mapping[str, float]
    rates: Mapping[str, float | None]
    outputs: Mapping[str, float]
    guess: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class _Search:
    """The unknowns and the conditions of one search.

    Attributes
    ----------
    at : Moment
        The model, with parameters and inputs before the search.
    y : ndarray, shape (n_states,)
        States before the search.
    unknowns : tuple of (str, int)
        Kind, ``y``, ``u`` or ``p``, and place of each unknown.
    rows : tuple of int
        Places of the conditions among rates, outputs and constraints.
    targets : ndarray, shape (n_rows,)
        What these are to be.
    """

    linearizer: Linearizer
    at: Moment
    y: Array
    unknowns: tuple[tuple[str, int], ...]
    rows: tuple[int, ...]
    targets: Array
    names: tuple[str, ...] = field(default=())

    @property
    def unknown_names(self) -> list[str]:
        """Names of the unknowns."""
        model = self.at.model
        by_kind = {"y": model.states, "u": model.inputs, "p": model.parameters}
        return [by_kind[kind][i] for kind, i in self.unknowns]

    @property
    def guess(self) -> Array:
        """The unknowns before the search."""
        known = {"y": self.y, "u": self.at.inputs, "p": self.at.p}
        return np.array([known[kind][i] for kind, i in self.unknowns])

    def point(self, z: Array) -> tuple[Moment, Array]:
        """Put unknowns in their places."""
        at, y, p = self.at, self.y.copy(), self.at.p.copy()
        for (kind, i), value in zip(self.unknowns, z, strict=True):
            if kind != "u":
                (y if kind == "y" else p)[i] = value
        own = Moment(at.model, at.t, p, at.u)
        if any(kind == "u" for kind, _ in self.unknowns):
            u = own.inputs.copy()  # the scene's may depend on parameters that are solved for
            for (kind, i), value in zip(self.unknowns, z, strict=True):
                if kind == "u":
                    u[i] = value
            own = Moment(at.model, at.t, p, u)
        return own, y

    def value(self, z: Array) -> Array:
        """Evaluate what is left of the conditions; nan where the model has no value."""
        try:
            at, y = self.point(z)
            found = all_values(at, y)[list(self.rows)]
        except (Error, ArithmeticError):
            return np.full(len(self.rows), np.nan)
        return np.asarray(found - self.targets)

    def slope(self, z: Array) -> Array:
        """Give the derivatives of the conditions by the unknowns, shape (n_rows, n_unknowns)."""
        at, y = self.point(z)
        try:
            by_states, by_inputs = all_slopes(self.linearizer, at, y)
            columns = [
                by_states[:, i]
                if kind == "y"
                else by_inputs[:, i]
                if kind == "u"
                else by_parameter(self.linearizer, at, y, i)
                for kind, i in self.unknowns
            ]
        except Error:
            return np.full((len(self.rows), len(z)), np.nan)
        return np.array(columns).reshape(len(z), -1).T[list(self.rows)]


def all_values(at: Moment, y: Array) -> Array:
    """Evaluate rates, then outputs, then residuals of constraints with norms of quaternions."""
    parts = [at.call("rhs", y)]
    if at.model.outputs:
        parts.append(at.call("outputs", y))
    if at.model.constraints:
        parts.append(at.call("constraints", y))
    return np.concatenate(parts)


def all_slopes(linearizer: Linearizer, at: Moment, y: Array) -> tuple[Array, Array]:
    """Differentiate :func:`all_values` by states and by inputs."""
    n, layout = len(y), at.model.layout
    _, whole, held = linearizer.whole(at.t, y, at.p, at.inputs)
    norms = np.zeros((len(layout.quaternions), n))
    for row, first in enumerate(layout.quaternions):
        norms[row, first : first + 4] = 2.0 * y[first : first + 4]
    held = held if held.size else np.zeros((0, n))
    rest = np.zeros((len(held) + len(norms), whole.shape[1] - n))
    return np.vstack([whole[:, :n], held, norms]), np.vstack([whole[:, n:], rest])


def by_parameter(linearizer: Linearizer, at: Moment, y: Array, place: int) -> Array:
    """Differentiate :func:`all_values` by one parameter, inputs of the scene following."""
    p = np.zeros(len(at.p))
    p[place] = 1.0
    u = np.zeros(len(at.model.inputs))
    if at.u is None:
        u = linearizer.inputs_by_parameters(at, p)
    found = linearizer.by_parameters(at, y, Direction(np.zeros(len(y)), u, p))
    return np.concatenate([found, np.zeros(len(at.model.layout.quaternions))])


class _Conditions(Equation):
    """The conditions as the search for roots takes them; there may be more than unknowns."""

    def __init__(self, search: _Search) -> None:
        super().__init__(search.value, search.slope, np.zeros(0))
        states, model = search.at.model.layout.states, search.at.model
        self._turns = np.array(
            [
                kind == "y" and i < model.layout.n_coordinates and states[i].unit == "rad"
                for kind, i in search.unknowns
            ],
            dtype=bool,
        )
        self._targets = np.abs(search.targets)

    def linearised(self, z: Array) -> Linear:
        """Give what solves for the least step in the sense of least squares."""
        slope = self.slope(z)
        if not np.all(np.isfinite(slope)):
            raise np.linalg.LinAlgError("not finite")
        inverse = pseudo_inverse(slope)[0]
        terms = np.abs(slope) @ np.abs(z) + self._targets
        # Steps of least squares also vanish where conditions contradict each other: what is left of
        # them then is no rounding. At zero all terms are rounding, so unknowns count at least one.
        sizes = _MET * (np.abs(slope) @ np.maximum(np.abs(z), 1.0) + self._targets)
        return Linear(inverse.dot, np.abs(z) + np.abs(inverse) @ terms, sizes)

    def moved(self, z: Array, step: Array) -> Array:
        """Take a step, shortened so that angles stay on their branch."""
        turn = float(np.max(np.abs(step[self._turns]), initial=0.0))
        return z + step * min(1.0, _LONGEST_TURN / max(turn, 1e-300))


def pseudo_inverse(slope: Array) -> tuple[Array, Array]:
    """Invert a matrix of any rank, free of units.

    Returns
    -------
    ndarray, shape (n, m), and ndarray, shape (n_free, n)
        The inverse of least steps, and the directions that change nothing.
    """
    rows, columns, scaled = np.ones(len(slope)), np.ones(slope.shape[1]), slope.copy()
    for _ in range(3):
        # Each round brings the largest entry of every column, then of every row, to one.
        for axis, sizes in ((0, columns), (1, rows)):
            found = np.max(np.abs(scaled), axis=axis, initial=0.0)
            found = np.where(found > 0.0, found, 1.0)
            sizes *= found
            scaled = scaled / np.expand_dims(found, axis)
    left, values, right = np.linalg.svd(scaled)
    rank = int(np.sum(values > RANK * np.max(values, initial=1e-300)))
    inverse = right[:rank].T @ (left[:, :rank] / values[:rank]).T
    return inverse / rows / columns[:, None], right[rank:]


def find_trim(
    model: CompiledModel, linearizer: Linearizer, at: Moment, wishes: Wishes
) -> TrimPoint:
    """Find a point; see :meth:`cotree.Model.trim`."""
    search = _posed(model, linearizer, at, wishes)
    for _ in range(_MOST_ROUNDS):
        root = find_near(_Conditions(search), search.guess)
        if not root.is_found:
            _refuse(search, root.z)
        own, y = search.point(root.z)
        settled = settle_jumps(own, y, np.zeros((len(y), len(model.sensitivities))))[0]
        if np.array_equal(settled, y):
            return _point(search, root.z)
        # Jumps inside expressions took the other side there, so the point is sought again.
        search = _Search(
            linearizer, own, settled, search.unknowns, search.rows, search.targets, search.names
        )
    raise SolveError("no point agrees with the sides of the jumps inside expressions there")


def _posed(model: CompiledModel, linearizer: Linearizer, at: Moment, wishes: Wishes) -> _Search:
    """Sort what is given, and check it."""
    states, inputs, parameters = (list(x) for x in (model.states, model.inputs, model.parameters))
    _check_names(model, wishes)
    values = {
        name: check_number(value, f"'{name}'")
        for name, value in (*wishes.guess.items(), *wishes.fixed.items())
    }
    p, u = at.p.copy(), at.u
    for name in values.keys() & parameters:
        p[parameters.index(name)] = values[name]
    if values.keys() & inputs:
        u = Moment(model, at.t, p, u).inputs.copy()
        for name in values.keys() & inputs:
            u[inputs.index(name)] = values[name]
    at = Moment(model, at.t, p, u)
    y = _first_guess(at)
    for name in values.keys() & states:
        y[states.index(name)] = values[name]
    # Modes change by events alone: they are no unknowns, and their rates are always zero.
    modes = linearizer.modes
    unknowns = [
        ("y", i) for i, name in enumerate(states) if name not in wishes.fixed and i not in modes
    ]
    unknowns += [("u", inputs.index(n)) for n in dict.fromkeys(wishes.solve) if n in inputs]
    unknowns += [("p", parameters.index(n)) for n in dict.fromkeys(wishes.solve) if n in parameters]
    known = _known_rates(linearizer, at, y, {states.index(n) for n in wishes.fixed if n in states})
    rows, targets = [], []
    for i, name in enumerate(states):
        wanted = wishes.rates.get(name, 0.0)
        if wanted is None or i in modes or (name not in wishes.rates and i in known):
            continue
        rows.append(i)
        targets.append(check_number(wanted, f"the rate of '{name}'"))
    for name, value in wishes.outputs.items():
        rows.append(len(states) + model.outputs.index(name))
        targets.append(check_number(value, f"output '{name}'"))
    first = len(states) + len(model.outputs)
    rows += range(first, first + len(model.constraints))
    targets += [0.0] * len(model.constraints)
    names = (
        *(f"the rate of '{name}'" for name in states),
        *(f"output '{name}'" for name in model.outputs),
        *(f"constraint '{name}'" for name in model.constraints),
    )
    return _Search(linearizer, at, y, tuple(unknowns), tuple(rows), np.array(targets), names)


def _first_guess(at: Moment) -> Array:
    """Take the start; where there is none, the initial values as they are given."""
    try:
        return find_start(at, {}).y.copy()
    except Error:
        return at.model.initial_values(at.t, at.p, at.u)[0].copy()


def _known_rates(linearizer: Linearizer, at: Moment, y: Array, fixed: set[int]) -> set[int]:
    """List coordinates whose rate is a speed that is held."""
    layout = at.model.layout
    if not any(layout.n_coordinates <= i < layout.n_coordinates + layout.n_speeds for i in fixed):
        return set()
    slopes = all_slopes(linearizer, at, y)[0]
    found = set()
    for i in range(layout.n_coordinates):
        others = np.flatnonzero(slopes[i])
        if len(others) and fixed.issuperset(others.tolist()):
            found.add(i)
    return found


def _check_names(model: CompiledModel, wishes: Wishes) -> None:
    states, inputs, parameters = set(model.states), set(model.inputs), set(model.parameters)
    known = states | inputs | parameters
    for what, names, allowed in (
        ("solve", wishes.solve, known),
        ("fixed", wishes.fixed, known),
        ("guess", wishes.guess, known),
        ("rates", wishes.rates, states),
        ("outputs", wishes.outputs, set(model.outputs)),
    ):
        for name in names:
            if name not in allowed:
                kinds = {"rates": "state", "outputs": "output"}.get(
                    what, "state, input or tunable parameter"
                )
                raise ParameterError(
                    f"{what} names '{brief(name)}', which is no {kinds} of the model"
                    f"{nearest(name, allowed)}"
                )
    twice = sorted(set(wishes.solve) & set(wishes.fixed))
    if twice:
        raise ParameterError(f"'{twice[0]}' is in solve and in fixed: it is either, not both")


def _refuse(search: _Search, z: Array) -> NoReturn:
    """Say what no point was found for."""
    left = search.value(z)
    n, m = len(search.unknowns), len(search.rows)
    if not np.all(np.isfinite(left)):
        raise SolveError(
            "the equations have no finite values near the guess: give other values in guess"
        )
    slope = search.slope(z)
    size = np.maximum(np.max(np.abs(slope), axis=1, initial=0.0), 1e-300)
    # In units of the unknowns, so that rates of small and of large capacitors compare.
    order = np.argsort(-np.abs(left) / size)
    worst = [i for i in order[:3] if abs(left[i]) > 1e-9 * max(1.0, float(np.max(np.abs(left))))]
    told = listed(
        f"{search.names[search.rows[i]]} stays {left[i] + search.targets[i]:.4g} where "
        f"{search.targets[i]:.4g} is wanted"
        for i in worst
    )
    if not worst:
        away = int(np.argmax(np.abs(z) / np.maximum(np.abs(search.guess), 1.0)))
        raise SolveError(
            f"no equilibrium or steady motion was found: the search ran away to {z[away]:.4g} in "
            f"'{search.unknown_names[away]}'; give a guess nearer to a solution"
        )
    hint = (
        f"there are {m} conditions for {n} unknowns: name inputs or parameters in solve, or leave "
        "rates free"
        if m > n and not search.at.model.constraints
        else "name inputs or parameters in solve, leave rates free, or give another guess"
    )
    raise SolveError(f"no equilibrium or steady motion was found: {told}; {hint}")


def _point(search: _Search, z: Array) -> TrimPoint:
    """Describe a point that was found."""
    at, y = search.point(z)
    model = at.model
    inverse, free = pseudo_inverse(search.slope(z))
    names = search.unknown_names
    largest = np.max(np.abs(free), axis=1, keepdims=True, initial=0.0)
    involved = [
        tuple(name for name, is_in in zip(names, row, strict=True) if is_in)
        for row in np.abs(free) > _INVOLVED * largest
    ]
    left = search.value(z)
    return TrimPoint(
        model=model,
        at=at,
        y=y,
        unknowns=tuple(names),
        undetermined=tuple(involved),
        residual=float(np.max(np.abs(left), initial=0.0)),
        places=search.unknowns,
        rows=search.rows,
        inverse=inverse,
        linearizer=search.linearizer,
    )
