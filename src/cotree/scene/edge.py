"""Edges of a scene: a component between its nodes, made of a statement and checked at once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.components import COMPONENTS, Component, Role
from cotree.errors import SceneError, brief
from cotree.scene.display import edge_cells
from cotree.scene.fields import check_fields, check_initial
from cotree.scene.ports import check_heat, check_ports
from cotree.scene.statements import edge_statement, plain
from cotree.scene.usage import proposed_types

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.scene.expressions import FieldValue
    from cotree.scene.ports import PortEnds


@dataclass(frozen=True, repr=False)
class Edge:
    """A component between its nodes, with its fields and initial values.

    Attributes
    ----------
    name : str
        Its name.
    component : Component
        What it is.
    nodes : tuple of str
        Its nodes: two, but for scalar components with several ports, or on a joint.
    fields, initial : mapping
        Values of its fields, and initial values, by name.
    ports : tuple of PortEnds
        Of a scalar component: where each port's edge runs.
    statement : mapping
        The original statement, as the table of a scene file: the component's type, the nodes as
        listed, the fields as given. The rest of an edge follows from this.
    """

    name: str
    component: Component = field(compare=False)  # some are made anew for each edge
    nodes: tuple[str, ...]
    fields: Mapping[str, FieldValue]
    initial: Mapping[str, FieldValue]
    ports: tuple[PortEnds, ...] = ()
    statement: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        name, kind, nodes, fields = self.cells()
        return f"<Edge {name}: {kind} {nodes}{', ' + fields if fields else ''}>"

    def __reduce__(self) -> tuple[Any, ...]:
        # Laws of components are functions, which cannot be pickled: the statement can.
        return _edge_again, (self.name, dict(self.statement))

    def in_mechanics(self) -> Edge | None:
        """Give what the multibody part of a scene has of it: all, shapes that touch, or nothing."""
        if self.component.role is not Role.NETWORK:
            return self
        geometry = self.component.geometry
        if geometry is None:
            return None
        fields = {name: value for name, value in self.fields.items() if geometry.field(name)}
        return Edge(self.name, geometry, self.ports[0].acts_on, fields, {}, (), self.statement)

    @property
    def law_fields(self) -> Mapping[str, FieldValue]:
        """The fields that laws take: all but those of shapes that touch."""
        geometry = self.component.geometry
        if geometry is None:
            return self.fields
        return {name: value for name, value in self.fields.items() if not geometry.field(name)}

    def cells(self) -> tuple[str, str, str, str]:
        """Give the row of a table: name, type, nodes and fields."""
        return edge_cells(self)


def make_edge(
    name: str, type: str, nodes: Sequence[str], initial: Any, fields: Mapping[str, Any]
) -> Edge:
    """Make an edge of a statement; see :meth:`SceneDescription.edge`.

    Raises
    ------
    SceneError, ExpressionError, UnitError
        If the type, a node, a field or an initial value is not accepted.
    """
    # The type comes from a file as it stands there, and may be anything.
    component = COMPONENTS.get(type) if isinstance(type, str) else None
    if component is None:
        hint = proposed_types(type)
        raise SceneError(f"edge '{name}' has the unknown type '{brief(type)}'{hint}")
    listed: Sequence[object] = nodes
    # Lists are copied, so that later changes to them do not affect the scene.
    given: Mapping[str, Any] = plain(fields)
    first: Any = {} if initial is None else plain(initial)
    statement = edge_statement(type, nodes, given, first)
    # Adapting comes first, since it decides on the ports. The thermal port is appended next, so
    # that ``check_ports`` finds it last; what nodes leave over are the fields.
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
    """Make an edge of its statement, where it is unpickled."""
    fields = dict(statement)
    type, nodes = fields.pop("type"), fields.pop("nodes", ())
    return make_edge(name, type, nodes, fields.pop("initial", None), fields)
