"""Edges of a scene: components between nodes, created from statements and checked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.arguments import plain
from cotree.components import COMPONENTS, Component, Role
from cotree.errors import SceneError, brief
from cotree.scene.fields import check_fields, check_initial, edge_statement
from cotree.scene.ports import PortEnds, check_heat, check_ports

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.scene.expressions import FieldValue


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
        from cotree.scene.usage_text import proposed_types

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
