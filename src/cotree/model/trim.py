"""Trim: search for equilibria and steady motions with prescribed rates and outputs.

The conditions F(z, p) = 0 on the unknowns z prescribe rates and outputs and include the constraints
and quaternion norms. They may be redundant, so each Newton step of :mod:`cotree.model.roots` is a
least-squares solution of minimum norm. The derivatives of the unknowns are dz/dp = -F_z^+ F_p.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, NoReturn

import numpy as np

from cotree.arguments import check_mapping, check_names
from cotree.errors import Error, ParameterError, SolveError, brief, listed, nearest
from cotree.model.bound import BoundModel
from cotree.model.linear import Linear
from cotree.model.linearize import Direction, Linearizer, unit_direction
from cotree.model.roots import Equation, find_near
from cotree.model.start import find_start
from cotree.model.unknowns import check_friction, guess_friction, settle_friction, settle_jumps
from cotree.report import Facts, Report, Reported
from cotree.scene.expressions import check_number
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array
    from cotree.model.linearization import Linearization
    from cotree.model.model import CompiledModel


class Conditions(NamedTuple):
    """The conditions on a trim point; see :meth:`cotree.Model.trim`."""

    solve: Sequence[str]
    fixed: Mapping[str, float]
    rates: Mapping[str, float | None]
    outputs: Mapping[str, float]
    guess: Mapping[str, float]


@dataclass(frozen=True, eq=False, repr=False)
class TrimPoint(Reported):
    """An equilibrium or a point of a steady motion; ``point["tau"]`` returns the value of tau.

    Attributes
    ----------
    model : cotree.Model
        The model.
    at : BoundModel
        Time, parameters and inputs.
    y : ndarray, shape (n_states,)
        States.
    unknowns : tuple of str
        Names of the unknowns.
    undetermined : tuple of tuple of str
        For each direction that satisfies the conditions to first order, the unknowns that change
        along it. In these directions the solution stays close to the guess.
    residual : float
        The largest residual of the conditions, in the unit of each condition.
    """

    model: CompiledModel
    at: BoundModel
    y: Array
    unknowns: tuple[str, ...]
    undetermined: tuple[tuple[str, ...], ...]
    residual: float
    places: tuple[tuple[str, int], ...] = field(default=())
    rows: tuple[int, ...] = field(default=())
    inverse: Array = field(default_factory=lambda: np.zeros((0, 0)))
    linearizer: Linearizer | None = None

    @property
    def t(self) -> float:
        """The time, [s]."""
        return self.at.t

    @property
    def p(self) -> Array:
        """The parameters, shape (n_parameters,)."""
        return self.at.p

    @property
    def u(self) -> Array:
        """The inputs, shape (n_inputs,)."""
        return self.at.inputs

    @property
    def is_unique(self) -> bool:
        """Whether the solution is locally unique."""
        return not self.undetermined

    @property
    def settings(self) -> dict[str, Any]:
        """Arguments of a run that starts here: ``model.simulate((0, 1), **point.settings)``."""
        return {
            "initial": dict(zip(self.model.states, self.y.tolist(), strict=True)),
            "parameters": dict(zip(self.model.parameters, self.p.tolist(), strict=True)),
            "inputs": dict(zip(self.model.inputs, self.u.tolist(), strict=True)),
        }

    def __getitem__(self, name: str) -> float:
        """Return the value of a state, input, parameter or output by name.

        Raises
        ------
        ParameterError
            If the name is unknown.
        """
        model = self.model
        groups = ((model.states, self.y), (model.inputs, self.u), (model.parameters, self.p))
        for names, values in groups:
            if name in names:
                return float(values[names.index(name)])
        if name in model.outputs:
            found = self.at.call("outputs", self.y)
            return float(found[model.outputs.index(name)])
        known = [*model.states, *model.inputs, *model.parameters, *model.outputs]
        raise ParameterError(
            f"the model has no variable or parameter '{brief(name)}'{nearest(name, known)}"
        )

    def linearize(
        self, *, reduced: bool = False, sensitivities: Sequence[str] | str = ()
    ) -> Linearization:
        """Linearise about the point; see :meth:`cotree.Model.linearize`.

        Derivatives with respect to parameters are total: the unknowns change with the parameter
        such that the conditions remain satisfied.

        Parameters
        ----------
        reduced : bool
            Whether the linear system has independent deviations as states.
        sensitivities : sequence of str
            Parameters, inputs and states, except unknowns, with respect to which A, B, C and D are
            differentiated.
        """
        names = check_names(sensitivities, "sensitivities")
        directions = {name: self._direction(name) for name in names}
        assert self.linearizer is not None
        return self.linearizer.about(self.at, self.y, reduced=reduced, directions=directions)

    def sensitivity(self, name: str, to: str) -> float:
        """Return the derivative of an unknown with respect to a known parameter, input or state.

        Raises
        ------
        ParameterError
            If ``name`` is not an unknown, or ``to`` is one.
        """
        if name not in self.unknowns:
            raise ParameterError(f"'{brief(name)}' is not an unknown{nearest(name, self.unknowns)}")
        return float(self._moved(to)[0][self.unknowns.index(name)])

    def _moved(self, name: str) -> tuple[Array, Direction]:
        """Return the unknowns' derivatives with respect to a quantity, and its unit direction."""
        assert self.linearizer is not None
        if name in self.unknowns:
            raise ParameterError(
                f"'{name}' is an unknown: differentiate with respect to a known quantity instead"
            )
        direction = unit_direction(self.linearizer, self.at, name)
        changed = along(self.linearizer, self.at, self.y, direction)
        return -self.inverse @ changed[list(self.rows)], direction

    def _direction(self, name: str) -> Direction:
        """Return the total derivative of the point with respect to a named quantity."""
        moved, found = self._moved(name)
        by_kind = {"y": found.y, "u": found.u, "p": found.p}
        for (kind, i), change in zip(self.places, moved, strict=True):
            by_kind[kind][i] = change
        return found

    def summary(self) -> str:
        """Return a sentence on whether the point is locally unique."""
        if self.is_unique:
            return "locally unique"
        parts = [
            f"'{names[0]}' may have any value"
            if len(names) == 1
            else f"{listed(map(repr, names))} may change together"
            for names in self.undetermined
        ]
        return f"not locally unique: {listed(parts)}"

    def report(self) -> Report:
        """Return a report that lists the unknowns."""
        values = [(name, f"{self[name]:.8g}") for name in self.unknowns]
        shown = values[:12] + ([("...", f"{len(values) - 12} more")] if len(values) > 12 else [])
        facts = [("point", self.summary()), *shown, ("residual", f"{self.residual:.2g}")]
        return Report(f"TrimPoint of {self.model.layout.name}", Facts(facts))


