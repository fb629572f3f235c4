"""Simultaneous events of an SBML model: their order, and which of them become one event.

SBML evaluates the assigned values when the trigger of an event becomes true, before any other event
acts (Level 3, section 4.11). Events of a scene act one after the other, each on the values that the
previous one leaves. Events with the same trigger therefore become one event of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

from cotree.errors import brief
from cotree.readers.sbml_names import TIME, names_of, rate_dependencies

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from cotree.readers.sbml_content import SbmlContent, SbmlEvent
    from cotree.readers.sbml_events import Crossing


@dataclass(frozen=True)
class Triggered:
    """An event, and the expressions that cross zero when it occurs: in a run and at its start."""

    event: SbmlEvent
    crossing: Crossing
    at_start: Crossing


class Dependencies:
    """Dependencies of the formulas of a model, through rules, reaction rates and compartments.

    Parameters
    ----------
    content : SbmlContent
        The model.
    """

    def __init__(self, content: SbmlContent) -> None:
        self._content = content
        self._laws = {reaction.id: reaction.law for reaction in content.reactions}
        self._rates = rate_dependencies(content)

    def of(self, node: object) -> frozenset[str]:
        """List the identifiers that the value of a formula depends on."""
        functions, quantities = self._content.functions, self._content.quantities
        found: set[str] = set()
        waiting = [*names_of(node, functions)]
        while waiting:
            id = waiting.pop()
            if id in found:
                continue
            found.add(id)
            waiting += self._rates.get(id, ())
            formula = self._content.assignments.get(id) or self._laws.get(id)
            if formula is not None:
                waiting += names_of(formula.node, functions)
            # The concentration of a species changes with the size of its compartment.
            elif id in quantities and quantities[id].compartment:
                waiting.append(quantities[id].compartment)
        return frozenset(found)

    def read_by(self, event: SbmlEvent) -> frozenset[str]:
        """List the identifiers that the values assigned by an event depend on."""
        return frozenset().union(*(self.of(formula.node) for formula in event.sets.values()))


def groups_of(rows: Sequence[Triggered], dependencies: Dependencies) -> list[list[Triggered]]:
    """Sort events by priority, and group those that become one event of the scene.

    Parameters
    ----------
    rows : sequence of Triggered
        The events in the order of the file.
    dependencies : Dependencies
        Dependencies of the same model.

    Returns
    -------
    list of list of Triggered
        Events of equal priority remain in the order of the file, since SBML leaves it undefined.

    Raises
    ------
    SceneError
        If events with one trigger affect each other in a way that a scene cannot represent.
    """
    ordered = sorted(rows, key=lambda row: -row.event.priority)
    by_crossing: dict[tuple[str, int], list[Triggered]] = {}
    for row in ordered:
        by_crossing.setdefault((row.crossing.text, row.crossing.direction), []).append(row)
    found: list[list[Triggered]] = []
    for group in by_crossing.values():
        found += _split(group, dependencies)
    return found


def _split(group: list[Triggered], dependencies: Dependencies) -> list[list[Triggered]]:
    """Group events of one trigger, or separate them if they depend on each other's values."""
    _check_order(group)
    changed: set[str] = set()
    is_in_turn = False
    for row in group:
        event = row.event
        if changed & dependencies.of(event.trigger.node) and not event.is_persistent:
            raise event.trigger.at.error(
                f"event '{brief(event.id)}' is not persistent, and an event with the same "
                "trigger may make it false: combine them into one event"
            )
        if changed & dependencies.read_by(event) and not event.uses_trigger_values:
            is_in_turn = True
        changed |= event.sets.keys()
    if not is_in_turn:
        return [group]
    _check_in_turn(group, dependencies)
    return [[row] for row in group]


def _check_order(group: Sequence[Triggered]) -> None:
    """Refuse events of one trigger that set the same quantity in an undefined order."""
    for first, second in combinations((row.event for row in group), 2):
        both = sorted(first.sets.keys() & second.sets.keys())
        if both and first.priority == second.priority:
            raise second.trigger.at.error(
                f"events '{brief(first.id)}' and '{brief(second.id)}' both set '{brief(both[0])}' "
                "at the same time: give them different priorities"
            )


def _check_in_turn(group: list[Triggered], dependencies: Dependencies) -> None:
    """Refuse events of one trigger for which the order of events in a scene would be wrong."""
    changed: set[str] = set()
    for row in group:
        event = row.event
        needed = dependencies.of(event.trigger.node)
        if event.uses_trigger_values:
            needed |= dependencies.read_by(event)
        if changed & needed:
            raise event.trigger.at.error(
                f"event '{brief(event.id)}' has the same trigger as others that change values it "
                "depends on, and useValuesFromTriggerTime differs or the trigger changes: combine "
                "them into one event"
            )
        changed |= event.sets.keys()


def check_coincidences(
    groups: Iterable[Sequence[Triggered]],
    dependencies: Dependencies,
    is_fixed: Callable[[str], bool],
    start_value: Callable[[Triggered], float],
) -> None:
    """Refuse events with different triggers at the same fixed time that affect each other.

    Parameters
    ----------
    groups : iterable of sequence of Triggered
        From :func:`groups_of`.
    dependencies : Dependencies
        Dependencies of the same model.
    is_fixed : callable
        Returns whether an identifier denotes a constant.
    start_value : callable
        Returns the initial value of the expression of a trigger.

    Raises
    ------
    SceneError
        If there are such events: the second would use the values after the first.
    """
    timed = [
        (row, start_value(row))
        for row in (group[0] for group in groups)
        if all(id == TIME or is_fixed(id) for id in dependencies.of(row.event.trigger.node))
    ]
    members = {group[0].event.id: group for group in groups}
    for (first, a), (second, b) in combinations(timed, 2):
        if a != b or first.crossing.text == second.crossing.text:
            continue
        early = [row.event for row in members[first.event.id]]
        late = [row.event for row in members[second.event.id]]
        changed = {id for event in early for id in event.sets}
        needed = {id for event in late for id in (*event.sets, *dependencies.read_by(event))}
        if changed & needed:
            names = " and ".join(f"'{brief(row.event.id)}'" for row in (first, second))
            raise second.event.trigger.at.error(
                f"events {names} occur at the same time, and one changes values that the other "
                "depends on: give them the same trigger"
            )
