"""Conversion of SBML models to scenes.

A species becomes an edge. A reaction becomes an output for its rate, and a molar flow source for
each species that it changes. Rules become outputs and states. See docs/sbml.md.

In SBML, assigned values are evaluated when the trigger of an event becomes true, before any other
event acts (Level 3, section 4.11). In a scene, each event acts on the values that the previous
event has set. Events with the same trigger therefore become one event of the scene.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import partial
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from cotree.errors import ExpressionError, SceneError, brief, check_known
from cotree.files import number_or_text, read_text
from cotree.readers.names import Namer, SourceLine, located, renaming_notes, scene_name
from cotree.readers.sbml.document import (
    Entity,
    Formula,
    Reaction,
    SbmlContent,
    SbmlEvent,
    explained,
    read_document,
)
from cotree.readers.sbml.mathml import (
    RELATIONS,
    FormulaReader,
    Term,
    TermMaker,
    children,
    kind_of,
    name,
    number,
)
from cotree.readers.sbml.roles import (
    TIME,
    EntityRole,
    RateTerms,
    Roles,
    names_of,
    rate_dependencies,
    roles_of,
)
from cotree.scene.description import Origin, SceneDescription
from cotree.scene.parameters import make_parameter, parameter_values

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

_Scene = TypeVar("_Scene", bound=SceneDescription)


@dataclass(frozen=True)
class SbmlSymbol:
    """Representation of a quantity of an SBML model in a scene."""

    kind: str  # kind of the quantity, such as ``compartment``, ``species`` or ``parameter``
    #: Parameter, mode or output of the scene for the quantity. Its value has the meaning of the
    #: identifier in formulas: for a species, an amount or a concentration.
    name: str
    state: str = ""  # state, such as ``A.c``, or mode of the quantity; empty if there is none
    #: Factor from value to state in compartments of variable size, where states are amounts, or "".
    factor: str = ""
    #: Parameter for the initial value in the unit of ``name``, which may be derived from other
    #: parameters. For a constant, it is the parameter of the constant. Empty for reactions and for
    #: quantities with an assignment rule.
    initial: str = ""


@dataclass(frozen=True)
class SbmlModel(Generic[_Scene]):
    """A scene from an SBML model, with the representation of the model's quantities."""

    scene: _Scene
    symbols: Mapping[str, SbmlSymbol]  # representation of quantities by identifier
    #: Scene parameters that represent local parameters, by reaction and identifier.
    local: Mapping[tuple[str, str], str] = field(default_factory=dict)
    #: Quantities without a value in the model, for which the caller has given a value.
    assumed: frozenset[str] = frozenset()


