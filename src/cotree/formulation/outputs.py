"""Outputs, and all observable names with their values and units."""

from __future__ import annotations

import ast
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.dag import vector
from cotree.dag.dual import tangent_of
from cotree.errors import ExpressionError, nearest
from cotree.formulation.across import Motion, View, inwards
from cotree.formulation.chords import chord_measure, whole_angle
from cotree.formulation.elements import Wrench
from cotree.formulation.laws import Applied, stored_energy
from cotree.formulation.measures import Angle
from cotree.formulation.through import Balance, Loads, shifted
from cotree.naming import owner_among, split_name
from cotree.scene.checks import (
    EDGE_VARIABLES,
    ENERGIES,
    NODE_VARIABLES,
    Dimensions,
    VariableUnits,
    dimension_of_unit,
    stated_units,
)
from cotree.scene.events import event_expressions
from cotree.scene.expressions import Expression, dotted
from cotree.scene.parameters import in_order
from cotree.units import unit_text

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.dag.vector import Matrix, Vector
    from cotree.formulation.clusters import Point
    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.networks.variable_names import Names
    from cotree.scene.description import SceneDescription


_XYZ = "xyz"

#: Name of the force or torque that drives a joint along a prescribed motion.
DRIVE = "drive"


def observe_motion(motion: Motion, name: str, is_acting: bool = False) -> Node | None:
    """Return the position or velocity ``node.variable`` or ``edge.coordinate``, or None.

    If ``is_acting``, the value affects the motion: raise FormulationError for an angle that is
    known only between -pi and pi.
    """
    first, last = split_name(name)
    edge, point = motion.system.edges.get(first), motion.clusters.points.get(first)
    if edge is not None and edge.component.role is Role.JOINT:
        found = _chord_coordinate(motion, edge, last, is_acting)
        if found is not None:
            return found
    if edge is not None and edge.component.role is Role.TOUCH and last.startswith("beyond_"):
        from cotree.formulation.contact_measures import beyond

        return beyond(motion, edge, last.removeprefix("beyond_"))
    if point is None:
        return None
    if last in ("x", "y", "z"):
        return motion.position(point)[_XYZ.index(last)]
    if last in ("vx", "vy", "vz"):
        return motion.velocity(point)[_XYZ.index(last[1])]
    if last in ("wx", "wy", "wz"):
        return _in_ground(motion, motion.omega[point.cluster], point.cluster)[_XYZ.index(last[1])]
    if last in NODE_VARIABLES and last[0] in "rpy":
        return _orientation(_axes(motion, point), last)
    return None


def _chord_coordinate(motion: Motion, edge: BoundEdge, name: str, is_acting: bool) -> Node | None:
    measure = chord_measure(motion, edge, name)
    if measure is None:
        return None
    is_value = any(name == n for step in edge.component.motion_space for n, _ in step.coordinates)
    if is_acting and is_value and isinstance(measure, Angle):
        measure = whole_angle(motion, edge)
    view = View(motion)
    found: Node = measure.value(view) if is_value else measure.rate(view)
    return found


def _in_ground(motion: Motion, a: Vector, cluster: int) -> Vector:
    return inwards(motion.clusters, motion.frames, a, cluster, 0)


def _axes(motion: Motion, point: Point) -> Matrix:
    units = vector.identity(motion.system.dag)
    columns = [
        # Transform from node axes to cluster axes, to the cluster's basis, to ground axes.
        _in_ground(motion, motion.frames.resolved(point.cluster, point.resolved(e)), point.cluster)
        for e in units
    ]
    return vector.transpose((columns[0], columns[1], columns[2]))


