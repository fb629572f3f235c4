"""Chemical components: concentration is across; molar flow, from plus to minus inside, is through.

A species is an edge to the ground. A reaction has one port per species, also to the ground, whose
flow is what the reaction consumes of the species. The port is a source if this flow does not depend
on the species' own concentration (products of one-way reactions, catalysts).
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Field, Role, Shape, optional, value
from cotree.components.law import Law
from cotree.components.ports import across_source, storage, through_source
from cotree.components.terminal import Kind, Terminal, active_port
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.components.component import Adapted, Given, Nodes

_DOMAIN = "chemical"

SPECIES = storage(
    _DOMAIN,
    "species",
    "amount of a species in a well-stirred volume",
    value("volume", "m^3", "volume of the solution"),
    is_absolute=True,
)

CONCENTRATION_SOURCE = across_source(
    _DOMAIN,
    "concentration_source",
    "prescribed concentration: a species in excess, a bath",
    value(
        "concentration", "mol/m^3", "concentration of the plus node; the ground is at 0 mol/m^3", ""
    ),
)

MOLAR_FLOW_SOURCE = through_source(
    _DOMAIN,
    "molar_flow_source",
    "prescribed molar flow",
    value("flow", "mol/s", "molar flow inside the source, positive from plus to minus", ""),
)


@lru_cache(maxsize=1024)
def _mass_action(
    orders: tuple[int, ...], products: tuple[int, ...], net: int, *, is_reversible: bool
) -> Law:
    """Return the law of a species' port: the flow that the reaction consumes.

    ``orders[i]`` and ``products[i]`` count how often species ``i`` is a reactant and a product.
    ``net`` is the number of molecules of the port's species that one turnover consumes.
    """
    # The ports are numbered in the order in which the scene lists the species.
    names = tuple(f"across_{i}" for i in range(len(orders)))

    def law(volume: Any, rate: Any, *rest: Any) -> Any:
        concentrations = rest[-len(names) :] if names else ()
        powers = zip(concentrations, orders, products, strict=True)
        # Law of mass action (Guldberg and Waage): rate = k * product of concentrations ** orders.
        forth, back = rate, rest[0] if is_reversible else 0
        for concentration, order, product in powers:
            forth, back = forth * concentration**order, back * concentration**product
        # The flow, [mol/s], leaves the species' node; ``net`` of a product is negative.
        return net * volume * (forth - back)

    fields = ("volume", "rate", "reverse_rate") if is_reversible else ("volume", "rate")
    return Law.taking((*fields, *names), law)


def _port(number: int, name: str, net: int, law: Callable[[int], Law]) -> Terminal:
    """Build the port of a species; one turnover consumes ``net`` molecules of it."""
    through = law(net)
    # If the flow does not depend on the species' concentration, the port is a source.
    kind = Kind.DISSIPATOR if through.uses(f"across_{number}") else Kind.THROUGH_SOURCE
    return active_port(_DOMAIN, kind, name, through=through, between=(name, "ground"))


def _names(edge: str, field: str, fields: dict[str, Any]) -> Counter[str]:
    """Remove the list ``field`` from ``fields``, and count how often it names each node."""
    listed = fields.pop(field, [])
    is_list = isinstance(listed, (list, tuple))
    if not is_list or not all(isinstance(name, str) for name in listed):
        raise SceneError(f"{field} of edge '{edge}' must be a list of names of nodes")
    if "ground" in listed:
        raise SceneError(
            f"{field} of edge '{edge}' name 'ground', the reference of concentrations: leave "
            "it out; species that need not be balanced are not reactants or products"
        )
    return Counter(listed)


def _react(edge: str, nodes: Nodes, fields: Given) -> Adapted:
    rest = dict(fields)
    reactants, products = _names(edge, "reactants", rest), _names(edge, "products", rest)
    # A catalyst (net 0) also gets a port, because the rate depends on its concentration.
    species = tuple(dict.fromkeys([*reactants, *products]))
    if nodes or not species:
        raise SceneError(
            f"edge '{edge}' of type 'reaction' needs reactants or products, lists of nodes, "
            "instead of nodes"
        )
    orders = tuple(reactants[name] for name in species)
    made = tuple(products[name] for name in species)
    law = partial(_mass_action, orders, made, is_reversible="reverse_rate" in rest)
    ports = tuple(
        _port(i, name, reactants[name] - products[name], law) for i, name in enumerate(species)
    )
    return replace(REACTION, ports=ports, terminals=species), species, rest


REACTION = Component(
    "reaction",
    Role.NETWORK,
    "reaction with mass action kinetics",
    fields=(
        Field(
            "reactants",
            "1",
            "nodes of the reactants, each repeated by its coefficient",
            Shape.NAMES,
        ),
        Field(
            "products", "1", "nodes of the products, each repeated by its coefficient", Shape.NAMES
        ),
        value("rate", "any", "rate constant of the forward reaction", "nonnegative"),
        optional(
            "reverse_rate", "any", "rate constant of the backward reaction", None, "nonnegative"
        ),
        optional("volume", "m^3", "volume of the solution", 1.0, "positive"),
    ),
    domains=(_DOMAIN,),
    adapt=_react,
)

COMPONENTS = (SPECIES, REACTION, MOLAR_FLOW_SOURCE, CONCENTRATION_SOURCE)
