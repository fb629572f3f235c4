"""SBML files, which libsbml parses, as checked plain data; formulas remain trees of libsbml."""

from __future__ import annotations

import math
import re
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.errors import ExpressionError, brief, optional_package
from cotree.readers.names import SourceLine
from cotree.readers.xml_tree import parse_xml

if TYPE_CHECKING:
    from collections.abc import Iterator


@dataclass(frozen=True)
class Formula:
    """A formula of a model, with its position in the file."""

    node: Any = field(repr=False)  # syntax tree of the formula
    at: SourceLine  # file and line of the formula
    what: str  # description in messages, such as ``kinetic law of reaction 'R1'``


@dataclass(frozen=True)
class Entity:
    """A compartment, a species, a parameter or a stoichiometry."""

    #: Kind, identifier and title of the quantity.
    kind: str
    id: str
    title: str
    at: SourceLine  # file and line of the quantity
    value: float | None = None  # initial value, if the file gives a number
    is_constant: bool = False  # whether the quantity is declared constant
    compartment: str = ""  # for a species: identifier of its compartment
    #: For a species: whether its identifier denotes an amount instead of a concentration.
    is_amount: bool = False
    gives_amount: bool = False  # for a species: whether ``value`` is an amount
    is_boundary: bool = False  # for a species: whether reactions leave it unchanged
    #: For a species: parameter that converts extents of reactions to amounts; otherwise empty.
    conversion: str = ""

    @property
    def whose(self) -> str:
        """Kind and identifier of the quantity, for messages."""
        return f"{self.kind} '{brief(self.id)}'"


@dataclass(frozen=True)
class Participant:
    """A reactant or product of a reaction."""

    species: str  # identifier of the species
    sign: int  # sign of the stoichiometry: -1 for a reactant, 1 for a product
    #: Stoichiometry: a number, the identifier of a quantity, or a formula.
    stoichiometry: float | str | Formula
    at: SourceLine  # file and line of the reference


@dataclass(frozen=True)
class Reaction:
    """A reaction, with its rate, local parameters, reactants and products."""

    id: str
    law: Formula
    local: dict[str, Entity]
    parts: tuple[Participant, ...]


@dataclass(frozen=True)
class SbmlEvent:
    """An event, with its trigger and its assignments."""

    id: str  # identifier, or a name with the event's number
    trigger: Formula  # condition; the event occurs when it becomes true
    sets: dict[str, Formula]  # assigned formulas, by identifier of the target
    is_initially_true: bool  # whether the trigger counts as true before the start
    priority: float = 0.0  # simultaneous events occur in order of decreasing priority
    #: Whether the event still occurs if a simultaneous event makes its trigger false.
    is_persistent: bool = True
    #: Whether assigned values are evaluated before simultaneous events instead of after them.
    uses_trigger_values: bool = True


@dataclass
class SbmlContent:
    """The content of an SBML model, by identifier."""

    id: str  # identifier of the model
    #: Compartments, species, parameters, and stoichiometries that have an identifier.
    quantities: dict[str, Entity] = field(default_factory=dict)
    functions: dict[str, Any] = field(default_factory=dict)  # syntax trees by identifier
    #: Initial assignments, assignment rules and rate rules, by identifier of their target.
    initials: dict[str, Formula] = field(default_factory=dict)
    assignments: dict[str, Formula] = field(default_factory=dict)
    rates: dict[str, Formula] = field(default_factory=dict)
    #: Reactions and events of the model.
    reactions: list[Reaction] = field(default_factory=list)
    events: list[SbmlEvent] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)  # notes on ignored elements
    _document: Any = None  # reference that keeps libsbml's syntax trees alive


_DEEPEST, _MOST_ELEMENTS = 1000, 3_000_000

_DECLARATION, _UTF_8 = re.compile(r"\A\s*<\?xml[^>]*\?>"), '<?xml version="1.0" encoding="UTF-8"?>'


def read_document(text: str, where: str) -> SbmlContent:
    """Read the model in the text of an SBML file."""
    # Document types are rejected first, because libsbml would resolve their entities.
    root = parse_xml(text, where, deepest=_DEEPEST, most=_MOST_ELEMENTS)
    if root.tag.rpartition(":")[2] != "sbml":
        raise root.at.error(f"not SBML: its outermost element is <{brief(root.tag)}>, not <sbml>")
    # Level 3 packages that change the meaning of a model are declared as required.
    for attribute, value in root.attributes.items():
        package, _, word = attribute.rpartition(":")
        if package and word == "required" and value in ("true", "1"):
            raise root.at.error(
                f"the package '{brief(package)}' changes the meaning of the model, and is not "
                "supported: convert the file to core SBML"
            )
    libsbml = optional_package("libsbml", "reading SBML needs", "sbml")
    # The text is already decoded, so the encoding in its first line is replaced.
    document = libsbml.readSBMLFromString(_DECLARATION.sub(_UTF_8, text, count=1))
    return _Reader(document, where, libsbml).read()


