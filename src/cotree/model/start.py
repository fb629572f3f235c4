"""The start of a run: states and sensitivities that satisfy all equations, step by step.

In: a model, parameters, inputs, and initial values of a run. Out: a ``Start``. The steps, of which
each leaves alone what those before it found:

1. Values as they are given: the scene's or those of its operating point, then those of the run.
2. The constraints of mechanisms (:mod:`cotree.model.consistent`).
3. Algebraic unknowns, and what storages hold from what follows from it; then the modes of jumps
   inside expressions, and the unknowns again (:mod:`cotree.model.unknowns`).
4. A check of what was given twice (:mod:`cotree.model.contents`, :mod:`cotree.model.redundant`).

Where C can, it takes all of them (:mod:`cotree.model.start_in_c`); what it refuses is tried here,
and refused with the reason.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ParameterError, SingularSystemError, listed, nearest
from cotree.model.consistent import Start, consistent_start
from cotree.model.contents import check_followers, held_followers
from cotree.model.friction_modes import settle_friction, without_sticking
from cotree.model.model import Moment
from cotree.model.redundant import check_redundant
from cotree.model.start_in_c import find_in_c
from cotree.model.unknowns import settle_jumps, solve_start
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array
    from cotree.model.contents import Pair
    from cotree.model.model import CompiledModel


def find_start(at: Moment, initial: Mapping[str, float]) -> Start:
    """Find initial states and sensitivities; see :meth:`cotree.Model.start`.

    Parameters
    ----------
    at : Moment
        The model at the start.
    initial : mapping of str to float
        Initial values of states in place of the scene's, and of their sensitivities.
    """
    model = at.model
    initial, slopes = _apart(initial)
    if model.layout.has_start_equations:
        given = None
        if slopes or model.begins_at_rest:
            y, s = given_values(at, initial, slopes)
            given = np.concatenate([y, s.T.ravel()])
        found = find_in_c(at, initial, given)
        if found is not None:
            check_followers(model, initial, found.y)
            return found
    start = constrained_start(at, initial, slopes)
    if not model.layout.has_start_equations:
        return start
    held = held_followers(model, initial)
    y, s = start.y, start.s
    if start.is_chosen and model.sensitivities:
        if slopes:
            raise ParameterError(
                f"'{next(iter(slopes))}' is given, but initial values do not satisfy the "
                "constraints, and what moves them changes their sensitivities: give consistent "
                "values of all states"
            )
        # The sensitivities of a chosen start do not know how that choice depends on parameters.
        s = _by_differences(at, initial, start)
    if model.layout.n_algebraic:
        y = settle_friction(at, y, initial)
    y, s = _solve(at, y, s, held)
    y, s = settle_jumps(at, y, s, held)
    # Checks come last, since they compare with values that the steps before have found.
    check_followers(model, initial, y)
    check_redundant(at, Start(y, s), set(initial))
    return replace(start, y=y, s=s)


def _solve(at: Moment, y: Array, s: Array, held: Sequence[Pair]) -> tuple[Array, Array]:
    """Solve for the unknowns of a start; what cannot stick begins to slide, see the engine."""
    try:
        return solve_start(at, y, s, held)
    except SingularSystemError:
        sliding = without_sticking(at, y)
        if sliding is None:
            raise
    return solve_start(at, sliding, s, held)


def scene_start(model: CompiledModel) -> Start:
    """Find the start at the scene's parameter values, at t = 0."""
    return find_start(Moment(model, 0.0, model.default_parameters), {})


def check_start(model: CompiledModel) -> None:
    """Evaluate a model once at its initial state.

    Raises
    ------
    ParameterError
        If the scene's parameter values are refused.
    SingularSystemError
        If the mass matrix is singular there, or a rate is not finite.
    """
    try:
        y = scene_start(model).y
    except ParameterError:
        if model.is_rheonomic:
            return  # it may start at another time
        raise
    rates = model.rhs(0.0, y)
    for name, rate in zip(model.states, rates, strict=True):
        if not math.isfinite(rate):
            why = model.why_undefined(0.0, y, model.default_parameters, None)
            where = f" ({why})" if why else ""
            raise SingularSystemError(
                f"the rate of '{name}' is not finite at the initial state{where}: check its "
                "initial value, and the inertia and the laws that act on it"
            )


def is_slope(name: str) -> bool:
    """Tell whether a name among initial values is that of a sensitivity."""
    return name.startswith("d(")


