"""Names in the formulas of an SBML model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.readers.sbml_content import Formula
from cotree.readers.sbml_nodes import children, kind_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.readers.sbml_content import SbmlContent

#: The symbol of time, in lists of names.
TIME = "time of the run"


def rate_name(identifier: str) -> str:
    """Return the entry for the rate of a quantity in lists of names; no identifier equals it."""
    return f"rateOf({identifier})"


def names_of(node: Any, functions: Mapping[str, Any]) -> frozenset[str]:
    """List the identifiers of a formula, the rates that it names, and :data:`TIME`.

    Parameters
    ----------
    node : libsbml.ASTNode
        Its tree.
    functions : mapping of str to node
        The model's functions, which may name the time.
    """
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
            # A function refers only to its arguments, which the call lists, and to the time.
            body = children(functions[own.getName()])[-1]
            found |= {TIME} & names_of(body, {k: v for k, v in functions.items() if k not in seen})
        waiting += children(own)
    return frozenset(found)


def rate_dependencies(content: SbmlContent) -> dict[str, frozenset[str]]:
    """List the identifiers that the rate of each quantity depends on, by its :func:`rate_name`.

    Parameters
    ----------
    content : SbmlContent
        The model.

    Returns
    -------
    dict of str to frozenset of str
        Quantities, reactions and other rates.
    """
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
