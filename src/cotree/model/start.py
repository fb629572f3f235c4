"""The start of a run: initial states and sensitivities that satisfy all equations.

C takes these steps (:mod:`cotree.model.start_in_c`), each without changing earlier results:

1. Take the initial values of the scene or its operating point; values of the run replace them.
2. Satisfy the constraints of mechanisms (``templates/runtime/start``).
3. Find the algebraic unknowns, and storage contents from the variables that determine them; then
   the modes of jumps inside expressions, and the unknowns again.
4. Check redundant initial values of network variables, which must agree with the values that follow
   from the states. If not, the error lists all contradictions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ParameterError, SingularSystemError, SolveError, listed, nearest
from cotree.model.bound import BoundModel
from cotree.model.kernels import NO_COMPILER
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.model.arrays import Array
    from cotree.model.model import CompiledModel


#: Relative tolerance for the agreement of two initial values, one of which determines the other.
_AGREE = 1e-6


@dataclass(frozen=True)
class Start:
    """Consistent initial states and sensitivities of a run.

    Attributes
    ----------
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        Initial states and their sensitivities.
    is_chosen : bool
        Whether some states are determined neither by constraints nor by initial values. They are
        chosen such that the change of all states has minimum norm, and ``s`` contains the
        derivatives.
    note : str
        A message on initial values that change with a parameter, or an empty string.
    is_mended : bool
        Whether prescribed initial values had to be changed.
    on_jump : str
        If an expression jumps exactly at the start, the reason why no sensitivities exist;
        otherwise an empty string.
    """

    y: Array
    s: Array
    is_chosen: bool = False
    note: str = ""
    is_mended: bool = False
    on_jump: str = ""

    @cached_property
    def z(self) -> Array:
        """States, then the sensitivities to each parameter, as in the solver's state vector."""
        found = np.concatenate([self.y, self.s.T.ravel()])
        found.flags.writeable = False  # all runs with this start share the array
        return found


def _check_followers(model: CompiledModel, initial: Mapping[str, float], y: Array) -> None:
    """Raise ParameterError if a run sets a storage content and a variable that contradicts it."""
    names = model.states
    for total, follower in model.layout.followers:
        if names[total] in initial and names[follower] in initial:
            given, found = initial[names[follower]], float(y[follower])
            # The negation makes nan raise an error, too.
            if not abs(given - found) <= _AGREE * max(abs(given), abs(found)):
                raise ParameterError(
                    f"initial values contradict each other: '{names[follower]}' is given as "
                    f"{given:.6g} but is {found:.6g} by '{names[total]}'; leave one out"
                )


def find_start(at: BoundModel, initial: Mapping[str, float]) -> Start:
    """Find initial states and sensitivities; ``initial`` replaces initial values of the scene."""
    model = at.model
    initial, slopes = _apart(initial)
    if not model.layout.has_start_equations:
        return Start(*_given_values(at, initial, slopes))
    if model.layout.has_only_norms and not (model.sensitivities or model.begins_at_rest):
        y, s = _given_values(at, initial, slopes)
        # The search in C, which takes a second to compile, would not change these values.
        if all(sum(y[i : i + 4] ** 2) == 1.0 for i in model.layout.quaternions):
            return Start(y, s)
    _check_initial(model, initial)
    starts, given = model.start_in_c, None
    if starts is None:
        raise SolveError(NO_COMPILER)
    if slopes or model.begins_at_rest:
        y, s = _given_values(at, initial, slopes)
        given = np.concatenate([y, s.T.ravel()])
    found = starts.find(at, initial, given)
    if found.is_chosen and model.sensitivities and slopes:
        raise ParameterError(
            f"'{next(iter(slopes))}' is given, but the initial values violate the constraints, "
            "and their correction changes this sensitivity: give consistent values of all states"
        )
    _check_followers(model, initial, found.y)
    return found


def scene_start(model: CompiledModel) -> Start:
    """Find the start for the scene's parameter values at t = 0."""
    return find_start(BoundModel(model, 0.0, model.default_parameters), {})


def check_start(model: CompiledModel) -> None:
    """Raise ParameterError or SingularSystemError if the initial state cannot be evaluated."""
    try:
        y = scene_start(model).y
    except ParameterError:
        if model.traits.is_rheonomic:
            return  # constraints depend on time, and runs may start at another time
        raise
    rates = model.rhs(0.0, y)
    for name, rate in zip(model.states, rates, strict=True):
        if not math.isfinite(rate):
            why = model.why_undefined(0.0, y, model.default_parameters, None)
            where = f" ({why})" if why else ""
            raise SingularSystemError(
                f"the rate of '{name}' is not finite at the initial state{where}: check its "
                "initial value, and the inertia and laws that determine it"
            )


def is_slope(name: str) -> bool:
    """Return whether the name of an initial value denotes a sensitivity, d(STATE)/d(PARAMETER)."""
    return name.startswith("d(")


def _apart(initial: Mapping[str, float]) -> tuple[Mapping[str, float], dict[str, float]]:
    slopes = {name: value for name, value in initial.items() if is_slope(name)} if initial else {}
    if not slopes:
        return initial, slopes
    return {name: value for name, value in initial.items() if name not in slopes}, slopes


def _put_slopes(model: CompiledModel, slopes: Mapping[str, float], s: Array) -> None:
    """Insert initial sensitivities into s; raise ParameterError if unknown or always zero."""
    for name, value in slopes.items():
        if name not in model.slopes:
            raise ParameterError(
                f"the model has no sensitivity '{name}'{nearest(name, model.slopes)}"
            )
        place = model.slopes[name]
        number = check_number(value, f"initial value of '{name}'")
        if number != 0.0 and not model.structure.sensitivity_pattern[place]:
            raise ParameterError(
                f"the initial value of '{name}' is {number:.6g}, but this sensitivity is always "
                "zero, since no equation relates the state to the parameter: remove the value"
            )
        s[place] = number


def _check_initial(model: CompiledModel, initial: Mapping[str, float]) -> None:
    for name, value in initial.items():
        if name not in model.states:
            raise ParameterError(_no_state(model, name))
        check_number(value, f"initial value of '{name}'")


def _given_values(
    at: BoundModel, initial: Mapping[str, float], slopes: Mapping[str, float]
) -> tuple[Array, Array]:
    """Return the initial states and sensitivities before equations are solved.

    Initial values of the run do not depend on parameters, unless ``slopes`` contains derivatives.
    """
    model = at.model
    names, wanted = model.states, model.sensitivities
    _check_initial(model, initial)
    y, s = model.initial_values(at.t, at.p, at.u)
    for name, value in initial.items():
        i = names.index(name)
        y[i] = float(value)
        # The derivative of a run's initial value is one for itself and zero for other parameters.
        s[i] = [float(other == name) for other in wanted]
    # A run without sensitivities ignores initial sensitivities.
    if slopes and wanted:
        _put_slopes(model, slopes, s)
    return y, s


def _no_state(model: CompiledModel, name: str) -> str:
    for row in model.layout.positions:
        if row.name == name:
            return (
                f"an f-circuit determines the position '{name}': give initial values of "
                f"{listed([model.states[i] for _, i in row.terms])} instead"
            )
    return f"the model has no state '{name}'{nearest(name, model.states)}"
