"""Algebraic unknowns, storage contents and modes at a point.

Storage contents follow from across or through variables: a scene may prescribe a voltage although
the state is a charge, and the tolerance of a charge follows from that of the voltage. Modes of dry
friction are guessed and checked here for linearisation and trim; during a run, C determines the
modes of all edges together.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import Error, SolveError
from cotree.scene.events import ModePart

if TYPE_CHECKING:
    from collections.abc import Collection

    from cotree.model.algebraic import Algebraic
    from cotree.model.arrays import Array
    from cotree.model.bound import BoundModel


def content_sizes(at: BoundModel, y: Array) -> Array | None:
    """Return a factor for the absolute tolerance of each state, (n_states,); None if all are one.

    For a storage content, the factor is the change of the content per unit of the across or through
    variable, such as a capacitance.
    """
    followers = at.model.layout.followers
    if not followers:
        return None
    sizes, jacobian = np.ones(len(y)), np.abs(at.model.jacobian(at.t, y, at.p, at.u))
    for total, follower in followers:
        # This row contains the derivatives of the storage's terminal equation. If its variable has
        # no effect at this point, the largest other derivative replaces the capacitance.
        own = jacobian[follower, follower] or np.max(np.delete(jacobian[follower], total))
        if own > 0.0 and np.isfinite(own):
            sizes[total] = own
    return sizes


def settle_jumps(at: BoundModel, y: Array) -> Array:
    """Return the states after correction of the jump modes that contradict them."""
    rows, settled = at.model.layout.events, y.copy()
    for row, value in zip(rows, at.event_values(y) if rows else (), strict=True):
        # An event has occurred if the sign of its function equals its direction.
        if row.is_jump and row.direction * value > 0.0:
            settled[row.targets[0]] = at.call("jumps", settled)[row.results.start]
    return settled


def contradicting_jumps(at: BoundModel) -> SolveError:
    """Return the exception for modes of jumps that contradict the resulting states."""
    model = at.model
    rows = [row for row in model.layout.events if row.is_jump]
    names = ", ".join(f"'{name}'" for name in {model.states[row.targets[0]]: 0 for row in rows})
    return SolveError(
        f"no values of {names} are consistent with the states that result from them at t = "
        f"{at.t:g}: the jump reverses its own condition"
    )


def solve_states(at: BoundModel, y: Array) -> Array:
    """Return the states with algebraic unknowns that satisfy their equations."""
    if at.model.layout.n_algebraic:
        y = y.copy()
        of_model(at).solve(at.t, y)
    return y


def of_model(at: BoundModel) -> Algebraic:
    """Return the algebraic equations of a model for fixed parameters and inputs."""
    # Imported here, because most models have no algebraic unknowns.
    from cotree.model.algebraic import Algebraic
    from cotree.model.linear import is_sparse

    none, model, p, u = np.zeros(0), at.model, at.p, at.u
    rhs, layout = model.bound("rhs", p), model.layout
    n_algebraic, cut = layout.n_algebraic, len(layout.states) - layout.n_algebraic
    # The matrix to factorise has only the rows of the algebraic equations.
    n_own = sum(row >= cut for row in layout.row_indices)
    jacobian = model.bound_jacobian(p, is_sparse=is_sparse(n_algebraic, n_own))

    # This is called only if Newton's method fails from the guess.
    def improve(t: float, y: Array) -> Array | None:
        return model.junctions.at(t, y, p, replace(at, t=t).inputs).search(y[cut:])

    return Algebraic(
        lambda t, y: rhs(t, y, none, u),
        lambda t, y: jacobian(t, y, u),
        model.states,
        n_algebraic,
        improve,
    )


#: Relative tolerance for speeds and forces, larger than the errors of runs and searches.
_CLOSE = 1e-6

#: Modes of a dry friction edge that sticks, and of one without normal force.
_STUCK, _FREE = 0.0, 2.0
_MODES = (_STUCK, 1.0, -1.0, _FREE)


def settle_friction(at: BoundModel, y: Array, fixed: Collection[str] = ()) -> Array:
    """Return the states with the friction modes that the forces require, except ``fixed`` ones."""
    settled = y.copy()
    speeds, grips = _speeds(at, y), _values(at, y, ModePart.ENGAGED)
    states = at.model.states
    for place, speed in speeds.items():
        if states[place] in fixed:
            continue
        if grips.get(place, 1.0) <= 0.0:
            settled[place] = _FREE
        elif abs(speed) > _still(y):
            settled[place] = np.sign(speed)
        elif y[place] == _FREE:
            settled[place] = _STUCK
    return settled


def guess_friction(at: BoundModel, y: Array, given: Collection[str]) -> Array:
    """Initialise the modes of dry friction in a guess, and the joint forces on which they depend.

    Without the mode, the search would move an edge that sticks, although it is in equilibrium at
    any force within its limits.
    """
    if not any(row.part == ModePart.SLIP for row in at.model.layout.events):
        return y
    y = settle_friction(at, y, given)
    try:
        return solve_states(at, y)
    except Error:  # the search raises the error again
        return y


def check_friction(at: BoundModel, y: Array) -> None:
    """Raise SolveError if modes of dry friction contradict speeds or forces."""
    for place, speed in _speeds(at, y).items():
        edge, mode = at.model.states[place].removesuffix(".mode"), y[place]
        if mode not in _MODES:
            raise SolveError(
                f"'{edge}.mode' is {mode:.6g} at this point: 0 means sticking, 1 and -1 sliding, "
                "2 no normal force"
            )
        grip = _values(at, y, ModePart.ENGAGED).get(place, 1.0)
        if (grip > 0.0) == (mode == _FREE):
            raise _refused(edge, mode, f"its grip would be {grip:.6g}")
        if mode == _FREE:
            continue
        if mode == _STUCK and abs(speed) > _still(y):
            raise _refused(edge, mode, f"its speed is {speed:.6g}")
        if mode * speed < -_still(y):
            raise _refused(edge, mode, f"its speed is {speed:.6g}")
        ways = [
            _values(at, y, part).get(place, np.inf)
            for part in (ModePart.FORWARD_LIMIT, ModePart.BACKWARD_LIMIT)
        ]
        # The distances from both limits add up to the width of the force range.
        width = sum(abs(way) for way in ways if np.isfinite(way))
        if min(ways) < -_CLOSE * width:
            raise _refused(edge, mode, f"its force exceeds its limit by {-min(ways):.6g}")


def _refused(edge: str, mode: float, why: str) -> SolveError:
    shown = dict(
        zip(_MODES, ("sticks", "slides forwards", "slides backwards", "is disengaged"), strict=True)
    )[mode]
    return SolveError(
        f"'{edge}' {shown} at this point according to its mode {mode:g}, but {why}: give another "
        f"state or guess, such as a state of a run, or another '{edge}.mode'"
    )


def _still(y: Array) -> float:
    """Return the speed below which an edge is at rest."""
    return _CLOSE * max(1.0, float(np.max(np.abs(y), initial=0.0)))


def _values(at: BoundModel, y: Array, part: ModePart) -> dict[int, float]:
    """Return the values of one kind of event function by the index of their mode."""
    rows = at.model.layout.events
    if not any(row.part == part for row in rows):
        return {}
    found = at.event_values(y)
    return {
        row.targets[0]: float(value)
        for row, value in zip(rows, found, strict=True)
        if row.part == part
    }


def _speeds(at: BoundModel, y: Array) -> dict[int, float]:
    """Return the relative speed of each dry friction edge by the index of its mode."""
    moving = y.copy()
    for row in at.model.layout.events:
        if row.part == ModePart.SLIP:
            # The event function is the speed times the mode.
            moving[row.targets[0]] = 1.0
    return _values(at, moving, ModePart.SLIP)
