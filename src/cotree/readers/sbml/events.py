"""Events of an SBML model: triggers, assignments and simultaneous events.

In SBML, assigned values are evaluated when the trigger of an event becomes true, before any other
event acts (Level 3, section 4.11). In a scene, each event acts on the values that the previous
event has set. Events with the same trigger therefore become one event of the scene.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

from cotree.errors import brief
from cotree.readers.names import located
from cotree.readers.sbml.formulas import RELATIONS, FormulaReader, children, kind_of
from cotree.readers.sbml.roles import TIME, Role, Roles, names_of, rate_dependencies
from cotree.scene.parameters import make_parameter, parameter_values

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from cotree.readers.sbml.document import SbmlContent, SbmlEvent
    from cotree.scene.description import SceneDescription


@dataclass(frozen=True)
class Triggered:
    """An event, with the expressions that cross zero when it occurs, in a run and at its start."""

    event: SbmlEvent
    crossing: Crossing
    at_start: Crossing


class Dependencies:
    """Dependencies of formulas, also through rules, reaction rates and compartments."""

    def __init__(self, content: SbmlContent) -> None:
        self._content = content
        self._laws = {reaction.id: reaction.law for reaction in content.reactions}
        self._rates = rate_dependencies(content)

    def of(self, node: object) -> frozenset[str]:
        """Return the identifiers on which the value of a formula depends."""
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
            # Concentrations depend on the size of the compartment.
            elif id in quantities and quantities[id].compartment:
                waiting.append(quantities[id].compartment)
        return frozenset(found)

    def read_by(self, event: SbmlEvent) -> frozenset[str]:
        """Return the identifiers on which the values that an event assigns depend."""
        return frozenset().union(*(self.of(formula.node) for formula in event.sets.values()))


def groups_of(rows: Sequence[Triggered], dependencies: Dependencies) -> list[list[Triggered]]:
    """Sort events by priority, else as in the file, and group those that become a single event.

    Raise an error if events with the same trigger affect each other in an unsupported manner.
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
    """Return events of one trigger as one group, or separately if later ones use changed values."""
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
    """Raise an error if events of one trigger set the same quantity in an undefined order."""
    for first, second in combinations((row.event for row in group), 2):
        both = sorted(first.sets.keys() & second.sets.keys())
        if both and first.priority == second.priority:
            raise second.trigger.at.error(
                f"events '{brief(first.id)}' and '{brief(second.id)}' both set '{brief(both[0])}' "
                "at the same time: give them different priorities"
            )


def _check_in_turn(group: list[Triggered], dependencies: Dependencies) -> None:
    """Raise an error if events of one trigger would act incorrectly one after another."""
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
    """Raise an error for events with different triggers at the same fixed time that interact."""
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


@dataclass(frozen=True)
class Crossing:
    """An expression that crosses zero when a condition becomes true."""

    text: str  # expression whose zero crossing is the event
    direction: int  # direction of the crossing: 1 if rising, 0 for both
    holds_at_zero: bool  # whether the condition is true where the expression is zero


def crossing_of(reader: FormulaReader, node: Any) -> Crossing:
    """Convert a condition to an expression that crosses zero when it becomes true."""
    relation = kind_of(node).removeprefix("RELATIONAL_")
    if relation in (*RELATIONS, "EQ") and node.getNumChildren() == 2:
        a, b = (reader.read(part) for part in children(node))
        if relation in ("LT", "LEQ"):
            a, b = b, a
        # Two continuous values become equal when their difference crosses zero.
        is_either = relation == "EQ"
        text = reader.make.form("a - b", a, b).text
        return Crossing(text, 0 if is_either else 1, relation in ("LEQ", "GEQ", "EQ"))
    made = reader.make.form("where(a, 1, -1)", reader.condition(node))
    return Crossing(made.text, 1, holds_at_zero=False)


def start_value(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> float:
    """Return the value of a trigger's expression at the start."""
    return _at_start(scene, event, begin)[0]


def check_start(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> None:
    """Raise an error for an event that a run would handle incorrectly at the start."""
    value, is_known = _at_start(scene, event, begin)
    # The event occurs at the start if its function is zero and rises; this is known only for times.
    is_late = value > 0.0 or (value == 0.0 and begin.holds_at_zero and not is_known)
    is_early = value == 0.0 and begin.holds_at_zero
    if is_early if event.is_initially_true else is_late:
        raise event.trigger.at.error(
            f"the {event.trigger.what} is true at the start with initialValue="
            f"{str(event.is_initially_true).lower()}, which is not supported: include the event's "
            "assignments in the initial values"
        )


def _at_start(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> tuple[float, bool]:
    """Return a trigger's value at the start, and whether it contains no parameters."""
    rows = dict(scene.parameters)
    with located(event.trigger.at):
        # The description contains spaces, so it differs from all names in the scene.
        row = make_parameter(event.trigger.what, begin.text, "", "", True)
        rows[row.name] = row
        value = parameter_values(rows)[row.name]
    return value, isinstance(row.value, float) or not row.value.names


def assigned_values(
    events: Iterable[Mapping[str, str]],
    content: SbmlContent,
    roles: Roles,
    names: Mapping[str, str],
) -> dict[str, str]:
    """Return the expressions that events with one trigger assign to states and modes, by name.

    A concentration is set through its amount, with the compartment size before the event; changes
    of size conserve amounts (SBML test suite, case 01779).
    """
    found: dict[str, str] = {}
    sizes: dict[str, str] = {}  # values that previous events have set, including compartment sizes
    for texts in events:
        for id, text in texts.items():
            state = names[id] if roles.of[id] is Role.MODE else f"{names[id]}.c"
            if roles.of[id] is Role.AMOUNT and not content.quantities[id].is_amount:
                place = content.quantities[id].compartment
                text = f"({text})*({sizes.get(place, names[place])})"
            found[state] = text
        for id, quantity in content.quantities.items():
            # For a rate rule, the state is the concentration.
            is_kept = roles.of[id] is Role.RATE and not quantity.is_amount
            if is_kept and (place := quantity.compartment) in texts:
                state, old = f"{names[id]}.c", sizes.get(place, names[place])
                found[state] = f"({found.get(state, state)})*({old})/({texts[place]})"
        sizes |= texts
    return found


def check_sizes(content: SbmlContent, roles: Roles, dependencies: Dependencies) -> None:
    """Raise an error for concentrations with rate rules that events would dilute indirectly."""
    set_by_events = {id for event in content.events for id in event.sets}
    for id, formula in content.rates.items():
        quantity = content.quantities[id]
        place = quantity.compartment
        if not place or quantity.is_amount or roles.of[place] is not Role.ASSIGNED:
            continue
        if set_by_events & dependencies.of(content.assignments[place].node):
            raise formula.at.error(
                f"the {formula.what} determines a concentration in '{brief(place)}', whose size "
                "changes at events through its assignment rule, which is not supported: set "
                "hasOnlySubstanceUnits of the species, or let the events set the compartment"
            )
