"""What events of SBML set in the states of a scene, some of which are amounts."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.readers.sbml_roles import Role

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.readers.sbml_content import SbmlContent
    from cotree.readers.sbml_roles import Roles


def assigned_values(
    events: Iterable[Mapping[str, str]],
    content: SbmlContent,
    roles: Roles,
    names: Mapping[str, str],
) -> dict[str, str]:
    """Give the states and modes that events with one trigger set, and the expressions of these.

    A concentration is set by the amount that it means in the size that the compartment has before
    the event, and a change of size keeps amounts (SBML test suite, case 01779).

    Parameters
    ----------
    events : iterable of mapping of str to str
        What each sets, by identifier: expressions of the values before all of them. The events
        act in this order.
    content : SbmlContent
        The model.
    roles : Roles
        Roles of its quantities.
    names : mapping of str to str
        Names of the scene by identifier.
    """
    found: dict[str, str] = {}
    sizes: dict[str, str] = {}  # what has been set by earlier events, compartments among it
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
