"""Events of a scene, bound to the states that they set."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.dag.nodes import PARAMETER, kinds_in, substitute
from cotree.equations import EventRow
from cotree.errors import SceneError, nearest
from cotree.scene.events import ModePart

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import State
    from cotree.formulation.system import System
    from cotree.scene.description import SceneDescription
    from cotree.scene.events import Event


def bind_events(
    scene: SceneDescription, system: System, states: Sequence[State]
) -> tuple[EventRow, ...]:
    """Bind the events of a scene to the states that they set.

    Raises SceneError if an event sets anything but modes and states with rates of their own, or
    sets a speed that its impact changes.
    """
    places = {state.name: i for i, state in enumerate(states)}
    speeds = {speed.name: places[speed.name] for speed in system.speeds}
    rows: list[EventRow] = []
    # Conditions come first; see event_expressions. Results are ordered as outputs, one expression
    # for each event, then new values and restitutions event by event.
    place, result = len(scene.outputs) + len(scene.events), 0
    for i, event in enumerate(scene.events.values(), start=len(scene.outputs)):
        _check(event, system, states, places, speeds)
        has_impact = event.restitution is not None
        targets = tuple(places[target] for target in event.set)
        new_values = range(place, place + len(targets))
        if has_impact:
            # An impact may change every speed of the mechanism, through its constraints.
            targets += tuple(speeds.values())
        rows.append(
            EventRow(
                event.name,
                event.direction,
                event.is_terminal,
                targets,
                i,
                new_values,
                new_values.stop if has_impact else None,
                range(result, result + len(targets)),
                event.is_jump,
                event.is_jump and any(target in event.when.names for target in event.set),
                int(event.part),
                event.part is ModePart.REBOUND,
                event.part is ModePart.FORCE,
                event.part is ModePart.SLIP and len(targets) > 2,
            )
        )
        # The restitution follows the new values.
        place, result = new_values.stop + has_impact, result + len(targets)
    return tuple(rows)


def _check(
    event: Event,
    system: System,
    states: Sequence[State],
    places: Mapping[str, int],
    speeds: Collection[str],
) -> None:
    """Raise if an event sets a variable that cannot be set."""
    if event.restitution is not None and not speeds:
        raise SceneError(f"event '{event.name}' has an impact, but the scene has no moving mass")
    for target in event.set:
        whose = f"event '{event.name}' sets '{target}'"
        if target in system.inputs:
            raise SceneError(
                f"{whose}, an input, which is given from outside: set a mode, and use the "
                "mode wherever the input is used"
            )
        if target not in places:
            known = [state.name for state in states if not state.is_algebraic]
            raise SceneError(
                f"{whose}, which is neither a state nor a mode{nearest(target, known)}"
            )
        if states[places[target]].is_algebraic:
            raise SceneError(
                f"{whose}, an algebraic unknown, which the equations determine at each "
                "instant: set a state that has a rate, or a mode that these equations use"
            )
        if event.restitution is not None and target in speeds:
            raise SceneError(
                f"{whose}, a speed, but its impact changes all speeds: remove one of the two"
            )


def started(
    states: Sequence[State], jumps: Mapping[str, Node], system: System
) -> tuple[State, ...]:
    """Return the modes of jumps by the signs of their expressions at the initial states, at t = 0.

    A mode that depends on more than parameters starts at zero;
    :func:`cotree.model.start.find_start` finds it.
    """
    if not jumps:
        return tuple(states)
    of_time = dict(zip(system.inputs.values(), system.input_values, strict=True))
    known = {state.symbol: state.initial for state in states} | {system.time: system.dag.zero}
    for state in states:
        if state.name in jumps:
            # In order, so that a jump may depend on modes of jumps before it.
            known[state.symbol] = _at_start(jumps[state.name], of_time, known)
    return tuple(
        replace(state, initial=known[state.symbol]) if state.name in jumps else state
        for state in states
    )


def _at_start(value: Node, of_time: Mapping[Node, Node], known: Mapping[Node, Node]) -> Node:
    try:
        (found,) = substitute(substitute([value], of_time), known)
    except (ArithmeticError, ValueError):  # a constant without a value: later checks raise
        return value.dag.zero
    is_known = kinds_in([found]) <= {PARAMETER}
    return found if is_known else value.dag.zero
