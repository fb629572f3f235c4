"""Assignments of SBML events to the states of a scene, some of which are amounts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.errors import brief
from cotree.readers.sbml_roles import Role

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.readers.sbml_content import SbmlContent
    from cotree.readers.sbml_roles import Roles
    from cotree.readers.sbml_simultaneous import Dependencies


def assigned_values(
    events: Iterable[Mapping[str, str]],
    content: SbmlContent,
    roles: Roles,
    names: Mapping[str, str],
) -> dict[str, str]:
    """Return the states and modes that events with one trigger set, with their expressions.

    A concentration is set through the amount to which it corresponds at the compartment's size
    before the event, and a change of size conserves amounts (SBML test suite, case 01779).

    Parameters
    ----------
    events : iterable of mapping of str to str
        Assignments of each event, by identifier: expressions of the values before all of them. The
        events act in this order.
    content : SbmlContent
        The model.
    roles : Roles
        Roles of its quantities.
    names : mapping of str to str
        Names of the scene by identifier.
    """
    found: dict[str, str] = {}
    sizes: dict[str, str] = {}  # values that earlier events have set, including compartments
    for texts in events:
        for id, text in texts.items():
            state = names[id] if roles.of[id] is Role.MODE else f"{names[id]}.c"
            if roles.of[id] is Role.AMOUNT and not content.quantities[id].is_amount:
                place = content.quantities[id].compartment
                text = f"({text})*({sizes.get(place, names[place])})"
            found[state] = text
        for id, quantity in content.quantities.items():
            # The state of a rate rule is the concentration itself.
            is_kept = roles.of[id] is Role.RATE and not quantity.is_amount
            if is_kept and (place := quantity.compartment) in texts:
                state, old = f"{names[id]}.c", sizes.get(place, names[place])
                found[state] = f"({found.get(state, state)})*({old})/({texts[place]})"
        sizes |= texts
    return found


def check_sizes(content: SbmlContent, roles: Roles, dependencies: Dependencies) -> None:
    """Refuse concentrations with rate rules in compartments whose size events change indirectly.

    Raises
    ------
    SceneError
        If there is one: an event would dilute it without setting its compartment.
    """
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