def _orientation(axes: Matrix, name: str) -> Node:
    """Return an entry of the rotation matrix, or a roll, pitch or yaw angle."""
    dag = axes[0][0].dag
    # R = Rz(yaw) Ry(pitch) Rx(roll) has the last row (-sin p, cos p sin r, cos p cos r).
    roll = dag.function("atan2", axes[2][1], axes[2][2])
    if name == "roll":
        return roll
    if name == "yaw":
        # R Rx(-roll) = Rz(yaw) Ry(pitch) has the second column (-sin yaw, cos yaw, 0), even if
        # pitch is a right angle and roll is arbitrary.
        sine, cosine = dag.function("sin", roll), dag.function("cos", roll)
        return dag.function(
            "atan2",
            axes[0][2] * sine - axes[0][1] * cosine,
            axes[1][1] * cosine - axes[1][2] * sine,
        )
    if name == "pitch":
        # The root is |cos p|: pitch is between -pi/2 and pi/2.
        flat = dag.function("sqrt", axes[2][1] * axes[2][1] + axes[2][2] * axes[2][2])
        return dag.function("atan2", -axes[2][0], flat)
    return axes[int(name[1]) - 1][int(name[2]) - 1]


@dataclass(frozen=True)
class Observer:
    """Computes observable values from the unknowns of the first graph."""

    view: View  # across variables of the multibody system
    #: Loads that do not depend on accelerations, and the balance with all unknowns.
    loads: Loads
    balance: Balance
    applied: Sequence[Applied]  # forces and torques, with the measures along which they act
    networks: Mapping[str, Node]  # variables of the scalar networks by name
    owners: Collection[str]  # names of the scene's nodes and edges, for error messages
    #: Names of the networks' variables, for error messages; None without networks.
    names: Names | None = None

    @property
    def motion(self) -> Motion:
        """Positions and velocities of the multibody system."""
        return self.view.motion

    def value(self, name: str) -> Node:
        """Return the value of an observable name."""
        if name == "energy.kinetic":
            return self._kinetic()
        if name == "energy.potential":
            return self._potential()
        found = observe_motion(self.motion, name)
        if found is None:
            found = self._of_node(name)
        if found is None:
            found = self._of_edge(name)
        if found is None:
            raise ExpressionError(self._unknown(name))
        return found

    def _unknown(self, name: str) -> str:
        system = self.motion.system
        # The variable of one of several ports has a dot in its name, after the edge's name.
        first = owner_among(name, {*self.owners, *system.edges}) or split_name(name)[0]
        last = name[len(first) + 1 :] if first else ""
        if first in self.motion.clusters.points:
            return f"node '{first}' has no variable '{last}'{nearest(last, NODE_VARIABLES)}"
        if first in system.edges:
            known = [split_name(n)[1] for n in system.names if split_name(n)[0] == first]
            known += [
                *EDGE_VARIABLES,
                *([DRIVE] if "motion" in system.edges[first].scalars else []),
                # A contact's variables are in its network.
                *(self.names.of_edge(first) if self.names is not None else ()),
            ]
            return f"edge '{first}' has no variable '{last}'{nearest(last, known)}"
        if last and first in self.owners:
            return f"uses the unknown name '{name}': '{first}' has no variable '{last}'"
        if last:
            hint = nearest(first, self.owners)
            return f"uses the unknown name '{name}': there is no node or edge '{first}'{hint}"
        known = [*system.names, *system.parameters, *system.inputs, *ENERGIES]
        return f"uses the unknown name '{name}'{nearest(name, known)}"

    def _of_node(self, name: str) -> Node | None:
        """Return the acceleration of a node, in ground axes."""
        first, last = split_name(name)
        point = self.motion.clusters.points.get(first)
        if point is None or last not in NODE_VARIABLES:
            return None
        i = _XYZ.index(last[-1])
        if last.startswith("alpha"):
            alpha = self.view.across.alpha[point.cluster]
            return _in_ground(self.motion, alpha, point.cluster)[i]
        return self.view.acceleration(point, 0)[i]

    def _of_edge(self, name: str) -> Node | None:
        """Return an edge's force or torque on its second node, its power, or its drive."""
        first, last = split_name(name)
        edge = self.motion.system.edges.get(first)
        if edge is None:
            return None
        if last == DRIVE:
            # A prescribed motion is a constraint, and its multiplier is the drive.
            own = [row for row in self.applied if row.name == f"{first}.motion"]
            return own[0].magnitude if own else None
        if last not in EDGE_VARIABLES:
            return None
        wrench = self._on_second(edge)
        if last == "power":
            return self._power(edge, wrench)
        i = _XYZ.index(last[1])
        return wrench.force[i] if last[0] == "f" else wrench.torque[i]

    def _power(self, edge: BoundEdge, wrench: Wrench) -> Node:
        """Return a wrench's power, F.(v2 - v1 - w1 x r) + T.(w2 - w1); it is zero for reactions."""
        motion, points = self.motion, self.motion.clusters.points
        first, second = points[edge.first], points[edge.second]
        spins = [_in_ground(motion, motion.omega[p.cluster], p.cluster) for p in (first, second)]
        reach = vector.sub(motion.position(second), motion.position(first))
        closing = vector.sub(motion.velocity(second), motion.velocity(first))
        # The reaction acts on the first body at the position of the second node: hence w1 x r.
        against = vector.sub(closing, vector.cross(spins[0], reach))
        turning = vector.dot(wrench.torque, vector.sub(spins[1], spins[0]))
        return vector.dot(wrench.force, against) + turning

    def _on_second(self, edge: BoundEdge) -> Wrench:
        """Return the force and torque of an edge on its second node, in ground axes."""
        if edge.component.role is Role.ARM and edge.name in self.motion.system.trees.branches:
            raise ExpressionError(
                f"uses the reaction of '{edge.name}', but its bodies are lumped into one: insert "
                "a joint where the reaction is needed"
            )
        pushing = self._transmitted(edge, "translation")
        turning = self._transmitted(edge, "rotation")
        # A branch of both trees transmits the whole cutset sum, which includes its law.
        if pushing is not None and turning is not None:
            return Wrench(pushing.force, turning.torque)
        second = self.motion.clusters.points[edge.second]
        # A chord of at least one graph: multipliers and laws act along measures.
        total = self._pulled(edge, second)
        zero = vector.zeros(self.motion.system.dag)
        if pushing is not None:
            total = total.plus(Wrench(pushing.force, zero))
        if turning is not None:
            total = total.plus(Wrench(zero, turning.torque))
        for action in self.loads.actions:
            if action.edge.name == edge.name:
                force = _in_ground(self.motion, action.force, action.ancestor)
                torque = _in_ground(self.motion, action.torque, action.ancestor)
                total = total.plus(Wrench(force, torque))
        return total

    def _pulled(self, edge: BoundEdge, second: Point) -> Wrench:
        """Return the wrench on an edge's second node due to through variables along measures."""
        zero = vector.zeros(self.motion.system.dag)
        total = Wrench(zero, zero)
        for row in self.applied:
            if row.edge != edge.name:
                continue
            # Of the two opposite wrenches, use the one on the second node, unless it is the ground.
            for cluster, force, torque in row.pull.scaled(row.magnitude).wrenches:
                sign = 1 if cluster == second.cluster else -1
                if sign < 0 and second.cluster != 0:
                    continue
                total = total.plus(self._about(cluster, sign, force, torque, second))
        return total

    def _about(
        self, cluster: int, sign: int, force: Vector, torque: Vector, second: Point
    ) -> Wrench:
        """Move a wrench from a cluster's origin to the second node; transform it to ground axes."""
        origin = self.motion.positions.between(0, cluster)
        force = vector.signed(sign, _in_ground(self.motion, force, cluster))
        torque = vector.signed(sign, _in_ground(self.motion, torque, cluster))
        arm = vector.sub(origin, self.motion.position(second))
        return Wrench(force, vector.add(torque, vector.cross(arm, force)))

    def _transmitted(self, edge: BoundEdge, domain: str) -> Wrench | None:
        """Return a branch's cutset sum, as a wrench on its second node; None for a chord."""
        entry = self.motion.clusters.entries[domain].get(edge.name)
        if entry is None:
            return None
        # The second node is the outer one if the edge points outwards, else the inner one.
        geometry = self.motion.to(entry.last if entry.sign > 0 else entry.first)
        branch = geometry.branch
        wrench = self.balance.beyond[branch.child - 1]
        if entry.sign < 0:  # the second node is the inner one, on which the reaction acts
            anchor = self.motion.frames.resolved(branch.parent, branch.anchor)
            to_inner = vector.sub(geometry.offset, anchor)
            wrench = shifted(wrench, to_inner)
        return Wrench(
            vector.signed(entry.sign, _in_ground(self.motion, wrench.force, branch.parent)),
            vector.signed(entry.sign, _in_ground(self.motion, wrench.torque, branch.parent)),
        )

    def _kinetic(self) -> Node:
        """Return the kinetic energy, the sum of (m v.v)/2 + v.(omega x h) + (omega.J omega)/2."""
        motion = self.motion
        total = motion.system.dag.zero
        for cluster, inertia in enumerate(self.loads.inertias[1:], start=1):
            if inertia is None:
                continue
            omega = motion.omega[cluster]
            # h and J refer to the cluster's origin: hence the mixed term.
            v = motion.velocities.between(0, cluster)
            carried = _in_ground(motion, vector.cross(omega, inertia.moment), cluster)
            spin = vector.dot(omega, vector.times(inertia.tensor, omega))
            total = total + 0.5 * (inertia.mass * vector.dot(v, v) + spin) + vector.dot(v, carried)
        return total

    def _potential(self) -> Node:
        """Return the potential energy of gravity and of linear springs."""
        motion, system = self.motion, self.motion.system
        total = system.dag.zero
        for cluster, inertia in enumerate(self.loads.inertias[1:], start=1):
            if inertia is None:
                continue
            # First moment about the ground's origin: m r + h.
            place = vector.scale(inertia.mass, motion.positions.between(0, cluster))
            first = vector.add(place, _in_ground(motion, inertia.moment, cluster))
            total = total - vector.dot(system.gravity, first)
        for action in self.loads.actions:
            if "stiffness" in action.arguments and "length" in action.arguments:
                total = total + stored_energy(action.arguments, action.arguments["length"])
        for row in self.applied:
            total = total + (row.potential or system.dag.zero)
        for arguments in (effort.arguments for effort in self.loads.efforts):
            if "stiffness" in arguments:
                # A tree joint with a spring has a single coordinate: an angle or a displacement.
                at = arguments["theta"] if "theta" in arguments else arguments["s"]
                total = total + stored_energy(arguments, at)
        return total


