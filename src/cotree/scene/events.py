"""Modes and events of a scene, checked one statement at a time.

A mode is a number that only events change. An event takes place at a zero crossing of an
expression; it sets states and modes, applies an impulse, or ends the run.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING

from cotree.errors import SceneError, brief, check_known
from cotree.naming import check_name
from cotree.scene.expressions import Expression, parse

if TYPE_CHECKING:
    from collections.abc import Iterable


@dataclass(frozen=True)
class Mode:
    """A number that only events change.

    Attributes
    ----------
    name : str
        Its name in expressions and results.
    initial : Expression
        Its value at the start, of parameters. A mode that represents a jump inside an expression
        starts at the value of the jumping function, an expression of the states.
    doc : str
        Its meaning, for people.
    is_jump : bool
        Whether it represents such a jump.
    """

    name: str
    initial: Expression
    doc: str = ""
    is_jump: bool = False


class ModePart(IntEnum):
    """Roles of events whose modes are chosen together, numbered as in ``cotree_jumps.h``."""

    NONE = 0  # selects no mode
    SLIP = 2  # slip rate times the mode
    FORWARD_LIMIT = 3  # forward limit: distance of the friction force to it
    BACKWARD_LIMIT = 4  # distance of the friction force to its backward limit
    ENGAGED = 5  # engaged: positive while a clutch is engaged
    TURN = 6  # angle by which the direction of sliding on a plane may still turn
    FIRST_IMPULSE = 7  # components of the friction impulse on a plane
    SECOND_IMPULSE = 8
    LOAD = 9  # load times the sign that the laws of its losses assume
    UPPER_GAP = 10  # upper gap: distance to a rigid stop at its upper limit
    LOWER_GAP = 11  # gap of a rigid stop at its lower limit
    FORCE = 12  # force: contact force of a closed stop, positive away from the limit
    REBOUND = 13  # rebound: rebound speed minus the rest threshold


@dataclass(frozen=True)
class Event:
    """An event at a zero crossing of an expression.

    Attributes
    ----------
    name : str
        Its name.
    when : Expression
        Expression whose zero crossing is the event.
    direction : int
        -1 for downwards, 1 for upwards, 0 for both.
    set : mapping of str to Expression
        New values of states and modes, as functions of the values before.
    is_terminal : bool
        Whether the run ends there.
    restitution : Expression or None
        Of an impact: the rate of ``when`` after it over that before, with its sign changed.
    is_jump : bool
        Whether it represents a jump inside an expression.
    part : ModePart
        Role of its function for an edge with dry friction, or for a rigid stop.
    """

    name: str
    when: Expression
    direction: int
    set: Mapping[str, Expression]
    is_terminal: bool = False
    restitution: Expression | None = None
    is_jump: bool = False
    part: ModePart = ModePart.NONE

    @property
    def expressions(self) -> tuple[Expression, ...]:
        """Every expression of the event."""
        # The condition is first: ``event_expressions`` relies on this.
        own = (self.when, *self.set.values())
        return own if self.restitution is None else (*own, self.restitution)


def make_event(
    name: object, when: object, direction: object, values: object, stop: object, impact: object
) -> Event:
    """Check an event; see :meth:`SceneDescription.event`."""
    accepted = check_name("event", name)
    whose = f"event '{accepted}'"
    # True equals 1 in Python, but is no direction.
    if isinstance(direction, bool) or direction not in (-1, 0, 1):
        raise SceneError(
            f"direction of {whose} is {brief(direction)}: give -1 (downwards), 1 (upwards) or 0 "
            "(both)"
        )
    if not isinstance(stop, bool):
        raise SceneError(f"stop of {whose} must be true or false")
    if not isinstance(values, Mapping):
        raise SceneError(f"set of {whose} must be a table of states and modes")
    # Keys are strings in TOML, but may be of any type in Python.
    for target in values:
        if not isinstance(target, str):
            raise SceneError(f"set of {whose} holds {brief(target)}: give names in quotes")
    return Event(
        accepted,
        parse(when, f"when of {whose}"),
        int(direction),
        {target: parse(v, f"'{target}' in set of {whose}") for target, v in values.items()},
        stop,
        _restitution(impact, whose),
    )


def _restitution(impact: object, whose: str) -> Expression | None:
    if impact is None:
        return None
    if not isinstance(impact, Mapping):
        raise SceneError(f"impact of {whose} must be a table with the field 'restitution'")
    check_known(impact, ("restitution",), f"impact of {whose} has no field")
    if "restitution" not in impact:
        raise SceneError(f"impact of {whose} needs the field 'restitution'")
    return parse(impact["restitution"], f"restitution of {whose}")


def event_expressions(events: Iterable[Event]) -> tuple[Expression, ...]:
    """List the expressions of events in one fixed order: every ``when``, then the others."""
    listed = tuple(events)
    return (
        # Conditions are first, so that the event functions form one block of these results.
        *(event.when for event in listed),
        *(value for event in listed for value in event.expressions[1:]),
    )