class _Reader:
    def __init__(self, document: Any, file: str, libsbml: Any) -> None:
        self.document, self.file, self.libsbml = document, file, libsbml

    def at(self, element: Any) -> SourceLine:
        return SourceLine(self.file, max(1, element.getLine()))

    def read(self) -> SbmlContent:
        self._check()
        model = self.document.getModel()
        if model is None:
            raise self.at(self.document).error("the file holds no <model>")
        self.model = model
        self.content = SbmlContent(model.getId(), _document=self.document)
        for definition in model.getListOfFunctionDefinitions():
            if not definition.isSetMath() or definition.getBody() is None:
                raise self.at(definition).error(
                    f"function '{brief(definition.getId())}' has no formula"
                )
            self.content.functions[definition.getId()] = definition.getMath()
        self._quantities()
        self._rules()
        for reaction in model.getListOfReactions():
            self._reaction(reaction)
        for i, event in enumerate(model.getListOfEvents(), 1):
            self._event(event, i)
        if model.getNumConstraints():
            self.content.notes.append("ignored: constraints")
        return self.content

    def _check(self) -> None:
        document = self.document
        for i in range(document.getNumErrors()):
            error = document.getError(i)
            if error.getSeverity() >= self.libsbml.LIBSBML_SEV_ERROR:
                words = " ".join(error.getMessage().split())
                raise SourceLine(self.file, max(1, error.getLine())).error(
                    f"not valid SBML: {brief(words, 300)}"
                )
        if document.getLevel() == 1 and not document.setLevelAndVersion(2, 4, False):
            raise self.at(document).error("SBML Level 1 that cannot be converted to Level 2")

    def _quantities(self) -> None:
        model, add = self.model, self._add
        for c in model.getListOfCompartments():
            value = c.getSize() if c.isSetSize() else None
            if value is None and c.isSetVolume():
                value = c.getVolume()  # Level 2 has the default volume 1
            add(Entity("compartment", c.getId(), c.getName(), self.at(c), value, c.getConstant()))
        for s in model.getListOfSpecies():
            add(self._species(s))
        for p in model.getListOfParameters():
            value = p.getValue() if p.isSetValue() else None
            add(Entity("parameter", p.getId(), p.getName(), self.at(p), value, p.getConstant()))

    def _species(self, s: Any) -> Entity:
        gives_amount = s.isSetInitialAmount()
        value = s.getInitialAmount() if gives_amount else None
        if value is None and s.isSetInitialConcentration():
            value = s.getInitialConcentration()
        place = self.model.getCompartment(s.getCompartment())
        if place is None:
            raise self.at(s).error(
                f"species '{brief(s.getId())}' is in '{brief(s.getCompartment())}', which is not "
                "a compartment"
            )
        # A compartment without dimensions has no concentrations.
        is_point = place.isSetSpatialDimensions() and place.getSpatialDimensions() == 0
        is_amount = s.getHasOnlySubstanceUnits() or is_point
        conversion = s.getConversionFactor() or self.model.getConversionFactor()
        return Entity(
            "species",
            s.getId(),
            s.getName(),
            self.at(s),
            value,
            s.getConstant(),
            s.getCompartment(),
            is_amount,
            gives_amount,
            s.getBoundaryCondition(),
            conversion,
        )

    def _add(self, quantity: Entity) -> None:
        if quantity.id in self.content.quantities:
            raise quantity.at.error(f"{quantity.whose} is declared twice")
        self.content.quantities[quantity.id] = quantity

    def _formula(self, element: Any, what: str) -> Formula:
        node = element.getMath() if element is not None and element.isSetMath() else None
        if node is None:
            at = self.at(element) if element is not None else self.at(self.model)
            raise at.error(f"the {what} has no formula")
        return Formula(node, self.at(element), what)

    def _rules(self) -> None:
        for a in self.model.getListOfInitialAssignments():
            symbol = a.getSymbol()
            formula = self._formula(a, f"initial assignment of '{brief(symbol)}'")
            _define(self.content.initials, symbol, formula)
        for rule in self.model.getListOfRules():
            if rule.isAlgebraic():
                math = self.libsbml.formulaToL3String(rule.getMath()) if rule.isSetMath() else ""
                raise self.at(rule).error(
                    f"the algebraic rule 0 = {brief(math or '')} is not supported, since it does "
                    "not state which quantity it determines: solve it for one and write an "
                    "assignment rule"
                )
            variable, is_rate = rule.getVariable(), rule.isRate()
            word = "rate rule" if is_rate else "assignment rule"
            formula = self._formula(rule, f"{word} of '{brief(variable)}'")
            _define(self.content.rates if is_rate else self.content.assignments, variable, formula)

    def _reaction(self, r: Any) -> None:
        whose = f"reaction '{brief(r.getId())}'"
        if r.isSetFast() and r.getFast():
            raise self.at(r).error(
                f"{whose} is fast, which is not supported, since it would be an algebraic "
                "equation: replace it by a reaction with a large rate"
            )
        law = r.getKineticLaw()
        if law is None or not law.isSetMath():
            raise self.at(r).error(f"{whose} has no kinetic law: give it one")
        formula = Formula(law.getMath(), self.at(law), f"kinetic law of {whose}")
        local: dict[str, Entity] = {}
        for p in [*law.getListOfParameters(), *law.getListOfLocalParameters()]:
            value = p.getValue() if p.isSetValue() else None
            kind = f"local parameter of {whose}:"
            local[p.getId()] = Entity(kind, p.getId(), p.getName(), self.at(p), value, True)
        parts = tuple(self._parts(r, whose))
        self.content.reactions.append(Reaction(r.getId(), formula, local, parts))

    def _parts(self, r: Any, whose: str) -> Iterator[Participant]:
        for sign, listed in ((-1, r.getListOfReactants()), (1, r.getListOfProducts())):
            for s in listed:
                species = s.getSpecies()
                known = self.content.quantities.get(species)
                if known is None or known.kind != "species":
                    raise self.at(s).error(
                        f"{whose} names '{brief(species)}', which is not a species"
                    )
                number = s.getStoichiometry() if s.isSetStoichiometry() else None
                # In Level 2 the default is 1, and a formula may replace the number.
                if number is None and self.document.getLevel() < 3:
                    number = 1.0
                made: float | str | Formula
                if s.isSetStoichiometryMath():
                    what = f"stoichiometry of '{brief(species)}' in {whose}"
                    made = self._formula(s.getStoichiometryMath(), what)
                elif s.isSetId() and self.document.getLevel() >= 3:
                    id = made = s.getId()
                    kind = f"stoichiometry in {whose}:"
                    fixed = s.isSetConstant() and s.getConstant()
                    self._add(Entity(kind, id, "", self.at(s), number, fixed))
                elif number is None:
                    raise self.at(s).error(
                        f"the stoichiometry of '{brief(species)}' in {whose} is missing: give a "
                        "number"
                    )
                else:
                    made = number
                yield Participant(species, sign, made, self.at(s))

    def _event(self, e: Any, number: int) -> None:
        id = e.getId() or f"event_{number}"
        whose = f"event '{brief(id)}'"
        trigger = self._formula(e.getTrigger(), f"trigger of {whose}")
        self._check_delay(e, whose)
        is_level_3 = self.document.getLevel() >= 3
        begins = e.getTrigger().getInitialValue() if is_level_3 else True
        persists = e.getTrigger().getPersistent() if is_level_3 else True
        sets: dict[str, Formula] = {}
        for a in e.getListOfEventAssignments():
            variable = a.getVariable()
            _define(sets, variable, self._formula(a, f"value of '{brief(variable)}' in {whose}"))
        priority, uses_old = self._priority(e, whose), e.getUseValuesFromTriggerTime()
        event = SbmlEvent(id, trigger, sets, begins, priority, persists, uses_old)
        self.content.events.append(event)

    def _check_delay(self, e: Any, whose: str) -> None:
        delay = e.getDelay()
        if delay is not None and delay.isSetMath() and _number_of(delay) != 0.0:
            raise self.at(delay).error(
                f"{whose} has a delay, which is not supported: let the event store the time in a "
                "parameter, and add a second event that is triggered when the delay has passed"
            )

    def _priority(self, e: Any, whose: str) -> float:
        priority = e.getPriority()
        # The priority of an event has no effect if it is the only event.
        if priority is None or not priority.isSetMath() or self.model.getNumEvents() == 1:
            return 0.0
        value = _number_of(priority)
        if value is None:
            raise self.at(priority).error(
                f"{whose} has a priority that is a formula, which is not supported: give a number"
            )
        return value


def _number_of(element: Any) -> float | None:
    """Return the number if a formula is only a number with an optional sign, else None."""
    node, sign = element.getMath(), 1.0
    if node.isUMinus():
        node, sign = node.getChild(0), -1.0
    is_number = node is not None and node.isNumber() and math.isfinite(node.getValue())
    return sign * node.getValue() if is_number else None


def _define(table: dict[str, Formula], symbol: str, formula: Formula) -> None:
    if symbol in table:
        raise formula.at.error(f"there are two formulas for the {formula.what}")
    table[symbol] = formula


@contextmanager
def explained(formula: Formula) -> Iterator[None]:
    """Prepend the description of a formula to messages of its errors."""
    try:
        yield
    except ExpressionError as error:
        raise formula.at.error(f"the {formula.what} {error}") from None
