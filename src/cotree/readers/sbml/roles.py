"""Roles of the quantities of an SBML model in the scene, and their rates of change."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any

from cotree.errors import ExpressionError, brief, check_known
from cotree.readers.sbml.document import Entity, Formula, Reaction, SbmlContent, explained
from cotree.readers.sbml.mathml import FormulaReader, Term, children, kind_of, name, number

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping


#: Entry for the time in sets of names, which differs from all identifiers.
TIME = "time of the run"


def rate_name(identifier: str) -> str:
    """Return the entry for a quantity's rate in sets of names, which is no valid identifier."""
    return f"rateOf({identifier})"


def names_of(node: Any, functions: Mapping[str, Any]) -> frozenset[str]:
    """Return the identifiers in a formula, entries for rates, and :data:`TIME` if used."""
    found: set[str] = set()
    waiting, seen = [node], set()
    while waiting:
        own = waiting.pop()
        if own is None:
            continue
        kind = kind_of(own)
        if kind == "NAME":
            found.add(own.getName())
        elif kind == "NAME_TIME":
            found.add(TIME)
        elif kind == "FUNCTION_RATE_OF":
            found.update(rate_name(child.getName() or "") for child in children(own))
        elif kind == "FUNCTION" and own.getName() in functions and own.getName() not in seen:
            seen.add(own.getName())
            # A function depends only on its arguments (nodes of the call) and on the time.
            body = children(functions[own.getName()])[-1]
            found |= {TIME} & names_of(body, {k: v for k, v in functions.items() if k not in seen})
        waiting += children(own)
    return frozenset(found)


def rate_dependencies(content: SbmlContent) -> dict[str, frozenset[str]]:
    """Return the names on which the rate of each quantity depends, by :func:`rate_name`."""
    found: dict[str, set[str]] = {}
    for id, quantity in content.quantities.items():
        own = found[rate_name(id)] = set()
        if quantity.compartment:
            own |= {id, quantity.compartment, rate_name(quantity.compartment)}
        if id in content.rates:
            own |= names_of(content.rates[id].node, content.functions)
    for reaction in content.reactions:
        for part in reaction.parts:
            own = found[rate_name(part.species)]
            own |= {reaction.id, content.quantities[part.species].conversion} - {""}
            if isinstance(part.stoichiometry, Formula):
                own |= names_of(part.stoichiometry.node, content.functions)
            elif isinstance(part.stoichiometry, str):
                own.add(part.stoichiometry)
    return {name: frozenset(own) for name, own in found.items()}


class EntityRole(Enum):
    """Role of a quantity, which determines the element that represents it in the scene."""

    FIXED = "parameter"
    DILUTED = "a constant amount in a compartment that changes"
    ASSIGNED = "output"
    CONCENTRATION = "state, a concentration"
    AMOUNT = "state, an amount"
    RATE = "state of a rate rule"
    MODE = "mode, set by events"
    UNNAMED = "stoichiometry that no formula contains"

    @property
    def is_state(self) -> bool:
        """Whether the quantity is a state that is integrated."""
        return self in (EntityRole.CONCENTRATION, EntityRole.AMOUNT, EntityRole.RATE)


@dataclass(frozen=True)
class Roles:
    """Roles of all quantities of a model."""

    of: dict[str, EntityRole]  # roles by identifier
    #: Quantities with assignment rules that become outputs, each after those on which it depends.
    order: tuple[str, ...]
    reactions: dict[str, Reaction]  # reactions by identifier

    @property
    def unnamed(self) -> frozenset[str]:
        """Stoichiometries whose identifiers occur in no formula."""
        return frozenset(id for id, role in self.of.items() if role is EntityRole.UNNAMED)


