"""Modes and events of a scene, each checked when it is declared."""

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
        Its initial value, a function of parameters. If the mode represents a jump inside an
        expression, this is the jumping function, which depends on states.
    doc : str
        Its meaning as text.
    is_jump : bool
        Whether the mode represents a jump inside an expression.
    """

    name: str
    initial: Expression
    doc: str = ""
    is_jump: bool = False


class ModePart(IntEnum):
    """Roles of events whose modes are selected together, numbered as in ``cotree_jumps.h``."""

    NONE = 0  # no mode is selected
    SLIP = 2  # slip rate times the mode
    FORWARD_LIMIT = 3  # distance of the friction force from its forward limit
    BACKWARD_LIMIT = 4  # distance of the friction force from its backward limit
    ENGAGED = 5  # positive while a clutch is engaged
    TURN = 6  # angle by which the sliding direction on a plane may still turn
    FIRST_IMPULSE = 7  # first component of the friction impulse on a plane
    SECOND_IMPULSE = 8
    LOAD = 9  # load times the sign that is assumed in the laws of its losses
    UPPER_GAP = 10  # distance from a rigid stop's upper limit
    LOWER_GAP = 11  # distance from a rigid stop's lower limit
    FORCE = 12  # contact force of a closed stop, positive away from the limit
    REBOUND = 13  # rebound speed minus the rest threshold


@dataclass(frozen=True)
class Event:
    """An event that occurs when an expression crosses zero.

    Attributes
    ----------
    name : str
        Its name.
    when : Expression
        Event function: an expression whose zero crossing is the event.
    direction : int
        -1 for downwards, 1 for upwards, 0 for both.
    set : mapping of str to Expression
        New values of states and modes, as functions of their previous values.
    is_terminal : bool
        Whether the run ends at the event.
    restitution : Expression or None
        Coefficient of an impact: minus the rate of ``when`` after it, divided by the rate before
        it.
    is_jump : bool
        Whether it represents a jump inside an expression.
    part : ModePart
        Role of the event for an edge with dry friction or a rigid stop.
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
        """All expressions of the event."""
        # The condition comes first, as ``event_expressions`` requires.
        own = (self.when, *self.set.values())
        return own if self.restitution is None else (*own, self.restitution)


def make_event(
    name: object, when: object, direction: object, values: object, stop: object, impact: object
) -> Event:
    """Create a checked event; see :meth:`SceneDescription.event`."""
    accepted = check_name("event", name)
    whose = f"event '{accepted}'"
    # True equals 1 in Python, but it is not a direction.
    if isinstance(direction, bool) or direction not in (-1, 0, 1):
        raise SceneError(
            f"direction of {whose} is {brief(direction)}: give -1 (downwards), 1 (upwards) or 0 "
            "(both)"
        )
    if not isinstance(stop, bool):
        raise SceneError(f"stop of {whose} must be true or false")
    if not isinstance(values, Mapping):
        raise SceneError(f"set of {whose} must be a table of states and modes")
    # TOML keys are strings, but Python keys may be of any type.
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
    """Return the expressions of events in a fixed order: all conditions, then all others."""
    listed = tuple(events)
    return (
        # Conditions come first, so that the event functions form one block of the results.
        *(event.when for event in listed),
        *(value for event in listed for value in event.expressions[1:]),
    )