#: Largest change of an angle in one step, [rad]; larger changes may lead to another solution.
_LONGEST_TURN = 1.0

#: A condition is satisfied if its residual is below 0.001 times this fraction of its terms.
_MET = 1e-6

#: Residuals below this fraction of the summed magnitudes of their terms are rounding errors.
_EXACT = 1e-11

#: Maximum number of mode changes; the search is repeated after each change.
_MOST_ROUNDS = 20

#: Unknowns with components below this fraction of the largest do not change in a null direction.
_INVOLVED = 0.1


@dataclass(frozen=True, eq=False)
class _Search:
    """The unknowns and equations of one search for a trim point."""

    linearizer: Linearizer
    at: BoundModel  # model with its parameters and inputs before the search
    y: Array  # states before the search
    unknowns: tuple[tuple[str, int], ...]  # kind (``y``, ``u`` or ``p``) and index of each unknown
    rows: tuple[int, ...]  # indices of the equations among rates, outputs and constraints
    targets: Array  # prescribed values of these equations
    names: tuple[str, ...] = field(default=())

    @property
    def unknown_names(self) -> list[str]:
        model = self.at.model
        by_kind = {"y": model.states, "u": model.inputs, "p": model.parameters}
        return [by_kind[kind][i] for kind, i in self.unknowns]

    @property
    def guess(self) -> Array:
        known = {"y": self.y, "u": self.at.inputs, "p": self.at.p}
        return np.array([known[kind][i] for kind, i in self.unknowns])

    def point(self, z: Array) -> tuple[BoundModel, Array]:
        """Return the evaluation point and states for values of the unknowns."""
        at, y, p = self.at, self.y.copy(), self.at.p.copy()
        for (kind, i), value in zip(self.unknowns, z, strict=True):
            if kind != "u":
                (y if kind == "y" else p)[i] = value
        moment = BoundModel(at.model, at.t, p, at.u)
        if any(kind == "u" for kind, _ in self.unknowns):
            u = moment.inputs.copy()  # inputs of the scene may depend on unknown parameters
            for (kind, i), value in zip(self.unknowns, z, strict=True):
                if kind == "u":
                    u[i] = value
            moment = BoundModel(at.model, at.t, p, u)
        return moment, y

    def value(self, z: Array) -> Array:
        """Return the residuals of the conditions; nan if the model cannot be evaluated."""
        try:
            at, y = self.point(z)
            found = all_values(at, y)[list(self.rows)]
        except (Error, ArithmeticError):
            return np.full(len(self.rows), np.nan)
        return np.asarray(found - self.targets)

    def slope(self, z: Array) -> Array:
        at, y = self.point(z)
        try:
            by_states, by_inputs = all_slopes(self.linearizer, at, y)
            columns = [
                by_states[:, i]
                if kind == "y"
                else by_inputs[:, i]
                if kind == "u"
                else along(
                    self.linearizer,
                    at,
                    y,
                    unit_direction(self.linearizer, at, at.model.parameters[i]),
                )
                for kind, i in self.unknowns
            ]
        except Error:
            return np.full((len(self.rows), len(z)), np.nan)
        return np.array(columns).reshape(len(z), len(self.names)).T[list(self.rows)]


