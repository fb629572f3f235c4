"""Constraints by chords: joints that close loops, and constraint components.

The across variable of a chord joint is zero along its reaction space, in which its multiplier acts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Freedom, FreeRotation, Role
from cotree.dag import vector
from cotree.errors import ExpressionError, FormulationError, nearest
from cotree.formulation.fields import plane_axes
from cotree.formulation.measures import (
    Angle,
    AxisLength,
    Coincidence,
    Composite,
    CoordinateMeasure,
    Cosine,
    Distance,
    Ends,
    Spin,
    carried_by,
    chord_ends,
)
from cotree.naming import split_name

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from cotree.components import MotionStep
    from cotree.dag.nodes import Node
    from cotree.dag.vector import Vector
    from cotree.formulation.across import Motion
    from cotree.formulation.clusters import Point
    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.measures import Measure
    from cotree.scene.expressions import Expression


@dataclass(frozen=True)
class Constraint:
    """One scalar constraint: a measure that must be zero."""

    name: str  # name of the measure in reports, ``edge.place``
    edge: str  # name of the edge that causes the constraint
    unit: str  # unit of the measure
    measure: Measure  # measure that must be zero


def constraint_rows(motion: Motion) -> list[Constraint]:
    """Return the constraint rows of all chord joints, constraints and prescribed motions."""
    rows: list[Constraint] = []
    for edge in motion.system.edges.values():
        role = edge.component.role
        if role is Role.CONSTRAINT and edge.component.name in _CONSTRAINTS:
            rows += _CONSTRAINTS[edge.component.name](motion, edge)
        elif role in (Role.JOINT, Role.ARM):
            rows += joint_rows(motion, edge)
        if role is Role.JOINT and "motion" in edge.scalars:
            rows.append(_prescribed(motion, edge))
    return rows


def joint_rows(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    """Yield the constraints of a chord joint: zero across variables along its reaction space."""
    trees = motion.system.trees
    if not trees.is_branch(edge.name, rotates=False):
        yield from _translation_rows(motion, edge)
    if not trees.is_branch(edge.name, rotates=True):
        yield from _rotation_rows(motion, edge)


def _named(edge: BoundEdge, place: str, unit: str, measure: Measure) -> Constraint:
    return Constraint(f"{edge.name}.{place}", edge.name, unit, measure)


def _translation_rows(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    """Yield rows that keep the two nodes together, except along the joint's translations."""
    ends, dag = chord_ends(motion, edge), motion.system.dag
    sliding = [s for s in edge.component.motion_space if isinstance(s, Freedom) and not s.rotates]
    if "vector" in edge.vectors:
        yield from _arm_rows(motion, edge, ends)
        return
    screws = [s for s in edge.component.motion_space if isinstance(s, Freedom) and s.pitch]
    if not sliding and not screws:
        for place, unit in zip("xyz", vector.identity(dag), strict=True):
            yield _named(edge, place, "m", Coincidence(ends, unit))
        return
    if len(sliding) == 3:
        return
    if len(sliding) == 2:
        normal = carried_by(motion, ends, 0, edge.vectors["normal"])
        yield _named(edge, "normal", "m", AxisLength(ends, normal))
        return
    axis = edge.vectors["axis"]
    for i, direction in enumerate(plane_axes(axis)):
        across = carried_by(motion, ends, 0, direction)
        yield _named(edge, f"across{i + 1}", "m", AxisLength(ends, across))
    if screws:
        along = AxisLength(ends, carried_by(motion, ends, 0, axis))
        symbols = [dag.symbol("measure", i) for i in range(2)]
        # A screw advances by its pitch per radian of its angle, which counts whole turns.
        held = symbols[0] - edge.scalars[screws[0].pitch] * symbols[1]
        parts = (along, whole_angle(motion, edge))
        yield _named(edge, "along", "m", Composite(parts, held, motion.system.time))


def _arm_rows(motion: Motion, edge: BoundEdge, ends: Ends) -> Iterator[Constraint]:
    """Yield rows that keep the second node at the tip of a vector fixed in the first node."""
    dag = motion.system.dag
    for i, place in enumerate("xyz"):
        axis = carried_by(motion, ends, 0, vector.identity(dag)[i])
        held = dag.symbol("measure", 0) - edge.vectors["vector"][i]
        measure = Composite((AxisLength(ends, axis),), held, motion.system.time)
        yield _named(edge, place, "m", measure)


