"""Roles of an SBML model's quantities: constant, state, or determined by a rule."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING

from cotree.errors import brief
from cotree.readers.sbml_content import Formula
from cotree.readers.sbml_names import names_of, rate_dependencies, rate_name

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.readers.sbml_content import Quantity, Reaction, SbmlContent


class Role(Enum):
    """The kind of element that represents a quantity in the scene."""

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
        """Whether the quantity is an integrated state."""
        return self in (Role.CONCENTRATION, Role.AMOUNT, Role.RATE)


@dataclass(frozen=True)
class Roles:
    """Roles of all quantities.

    Attributes
    ----------
    of : dict of str to Role
        By identifier.
    order : tuple of str
        Quantities of assignment rules that become outputs, in order of their dependencies.
    reactions : dict of str to Reaction
        The reactions by identifier.
    """

    of: dict[str, Role]
    order: tuple[str, ...]
    reactions: dict[str, Reaction]

    @property
    def unnamed(self) -> frozenset[str]:
        """Stoichiometries that no formula contains."""
        return frozenset(id for id, role in self.of.items() if role is Role.UNNAMED)


def roles_of(content: SbmlContent) -> Roles:
    """Determine the role of each quantity.

    Raises
    ------
    SceneError
        If rules contradict each other or the reactions, form a cycle, or determine an unknown
        quantity.
    """
    reactions = {reaction.id: reaction for reaction in content.reactions}
    _check(content)
    formulas = {id: f.node for id, f in content.assignments.items()}
    formulas |= {id: reaction.law.node for id, reaction in reactions.items()}
    uses = {id: names_of(node, content.functions) for id, node in formulas.items()}
    for id, reaction in reactions.items():
        uses[id] -= reaction.local.keys()
    set_by_events = {id for event in content.events for id in event.sets}
    named = _named(content, uses.values())
    found: dict[str, Role] = {}
    for id, row in content.quantities.items():
        if id in content.rates:
            found[id] = Role.RATE
        elif id in content.assignments:
            found[id] = Role.ASSIGNED
        elif row.kind.startswith("stoichiometry") and id not in named:
            found[id] = Role.UNNAMED
        elif row.kind == "species" and not row.is_boundary and not row.is_constant:
            found[id] = Role.CONCENTRATION
        else:
            found[id] = Role.MODE if id in set_by_events else Role.FIXED
    order = _order(uses | rate_dependencies(content), content)
    # A rule that depends only on constants defines a constant; species in such a compartment need
    # not become amounts.
    for id in order:
        if id in content.assignments and all(found.get(n) is Role.FIXED for n in uses[id]):
            found[id] = Role.FIXED
    for id, row in content.quantities.items():
        if row.kind == "species" and found[row.compartment] is not Role.FIXED:
            found[id] = _in_changing_place(found[id], row)
        elif found[id] is Role.CONCENTRATION and row.is_amount:
            found[id] = Role.AMOUNT
    outputs = tuple(id for id in order if found.get(id) is Role.ASSIGNED)
    return Roles(found, outputs, reactions)


def _in_changing_place(role: Role, species: Quantity) -> Role:
    """Return the role of a species whose compartment changes its size."""
    if role is Role.CONCENTRATION or (role is Role.MODE and not species.is_amount):
        return Role.AMOUNT
    return Role.DILUTED if role is Role.FIXED and not species.is_amount else role


def _named(content: SbmlContent, uses: Iterable[frozenset[str]]) -> frozenset[str]:
    """List the identifiers that formulas contain or determine."""
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
    """Sort assigned quantities and reaction rates so that each follows what it depends on."""
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
    """Refuse quantities that both rules and reactions determine, and rules for unknown ones."""
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