class SceneWriter(Generic[_Scene]):
    """Builder of the scene of an SBML model; ``values`` replace values that the file lacks."""

    def __init__(
        self, scene_type: type[_Scene], content: SbmlContent, file: str, values: Mapping[str, float]
    ) -> None:
        self.content, self.file, self.values = content, file, values
        self.scene = scene_type(scene_name(content.id or Path(file).stem, "model"))
        self.namer = Namer()
        self.roles = roles_of(content)
        # Names that the reader adds must differ from identifiers of the model.
        rows = content.quantities.items()
        self.names = {id: self.namer.give(row.kind.split()[0], id) for id, row in rows}
        for reaction in content.reactions:
            self.names[reaction.id] = self.namer.give("reaction", reaction.id)
        self.local: dict[tuple[str, str], str] = {}
        self.assumed: set[str] = set()
        self.initial: dict[str, str] = {}
        self.waiting: list[str] = []
        self.notes = list(content.notes)
        self.running = self._reader(self._running_symbol, name("t"), self._cut_running)
        self.starting = self._reader(self._starting_symbol, number(0.0), self._cut_starting)

    def _reader(
        self, symbol: Callable[[str], Term], time: Term, cut: Callable[[str, str], str]
    ) -> FormulaReader:
        rates = RateTerms(self.content, self.roles, cut)
        return FormulaReader(self.content.functions, symbol, time, TermMaker(cut), rates.of)

    def write(self) -> SbmlModel[_Scene]:
        """Declare all elements, and return the scene with its quantities."""
        for id, quantity in self.content.quantities.items():
            with located(quantity.at):
                self._quantity(id, quantity)
        for id in self.roles.order:
            self._output(self.names[id], self.content.assignments[id])
        for reaction in self.content.reactions:
            self._reaction(reaction)
        for id in self.content.rates:
            self._rate(id)
        checks = self._events()
        # Initial values are declared when needed, and may need further initial values.
        while self.waiting:
            self._start_of(self.waiting.pop())
        for check in checks:
            check()
        is_still = not any(e.component.name == "species" for e in self.scene.edges.values())
        if is_still and not self.scene.events:
            raise SceneError(
                f"{self.file}: nothing in the model changes with time, since it has no rate "
                "rules, no species that reactions change and no events"
            )
        changed = dict(self.namer.changed)
        notes = (*self.notes, *renaming_notes(changed))
        self.scene.origin = Origin(self.file, notes, changed)
        return SbmlModel(self.scene, self._symbols(), dict(self.local), frozenset(self.assumed))

    def _known(self, id: str) -> None:
        after = ", which is not a compartment, species, parameter or reaction"
        check_known([id], self.names, "contains", after, ExpressionError)

    def _running_symbol(self, id: str) -> Term:
        self._known(id)
        return name(self.names[id])

    def _starting_symbol(self, id: str) -> Term:
        self._known(id)
        return name(self._initial_name(id))

    def _initial_name(self, id: str) -> str:
        """Return the parameter for an initial value, and schedule its declaration."""
        if self.roles.of.get(id) is EntityRole.FIXED:
            return self.names[id]
        if id not in self.initial:
            self.initial[id] = self.namer.own(f"{self.names[id]}_0")
            self.waiting.append(id)
        return self.initial[id]

    def _cut_running(self, text: str, stem: str) -> str:
        own = self.namer.own(stem)
        self.scene.output(own, text)
        return own

    def _cut_starting(self, text: str, stem: str) -> str:
        own = self.namer.own(f"{stem}_0")
        self.scene.parameter(own, text)
        return own

    def _text(
        self, formula: Formula, reader: FormulaReader, bound: Mapping[str, Term] | None = None
    ) -> str:
        with explained(formula):
            return reader.read(formula.node, bound).text

    def _quantity(self, id: str, quantity: Entity) -> None:
        own = self.names[id]
        match self.roles.of[id]:
            case EntityRole.FIXED:
                self.initial[id] = own
                self._start_of(id)
            case EntityRole.DILUTED:
                # The amount is constant, but the compartment has a variable size.
                place = quantity.compartment
                begin = f"{self._initial_name(id)}*{self._initial_name(place)}"
                self.scene.output(own, f"{begin}/{self.names[place]}")
            case EntityRole.CONCENTRATION:
                self._state(id, self.names[quantity.compartment], own_value=True)
            case EntityRole.AMOUNT:
                self._state(id, 1.0, own_value=quantity.is_amount)
            case EntityRole.RATE:
                self._state(id, 1.0, own_value=True)
            case EntityRole.MODE:
                self.scene.mode(own, self._initial_name(id), doc=quantity.title[:1000])

    def _state(self, id: str, volume: str | float, *, own_value: bool) -> None:
        """Declare a state and an output, whose value formulas use."""
        own, begin = self.names[id], self._initial_name(id)
        value = f"{own}.c"
        if not own_value:
            place = self.content.quantities[id].compartment
            begin, value = (f"{begin}*{self._initial_name(place)}", f"{value}/{self.names[place]}")
        self.scene.edge(own, "species", own, "ground", volume=volume, initial={"c": begin})
        self.scene.output(own, value)

    def _start_of(self, id: str) -> None:
        own, content = self.initial[id], self.content
        quantity = content.quantities.get(id)
        formula = content.assignments.get(id) or content.initials.get(id)
        if quantity is None:
            reaction = self.roles.reactions[id]
            text = self._text(reaction.law, self.starting, self._bound(reaction))
            with located(reaction.law.at):
                self.scene.parameter(own, text)
            return
        at = formula.at if formula else quantity.at
        value: float | str
        if formula is not None:
            value = self._text(formula, self.starting)
        else:
            value = self._number(quantity)
            if quantity.kind == "species" and quantity.gives_amount != quantity.is_amount:
                value = self._converted(own, quantity, value)
        with located(at):
            # A text that is only a number becomes a number.
            value = number_or_text(value)
            self.scene.parameter(own, value, doc=quantity.title[:1000])

    def _converted(self, own: str, quantity: Entity, value: float) -> str:
        """Return an amount that is given as a concentration, or vice versa, as an expression."""
        place = self._initial_name(quantity.compartment)
        word, sign = ("amount", "/") if quantity.gives_amount else ("concentration", "*")
        given = self.namer.own(f"{own}_{word}")
        with located(quantity.at):
            self.scene.parameter(given, value)
        return f"{given}{sign}{place}"

    def _number(self, quantity: Entity) -> float:
        if quantity.value is not None:
            return quantity.value
        if quantity.id in self.values:
            self.assumed.add(quantity.id)
            return self.values[quantity.id]
        if quantity.kind == "compartment":
            self.notes.append(f"{quantity.whose} has no size: it is taken as 1")
            return 1.0
        raise quantity.at.error(
            f"{quantity.whose} has no value: give it one, an initial assignment or a rule"
        )

    def _output(self, own: str, formula: Formula, bound: Mapping[str, Term] | None = None) -> None:
        text = self._text(formula, self.running, bound)
        with located(formula.at):
            self.scene.output(own, text)

    def _rate(self, id: str) -> None:
        formula, own = self.content.rates[id], self.names[id]
        text = self._text(formula, self.running)
        edge = self.namer.own(f"{own}_rate")
        with located(formula.at):
            self.scene.edge(edge, "molar_flow_source", "ground", own, flow=number_or_text(text))

    def _bound(self, reaction: Reaction) -> dict[str, Term]:
        """Declare the local parameters of a reaction, and return their terms by identifier."""
        for id, quantity in reaction.local.items():
            if (reaction.id, id) not in self.local:
                own = self.namer.give("local parameter", f"{reaction.id}_{id}")
                self.local[reaction.id, id] = own
                with located(quantity.at):
                    self.scene.parameter(own, self._number(quantity), doc=quantity.title[:1000])
        return {id: name(self.local[reaction.id, id]) for id in reaction.local}

    def _reaction(self, reaction: Reaction) -> None:
        own = self.names[reaction.id]
        self._output(own, reaction.law, self._bound(reaction))
        numbers: dict[str, float] = {}
        for part in reaction.parts:
            if self.roles.of[part.species] not in (EntityRole.CONCENTRATION, EntityRole.AMOUNT):
                continue
            count = self._stoichiometry(part.stoichiometry)
            if isinstance(count, float):
                # If a species is both reactant and product, its flow is the difference.
                numbers[part.species] = numbers.get(part.species, 0.0) + part.sign * count
            else:
                factor = count if count.isidentifier() else f"({count})"
                self._flow(own, part.species, f"{factor}*{own}", part.sign, part.at)
        for species, count in numbers.items():
            if not math.isfinite(count):
                raise reaction.law.at.error(
                    f"the stoichiometry of '{brief(species)}' in reaction '{brief(reaction.id)}' "
                    "is not finite"
                )
            flow = own if abs(count) == 1.0 else f"{number(abs(count)).text}*{own}"
            if count:
                self._flow(own, species, flow, 1 if count > 0.0 else -1, reaction.law.at)

    def _stoichiometry(self, given: float | str | Formula) -> float | str:
        if isinstance(given, Formula):
            return number_or_text(self._text(given, self.running))
        if isinstance(given, float):
            return given
        if given in self.roles.unnamed:
            value = self.content.quantities[given].value
            if value is not None:
                return value
        return self.names[given]

    def _flow(self, reaction: str, species: str, flow: str, sign: int, at: SourceLine) -> None:
        own, conversion = self.names[species], self.content.quantities[species].conversion
        nodes = ("ground", own) if sign > 0 else (own, "ground")
        with located(at):
            if conversion:
                self._known(conversion)
                flow = f"{self.names[conversion]}*{flow}"
            edge = self.namer.own(f"{reaction}_{own}")
            self.scene.edge(edge, "molar_flow_source", *nodes, flow=flow)

    def _events(self) -> list[Callable[[], None]]:
        """Declare all events; return checks to be called when all parameters are declared."""
        dependencies = Dependencies(self.content)
        check_sizes(self.content, self.roles, dependencies)
        groups = groups_of([self._triggered(e) for e in self.content.events], dependencies)
        for group in groups:
            self._event(group)
        return [
            *(partial(check_start, self.scene, r.event, r.at_start) for g in groups for r in g),
            lambda: check_coincidences(
                groups,
                dependencies,
                lambda id: self.roles.of.get(id) is EntityRole.FIXED,
                lambda row: start_value(self.scene, row.event, row.at_start),
            ),
        ]

    def _triggered(self, event: SbmlEvent) -> Triggered:
        trigger = event.trigger
        with located(trigger.at), explained(trigger):
            return Triggered(
                event,
                crossing_of(self.running, trigger.node),
                crossing_of(self.starting, trigger.node),
            )

    def _event(self, group: Sequence[Triggered]) -> None:
        """Declare a group of events as a single event; later assignments take precedence."""
        first = group[0]
        for id, formula in (pair for row in group for pair in row.event.sets.items()):
            self._check_target(id, formula)
        texts = [
            {id: self._text(formula, self.running) for id, formula in row.event.sets.items()}
            for row in group
        ]
        values = assigned_values(texts, self.content, self.roles, self.names)
        own = self.namer.give("event", first.event.id)
        if len(group) > 1:
            others = ", ".join(f"'{brief(row.event.id)}'" for row in group[1:])
            self.notes.append(f"event '{own}' includes {others}, with the same trigger")
        with located(first.event.trigger.at):
            crossing = first.crossing
            self.scene.event(own, crossing.text, direction=crossing.direction, set=values)

    def _check_target(self, id: str, formula: Formula) -> None:
        """Raise an error if an event sets a constant or a quantity with an assignment rule."""
        role = self.roles.of[id]
        if self.content.quantities[id].is_constant or not (
            role.is_state or role is EntityRole.MODE
        ):
            raise formula.at.error(
                f"the {formula.what} sets a constant, or a quantity that a rule determines"
            )

    def _symbols(self) -> dict[str, SbmlSymbol]:
        found = {r.id: SbmlSymbol("reaction", self.names[r.id]) for r in self.content.reactions}
        for id, quantity in self.content.quantities.items():
            own, role, factor = self.names[id], self.roles.of[id], ""
            if role is EntityRole.UNNAMED:
                continue
            state = {EntityRole.MODE: own}.get(role, f"{own}.c" if role.is_state else "")
            if role is EntityRole.AMOUNT and not quantity.is_amount:
                factor = self.names[quantity.compartment]
            begin = "" if role is EntityRole.ASSIGNED else self.initial[id]
            if id in self.content.assignments:
                begin = ""
            found[id] = SbmlSymbol(quantity.kind.split()[0], own, state, factor, begin)
        return found


