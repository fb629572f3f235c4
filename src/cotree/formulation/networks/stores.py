"""Totals of contents (charges, flux linkages) as states, which need no rates of storages.

Consider a branch capacitor and the capacitors in its f-cutset: only the currents of other chords
change their total charge. This total is the state, and an equation determines the voltages from it.
Integration methods conserve linear invariants up to rounding, so no charge is lost at any
tolerance. The flux linkage along the f-circuit of an inductor is the dual case.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Kind, content_of
from cotree.domains import DOMAINS
from cotree.formulation.networks.rules import linear_content

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from cotree.components import Law
    from cotree.formulation.networks.rules import Variable
    from cotree.formulation.networks.topology import Topology
    from cotree.scene.networks import Port

#: For each kind of storage: its state variable, and the variable that is the content's rate.
_VARIABLES = {
    Kind.ACROSS_STORAGE: ("across", "through"),
    Kind.THROUGH_STORAGE: ("through", "across"),
}


@dataclass(frozen=True)
class Total:
    """A sum of storage contents (charges or flux linkages) that is a state."""

    port: Port  # the storage whose f-cutset or f-circuit defines the total
    #: Signs and names of the storages whose contents are added, beginning with ``port``.
    parts: tuple[tuple[int, str], ...]
    #: Signs and variables whose sum is the rate of the total.
    flows: tuple[tuple[int, Variable], ...]

    @property
    def is_alone(self) -> bool:
        """Whether the total is the content of a single storage."""
        return len(self.parts) == 1

    @property
    def symbol(self) -> tuple[str, str]:
        """Name of the total without its port's name, and its unit."""
        row = DOMAINS[self.port.terminal.domain]
        own = row.content if self.port.kind is Kind.ACROSS_STORAGE else row.impulse
        return (own[0] if self.is_alone else f"{own[0]}_total"), own[1]

    @property
    def unknown(self) -> Variable:
        """The variable of the storage that the total determines."""
        return _VARIABLES[self.port.kind][0], self.port.name


def contents_of(
    ports: Mapping[str, Port], is_constant: Callable[[Port, str], bool]
) -> dict[str, Law]:
    """Return the laws of storage contents, including constant capacities and inertances."""
    found = {}
    # If no storage is defined by its content, voltages and currents are the states.
    if all(content_of(port.terminal) is None for port in ports.values()):
        return {}
    for port in ports.values():
        law = port.terminal.content
        if law is None and port.kind in _VARIABLES:
            law = linear_content(port.terminal)
            own = () if law is None else law.arguments
            # If the capacity depends on time, its law lacks the term v dC/dt of the content's rate.
            if not all(n in _VARIABLES[port.kind] or is_constant(port, n) for n in own):
                law = None
        if law is not None:
            found[port.name] = law
    return found


def find_stores(
    ports: Mapping[str, Port],
    topologies: Mapping[str, Topology],
    cutsets: Mapping[str, Topology],
    contents: Mapping[str, Law],
) -> dict[str, Total]:
    """Return the totals of contents that are states, by port."""
    found = {}
    for name in contents:
        port = ports[name]
        # A port on a multibody system, or with both ends at one node, is in no cutset or circuit.
        if port.is_coupling or port.is_short:
            continue
        across, through = topologies[port.terminal.domain], cutsets[port.terminal.domain]
        is_branch = name in across.branches
        # An across storage that is a chord depends on others, and so does a through storage that
        # is a branch.
        if is_branch != (port.kind is Kind.ACROSS_STORAGE):
            continue
        # Charges are summed over a cutset, flux linkages along a circuit.
        if not is_branch:
            around = across.along(name)
        elif name in through.branches:
            around = through.crossing(name)
        else:
            around = {name: 1}  # the source that this storage controls determines the inflow
        like = [n for n in around if n != name and n in contents and ports[n].kind is port.kind]
        if any(ports[n].terminal.content is not None for n in (name, *like)):
            found[name] = _store(ports, name, around, like)
    return found


def _store(
    ports: Mapping[str, Port], name: str, around: Mapping[str, int], like: Iterable[str]
) -> Total:
    port, within = ports[name], set(like)
    flow = _VARIABLES[port.kind][1]
    flows: list[tuple[int, Variable]] = [
        (sign, ("loss" if n in within else flow, n))
        for n, sign in around.items()
        # Charge that moves between storages of the total leaves it unchanged: only leakage counts.
        if n not in within or _has_loss(ports[n])
    ]
    if _has_loss(port):
        flows.append((-1, ("loss", name)))
    # The contents of edges in the opposite direction are subtracted.
    parts = ((1, name), *((-around[n], n) for n in like))
    return Total(port, parts, tuple(flows))


def _has_loss(port: Port) -> bool:
    """Return whether the rate of a port's content has a term besides the inflow."""
    is_across = port.kind is Kind.ACROSS_STORAGE
    return (port.terminal.through if is_across else port.terminal.across) is not None


def is_of_content(ports: Iterable[Port], edge: str, field: str) -> bool:
    """Return whether a field of an edge occurs only in the contents of storages."""
    laws = {
        name
        for port in ports
        for name in ("across", "through", "storage", "content")
        if port.edge.name == edge and (law := getattr(port.terminal, name)) and law.uses(field)
    }
    return laws == {"content"}
