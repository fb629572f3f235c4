"""Motion spaces of a scene's branches: joints have their own, bodies follow from the scene.

A body in the tree gives absolute coordinates. Where joints, forces and gravity keep one line, it
moves along that line; where they keep one plane, in that plane; a body without inertia that
nothing turns is a particle; else it is free.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Role, Shape
from cotree.components.spaces import PLANE_AXES, body_space

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.components import MotionStep
    from cotree.scene.description import Edge, SceneDescription
    from cotree.scene.expressions import Expression

_PLANAR_NAMES = frozenset(
    name
    for step in body_space("z", is_particle=False)
    for name, _ in (*step.coordinates, *step.rates)
)

# Components that can keep a line; joints that turn are absent, since whatever turns leaves it.
_LINE_TYPES = frozenset(
    {"rigid_body", "arm", "weld", "prismatic", "spring", "damper", "force", "gear", "constraint"}
)

_PLACES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True)
class MotionSpaces:
    """Motion spaces by edge, and the plane that everything moves in.

    Attributes
    ----------
    plane : str
        The plane's normal, ``x``, ``y`` or ``z``; empty where there is none.
    of : mapping of str to tuple of MotionStep
        The motion space of each edge, were it a branch.
    """

    plane: str
    of: Mapping[str, tuple[MotionStep, ...]]


def motion_spaces(scene: SceneDescription) -> MotionSpaces:
    """Find the motion space of every edge of a scene."""
    # A line is tried before a plane, since it leaves a body one coordinate in place of three.
    line = next((axis for axis in "xyz" if _keeps_line(scene, axis)), "")
    plane = next((normal for normal in PLANE_AXES if _keeps_plane(scene, normal)), "")
    found = {}
    for edge in scene.edges.values():
        if edge.component.role is Role.BODY:
            found[edge.name] = body_space(plane, _is_particle(scene, edge), line)
        else:
            found[edge.name] = edge.component.motion_space
    return MotionSpaces(plane, found)


def _is_particle(scene: SceneDescription, body: Edge) -> bool:
    """Whether nothing constrains or acts on the rotation of the body's node."""
    # A body with inertia to rotation has an orientation.
    if "inertia" in body.fields:
        return False
    node = body.nodes[1]
    return not any(
        ("rotation" in edge.component.domains and node in edge.nodes)
        or (edge.nodes[:1] == (node,) and _needs_axes(edge))
        for edge in scene.edges.values()
        if edge is not body
    )


def _needs_axes(edge: Edge) -> bool:
    """Whether the edge has vectors in the axes of its first node."""
    return any(edge.component.field(name).shape is Shape.VECTOR for name in edge.fields)  # type: ignore[union-attr]


def _keeps_line(scene: SceneDescription, axis: str) -> bool:
    """Whether guides, gravity and every edge keep the lines along an axis."""
    n = _PLACES[axis]
    edges = scene.edges.values()
    kinds = {edge.component.name for edge in edges}
    guides = [edge for edge in edges if edge.component.name == "prismatic"]
    # Without a guide, motion along one line would be a coincidence of the initial values.
    if not guides or not kinds <= _LINE_TYPES or not _is_normal(scene.gravity, n):
        return False
    # Initial values under other names say that the body is meant to move otherwise.
    names = {axis, f"{axis}_dot"}
    for edge in edges:
        if edge.component.role is Role.BODY and not edge.initial.keys() <= names:
            return False
        for name in ("axis", "force", "vector"):
            value = edge.fields.get(name)
            if isinstance(value, tuple) and not _is_normal(_vector(edge, name), n):
                return False
        is_line = edge.component.role is Role.LINE
        # An element along the line of its nodes pulls off the axis where the lines of the nodes
        # differ.
        if "rotation" in edge.fields or (is_line and "axis" not in edge.fields):
            return False
    return True


def _keeps_plane(scene: SceneDescription, normal: str) -> bool:
    """Whether gravity and every edge keep the plane of a normal."""
    n = _PLACES[normal]
    return _is_within(scene.gravity, n) and all(_keeps(edge, n) for edge in scene.edges.values())


def _keeps(edge: Edge, n: int) -> bool:
    """Whether an edge moves and pulls its nodes within the plane only."""
    if edge.component.keeps_plane is None:
        return False
    if edge.component.role is Role.BODY and not edge.initial.keys() <= _PLANAR_NAMES:
        return False  # it starts out of the plane, or is told of as free
    for name in edge.component.keeps_plane.along:
        if name in edge.fields and not _is_normal(_vector(edge, name), n):
            return False
    for name in edge.component.keeps_plane.within:
        if name in edge.fields and not _is_within(_vector(edge, name), n):
            return False
    return _is_turned_within(edge, n) and _is_inertia_within(edge, n)


def _is_turned_within(edge: Edge, n: int) -> bool:
    """Whether the rotation of an arm is about the normal."""
    if "rotation" not in edge.fields:
        return True
    rows = edge.fields["rotation"]
    if not isinstance(rows[0], tuple):  # type: ignore[index]
        return _is_normal(_vector(edge, "rotation"), n)
    # A turn about axis n has zeros beside the diagonal in row and column n.
    entries = [rows[i][j] for i, j in _off_plane(n)]  # type: ignore[index]
    return all(entry.is_zero for entry in entries)


def _is_inertia_within(edge: Edge, n: int) -> bool:
    """Whether the normal is a principal axis of a body's inertia."""
    row = edge.component.field("inertia")
    if row is None or row.shape is not Shape.INERTIA or "inertia" not in edge.fields:
        return True
    rows = edge.fields["inertia"]
    if not isinstance(rows[0], tuple):  # type: ignore[index]
        return True
    return all(rows[i][j].is_zero for i, j in _off_plane(n))  # type: ignore[index]


def _off_plane(n: int) -> list[tuple[int, int]]:
    others = [i for i in range(3) if i != n]
    return [(n, i) for i in others] + [(i, n) for i in others]


def _vector(edge: Edge, name: str) -> Sequence[Expression]:
    return edge.fields[name]  # type: ignore[return-value]


def _is_within(components: Sequence[Expression], n: int) -> bool:
    # Zero for all values of the parameters: the motion space stays the same when they change.
    return components[n].is_zero


def _is_normal(components: Sequence[Expression], n: int) -> bool:
    # Parallel to axis n, which is the normal of the plane or the direction of the line.
    return _all_zero(c for i, c in enumerate(components) if i != n)


def _all_zero(entries: Iterable[Expression]) -> bool:
    return all(entry.is_zero for entry in entries)