_LARGEST_FILE = 50_000_000  # maximum file size, [byte]; large published models have 10 MB


def read_sbml_scene(source: str | Path, scene_type: type[_Scene]) -> _Scene:
    """Read a scene from an SBML file."""
    return read_sbml_model(source, scene_type).scene


def read_sbml_model(
    source: str | Path, scene_type: type[_Scene], values: Mapping[str, float] | None = None
) -> SbmlModel[_Scene]:
    """Read a scene from an SBML file, with its quantities by identifier of the model."""
    text = read_text(source, _LARGEST_FILE)
    return read_sbml_text(text, str(source), scene_type, values)


def read_sbml_text(
    text: str, where: str, scene_type: type[_Scene], values: Mapping[str, float] | None = None
) -> SbmlModel[_Scene]:
    """Read a scene from the text of an SBML file; see :func:`read_sbml_model`."""
    content = read_document(text, where)
    return SceneWriter(scene_type, content, where, values or {}).write()


@dataclass(frozen=True)
class Triggered:
    """An event, with the expressions that cross zero when it occurs, in a run and at its start."""

    event: SbmlEvent
    crossing: ZeroCrossing
    at_start: ZeroCrossing


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
class ZeroCrossing:
    """An expression that crosses zero when a condition becomes true."""

    text: str  # expression whose zero crossing is the event
    direction: int  # direction of the crossing: 1 if rising, 0 for both
    holds_at_zero: bool  # whether the condition is true where the expression is zero


