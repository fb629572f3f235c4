"""Edges of a scene: components between nodes, created from statements and checked.

Typed methods, their docstrings and ``cotree components`` follow from these descriptions, which
follow from the table of components alone.
"""

from __future__ import annotations

import difflib
import tomllib
from dataclasses import dataclass, field
from functools import lru_cache
from importlib import resources
from typing import TYPE_CHECKING, Any

from cotree.arguments import plain
from cotree.components import COMPONENTS, Component, Field, Kind, Role, Shape, Terminal
from cotree.components.ports import HEAT, loss_of
from cotree.domains import DOMAINS
from cotree.errors import SceneError, brief
from cotree.scene.fields import check_fields, check_initial, edge_statement, initial_names
from cotree.scene.ports import PortEnds, acts_on_multibody, check_heat, check_ports

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.scene.expressions import FieldValue


_LONGEST = 40  # number of letters of a name that are compared: a name from a file may be long

#: Synonyms of components, in the order of the table.
_ALSO_CALLED = {
    "rigid_body": ("body", "mass", "point_mass", "particle", "inertia"),
    "arm": ("link", "rod", "bar", "beam", "offset"),
    "weld": ("fixed", "rigid", "clamp"),
    "revolute": ("hinge", "pin", "pivot", "rotary", "rotation"),
    "prismatic": ("slider", "slide", "rail", "guide", "linear_joint"),
    "spherical": ("ball", "ball_joint", "ball_and_socket"),
    "universal": ("cardan", "hooke"),
    "free": ("floating", "six_dof"),
    "screw": ("helical", "lead_screw"),
    "rolling_disc": ("wheel", "rolling"),
    "contact": ("collision", "impact", "ground_contact", "bump"),
    "spring": ("spring_damper",),
    "damper": ("dashpot", "viscous"),
    "coupled_inductors": ("mutual_inductance",),
    "translational_mass": ("mass",),
    "translational_stop": ("limit", "limits", "end_stop", "hard_stop", "bumper"),
    "rotational_stop": ("limit", "limits", "end_stop", "hard_stop"),
    "rotational_inertia": ("inertia", "flywheel", "rotor"),
    "ideal_gear": ("gearbox",),
    "dc_motor": ("generator",),
    "voice_coil": ("linear_motor", "loudspeaker", "actuator"),
    "hydraulic_cylinder": ("actuator", "piston", "ram"),
    "voltage_source": ("battery", "supply"),
    "battery_cell": ("battery",),
    "bjt_npn": ("transistor", "npn"),
    "bjt_pnp": ("transistor", "pnp"),
    "mosfet_n": ("transistor", "nmos"),
    "mosfet_p": ("transistor", "pmos"),
    "ideal_op_amp": ("opamp", "op_amp", "amplifier"),
}


@dataclass(frozen=True)
class Entry:
    """Name, meaning and unit of one entry of an edge besides its positional nodes."""

    name: str
    doc: str
    takes: str  # kind of value: ``value``, ``constant``, ``vector``, ``nodes``, ``name``, ...
    unit: str = ""
    required: bool = False  # whether the field must be given
    default: float | None = None  # default; None: the entry may be omitted


@dataclass(frozen=True)
class Usage:
    """The form in which edges of a component type are written."""

    component: Component  # component of the edge
    #: Node names in the order of the list; empty if each port has separate nodes.
    nodes: tuple[str, ...]
    n_needed: int  # number of required nodes
    #: Whether a list of nodes has one node for each port, with the ground as the other one.
    has_ports: bool
    entries: tuple[Entry, ...]  # ports and fields of the component
    initial: tuple[str, ...]  # variables for which initial values may be given


def usage_of(name: str) -> Usage:
    """Describe how edges of a component type are written."""
    component = COMPONENTS.get(name)
    if component is None:
        raise SceneError(f"there is no component '{brief(name)}'{proposed_types(name)}")
    nodes, n_needed, has_ports = _nodes(component)
    fields = [_entry(field) for field in component.fields]
    entries = (*_ports(component), *fields, *_heat(component))
    initial = tuple(initial_names(component))
    return Usage(component, nodes, n_needed, has_ports, entries, initial)