def roles_of(content: SbmlContent) -> Roles:
    """Determine the role of each quantity of a model."""
    reactions = {reaction.id: reaction for reaction in content.reactions}
    _check(content)
    formulas = {id: f.node for id, f in content.assignments.items()}
    formulas |= {id: reaction.law.node for id, reaction in reactions.items()}
    uses = {id: names_of(node, content.functions) for id, node in formulas.items()}
    for id, reaction in reactions.items():
        uses[id] -= reaction.local.keys()
    set_by_events = {id for event in content.events for id in event.sets}
    named = _named(content, uses.values())
    found: dict[str, EntityRole] = {}
    for id, row in content.quantities.items():
        if id in content.rates:
            found[id] = EntityRole.RATE
        elif id in content.assignments:
            found[id] = EntityRole.ASSIGNED
        elif row.kind.startswith("stoichiometry") and id not in named:
            found[id] = EntityRole.UNNAMED
        elif row.kind == "species" and not row.is_boundary and not row.is_constant:
            found[id] = EntityRole.CONCENTRATION
        else:
            found[id] = EntityRole.MODE if id in set_by_events else EntityRole.FIXED
    order = _order(uses | rate_dependencies(content), content)
    # A rule of constants defines a constant; states in a constant compartment need not be amounts.
    for id in order:
        if id in content.assignments and all(found.get(n) is EntityRole.FIXED for n in uses[id]):
            found[id] = EntityRole.FIXED
    for id, row in content.quantities.items():
        if row.kind == "species" and found[row.compartment] is not EntityRole.FIXED:
            found[id] = _in_changing_place(found[id], row)
        elif found[id] is EntityRole.CONCENTRATION and row.is_amount:
            found[id] = EntityRole.AMOUNT
    outputs = tuple(id for id in order if found.get(id) is EntityRole.ASSIGNED)
    return Roles(found, outputs, reactions)


def _in_changing_place(role: EntityRole, species: Entity) -> EntityRole:
    """Return the role of a species in a compartment of variable size."""
    if role is EntityRole.CONCENTRATION or (role is EntityRole.MODE and not species.is_amount):
        return EntityRole.AMOUNT
    return EntityRole.DILUTED if role is EntityRole.FIXED and not species.is_amount else role


def _named(content: SbmlContent, uses: Iterable[frozenset[str]]) -> frozenset[str]:
    """Return the identifiers that formulas contain or determine."""
    functions = content.functions
    formulas = [*content.initials.values(), *content.rates.values()]
    for event in content.events:
        formulas += [event.trigger, *event.sets.values()]
    for reaction in content.reactions:
        formulas += [
            p.stoichiometry for p in reaction.parts if isinstance(p.stoichiometry, Formula)
        ]
    found = {*content.initials, *content.rates, *content.assignments}
    found.update(*(event.sets for event in content.events))
    found.update(*uses, *(names_of(formula.node, functions) for formula in formulas))
    return frozenset(found)


def _order(uses: dict[str, frozenset[str]], content: SbmlContent) -> list[str]:
    """Sort assigned quantities and reaction rates so that each follows its dependencies."""
    graph = {id: names & uses.keys() for id, names in uses.items()}
    try:
        return list(TopologicalSorter(graph).static_order())
    except CycleError as error:
        way = list(reversed(error.args[1]))
        formulas = {reaction.id: reaction.law for reaction in content.reactions}
        formulas |= {rate_name(id): formula for id, formula in content.rates.items()}
        formulas |= content.assignments
        formula = next(formulas[name] for name in way if name in formulas)
        raise formula.at.error(
            f"the {formula.what} depends on itself: {' -> '.join(way)}"
        ) from None


def _check(content: SbmlContent) -> None:
    """Raise an error if both rules and reactions determine a quantity, or if it is unknown."""
    changed = {part.species for reaction in content.reactions for part in reaction.parts}
    tables = (content.assignments, content.rates, content.initials)
    targets = [(id, formula) for table in tables for id, formula in table.items()]
    targets += [pair for event in content.events for pair in event.sets.items()]
    for id, formula in targets:
        if id not in content.quantities:
            raise formula.at.error(
                f"the {formula.what} determines '{brief(id)}', which is not a compartment, species "
                "or parameter"
            )
        if content.quantities[id].is_constant and content.initials.get(id) is not formula:
            raise formula.at.error(
                f'the {formula.what} determines a constant: declare it constant="false", or '
                "remove the formula"
            )
    for id, formula in (*content.assignments.items(), *content.rates.items()):
        row = content.quantities[id]
        if id in content.assignments and id in content.rates:
            raise formula.at.error(
                f"{row.whose} has an assignment rule and a rate rule: remove one of them"
            )
        if row.kind == "species" and id in changed and not row.is_boundary:
            raise formula.at.error(
                f"{row.whose} has a rule, and reactions change it: set its boundaryCondition, or "
                "remove it from one of them"
            )


