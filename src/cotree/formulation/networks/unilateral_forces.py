"""Dry friction and rigid stops: checks, and forces that are multipliers.

Inertias must determine the relative acceleration of each edge that may stick. On a mechanism, the
force of friction or of a stop is an unknown of the linear equations: while the edge sticks or is
closed, the multiplier of the condition that its relative acceleration is zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind
from cotree.dag.nodes import MEASURED, symbols_in
from cotree.errors import FormulationError
from cotree.formulation.networks.rules import holding_laws

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from cotree.components import Law
    from cotree.dag.nodes import Node
    from cotree.formulation.networks.rules import Variable
    from cotree.formulation.networks.topology import Topology
    from cotree.scene.networks import Port


def check_friction(ports: Mapping[str, Port], topologies: Mapping[str, Topology]) -> None:
    """Raise FormulationError unless inertias determine the acceleration of each sticking edge."""
    for name, port in ports.items():
        if not port.kind.may_hold or port.is_coupling:
            continue
        whose = f"edge '{port.edge.name}' of type '{port.edge.component.name}'"
        if port.is_short:
            raise FormulationError(
                f"{whose} begins and ends at node '{port.head}': name another node"
            )
        kinds = {n: ports[n].kind for n in topologies[port.terminal.domain].along(name)}
        for branch, kind in kinds.items():
            if kind not in (Kind.ACROSS_STORAGE, Kind.COUPLED, Kind.ACROSS_SOURCE):
                raise FormulationError(
                    f"{whose} {_HOLDS[port.kind]}, so that inertias must determine the "
                    f"relative acceleration of its nodes, but between them is '{branch}', "
                    f"which has none: add {_INERTIA[port.terminal.domain]} to the node that "
                    "has none"
                )
        if all(kind is Kind.ACROSS_SOURCE for kind in kinds.values()):
            raise FormulationError(
                f"{whose} is connected between prescribed speeds, so that it cannot stick: "
                f"add {_INERTIA[port.terminal.domain]} to one of its nodes, or remove it"
            )


def used_by_friction(
    ports: Mapping[str, Port], fields: Mapping[tuple[str, str], Node]
) -> frozenset[Node]:
    """Return the mechanism's symbols that occur only in fields of its friction and dampers."""
    frictional = _edges(ports, Kind.FRICTION, Kind.DISSIPATOR)
    used: dict[bool, set[Node]] = {True: set(), False: set()}
    for (edge, _), node in fields.items():
        used[edge in frictional].update(s for s in symbols_in([node]) if s.data[0] == MEASURED)
    return frozenset(used[True] - used[False])


def _edges(ports: Mapping[str, Port], *kinds: Kind) -> set[str]:
    return {port.edge.name for port in ports.values() if port.kind in kinds and port.is_coupling}


_HOLDS = {Kind.FRICTION: "sticks", Kind.STOP: "holds at its limits"}

_INERTIA = {"translational": "a translational_mass", "rotational": "a rotational_inertia"}


@dataclass(frozen=True)
class Holding:
    """A unilateral constraint on a mechanism; it holds while it sticks or is closed."""

    port: str  # name of the port
    multiplier: Node  # symbol of its force while it holds
    share: Node  # one in modes in which the multiplier acts, otherwise zero
    jump: Node  # change of the port's across variable in an impact, otherwise zero


def holding_ports(ports: Mapping[str, Port]) -> list[str]:
    """Return the ports of friction and stops that act on the mechanism."""
    return [
        name
        for name, port in ports.items()
        if port.kind.may_hold
        and port.is_coupling
        and not (port.terminal.friction and port.terminal.friction.load)
    ]


def reacting_fields(
    ports: Mapping[str, Port],
    holding: Collection[str],
    fields: Mapping[tuple[str, str], Node],
    measured: Mapping[Node, Variable],
    is_motion: Callable[[Node], bool],
) -> frozenset[tuple[str, str]]:
    """Return the fields of friction, stops and dampers that depend on forces or accelerations."""
    edges = {ports[name].edge.name for name in holding}
    dampers = _edges(ports, Kind.DISSIPATOR)

    def is_reacting(edge: str, symbol: Node) -> bool:
        if symbol in measured:
            if edge in dampers:
                return False
            quantity, name = measured[symbol]
            return not (quantity in ("across", "stretch") and ports[name].is_coupling)
        return symbol.data[0] == MEASURED and not is_motion(symbol)

    return frozenset(
        key
        for key, node in fields.items()
        if key[0] in edges | dampers
        and any(is_reacting(key[0], symbol) for symbol in symbols_in([node]))
    )


def holding_of(port: Port, multiplier: Node, fields: Mapping[tuple[str, str], Node]) -> Holding:
    """Return the unilateral constraint of a port with the given multiplier."""

    def value(law: Law) -> Node:
        own = {field: fields[port.edge.name, field] for field in law.arguments}
        return law.value(multiplier.dag, own)

    _, share, jump = holding_laws(port.terminal)
    return Holding(port.name, multiplier, value(share), value(jump))


def limit_law(port: Port, which: str) -> Law:
    """Return the law named ``which`` of dry friction or of a stop."""
    law: Law = getattr(port.terminal.friction or port.terminal.stop, which)
    return law


def is_holding(ports: Mapping[str, Port], variable: Variable) -> bool:
    """Return whether a variable is the force of dry friction or of a rigid stop."""
    quantity, name = variable
    return quantity == "through" and ports[name].kind.may_hold
