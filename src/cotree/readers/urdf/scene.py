"""Conversion of URDF robots to scenes.

Links become nodes, and joints become edges, with arms and welds between them. An inertia becomes a
``rigid_body`` at the end of an arm to the centre of mass. See docs/urdf.md.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from cotree.errors import ModelError, SceneError, brief, listed
from cotree.files import read_text
from cotree.readers.names import LARGEST_FILE, Namer, renaming_notes, scene_name
from cotree.readers.urdf.robot import (
    MOMENTS,
    Inertial,
    Joint,
    Pose,
    Robot,
    RobotLink,
    check_mimics,
    has_one_coordinate,
    order_joints,
    read_robot,
)
from cotree.readers.xml_tree import parse_xml
from cotree.scene.description import Origin, SceneDescription, Visual
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path


Rows = list[list[float]]

#: Relative tolerance for angles that are multiples of a quarter turn, written with all digits.
_ROUNDING = 4e-16
_QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))


def rotation_rows(rpy: Sequence[float], snap: float) -> Rows | None:
    """Compute Rz(yaw) Ry(pitch) Rx(roll), from rotated to original axes; None for the identity.

    Angles, [rad], within ``snap`` of a multiple of a quarter turn are rounded to the multiple.
    """
    (cr, sr), (cp, sp), (cy, sy) = (_cosine_and_sine(angle, snap) for angle in rpy)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    rows = [[entry + 0.0 for entry in row] for row in rows]  # makes negative zeros positive
    identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    # Without a rotation, the equations need no product with the matrix.
    return None if rows == identity else rows


def _cosine_and_sine(angle: float, snap: float) -> tuple[float, float]:
    quarters = round(angle / (0.5 * math.pi))
    # A quarter turn in decimals is rounded in its last digit.
    gap = abs(angle - quarters * 0.5 * math.pi)
    if gap <= max(snap, _ROUNDING * abs(angle)):
        return _QUARTERS[quarters % 4]
    return math.cos(angle), math.sin(angle)


_Scene = TypeVar("_Scene", bound=SceneDescription)

_STANDARD_GRAVITY = 9.81  # gravitational acceleration, [m/s^2], as in Pinocchio
_FRICTION_SPEED = 0.01  # regularisation speed of dry friction, [rad/s] or [m/s]
_COORDINATE = {"revolute": "theta", "continuous": "theta", "prismatic": "s"}


@dataclass(frozen=True)
class UrdfOptions:
    """Options for conversion of a robot."""

    base: str = "fixed"  # whether the root link is ``fixed`` to the ground or ``free`` to move
    #: Whether mimic joints follow other joints instead of moving independently.
    mimic: bool = True
    #: Frame angles within this distance, [rad], of a multiple of a quarter turn are rounded to it.
    snap: float = 0.0

    def __post_init__(self) -> None:
        if self.base not in ("fixed", "free"):
            raise SceneError(f"base is {brief(self.base)!r}: give 'fixed' or 'free'")
        if not isinstance(self.mimic, bool):
            raise SceneError("mimic must be True or False")
        if not 0.0 <= check_number(self.snap, "snap") <= 0.1:
            raise SceneError(f"snap is {self.snap}: give an angle between 0 and 0.1 rad")


def read_urdf_scene(source: str | Path, scene_type: type[_Scene], options: UrdfOptions) -> _Scene:
    """Read a scene from a URDF file."""
    return read_urdf_text(read_text(source, LARGEST_FILE), str(source), scene_type, options)


def read_urdf_text(text: str, where: str, scene_type: type[_Scene], options: UrdfOptions) -> _Scene:
    """Read a scene from the text of a URDF file."""
    robot = read_robot(parse_xml(text, where))
    root, joints = order_joints(robot)
    if options.mimic:
        check_mimics(joints)
    try:
        return _SceneWriter(scene_type, robot, options).write(root, joints, where)
    except ModelError as error:
        raise type(error)(f"{where}: {error}") from None


class _SceneWriter(Generic[_Scene]):
    def __init__(self, scene_type: type[_Scene], robot: Robot, options: UrdfOptions) -> None:
        self.robot, self.options = robot, options
        self.namer = Namer()
        self.empty: list[str] = []
        self.fixed_mimics: list[str] = []
        self.free_mimics: list[str] = []
        self.visuals: list[Visual] = []
        self.gravity = self.namer.own("g")
        # By convention, the z axis of the root points up.
        gravity: list[float | str] = [0.0, 0.0, f"-{self.gravity}"]
        self.scene = scene_type(scene_name(robot.name, "robot"), gravity=gravity)

    def write(self, root: RobotLink, joints: Sequence[Joint], where: str) -> _Scene:
        self.scene.parameter(self.gravity, _STANDARD_GRAVITY, unit="m/s^2", doc="gravity")
        # Links and joints keep their names. Names that the reader adds must differ.
        self.node = {link.name: self.namer.give("link", link.name) for link in self.robot.links}
        self.edge = {joint.name: self.namer.give("joint", joint.name) for joint in joints}
        base = self.namer.own("base")
        # URDF does not define whether the root is fixed.
        root_type = "free" if self.options.base == "free" else "weld"
        self.scene.edge(base, root_type, "ground", self.node[root.name])
        for joint in joints:
            self._add_joint(joint)
        # A joint may mimic a later joint, so mimic constraints are added after all joints.
        by_name = {joint.name: joint for joint in joints}
        for joint in joints:
            self._add_mimic(joint, by_name)
        for link in self.robot.links:
            self._add_link(link)
        changed = dict(self.namer.changed)
        self.scene.origin = Origin(where, tuple(self._notes()), changed, tuple(self.visuals))
        return self.scene

    def _add_joint(self, joint: Joint) -> None:
        parent, child = self.node[joint.parent], self.node[joint.child]
        edge = self.edge[joint.name]
        if joint.type == "fixed":
            self._place(edge, parent, child, joint.pose, weld=True)
            return
        # The origin is the pose of the joint's frame on the parent.
        start = parent
        if joint.pose != Pose():
            start = self.namer.own(f"{edge}_frame")
            self._place(self.namer.own(f"{edge}_origin"), parent, start, joint.pose)
        if has_one_coordinate(joint):
            self._add_axis_joint(joint, edge, start, child)
        elif joint.type == "planar":
            self.scene.edge(edge, "planar", start, child, normal=joint.axis)
        else:
            self.scene.edge(edge, "free", start, child)

    def _add_axis_joint(self, joint: Joint, edge: str, start: str, child: str) -> None:
        slides = joint.type == "prismatic"
        drive, unit = ("force", "N") if slides else ("torque", "N m")
        fields: dict[str, Any] = {"axis": joint.axis}
        initial: dict[str, float] = {}
        terms = []
        if self._follows(joint):
            # A mimic joint has no actuator, and its initial value satisfies its constraint.
            initial = self._mimicked_start(joint)
        else:
            terms.append(self.namer.own(f"{edge}_{drive}"))
            # Actuator efforts are inputs, which a run may replace.
            self.scene.input(terms[0], 0.0, unit=unit, doc=f"drives joint {joint.name[:100]}")
        per = "N s/m" if slides else "N m s/rad"
        if joint.damping:
            fields["damping"] = self._parameter(f"{edge}_damping", joint.damping, per)
        if joint.friction:
            friction = self._parameter(f"{edge}_friction", joint.friction, unit)
            rate, speed = f"{edge}.{_COORDINATE[joint.type]}_dot", self._friction_speed()
            # Friction is smooth at rest, so that equations and sensitivities are continuous.
            terms.append(f"-{friction}*{rate}/sqrt({rate}**2 + {speed}**2)")
        if terms:
            fields[drive] = " ".join(terms)
        kind = "prismatic" if slides else "revolute"
        self.scene.edge(edge, kind, start, child, initial=initial, **fields)

    def _friction_speed(self) -> str:
        """Return the parameter for the regularisation speed of friction, which all joints share."""
        if "friction_speed" not in self.scene.parameters:
            self.speed = self._parameter("friction_speed", _FRICTION_SPEED, "")
        return self.speed

    def _follows(self, joint: Joint) -> bool:
        return self.options.mimic and joint.mimic is not None and has_one_coordinate(joint)

    def _mimicked_start(self, joint: Joint) -> dict[str, float]:
        """Return the initial value of a mimic joint if the joint that it follows starts at zero."""
        factors = []
        follower = joint
        by_name = {other.name: other for other in self.robot.joints}
        while follower.mimic is not None and self._follows(follower):
            factors.append(follower.mimic)
            follower = by_name[follower.mimic.joint]
        value = 0.0
        for mimic in reversed(factors):
            value = mimic.multiplier * value + mimic.offset
        return {_COORDINATE[joint.type]: value} if value else {}

    def _add_mimic(self, joint: Joint, by_name: dict[str, Joint]) -> None:
        if joint.mimic is None:
            return
        if not self._follows(joint):
            kind = self.fixed_mimics if joint.type == "fixed" else self.free_mimics
            kind.append(f"'{joint.name}'")
            return
        leader = by_name[joint.mimic.joint]
        self.scene.edge(
            self.namer.own(f"{self.edge[joint.name]}_mimic"),
            "gear",
            self.node[joint.child],
            self.node[leader.child],
            coordinate1=f"{self.edge[joint.name]}.{_COORDINATE[joint.type]}",
            coordinate2=f"{self.edge[leader.name]}.{_COORDINATE[leader.type]}",
            # The gear is coordinate1 = ratio * coordinate2 + phase, as URDF defines mimic.
            ratio=joint.mimic.multiplier,
            phase=joint.mimic.offset,
        )

    def _add_link(self, link: RobotLink) -> None:
        node = self.node[link.name]
        self.visuals += [replace(visual, node=node) for visual in link.visuals]
        inertial = link.inertial
        if inertial is None:
            return
        # Many files contain zeros instead of no inertia.
        if inertial.mass == 0.0 and not any(inertial.moments):
            self.empty.append(f"'{link.name}'")
            return
        self._add_inertia(node, inertial)

    def _add_inertia(self, node: str, inertial: Inertial) -> None:
        # The arm leads to the centre of mass and to the axes of the inertial frame.
        centre = self.namer.own(f"{node}_com")
        vector = [
            self._parameter(f"{node}_c{axis}", value, "m")
            for axis, value in zip("xyz", inertial.pose.xyz, strict=True)
        ]
        turn = self._rotation(inertial.pose)
        self.scene.edge(
            self.namer.own(f"{node}_centre"), "arm", node, centre, vector=vector, **turn
        )
        mass = self._parameter(f"{node}_mass", inertial.mass, "kg")
        xx, xy, xz, yy, yz, zz = (
            self._parameter(f"{node}_{name}", value, "kg m^2")
            for name, value in zip(MOMENTS, inertial.moments, strict=True)
        )
        self.scene.edge(
            self.namer.own(f"{node}_body"),
            "rigid_body",
            "ground",
            centre,
            mass=mass,
            # URDF lists entries of the inertia tensor, with the sign of products of inertia.
            inertia=[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
        )

    def _place(self, edge: str, first: str, second: str, pose: Pose, weld: bool = False) -> None:
        """Add an arm between two nodes, or a weld if ``weld`` is set and their origins coincide."""
        turn = self._rotation(pose)
        if weld and not any(pose.xyz):
            self.scene.edge(edge, "weld", first, second, **turn)
        else:
            self.scene.edge(edge, "arm", first, second, vector=pose.xyz, **turn)

    def _rotation(self, pose: Pose) -> dict[str, Any]:
        rows = rotation_rows(pose.rpy, self.options.snap)
        return {} if rows is None else {"rotation": rows}

    def _parameter(self, name: str, value: float, unit: str) -> str:
        found = self.namer.own(name)
        self.scene.parameter(found, value, unit=unit)
        return found

    def _notes(self) -> Iterator[str]:
        if self.robot.ignored:
            counts = sorted(self.robot.ignored.items())
            yield "not read: " + _quoted(f"{n} <{brief(tag)}>" for tag, n in counts)
        if self.empty:
            yield f"links without inertia, since theirs is zero: {_quoted(self.empty)}"
        if self.fixed_mimics:
            yield f"mimics of fixed joints are ignored: {_quoted(self.fixed_mimics)}"
        if self.free_mimics:
            yield f"mimics are ignored, since mimic is False: {_quoted(self.free_mimics)}"
        yield from renaming_notes(self.namer.changed)


def _quoted(items: Iterable[str]) -> str:
    return listed(brief(item, 140) for item in items)