def crossing_of(reader: FormulaReader, node: Any) -> ZeroCrossing:
    """Convert a condition to an expression that crosses zero when it becomes true."""
    relation = kind_of(node).removeprefix("RELATIONAL_")
    if relation in (*RELATIONS, "EQ") and node.getNumChildren() == 2:
        a, b = (reader.read(part) for part in children(node))
        if relation in ("LT", "LEQ"):
            a, b = b, a
        # Two continuous values become equal when their difference crosses zero.
        is_either = relation == "EQ"
        text = reader.make.form("a - b", a, b).text
        return ZeroCrossing(text, 0 if is_either else 1, relation in ("LEQ", "GEQ", "EQ"))
    made = reader.make.form("where(a, 1, -1)", reader.condition(node))
    return ZeroCrossing(made.text, 1, holds_at_zero=False)


def start_value(scene: SceneDescription, event: SbmlEvent, begin: ZeroCrossing) -> float:
    """Return the value of a trigger's expression at the start."""
    return _at_start(scene, event, begin)[0]


def check_start(scene: SceneDescription, event: SbmlEvent, begin: ZeroCrossing) -> None:
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


def _at_start(scene: SceneDescription, event: SbmlEvent, begin: ZeroCrossing) -> tuple[float, bool]:
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
            state = names[id] if roles.of[id] is EntityRole.MODE else f"{names[id]}.c"
            if roles.of[id] is EntityRole.AMOUNT and not content.quantities[id].is_amount:
                place = content.quantities[id].compartment
                text = f"({text})*({sizes.get(place, names[place])})"
            found[state] = text
        for id, quantity in content.quantities.items():
            # For a rate rule, the state is the concentration.
            is_kept = roles.of[id] is EntityRole.RATE and not quantity.is_amount
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
        if not place or quantity.is_amount or roles.of[place] is not EntityRole.ASSIGNED:
            continue
        if set_by_events & dependencies.of(content.assignments[place].node):
            raise formula.at.error(
                f"the {formula.what} determines a concentration in '{brief(place)}', whose size "
                "changes at events through its assignment rule, which is not supported: set "
                "hasOnlySubstanceUnits of the species, or let the events set the compartment"
            )
