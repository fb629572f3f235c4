"""Scalar graphs of a scene: an edge for each port of its components.

The law of a controlled source relates its own variable to a variable elsewhere. If the rest of the
network determines the first, as the current in series with an inductor, the law determines the
second: the controlling edge is a branch of the tree of across variables and a chord in that of
through variables, and the source the opposite, like the input and output of an ideal amplifier.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind, Law, Role, Terminal
from cotree.dag.derivative import tangents
from cotree.dag.nodes import Dag
from cotree.domains import DOMAINS
from cotree.errors import Error
from cotree.graph import GraphEdge, LinearGraph
from cotree.scene.ports import PortEnds

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import Expression, FieldValue


@dataclass(frozen=True)
class Port:
    """An edge of a scalar graph: one port of a component."""

    #: Name of the edge in the graph: name of the component, and of the port if there are several.
    name: str
    edge: Edge  # component of the scene
    terminal: Terminal  # terminal equation of the component
    ends: PortEnds  # its nodes, or the joint or line of a multibody system on which the port acts

    @property
    def tail(self) -> str:
        """The node at which it begins."""
        return self.ends.tail

    @property
    def head(self) -> str:
        """The node at which it ends, which the across variable is positive at."""
        return self.ends.head

    @property
    def is_coupling(self) -> bool:
        """Return whether it acts on a multibody system instead of a scalar graph."""
        return bool(self.ends.acts_on)

    @property
    def is_short(self) -> bool:
        """Return whether both ends are one node; its across variable is then zero."""
        return not self.is_coupling and self.tail == self.head

    @property
    def kind(self) -> Kind:
        """Its kind in the order of the normal tree."""
        return self.terminal.kind

    @property
    def initial(self) -> dict[str, FieldValue]:
        """Its initial values in the scene: ``name``, or ``port.name`` with several ports."""
        given = self.edge.initial
        # If there are several ports, a table of a port was flattened to port.name.
        own = f"{self.terminal.port}."
        named = {key.removeprefix(own): v for key, v in given.items() if key.startswith(own)}
        return {key: v for key, v in given.items() if "." not in key} | named

    def sibling(self, port: str) -> str:
        """Return another port of the same component, by its name or number."""
        # Ports of reactions are numbered, so that one law serves all reactions of equal orders.
        if port.isdecimal():
            port = self.edge.component.ports[int(port)].port
        return port_name(self.edge, port)


def port_name(edge: Edge, port: str) -> str:
    """Return the name of the edge of a component's port."""
    return f"{edge.name}.{port}" if port else edge.name


def scalar_ports(scene: SceneDescription) -> dict[str, Port]:
    """Return the edges of all scalar graphs by name."""
    found = {}
    for edge in scene.edges.values():
        if edge.component.role is Role.NETWORK:
            # Ports and ends are in the same order, in which ``check_ports`` made them.
            for terminal, ends in zip(edge.component.ports, edge.ports, strict=True):
                name = port_name(edge, terminal.port)
                found[name] = Port(name, edge, terminal, ends)
    return found


def scalar_graphs(ports: Mapping[str, Port]) -> dict[str, LinearGraph]:
    """Form the scalar graphs that have edges."""
    graphs = {}
    for domain, row in DOMAINS.items():
        own = [p for p in ports.values() if p.terminal.domain == domain and not p.is_coupling]
        # A port that acts on a multibody system has no edge in a scalar graph.
        if row.is_scalar and own:
            # The reference comes first; a dict keeps the order of the scene and drops duplicates.
            nodes = dict.fromkeys(["ground", *(n for p in own for n in (p.tail, p.head))])
            edges = (
                GraphEdge(p.name, p.tail, p.head, p.edge.component.name)
                for p in own
                if not p.is_short
            )
            graphs[domain] = LinearGraph(domain, tuple(nodes), tuple(edges))
    return graphs


#: Variable that a source prescribes, by kind of source.
GIVES = {Kind.ACROSS_SOURCE: "across", Kind.THROUGH_SOURCE: "through"}

#: Kinds whose through variable may be determined by the law of a source that they control. The
#: through variable of a through storage is a state, and that of a through source is given.
_MEASURED_THROUGH = (Kind.ACROSS_SOURCE, Kind.ACROSS_STORAGE, Kind.DISSIPATOR)


@dataclass(frozen=True)
class Swap:
    """A controlled source whose law may determine its controlling variable."""

    source: Port
    #: Edge of the controlling variable. If the variable is a difference of node potentials, or
    #: belongs to an edge with its own law, an open edge is added, which is in no other graph.
    control: Port
    #: The controlling variable: ``across`` or ``through``; empty for an ideal coupling, whose ports
    #: have laws for both.
    quantity: str

    @property
    def name(self) -> str:
        """Its name among the edges."""
        return f"{self.source.name}|{self.control.name}"


def swaps_of(ports: Mapping[str, Port]) -> tuple[Swap, ...]:
    """List the possible swaps: of each source with each variable in its law.

    The ports of an ideal coupling may be swapped, too: each of its two laws may determine a
    variable of the same port.
    """
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
            # A controlled source cannot also determine a variable of the source itself.
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
    """Return whether a port is a source, and the only one of its component apart from meters."""
    others = [ports[port.sibling(row.port)] for row in port.edge.component.ports]
    is_source = port.kind in GIVES and not _is_meter(port)
    return is_source and all(_is_meter(p) for p in others if p is not port)


def _variables(port: Port, ports: Mapping[str, Port]) -> Iterator[tuple[str, str, str, str]]:
    """List the variables in the law of a source: quantity, tail, head, and edge or node."""
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
    """List the variables of edges and nodes in an expression."""
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
    # If only the difference of two potentials occurs, it is the controlling variable.
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
    """Return whether an expression depends on two names only by their difference."""
    dag = Dag()
    symbols = {name: dag.symbol("name", i) for i, name in enumerate(field.names)}
    try:
        node = field.lower(dag, symbols.__getitem__)
        (rate,) = tangents([node], {symbols[first]: dag.one, symbols[second]: dag.one})
    except (Error, ArithmeticError):
        return False  # the error is reported when the law is formed
    return rate.is_zero


def _of_port(quantity: str, port: Port, domain: str) -> Iterator[tuple[str, str, str, str]]:
    if not port.is_coupling and not port.is_short and port.terminal.domain == domain:
        yield quantity, port.tail, port.head, port.name


def _is_meter(port: Port) -> bool:
    """Return whether a port only measures a variable: its other variable is zero."""
    law = getattr(port.terminal, GIVES[port.kind]) if port.kind in GIVES else None
    return law is not None and law.expression == 0


def _open(source: Port, tail: str, head: str, measured: str) -> Port:
    """Make an open edge between nodes."""
    terminal = Terminal(
        source.terminal.domain,
        Kind.THROUGH_SOURCE,
        measured,
        through=Law(lambda: 0),
        is_passive=False,
    )
    return Port(f"{source.name}.{measured}", source.edge, terminal, PortEnds(tail, head))
