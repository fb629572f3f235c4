"""Events of a scene bound to its states: what each sets."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.equations import EventRow
from cotree.errors import SceneError, nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.equations import State
    from cotree.formulation.system import System
    from cotree.scene.description import SceneDescription
    from cotree.scene.events import Event


def bind_events(
    scene: SceneDescription, system: System, states: Sequence[State]
) -> tuple[EventRow, ...]:
    """Say which states the events of a scene set.

    Raises
    ------
    SceneError
        If an event sets what is no state with a rate of its own, or a speed that its impact
        changes.
    """
    return tuple(_bind(event, system, states) for event in scene.events.values())


def _bind(event: Event, system: System, states: Sequence[State]) -> EventRow:
    places = {state.name: i for i, state in enumerate(states)}
    speeds = {speed.name for speed in system.speeds}
    if event.restitution is not None and not speeds:
        raise SceneError(
            f"event '{event.name}' has an impact, but nothing in the scene has mass and moves"
        )
    for target in event.set:
        whose = f"event '{event.name}' sets '{target}'"
        if target in system.inputs:
            raise SceneError(
                f"{whose}, an input, which comes from outside: set a mode, and let what names the "
                "input name the mode, too"
            )
        if target not in places:
            known = [state.name for state in states if not state.is_algebraic]
            raise SceneError(f"{whose}, which is no state and no mode{nearest(target, known)}")
        if states[places[target]].is_algebraic:
            raise SceneError(
                f"{whose}, an algebraic unknown, which the equations give at each instant: set a "
                "state that has a rate, or a mode that these equations use"
            )
        if event.restitution is not None and target in speeds:
            raise SceneError(f"{whose}, a speed, but its impact changes all speeds: leave one out")
    return EventRow(
        event.name,
        event.direction,
        event.is_stop,
        tuple(places[target] for target in event.set),
        event.restitution is not None,
    )
