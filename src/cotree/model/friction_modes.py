"""Modes of dry friction at a single point: what they are there, and what contradicts them.

A run chooses the modes of all edges together, in C. A point that is linearised about, or searched
for, has its modes given; they are compared with speeds and forces, and not chosen anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import Error, SolveError
from cotree.model.unknowns import solve_states
from cotree.scene.events import ModePart

if TYPE_CHECKING:
    from collections.abc import Collection

    from cotree.model.arrays import Array
    from cotree.model.model import Moment

#: Runs and searches hold speeds and forces to their tolerances, which are rarely above this share.
_CLOSE = 1e-6

#: Modes while an edge sticks and while nothing presses it together.
_STUCK, _FREE = 0.0, 2.0
_MODES = (_STUCK, 1.0, -1.0, _FREE)


def settle_friction(at: Moment, y: Array, fixed: Collection[str] = ()) -> Array:
    """Give edges that move relative to their mode the mode of their speed.

    Parameters
    ----------
    at : Moment
        The model, with time, parameters and inputs.
    y : ndarray, shape (n_states,)
        States that satisfy the equations with the modes that they hold.
    fixed : collection of str
        Modes that stay.

    Returns
    -------
    ndarray, shape (n_states,)
    """
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


def guess_friction(at: Moment, y: Array, given: Collection[str]) -> Array:
    """Give a guess the modes of its dry friction, and on joints the forces that these ask for.

    What sticks is an equilibrium where its force holds it: a search would move it otherwise.

    Parameters
    ----------
    at, y
        As for :func:`settle_friction`.
    given : collection of str
        Modes that stay.
    """
    if not any(row.part == ModePart.SLIP for row in at.model.layout.events):
        return y
    y = settle_friction(at, y, given)
    try:
        return solve_states(at, y)
    except Error:  # the search says what is wrong
        return y


def without_sticking(at: Moment, y: Array) -> Array | None:
    """Return a point at which all that sticks slides forwards; None where nothing sticks."""
    modes = [row.targets[0] for row in at.model.layout.events if row.part == ModePart.SLIP]
    stuck = [mode for mode in modes if y[mode] == _STUCK]
    if not stuck:
        return None
    sliding = y.copy()
    sliding[stuck] = 1.0
    return sliding


def check_friction(at: Moment, y: Array) -> None:
    """Refuse a point at which a mode of dry friction is not one of its equations' own.

    Raises
    ------
    SolveError
        If an edge sticks beyond its limits or while it moves, slides against its mode, or is
        engaged or not as its mode does not say.
    """
    for place, speed in _speeds(at, y).items():
        edge, mode = at.model.states[place].removesuffix(".mode"), y[place]
        if mode not in _MODES:
            raise SolveError(
                f"'{edge}.mode' is {mode:.6g} at this point: it is 0 where the edge sticks, 1 and "
                "-1 where it slides, 2 where nothing presses it together"
            )
        grip = _values(at, y, ModePart.ENGAGED).get(place, 1.0)
        if (grip > 0.0) == (mode == _FREE):
            raise _refused(edge, mode, f"its faces would rub with {grip:.6g}")
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
        # The sum is the distance of both limits from each other.
        width = sum(abs(way) for way in ways if np.isfinite(way))
        if min(ways) < -_CLOSE * width:
            raise _refused(edge, mode, f"its force is beyond its limit by {-min(ways):.6g}")


def _refused(edge: str, mode: float, why: str) -> SolveError:
    shown = dict(
        zip(_MODES, ("sticks", "slides forwards", "slides backwards", "is disengaged"), strict=True)
    )[mode]
    return SolveError(
        f"'{edge}' {shown} at this point by its mode {mode:g}, but {why}: give another state or "
        f"guess, such as a state of a run, or another '{edge}.mode'"
    )


def _still(y: Array) -> float:
    """Give the largest speed that is none."""
    return _CLOSE * max(1.0, float(np.max(np.abs(y), initial=0.0)))


def _values(at: Moment, y: Array, part: ModePart) -> dict[int, float]:
    """Evaluate what one part of each edge's events looks at, by the place of its mode."""
    rows = at.model.layout.events
    if not any(row.part == part for row in rows):
        return {}
    found = at.event_values(y)
    return {
        row.targets[0]: float(value)
        for row, value in zip(rows, found, strict=True)
        if row.part == part
    }


def _speeds(at: Moment, y: Array) -> dict[int, float]:
    """Evaluate the relative speed of each edge, by the place of its mode."""
    moving = y.copy()
    for row in at.model.layout.events:
        if row.part == ModePart.SLIP:
            # Its event looks at the speed times the mode.
            moving[row.targets[0]] = 1.0
    return _values(at, moving, ModePart.SLIP)