def proposed_types(name: object) -> str:
    """Return suggestions for an unknown component type, for the end of a message."""
    word = str(name)[:_LONGEST].lower().replace("-", "_").strip()
    rows = COMPONENTS.items()
    # Synonyms from textbooks first, then names and descriptions that contain the word, then
    # misspellings.
    found = [type for type, others in _ALSO_CALLED.items() if word in others]
    # Transposed letters may form another word: 'ram' for 'arm'.
    found += [type for type in COMPONENTS if sorted(type) == sorted(word)]
    found += [type for type, row in rows if word in type.split("_") or word in row.doc.split()]
    if not found:
        parts = {part for type in COMPONENTS for part in (type, *type.split("_"))}
        close = difflib.get_close_matches(word, sorted(parts), n=1, cutoff=0.6)
        found = [type for type in COMPONENTS if close and close[0] in (type, *type.split("_"))]
    if not found:
        return f"; known: {', '.join(COMPONENTS)}"
    return f"; did you mean {' or '.join(repr(other) for other in dict.fromkeys(found[:5]))}?"


def _nodes(component: Component) -> tuple[tuple[str, ...], int, bool]:
    """List the nodes of a type, how many of them are needed, and whether ports have their own."""
    if any(field.shape is Shape.NAMES for field in component.fields):
        return (), 0, False  # nodes are given by fields
    if component.terminals:
        nodes = (*component.terminals, *component.optional_terminals)
        return nodes, len(component.terminals), False
    if component.geometry is None and len(component.ports) > 1:
        return (), 0, True
    if component.geometry is not None or not component.ports:
        return ("first", "second"), 2, False
    (port,) = component.ports
    ends = ("plus", "minus") if DOMAINS[port.domain].head_first else ("first", "second")
    return ends, 0 if acts_on_multibody(port) else 2, False


def _ports(component: Component) -> list[Entry]:
    """List the entries for nodes of ports, and for the joint or line on which ports act."""
    if component.terminals or component.geometry is not None:
        return []
    found = []
    if len(component.ports) > 1:
        found = [Entry(port.port, _port_doc(port), "nodes") for port in component.ports]
    acting = [port for port in component.ports if acts_on_multibody(port)]
    if acting:
        doc = "joint that it acts on in place of two nodes, or its coordinate: h or h.theta"
        found.append(Entry("joint", doc, "name"))
    # Prescribed velocities along a line are not supported.
    along = [port for port in acting if port.kind is not Kind.ACROSS_SOURCE]
    if any(port.domain == "translational" for port in along):
        doc = "two nodes of the multibody system; it acts along their line"
        found.append(Entry("line", doc, "nodes"))
    return found


def _port_doc(port: Terminal) -> str:
    row = DOMAINS[port.domain]
    ends = "plus, minus" if row.head_first else "first, second"
    return f"its nodes in the {port.domain} graph: {ends}"


def _heat(component: Component) -> list[Entry]:
    if component.role is not Role.NETWORK or loss_of(component) is None:
        return []
    return [Entry(HEAT, "thermal node that takes up its loss, or two", "node or nodes")]


def _entry(field: Field) -> Entry:
    takes = field.shape.value
    if field.shape is Shape.SCALAR:
        takes = "constant" if field.constant and not field.timed else "value"
    # A unit of one is not shown.
    unit = "" if field.unit == "1" else field.unit
    return Entry(field.name, field.doc, takes, unit, field.required, field.default)


@lru_cache(maxsize=1)
def examples() -> Mapping[str, tuple[str, Mapping[str, Any]]]:
    """Return an edge of each built-in component: its name and its statement.

    They are those of the component pages, in a file that a test compares with them.
    """
    file = resources.files("cotree") / "components" / "examples.toml"
    tables = tomllib.loads(file.read_text(encoding="utf-8"))
    # Each table holds one edge, under its name.
    return {type: next(iter(edges.items())) for type, edges in tables.items()}