class RateTerms:
    """Terms for rates of change; ``declare`` adds an output or parameter and returns its name."""

    def __init__(
        self, content: SbmlContent, roles: Roles, declare: Callable[[str, str], str]
    ) -> None:
        self._content, self._roles, self._declare = content, roles, declare
        self._found: dict[str, Term] = {}
        self._open: list[str] = []

    def of(self, id: str, reader: FormulaReader) -> Term:
        """Return a quantity's rate of change, per amount or concentration as its identifier."""
        if id in self._open:
            raise ExpressionError(f"depends on itself through rateOf({brief(id)})")
        if id not in self._found:
            self._open.append(id)
            try:
                term = self._formed(id, reader)
            finally:
                self._open.pop()
            # Several formulas may use the rate, so a longer expression becomes a quantity.
            is_short = term.size == 1
            self._found[id] = term if is_short else name(self._declare(term.text, f"rate_of_{id}"))
        return self._found[id]

    def _formed(self, id: str, reader: FormulaReader) -> Term:
        make, content = reader.make, self._content
        what = f"contains rateOf({brief(id)}), but"
        after = " is not a compartment, species or parameter"
        check_known([id], content.quantities, what, after, ExpressionError)
        quantity, role = content.quantities[id], self._roles.of[id]
        if id in content.assignments and role is not EntityRole.FIXED:
            raise ExpressionError(
                f"contains rateOf({brief(id)}), but '{brief(id)}' has an assignment rule: replace "
                "rateOf by the derivative of the rule"
            )
        if role is EntityRole.RATE:
            formula = content.rates[id]
            with explained(formula):
                return reader.read(formula.node)
        if role is EntityRole.CONCENTRATION:
            return make.form("a/b", self._flow(id, reader), reader.symbol(quantity.compartment))
        if role is EntityRole.AMOUNT and quantity.is_amount:
            return self._flow(id, reader)
        if role not in (EntityRole.AMOUNT, EntityRole.DILUTED):
            return number(0.0)
        # c = n/V: c' = (n' - c V')/V.
        size = reader.symbol(quantity.compartment)
        growth = self.of(quantity.compartment, reader)
        diluted = make.form("a*b", reader.symbol(id), growth)
        if role is EntityRole.DILUTED:
            return make.form("-a/b", diluted, size)
        return make.form("(a - b)/c", self._flow(id, reader), diluted, size)

    def _flow(self, id: str, reader: FormulaReader) -> Term:
        """Return the sum of the molar flows from all reactions to a species."""
        make, terms = reader.make, []
        for reaction in self._content.reactions:
            for part in reaction.parts:
                if part.species != id:
                    continue
                count = self._stoichiometry(part.stoichiometry, reader)
                form = "-(a*b)" if part.sign < 0 else "a*b"
                terms.append(make.form(form, count, reader.symbol(reaction.id)))
        if not terms:
            return number(0.0)
        total = make.balanced("a + b", terms)
        conversion = self._content.quantities[id].conversion
        return make.form("a*b", reader.symbol(conversion), total) if conversion else total

    def _stoichiometry(self, given: float | str | Formula, reader: FormulaReader) -> Term:
        if isinstance(given, Formula):
            with explained(given):
                return reader.read(given.node)
        if isinstance(given, str) and given in self._roles.unnamed:
            value = self._content.quantities[given].value
            return reader.symbol(given) if value is None else number(value)
        return reader.symbol(given) if isinstance(given, str) else number(given)
