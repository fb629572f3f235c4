"""Scalar graphs of a scene, with one edge for each port of its components.

The network may determine the variable of a controlled source, such as the current in series with an
inductor. The law of the source then determines the controlling variable, and the two edges are
swapped in the trees, like the input and the output of an ideal amplifier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind, Role, Terminal
from cotree.components.law import ZERO
from cotree.components.terminal import active_port
from cotree.dag.derivative import tangents
from cotree.dag.nodes import Dag
from cotree.domains import DOMAINS
from cotree.errors import Error
from cotree.graph import GraphEdge, LinearGraph
from cotree.scene.scalar_ports import PortEnds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import Expression, FieldValue


@dataclass(frozen=True)
class Port:
    """An edge of a scalar graph, which represents one port of a component."""

    #: Name of the edge: the name of its component and, if there are several ports, of the port.
    name: str
    edge: Edge  # the component, an edge of the scene
    terminal: Terminal  # terminal equation of the port
    ends: PortEnds  # its nodes, or the joint or line of a multibody system on which it acts

    @property
    def tail(self) -> str:
        """The node at which the edge begins."""
        return self.ends.tail

    @property
    def head(self) -> str:
        """The end node of the edge; the across variable is its potential minus the tail's."""
        return self.ends.head

    @property
    def is_coupling(self) -> bool:
        """Whether the port acts on a multibody system instead of a scalar graph."""
        return bool(self.ends.acts_on)

    @property
    def is_short(self) -> bool:
        """Whether both ends are the same node, so that the across variable is zero."""
        return not self.is_coupling and self.tail == self.head

    @property
    def kind(self) -> Kind:
        """The kind of the port, which determines its order in the normal tree."""
        return self.terminal.kind

    @property
    def initial(self) -> dict[str, FieldValue]:
        """Stated initial values, by ``name``, or by ``port.name`` if there are several ports."""
        given = self.edge.initial
        # If there are several ports, the table of a port was converted to names ``port.name``.
        own = f"{self.terminal.port}."
        named = {key.removeprefix(own): v for key, v in given.items() if key.startswith(own)}
        return {key: v for key, v in given.items() if "." not in key} | named

    def sibling(self, port: str) -> str:
        """Return the name of another port of the same component, given its name or number."""
        # The ports of reactions are numbered, so that all reactions of equal orders share one law.
        if port.isdecimal():
            port = self.edge.component.ports[int(port)].port
        return port_name(self.edge, port)


def port_name(edge: Edge, port: str) -> str:
    """Return the name of the edge that represents a component's port."""
    return f"{edge.name}.{port}" if port else edge.name


def scalar_ports(scene: SceneDescription) -> dict[str, Port]:
    """Return the edges of all scalar graphs by name."""
    found = {}
    for edge in scene.edges.values():
        if edge.component.role is Role.NETWORK:
            # ``check_ports`` made ports and ends in the same order.
            for terminal, ends in zip(edge.component.ports, edge.ports, strict=True):
                name = port_name(edge, terminal.port)
                found[name] = Port(name, edge, terminal, ends)
    return found


def scalar_graphs(ports: Mapping[str, Port]) -> dict[str, LinearGraph]:
    """Return the scalar graphs that have edges, by domain."""
    graphs = {}
    for domain, row in DOMAINS.items():
        own = [p for p in ports.values() if p.terminal.domain == domain and not p.is_coupling]
        # A port that acts on a multibody system is not an edge of a scalar graph.
        if row.is_scalar and own:
            # The reference comes first; a dict keeps the scene's order and removes duplicates.
            nodes = dict.fromkeys(["ground", *(n for p in own for n in (p.tail, p.head))])
            edges = (
                GraphEdge(p.name, p.tail, p.head, p.edge.component.name)
                for p in own
                if not p.is_short
            )
            graphs[domain] = LinearGraph(domain, tuple(nodes), tuple(edges))
    return graphs


#: The variable that a source prescribes, by kind of source.
GIVES = {Kind.ACROSS_SOURCE: "across", Kind.THROUGH_SOURCE: "through"}

#: Kinds of controlling edges whose through variable the law of the source may determine. It is a
#: state of through storages, and through sources prescribe it, so these are excluded.
_MEASURED_THROUGH = (Kind.ACROSS_SOURCE, Kind.ACROSS_STORAGE, Kind.DISSIPATOR)


@dataclass(frozen=True)
class Swap:
    """A controlled source whose law may determine the controlling variable."""

    source: Port
    #: Edge of the controlling variable. An open edge, which is in no other graph, replaces it if
    #: the variable is a difference of node potentials or belongs to an edge with its own law.
    control: Port
    #: ``across``, ``through``, or "" for an ideal coupling, whose ports have laws for both.
    quantity: str

    @property
    def name(self) -> str:
        """The name of the swap, which identifies it among the edges."""
        return f"{self.source.name}|{self.control.name}"