@dataclass(frozen=True, repr=False)
class Edge:
    """A component between its nodes, with its fields and initial values.

    Attributes
    ----------
    name : str
        Its name.
    component : Component
        Its component type.
    nodes : tuple of str
        Its nodes: two, except for scalar components with several ports, or on a joint.
    fields, initial : mapping
        Values of its fields, and initial values, by name.
    ports : tuple of PortEnds
        Of a scalar component: the end nodes of each port's edge.
    statement : mapping
        The original statement, as the table of a scene file: the component's type, the nodes as
        listed, the fields as given. The rest of an edge follows from this.
    """

    name: str
    component: Component = field(compare=False)  # some components are adapted to the edge
    nodes: tuple[str, ...]
    fields: Mapping[str, FieldValue]
    initial: Mapping[str, FieldValue]
    ports: tuple[PortEnds, ...] = ()
    statement: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        name, kind, nodes, fields = self.cells()
        return f"<Edge {name}: {kind} {nodes}{', ' + fields if fields else ''}>"

    def __reduce__(self) -> tuple[Any, ...]:
        # Laws of components are functions, which cannot be pickled; the statement can be.
        return _edge_again, (self.name, dict(self.statement))

    def in_mechanics(self) -> Edge | None:
        """Return the edge's multibody component, its contact shapes, or None."""
        if self.component.role is not Role.NETWORK:
            return self
        geometry = self.component.geometry
        if geometry is None:
            return None
        fields = {name: value for name, value in self.fields.items() if geometry.field(name)}
        return Edge(self.name, geometry, self.ports[0].acts_on, fields, {}, (), self.statement)

    @property
    def law_fields(self) -> Mapping[str, FieldValue]:
        """The fields that laws take: all but contact shapes."""
        geometry = self.component.geometry
        if geometry is None:
            return self.fields
        return {name: value for name, value in self.fields.items() if not geometry.field(name)}

    def cells(self) -> tuple[str, str, str, str]:
        """Return the row of a table: name, type, nodes and fields, as stated."""
        known = {"type", "nodes", "initial"}
        fields = ", ".join(f"{k}={_plain(v)}" for k, v in self.statement.items() if k not in known)
        between = " → " if len(self.nodes) == 2 else ", "
        return self.name, self.component.name, between.join(self.nodes), fields


def _plain(value: object) -> str:
    """Write a value of a field without quotes."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_plain, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{k}={_plain(v)}' for k, v in value.items())}}}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def make_edge(
    name: str, type: str, nodes: Sequence[str], initial: Any, fields: Mapping[str, Any]
) -> Edge:
    """Make an edge from a statement; see :meth:`SceneDescription.edge`."""
    # The type is read from a file and may be of any kind.
    component = COMPONENTS.get(type) if isinstance(type, str) else None
    if component is None:
        hint = proposed_types(type)
        raise SceneError(f"edge '{name}' has the unknown type '{brief(type)}'{hint}")
    listed: Sequence[object] = nodes
    # Lists are copied, so that later changes to them do not affect the scene.
    given: Mapping[str, Any] = plain(fields)
    first: Any = {} if initial is None else plain(initial)
    statement = edge_statement(type, nodes, given, first)
    # Adapt the component first, since this determines the ports. Then append the thermal port, so
    # that ``check_ports`` finds it last; all entries except nodes are fields.
    if component.adapt is not None:
        component, listed, given = component.adapt(name, nodes, given)
    component = check_heat(name, component, given)
    names, ports, rest = check_ports(name, component, listed, given)
    return Edge(
        name,
        component,
        names,
        check_fields(name, component, rest),
        check_initial(name, component, first),
        ports,
        statement,
    )


def _edge_again(name: str, statement: Mapping[str, Any]) -> Edge:
    """Make an edge from its statement when it is unpickled."""
    fields = dict(statement)
    type, nodes = fields.pop("type"), fields.pop("nodes", ())
    return make_edge(name, type, nodes, fields.pop("initial", None), fields)