def _apart(initial: Mapping[str, float]) -> tuple[Mapping[str, float], dict[str, float]]:
    """Separate initial values of states from those of sensitivities."""
    slopes = {name: value for name, value in initial.items() if is_slope(name)} if initial else {}
    if not slopes:
        return initial, slopes
    return {name: value for name, value in initial.items() if name not in slopes}, slopes


def _put_slopes(model: CompiledModel, slopes: Mapping[str, float], s: Array) -> None:
    """Put given sensitivities among those of the start.

    Raises
    ------
    ParameterError
        If the model has no such sensitivity, or it vanishes always.
    """
    for name, value in slopes.items():
        if name not in model.slopes:
            raise ParameterError(
                f"the model has no sensitivity '{name}'{nearest(name, model.slopes)}"
            )
        place = model.slopes[name]
        number = check_number(value, f"initial value of '{name}'")
        if number != 0.0 and not model.structure.sensitivity_pattern[place]:
            raise ParameterError(
                f"initial value of '{name}' is {number:.6g}, but no equation lets that state "
                "depend on it, so that the sensitivity is left out of the code"
            )
        s[place] = number


def given_values(
    at: Moment, initial: Mapping[str, float], slopes: Mapping[str, float] | None = None
) -> tuple[Array, Array]:
    """Return the initial states and sensitivities as given; see :func:`constrained_start`."""
    model = at.model
    names, wanted = model.states, model.sensitivities
    y, s = model.initial_values(at.t, at.p, at.u)
    for name, value in initial.items():
        if name not in names:
            raise ParameterError(_no_state(model, name))
        i = names.index(name)
        y[i] = check_number(value, f"initial value of '{name}'")
        # A run's own value depends on no parameter, only on itself.
        s[i] = [float(other == name) for other in wanted]
    # Runs of the states alone are given none.
    if slopes and wanted:
        _put_slopes(model, slopes, s)
    return y, s


def constrained_start(
    at: Moment,
    initial: Mapping[str, float],
    slopes: Mapping[str, float] | None = None,
    *,
    is_probe: bool = False,
) -> Start:
    """Take the values that are given, and move what is not onto the constraints.

    Parameters
    ----------
    at, initial
        As for :func:`find_start`, sensitivities apart.
    slopes : mapping of str to float, optional
        Initial values of sensitivities by name; of others a run's own value depends on no
        parameter.
    is_probe : bool
        Whether only the states are wanted, next to a start that was found.
    """
    model = at.model
    names, wanted = model.states, model.sensitivities
    y, s = given_values(at, initial, slopes)
    if not model.layout.has_conditions:
        return Start(y, s)
    anew = [names.index(name) for name in initial]
    kept = {i for i, is_given in enumerate(model.layout.given) if is_given}.union(anew)
    # A state whose initial value has a sensitivity counts as given.
    kept |= {names.index(name) for name in wanted if name in names}
    # Constraints depend on time and the scene's own inputs alone.
    own = replace(at, u=None)
    return consistent_start(own, y, s, kept, is_probe=is_probe, anew=anew)


def _no_state(model: CompiledModel, name: str) -> str:
    for row in model.layout.positions:
        if row.name == name:
            return (
                f"the position '{name}' follows along an f-circuit: give initial values of "
                f"{listed([model.states[i] for _, i in row.terms])}"
            )
    return f"the model has no state '{name}'{nearest(name, model.states)}"


def _by_differences(at: Moment, initial: Mapping[str, float], start: Start) -> Array:
    """Differentiate a start that was chosen as the least move, shape (n_states, n_parameters).

    The choice depends on the parameters through the constraints' gradients, whose derivatives no
    kernel has: five points give it to ten digits.
    """
    model, p, s = at.model, at.p, start.s.copy()
    for j, name in enumerate(model.sensitivities):
        if name in model.states:
            size = max(1.0, abs(start.y[model.states.index(name)]))
        else:
            size = max(abs(p[model.parameters.index(name)]), 1e-3)
        # h^4 of this step is about as small as what rounding leaves of the differences.
        step, total = 1e-3 * size, np.zeros(len(model.states))
        # (f(-2h) - 8 f(-h) + 8 f(h) - f(2h)) / 12h, whose error is of order h^4.
        for place, weight in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):
            moved, given = p.copy(), dict(initial)
            if name in model.states:
                own = start.y[model.states.index(name)]
                given[name] = float(own + place * step)
            else:
                moved[model.parameters.index(name)] += place * step
            aside = Moment(model, at.t, moved)
            total += weight * constrained_start(aside, given, is_probe=True).y
        s[:, j] = total / (12.0 * step)
    return np.where(
        model.structure.sensitivity_pattern, s, 0.0
    )  # of what does not depend, rounding is left