@dataclass(frozen=True)
class Outputs:
    """Output expressions in terms of the first graph's states and unknowns."""

    #: Outputs, then events in the order of :func:`cotree.scene.events.event_expressions`.
    values: tuple[Node, ...]
    #: Positions and velocities of nodes that outputs use, by ``node.variable``.
    across: Mapping[str, Node]
    networks: Mapping[str, Node]  # values of network variables that outputs use, by name
    #: Expressions of jumps by the names of their modes, from which initial modes are determined.
    jumps: Mapping[str, Node]


def form_outputs(observer: Observer, scene: SceneDescription) -> Outputs:
    """Form the outputs of a scene and the expressions of its events."""
    motion = observer.motion
    system = motion.system
    known: dict[str, Node] = {**system.parameters, **system.inputs, "t": system.time}
    known |= {**system.names, **observer.networks}
    across: dict[str, Node] = {}
    formed: dict[str, Node] = {}
    pending: list[str] = []

    def of_output(name: str) -> Node:
        if name in pending:
            raise ExpressionError(f"uses output '{name}', which depends on itself")
        if name not in formed:
            pending.append(name)
            formed[name] = scene.outputs[name].lower(system.dag, resolve)
            pending.remove(name)
        return formed[name]

    def resolve(name: str) -> Node:
        if name not in known and name in scene.outputs:
            return of_output(name)
        if name not in known:
            # Only names in use are computed, and only once: reactions and energies are expensive.
            known[name] = observer.value(name)
            # Sensitivity graphs provide the tangents of positions and velocities; it would be
            # costly to differentiate their long expressions again.
            if _place(name) is not None and split_name(name)[0] in motion.clusters.points:
                across[name] = known[name]
        return known[name]

    with system.dag.labelled("outputs"):
        values = [of_output(name) for name in scene.outputs]
        values += [
            item.lower(system.dag, resolve) for item in event_expressions(scene.events.values())
        ]
        jumps = {
            mode.name: mode.initial.lower(system.dag, resolve)
            for mode in scene.modes.values()
            if mode.is_jump
        }
    return Outputs(tuple(values), across, observer.networks, jumps)