def all_values(at: BoundModel, y: Array) -> Array:
    """Evaluate rates, outputs, and residuals of constraints and quaternion norms."""
    parts = [at.call("rhs", y)]
    if at.model.outputs:
        parts.append(at.call("outputs", y))
    if at.model.constraints:
        parts.append(at.call("constraints", y))
    return np.concatenate(parts)


def all_slopes(linearizer: Linearizer, at: BoundModel, y: Array) -> tuple[Array, Array]:
    """Return the derivatives of :func:`all_values` with respect to states and inputs."""
    n, layout = len(y), at.model.layout
    _, whole, held = linearizer.whole(at.t, y, at.p, at.inputs)
    norms = np.zeros((len(layout.quaternions), n))
    for row, first in enumerate(layout.quaternions):
        norms[row, first : first + 4] = 2.0 * y[first : first + 4]
    held = held if held.size else np.zeros((0, n))
    rest = np.zeros((len(held) + len(norms), whole.shape[1] - n))
    return np.vstack([whole[:, :n], held, norms]), np.vstack([whole[:, n:], rest])


def along(linearizer: Linearizer, at: BoundModel, y: Array, direction: Direction) -> Array:
    """Differentiate :func:`all_values` along a direction."""
    found = linearizer.by_parameters(at, y, direction)
    quaternions = [slice(first, first + 4) for first in at.model.layout.quaternions]
    return np.array([*found, *(2.0 * y[q] @ direction.y[q] for q in quaternions)])


class _TrimEquation(Equation):
    """The conditions as equations for the root finder, over- or underdetermined."""

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
        """Return the solver for the minimum-norm least-squares step."""
        slope = self.slope(z)
        if not np.all(np.isfinite(slope)):
            raise np.linalg.LinAlgError("not finite")
        inverse = pseudo_inverse(slope)[0]
        terms = np.abs(slope) @ np.abs(z) + self._targets
        # Least-squares steps also vanish if the conditions contradict each other, so residuals are
        # compared with the magnitudes of their terms. Unknowns count as at least one, because at a
        # zero solution all terms are rounding errors.
        sizes = _MET * (np.abs(slope) @ np.maximum(np.abs(z), 1.0) + self._targets)
        return Linear(inverse.dot, np.abs(z) + np.abs(inverse) @ terms, sizes)

    def moved(self, z: Array, step: Array) -> Array:
        """Return the point after a step, shortened if an angle would change too much."""
        turn = float(np.max(np.abs(step[self._turns]), initial=0.0))
        return z + step * min(1.0, _LONGEST_TURN / max(turn, 1e-300))


def pseudo_inverse(slope: Array) -> tuple[Array, Array]:
    """Return pseudo-inverse and null space, as rows; equilibration makes units irrelevant."""
    rows, columns, scaled = np.ones(len(slope)), np.ones(slope.shape[1]), slope.copy()
    for _ in range(3):
        # Scale the largest entry of every column, then of every row, to one.
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
    linearizer: Linearizer,
    at: BoundModel,
    solve: Sequence[str] | str = (),
    fixed: Any = None,
    rates: Any = None,
    outputs: Any = None,
    guess: Any = None,
) -> TrimPoint:
    """Find a trim point; see :meth:`cotree.Model.trim`."""
    conditions = Conditions(
        check_names(solve, "solve"),
        check_mapping(fixed, "fixed"),
        check_mapping(rates, "rates"),
        check_mapping(outputs, "outputs"),
        check_mapping(guess, "guess"),
    )
    model = at.model
    search = _posed(model, linearizer, at, conditions)
    for _ in range(_MOST_ROUNDS):
        root = find_near(_TrimEquation(search), search.guess)
        if not (root.is_found or _is_met(search, root.z)):
            _refuse(search, root.z)
        moment, y = search.point(root.z)
        settled = settle_jumps(moment, y)
        settled = settle_friction(moment, settled, conditions.fixed)
        if np.array_equal(settled, y):
            check_friction(moment, y)
            return _point(search, root.z)
        # The mode of a jump or of dry friction has changed: search again.
        search = _Search(
            linearizer, moment, settled, search.unknowns, search.rows, search.targets, search.names
        )
    raise SolveError(
        "no consistent point was found: discontinuous expressions, or modes of dry friction, "
        "switch at every attempt; give another guess"
    )