def _rotation_rows(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    """Yield rows that keep the axes of both nodes aligned, except for the joint's rotations."""
    ends, dag = chord_ends(motion, edge), motion.system.dag
    turning = [s for s in edge.component.motion_space if s.rotates]
    if any(isinstance(s, FreeRotation) for s in turning):
        return
    units = vector.identity(dag)
    if not turning:
        for i, place in enumerate(("xy", "yz", "zx")):
            # The axes agree if each axis of one node is perpendicular to the other's next axis.
            mark = units[(i + 1) % 3]
            if edge.rotation is not None:
                mark = vector.transposed_times(edge.rotation, mark)
            a, b = carried_by(motion, ends, 0, units[i]), carried_by(motion, ends, 1, mark)
            yield _named(edge, f"turn_{place}", "", Cosine(ends, a, b))
        return
    if len(turning) == 2:
        u, v = edge.vectors["axis"], edge.vectors["axis2"]
        a, b = carried_by(motion, ends, 0, u), carried_by(motion, ends, 1, v)
        # A universal joint keeps the angle between the axes of its two forks constant.
        held = dag.symbol("measure", 0) - vector.dot(u, v)
        yield _named(edge, "turn", "", Composite((Cosine(ends, a, b),), held, motion.system.time))
        return
    axis = _axis_of(edge)
    # The axis remains perpendicular to two directions that are fixed in the second node.
    a = carried_by(motion, ends, 0, axis)
    for i, direction in enumerate(plane_axes(axis)):
        b = carried_by(motion, ends, 1, direction)
        yield _named(edge, f"turn{i + 1}", "", Cosine(ends, a, b))


def _axis_of(edge: BoundEdge) -> Vector:
    return edge.vectors["normal"] if "normal" in edge.vectors else edge.vectors["axis"]


def whole_angle(motion: Motion, edge: BoundEdge) -> Angle:
    """Return a chord joint's angle as a measure; raise an error if it jumps at half a turn."""
    angle = joint_angle(motion, edge)
    if angle.sum is None:
        raise FormulationError(
            f"the angle of joint '{edge.name}' is needed, but the joint is a chord of the "
            f"tree ({motion.system.trees.listed()}) and does not rotate about the normal of a "
            "plane, so that its angle is known only between -pi and pi: name a tree that "
            "contains it"
        )
    return angle


def joint_angle(motion: Motion, edge: BoundEdge) -> Angle:
    """Return the angle of a chord joint as a measure; in space, it is between -pi and pi."""
    return _angle_about(motion, edge, _axis_of(edge))


def _angle_about(motion: Motion, edge: BoundEdge, axis: Vector) -> Angle:
    ends = chord_ends(motion, edge)
    reference = plane_axes(axis)[0]
    return Angle(
        ends,
        carried_by(motion, ends, 0, axis),
        carried_by(motion, ends, 0, reference),
        carried_by(motion, ends, 1, reference),
        _plane_angle(motion, edge, axis),
    )


def _plane_angle(motion: Motion, edge: BoundEdge, axis: Vector) -> Node | None:
    """Return the sum of the angles between the nodes; None if the motion is not planar."""
    system = motion.system
    if not system.plane:
        return None
    points = motion.clusters.points
    turned = node_angle(motion, points[edge.second], system.plane)
    turned = turned - node_angle(motion, points[edge.first], system.plane)
    # This component is 1, or -1 if the axis points against the normal.
    return axis["xyz".index(system.plane)] * turned


def node_angle(motion: Motion, point: Point, plane: str) -> Node:
    """Return the sum of all rotations about a plane's normal, from the ground to a node."""
    n = "xyz".index(plane)
    total = motion.system.dag.zero
    for branch in motion.clusters.turning_path(point.cluster):
        along = vector.signed(branch.sign, branch.axes[0])[n]
        total = total + along * branch.position
    if point.turn is not None:
        # A weld or an arm may rotate the node relative to its rigid cluster.
        i, j = (n + 1) % 3, (n + 2) % 3
        total = total + motion.system.dag.function("atan2", point.turn[j][i], point.turn[i][i])
    return total


def chord_measure(
    motion: Motion, edge: BoundEdge, name: str, space: Sequence[MotionStep] = ()
) -> Measure | None:
    """Return the measure of a chord's coordinate or rate by name, or None if there is none.

    For a body, ``space`` is the motion space that it would have as a branch.
    """
    ends = chord_ends(motion, edge)
    units = vector.identity(motion.system.dag)
    for step in space or edge.component.motion_space:
        if isinstance(step, FreeRotation):
            rates = [rate for rate, _ in step.rates]
            if name in rates:
                return Spin(ends, carried_by(motion, ends, 1, units[rates.index(name)]))
            continue
        if name not in (step.name, step.rates[0][0]):
            continue
        if not step.rotates:
            axis = (dict(zip("xyz", units, strict=True)) | dict(edge.vectors))[step.axis]
            return AxisLength(ends, carried_by(motion, ends, 0, axis))
        if edge.component.role is Role.BODY:
            return _angle_about(motion, edge, units["xyz".index(step.axis)])
        if edge.component.name != "universal":
            return joint_angle(motion, edge)
    return None


def named_measure(motion: Motion, name: str) -> Measure | None:
    """Return the measure ``edge.coordinate``, or ``x``, ``y``, ``z`` of a node; None if unknown."""
    system = motion.system
    for speed in system.speeds:
        if speed.coordinate is not None and speed.coordinate.name == name:
            return CoordinateMeasure(speed)
    first, last = split_name(name)
    edge = system.edges.get(first)
    if edge is not None and edge.component.role is Role.JOINT:
        found = chord_measure(motion, edge, last)
        # A measure in an expression must not jump at half a turn.
        if isinstance(found, Angle):
            return whole_angle(motion, edge)
        if found is not None:
            return found
    point = motion.clusters.points.get(first)
    if point is not None and last in ("x", "y", "z"):
        ground = motion.clusters.points["ground"]
        ends = Ends.of(motion.clusters, ground, point)
        return Coincidence(ends, vector.identity(system.dag)["xyz".index(last)])
    return None


def expression_measure(motion: Motion, expression: Expression, offset: Node) -> Composite:
    """Return the measure of an expression of coordinates and positions, minus an offset."""
    system = motion.system
    parts: list[Measure] = []
    known: dict[str, Node] = {**system.parameters, "t": system.time}

    def resolve(name: str) -> Node:
        if name not in known:
            measure = named_measure(motion, name)
            if measure is None:
                names = [c.name for c in system.coordinates]
                raise ExpressionError(
                    f"uses '{name}', which is not a coordinate, position of a node, parameter "
                    f"or t{nearest(name, [*known, *names])}"
                )
            known[name] = system.dag.symbol("measure", len(parts))
            parts.append(measure)
        return known[name]

    node = expression.lower(system.dag, resolve) - offset
    return Composite(tuple(parts), node, system.time)


def _prescribed(motion: Motion, edge: BoundEdge) -> Constraint:
    name, unit = edge.component.motion_space[0].coordinates[0]
    measure = named_measure(motion, f"{edge.name}.{name}")
    assert measure is not None  # only joints with a single coordinate have the field ``motion``
    dag = motion.system.dag
    held = dag.symbol("measure", 0) - edge.scalars["motion"]
    return _named(edge, "motion", unit, Composite((measure,), held, motion.system.time))


def _distance(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    held = motion.system.dag.symbol("measure", 0) - edge.scalars["length"]
    measure = Composite((Distance(chord_ends(motion, edge)),), held, motion.system.time)
    yield _named(edge, "length", "m", measure)


def _slot(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    ends = chord_ends(motion, edge)
    for i, normal in enumerate(_perpendicular(edge.vectors["axis"])):
        across = carried_by(motion, ends, 0, normal)
        yield _named(edge, f"across{i + 1}", "m", AxisLength(ends, across))


def _perpendicular(axis: Vector) -> tuple[Vector, Vector]:
    """Return two directions perpendicular to an axis of any length, which may depend on time."""
    dag = axis[0].dag
    square = vector.dot(axis, axis)
    length = dag.function("sqrt", square)
    x, y, z = (entry if square is dag.one else entry / length for entry in axis)
    # For an axis in a coordinate plane, this choice needs the fewest operations.
    if not z.is_zero and y.is_zero:
        return (z, dag.zero, -x), (dag.zero, dag.one, dag.zero)
    if not z.is_zero and x.is_zero:
        return (dag.zero, -z, y), (dag.one, dag.zero, dag.zero)
    first = (-y, x, dag.zero)
    if z.is_zero:
        return first, (dag.zero, dag.zero, dag.one)
    return first, vector.cross((x, y, z), first)


def _knife_edge(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    from cotree.formulation.contact_measures import Slip

    ends = chord_ends(motion, edge)
    across = carried_by(motion, ends, 1, edge.vectors["axis"])
    yield _named(edge, "across", "m/s", Slip(ends, across))


def _rolling(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    from cotree.formulation.contact_measures import Touching, surface_of

    ends, normal = chord_ends(motion, edge), edge.vectors["normal"]
    # The height is a holonomic constraint; the two slips constrain only rates.
    up = carried_by(motion, ends, 0, normal)
    body = surface_of(motion, edge, ends)
    for place, direction in zip(
        ("height", "slip1", "slip2"), (normal, *plane_axes(normal)), strict=True
    ):
        along = carried_by(motion, ends, 0, direction)
        is_height = direction is normal
        measure = Touching(ends, up, body, along, motion.system.dag.zero if is_height else None)
        yield _named(edge, place, "m" if is_height else "m/s", measure)


def _gear(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    dag = motion.system.dag
    pair = [
        expression_measure(motion, edge.expressions[name], dag.zero)
        for name in ("coordinate1", "coordinate2")
    ]
    first, second = (dag.symbol("measure", i) for i in range(2))
    held = first - edge.scalars["ratio"] * second - edge.scalars["phase"]
    yield _named(edge, "mesh", "", Composite(tuple(pair), held, motion.system.time))


def _constraint(motion: Motion, edge: BoundEdge) -> Iterator[Constraint]:
    measure = expression_measure(motion, edge.expressions["expression"], motion.system.dag.zero)
    yield _named(edge, "value", "", measure)


_CONSTRAINTS: dict[str, Callable[[Motion, BoundEdge], Iterator[Constraint]]] = {
    "distance": _distance,
    "slot": _slot,
    "knife_edge": _knife_edge,
    "rolling_disc": _rolling,
    "rolling_ellipsoid": _rolling,
    "gear": _gear,
    "constraint": _constraint,
}
