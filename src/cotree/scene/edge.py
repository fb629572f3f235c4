"""Edges of a scene: components between nodes, created from checked statements."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.arguments import plain
from cotree.components import COMPONENTS, Component, Role
from cotree.errors import SceneError, brief
from cotree.scene.fields import check_fields, check_initial, edge_statement
from cotree.scene.scalar_ports import PortEnds, check_heat, check_ports

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.scene.expressions import FieldValue


@dataclass(frozen=True, repr=False)
class Edge:
    """A component between nodes, with fields and initial values.

    Attributes
    ----------
    name : str
        Its name.
    component : Component
        Its component type.
    nodes : tuple of str
        Its nodes: two, unless it has several scalar ports or acts on a joint.
    fields, initial : mapping
        Its fields and its initial values, by name.
    ports : tuple of PortEnds
        The end nodes of each port's edge, for scalar components.
    statement : mapping
        The original statement, as in a scene file: component type, listed nodes, stated fields. It
        determines all other attributes.
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
        # Laws of components contain functions, which cannot be pickled, but the statement can.
        return _edge_again, (self.name, dict(self.statement))

    def in_mechanics(self) -> Edge | None:
        """Return the edge's part in the multibody system: itself, its contact shapes, or None."""
        if self.component.role is not Role.NETWORK:
            return self
        geometry = self.component.geometry
        if geometry is None:
            return None
        fields = {name: value for name, value in self.fields.items() if geometry.field(name)}
        return Edge(self.name, geometry, self.ports[0].acts_on, fields, {}, (), self.statement)

    @property
    def law_fields(self) -> Mapping[str, FieldValue]:
        """The fields that are arguments of laws: all except contact shapes."""
        geometry = self.component.geometry
        if geometry is None:
            return self.fields
        return {name: value for name, value in self.fields.items() if not geometry.field(name)}

    def cells(self) -> tuple[str, str, str, str]:
        """Return the cells of a table row: name, type, nodes and fields, as stated."""
        known = {"type", "nodes", "initial"}
        fields = ", ".join(f"{k}={_plain(v)}" for k, v in self.statement.items() if k not in known)
        between = " → " if len(self.nodes) == 2 else ", "
        return self.name, self.component.name, between.join(self.nodes), fields


def _plain(value: object) -> str:
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_plain, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{k}={_plain(v)}' for k, v in value.items())}}}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def make_edge(
    name: str, type: str, nodes: Sequence[str], initial: Any, fields: Mapping[str, Any]
) -> Edge:
    """Create an edge from a statement; see :meth:`SceneDescription.edge`."""
    # The type was read from a file and may be any object.
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
    # The component is adapted first, because this determines its ports. The thermal port is then
    # appended, so that it is the last one in ``check_ports``. All remaining entries are fields.
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
    """Create an edge from its statement after unpickling."""
    fields = dict(statement)
    type, nodes = fields.pop("type"), fields.pop("nodes", ())
    return make_edge(name, type, nodes, fields.pop("initial", None), fields)