def _place(name: str) -> tuple[int, int] | None:
    """Return order of derivative and component of a node's position or velocity; or None."""
    variable = split_name(name)[1]
    if len(variable) == 1 and variable in "xyz":
        return 0, "xyz".index(variable)
    if len(variable) == 2 and variable[0] == "v" and variable[1] in "xyz":
        return 1, "xyz".index(variable[1])
    return None


def output_tangents(motion: Motion, outputs: Outputs) -> dict[Node, Node]:
    """Return the tangents of across variables in outputs, from the sensitivity graph's motion."""
    seed = {}
    for name, value in outputs.across.items():
        place = _place(name)
        assert place is not None  # only such variables are stored
        point = motion.clusters.points[split_name(name)[0]]
        order, i = place
        see = motion.velocity if order else motion.position
        seed[value] = tangent_of(see(point))[i]
    return seed


def units_of_expressions(
    scene: SceneDescription, states: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Return the units of outputs and derived parameters; a unit is "" if a name in it has none.

    A sum has the unit of its terms; a product has an SI unit.
    """
    units = {**stated_units(scene), "t": "s", **states}
    found: dict[str, str] = {}
    pending: set[str] = set()
    variable_unit = VariableUnits(scene)

    def unit_of(name: str) -> str:
        if name in units:
            return units[name]
        if name in scene.outputs and name not in scene.parameters:
            return output(name)
        return variable_unit(name)

    dimensions = Dimensions(lambda name: dimension_of_unit(unit_of(name)), with_plain_numbers=True)

    def output(name: str) -> str:
        # An output that depends on itself raises an error elsewhere.
        if name not in found and name not in pending:
            pending.add(name)
            found[name] = unit_in(scene.outputs[name].tree)
        return found.get(name, "")

    def unit_in(tree: ast.expr) -> str:
        terms = {unit_of(term) for term in _terms(tree)}
        if _is_celsius(tree) and terms == {"K", ""}:
            return "degC"
        if len(terms) == 1 and terms != {""}:
            return terms.pop()
        dimension = dimensions.of(tree)
        return "" if dimension is None else unit_text(dimension)

    # In this order, each name comes after its arguments; recursion could exceed Python's limit.
    derived = {}
    for name in in_order(scene.parameters):
        value = scene.parameters[name].value
        if isinstance(value, Expression):
            units[name] = derived[name] = units.get(name) or unit_in(value.tree)
    return {name: output(name) for name in scene.outputs}, derived


def _is_celsius(tree: ast.expr) -> bool:
    """Return whether an expression subtracts the zero point of the Celsius scale."""
    match tree:
        case ast.BinOp(op=ast.Sub(), right=ast.Constant(value=273.15)):
            return True
    return False


def _terms(tree: ast.expr) -> list[str]:
    """Return the names in a sum, with "" for each term that is no name."""
    match tree:
        case ast.UnaryOp(operand=operand):
            return _terms(operand)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return _terms(left) + _terms(right)
        case ast.Call(func=ast.Name(id="abs" | "min" | "max"), args=args):
            return [term for arg in args for term in _terms(arg)]
        case ast.Name(id=name):
            return [name]
    return [dotted(tree)]