def _is_met(search: _Search, z: Array) -> bool:
    """Return whether residuals are rounding errors; at double roots, slopes at the guess count."""
    left = np.abs(search.value(z))
    # Slopes at the guess are multiplied by the guess: diverging unknowns would hide residuals.
    terms = [np.abs(search.slope(x)) @ np.maximum(np.abs(x), 1.0) for x in (z, search.guess)]
    return bool(np.all(left <= _EXACT * (np.maximum(*terms) + np.abs(search.targets))))


def _posed(
    model: CompiledModel, linearizer: Linearizer, at: BoundModel, conditions: Conditions
) -> _Search:
    states, inputs, parameters = (list(x) for x in (model.states, model.inputs, model.parameters))
    _check_names(model, conditions)
    values = {
        name: check_number(value, f"'{name}'")
        for name, value in (*conditions.guess.items(), *conditions.fixed.items())
    }
    p, u = at.p.copy(), at.u
    for name in values.keys() & parameters:
        p[parameters.index(name)] = values[name]
    if values.keys() & inputs:
        u = BoundModel(model, at.t, p, u).inputs.copy()
        for name in values.keys() & inputs:
            u[inputs.index(name)] = values[name]
    at = BoundModel(model, at.t, p, u)
    try:
        y = find_start(at, {}).y.copy()
    except Error:  # without a start, keep the scene's initial values
        y = model.initial_values(at.t, at.p, at.u)[0].copy()
    for name in values.keys() & states:
        y[states.index(name)] = values[name]
    y = guess_friction(at, y, values)
    # Modes change only at events: they are not unknowns, and their rates are zero.
    modes = linearizer.modes
    unknowns = [
        ("y", i) for i, name in enumerate(states) if name not in conditions.fixed and i not in modes
    ]
    unknowns += [("u", inputs.index(n)) for n in dict.fromkeys(conditions.solve) if n in inputs]
    unknowns += [
        ("p", parameters.index(n)) for n in dict.fromkeys(conditions.solve) if n in parameters
    ]
    known = _known_rates(
        linearizer, at, y, {states.index(n) for n in conditions.fixed if n in states}
    )
    rows, targets = [], []
    for i, name in enumerate(states):
        wanted = conditions.rates.get(name, 0.0)
        if wanted is None or i in modes or (name not in conditions.rates and i in known):
            continue
        rows.append(i)
        targets.append(check_number(wanted, f"the rate of '{name}'"))
    for name, value in conditions.outputs.items():
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


def _known_rates(linearizer: Linearizer, at: BoundModel, y: Array, fixed: set[int]) -> set[int]:
    """Return the coordinates whose rates depend only on the fixed states."""
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


def _check_names(model: CompiledModel, conditions: Conditions) -> None:
    states, inputs, parameters = set(model.states), set(model.inputs), set(model.parameters)
    known = states | inputs | parameters
    for what, names, allowed in (
        ("solve", conditions.solve, known),
        ("fixed", conditions.fixed, known),
        ("guess", conditions.guess, known),
        ("rates", conditions.rates, states),
        ("outputs", conditions.outputs, set(model.outputs)),
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
    twice = sorted(set(conditions.solve) & set(conditions.fixed))
    if twice:
        raise ParameterError(f"'{twice[0]}' is in solve and in fixed: remove it from one of them")


def _refuse(search: _Search, z: Array) -> NoReturn:
    """Raise an error that names the conditions violated at the last point of the search."""
    left = search.value(z)
    n, m = len(search.unknowns), len(search.rows)
    if not np.all(np.isfinite(left)):
        raise SolveError("the equations have no finite values near the guess: give another guess")
    slope = search.slope(z)
    size = np.maximum(np.max(np.abs(slope), axis=1, initial=0.0), 1e-300)
    # Residuals are divided by the largest derivative, because rates may have different magnitudes.
    order = np.argsort(-np.abs(left) / size)
    worst = [i for i in order[:3] if abs(left[i]) > 1e-9 * max(1.0, float(np.max(np.abs(left))))]
    violated = listed(
        f"{search.names[search.rows[i]]} is {left[i] + search.targets[i]:.4g} instead of "
        f"{search.targets[i]:.4g}"
        for i in worst
    )
    if not worst:
        away = int(np.argmax(np.abs(z) / np.maximum(np.abs(search.guess), 1.0)))
        raise SolveError(
            f"no equilibrium or steady motion was found: the search diverged to {z[away]:.4g} in "
            f"'{search.unknown_names[away]}'; give a guess closer to a solution"
        )
    hint = (
        f"there are {m} conditions for {n} unknowns: name inputs or parameters in solve, or leave "
        "rates free"
        if m > n and not search.at.model.constraints
        else "name inputs or parameters in solve, leave rates free, or give another guess"
    )
    raise SolveError(f"no equilibrium or steady motion was found: {violated}; {hint}")


def _point(search: _Search, z: Array) -> TrimPoint:
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