def swaps_of(ports: Mapping[str, Port]) -> tuple[Swap, ...]:
    """Return the possible swaps: each source with each variable in its law, and coupled ports."""
    controlled = {
        name: variables
        for name, port in ports.items()
        if _is_single(port, ports) and not port.is_coupling and not port.is_short
        if (variables := dict.fromkeys(_variables(port, ports)))
    }
    found = []
    for name, variables in controlled.items():
        for quantity, tail, head, measured in variables:
            other = ports.get(measured)
            if quantity == "across":
                if other is None or other.kind is not Kind.THROUGH_SOURCE or not _is_meter(other):
                    other = _open(ports[name], tail, head, measured)
                found.append(Swap(ports[name], other, quantity))
            # One controlled source cannot determine the variable of another controlled source.
            elif other is not None and other.kind in _MEASURED_THROUGH:
                found += [] if measured in controlled else [Swap(ports[name], other, quantity)]
    active = {swap.source.terminal.domain for swap in found}
    couples: dict[str, list[Port]] = {}
    for port in ports.values():
        is_free = not port.is_coupling and not port.is_short
        if port.kind is Kind.COUPLED and is_free and port.terminal.domain in active:
            couples.setdefault(port.edge.name, []).append(port)
    for both in couples.values():
        if len(both) == 2:
            first, second = both
            found += [Swap(first, second, ""), Swap(second, first, "")]
    return tuple(found)


def _is_single(port: Port, ports: Mapping[str, Port]) -> bool:
    """Return whether a port is a source and, except for meters, the only port of its component."""
    others = [ports[port.sibling(row.port)] for row in port.edge.component.ports]
    is_source = port.kind in GIVES and not _is_meter(port)
    return is_source and all(_is_meter(p) for p in others if p is not port)


def _variables(port: Port, ports: Mapping[str, Port]) -> Iterator[tuple[str, str, str, str]]:
    """Yield the variables in a source's law: quantity, tail, head, and name of edge or node."""
    law = getattr(port.terminal, GIVES[port.kind])
    fields = port.edge.law_fields
    for argument in law.arguments if law is not None else ():
        quantity, _, rest = argument.partition("_")
        if argument in fields:
            yield from _in_field(fields[argument], port.terminal.domain, ports)  # type: ignore[arg-type]
        elif quantity in GIVES.values() and rest and not rest.startswith("rate"):
            meter = ports[port.sibling(rest)]
            if _is_meter(meter):
                yield from _of_port(quantity, meter, port.terminal.domain)


def _in_field(
    field: Expression, domain: str, ports: Mapping[str, Port]
) -> Iterator[tuple[str, str, str, str]]:
    row = DOMAINS[domain]
    alike = [p for p in ports.values() if p.terminal.domain == domain and not p.is_coupling]
    nodes = {node for port in alike for node in (port.tail, port.head)} - {"ground"}
    potentials = []
    for name in field.names:
        first, _, symbol = name.rpartition(".")
        own = [p for p in alike if first in (p.name, p.edge.name)]
        if len(own) == 1 and symbol in (row.across_symbol, row.through_symbol):
            quantity = "across" if symbol == row.across_symbol else "through"
            yield from _of_port(quantity, own[0], domain)
        elif not own and symbol == row.across_symbol and first in nodes:
            potentials.append(name)
    # If the law depends only on the difference of two potentials, this difference is the variable.
    for name in potentials:
        first = name.rpartition(".")[0]
        others = [o for o in potentials if o != name and _is_of_difference(field, name, o)]
        for other in others:
            if other > name:
                second = other.rpartition(".")[0]
                yield "across", second, first, f"{first}_{second}"
        if not others:
            yield "across", "ground", first, first


def _is_of_difference(field: Expression, first: str, second: str) -> bool:
    """Return whether an expression depends only on the difference of two variables."""
    dag = Dag()
    symbols = {name: dag.symbol("name", i) for i, name in enumerate(field.names)}
    try:
        node = field.lower(dag, symbols.__getitem__)
        (rate,) = tangents([node], {symbols[first]: dag.one, symbols[second]: dag.one})
    except (Error, ArithmeticError):
        return False  # the error is raised later, when the law is formed
    return rate.is_zero


def _of_port(quantity: str, port: Port, domain: str) -> Iterator[tuple[str, str, str, str]]:
    if not port.is_coupling and not port.is_short and port.terminal.domain == domain:
        yield quantity, port.tail, port.head, port.name


def _is_meter(port: Port) -> bool:
    """Return whether a port measures one variable while its other variable is zero."""
    law = getattr(port.terminal, GIVES[port.kind]) if port.kind in GIVES else None
    return law is not None and law.is_zero


def _open(source: Port, tail: str, head: str, measured: str) -> Port:
    terminal = active_port(source.terminal.domain, Kind.THROUGH_SOURCE, measured, through=ZERO)
    return Port(f"{source.name}.{measured}", source.edge, terminal, PortEnds(tail, head))
