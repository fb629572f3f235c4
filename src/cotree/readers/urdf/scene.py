"""URDF robots to scenes.

Each link is a node, each joint an edge: arms and welds place it, its type moves it. Each inertia
is a ``rigid_body`` on an arm to the centre of mass, whose fields are parameters. See docs/urdf.md
for what becomes of each element.
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
from cotree.scene.description import SceneDescription
from cotree.scene.expressions import check_number
from cotree.scene.origin import Origin, Visual

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path


Rows = list[list[float]]

#: Share of an angle within which it is a quarter turn that was written with all digits.
_ROUNDING = 4e-16
_QUARTERS = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))


def rotation_rows(rpy: Sequence[float], snap: float) -> Rows | None:
    """Form Rz(yaw) Ry(pitch) Rx(roll), from turned to first frame's components; None if none turns.

    Angles, [rad], that are within ``snap`` of a multiple of a quarter turn are taken as that.
    """
    (cr, sr), (cp, sp), (cy, sy) = (_cosine_and_sine(angle, snap) for angle in rpy)
    rows = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    rows = [[entry + 0.0 for entry in row] for row in rows]  # no negative zeros
    identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    # Without a rotation the axes of both nodes are the same, and no product is formed with them.
    return None if rows == identity else rows


def _cosine_and_sine(angle: float, snap: float) -> tuple[float, float]:
    quarters = round(angle / (0.5 * math.pi))
    # A quarter turn in decimals is off by the rounding of its last digit.
    gap = abs(angle - quarters * 0.5 * math.pi)
    if gap <= max(snap, _ROUNDING * abs(angle)):
        return _QUARTERS[quarters % 4]
    return math.cos(angle), math.sin(angle)


_Scene = TypeVar("_Scene", bound=SceneDescription)

_STANDARD_GRAVITY = 9.81  # m/s^2, as Pinocchio has it
_FRICTION_SPEED = 0.01  # rad/s or m/s
_COORDINATE = {"revolute": "theta", "continuous": "theta", "prismatic": "s"}


@dataclass(frozen=True)
class UrdfOptions:
    """Options for reading a robot."""

    base: str = "fixed"  # whether the root link is welded to the ground or free to move
    #: Whether joints that mimic others follow them; else they are joints of their own.
    mimic: bool = True
    #: Angles of frames this close, [rad], to a multiple of a quarter turn are taken as that.
    snap: float = 0.0

    def __post_init__(self) -> None:
        if self.base not in ("fixed", "free"):
            raise SceneError(f"base is {brief(self.base)!r}: give 'fixed' or 'free'")
        if not isinstance(self.mimic, bool):
            raise SceneError("mimic must be True or False")
        if not 0.0 <= check_number(self.snap, "snap") <= 0.1:
            raise SceneError(f"snap is {self.snap}: give an angle between 0 and 0.1 rad")


def read_urdf_scene(source: str | Path, scene_type: type[_Scene], options: UrdfOptions) -> _Scene:
    """Read a robot from a URDF file."""
    return read_urdf_text(read_text(source, LARGEST_FILE), str(source), scene_type, options)


def read_urdf_text(text: str, where: str, scene_type: type[_Scene], options: UrdfOptions) -> _Scene:
    """Read a robot from the text of a URDF file."""
    robot = read_robot(parse_xml(text, where))
    root, joints = order_joints(robot)
    if options.mimic:
        check_mimics(joints)
    try:
        return _SceneWriter(scene_type, robot, options).write(root, joints, where)
    except ModelError as error:
        raise type(error)(f"{where}: {error}") from None


class _SceneWriter(Generic[_Scene]):
    """Adds a robot's parts to a scene, from the root outwards."""

    def __init__(self, scene_type: type[_Scene], robot: Robot, options: UrdfOptions) -> None:
        self.robot, self.options = robot, options
        self.namer = Namer()
        self.empty: list[str] = []
        self.fixed_mimics: list[str] = []
        self.free_mimics: list[str] = []
        self.visuals: list[Visual] = []
        self.gravity = self.namer.own("g")
        # The z axis of a robot's root points up by convention.
        gravity: list[float | str] = [0.0, 0.0, f"-{self.gravity}"]
        self.scene = scene_type(scene_name(robot.name, "robot"), gravity=gravity)

    def write(self, root: RobotLink, joints: Sequence[Joint], where: str) -> _Scene:
        self.scene.parameter(self.gravity, _STANDARD_GRAVITY, unit="m/s^2", doc="gravity")
        # Links and joints are named first: what the reader adds has to evade their names.
        self.node = {link.name: self.namer.give("link", link.name) for link in self.robot.links}
        self.edge = {joint.name: self.namer.give("joint", joint.name) for joint in joints}
        base = self.namer.own("base")
        # URDF does not say whether the root is fixed.
        root_type = "free" if self.options.base == "free" else "weld"
        self.scene.edge(base, root_type, "ground", self.node[root.name])
        for joint in joints:
            self._add_joint(joint)
        # A joint may follow one that comes after it in the tree, hence all joints are there first.
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
        # A joint moves from its own frame, which the origin places on the parent.
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
            # A follower has no drive of its own: its start has to satisfy the constraint of its
            # gear.
            initial = self._mimicked_start(joint)
        else:
            terms.append(self.namer.own(f"{edge}_{drive}"))
            # Actuators are inputs that a run may replace.
            self.scene.input(terms[0], 0.0, unit=unit, doc=f"drives joint {joint.name[:100]}")
        per = "N s/m" if slides else "N m s/rad"
        if joint.damping:
            fields["damping"] = self._parameter(f"{edge}_damping", joint.damping, per)
        if joint.friction:
            friction = self._parameter(f"{edge}_friction", joint.friction, unit)
            rate, speed = f"{edge}.{_COORDINATE[joint.type]}_dot", self._friction_speed()
            # Smooth, so that the equations and their sensitivities stay continuous at rest.
            terms.append(f"-{friction}*{rate}/sqrt({rate}**2 + {speed}**2)")
        if terms:
            fields[drive] = " ".join(terms)
        kind = "prismatic" if slides else "revolute"
        self.scene.edge(edge, kind, start, child, initial=initial, **fields)

    def _friction_speed(self) -> str:
        """Name the rate over which friction changes its sign, one for all joints."""
        if "friction_speed" not in self.scene.parameters:
            self.speed = self._parameter("friction_speed", _FRICTION_SPEED, "")
        return self.speed

    def _follows(self, joint: Joint) -> bool:
        return self.options.mimic and joint.mimic is not None and has_one_coordinate(joint)

    def _mimicked_start(self, joint: Joint) -> dict[str, float]:
        """Return the start of a mimicking joint, whose leader starts at zero."""
        factors = []
        follower = joint
        by_name = {other.name: other for other in self.robot.joints}
        while follower.mimic is not None and self._follows(follower):
            factors.append(follower.mimic)
            follower = by_name[follower.mimic.joint]
        value = 0.0
        # From the leader, which starts at zero, to the follower.
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
        # A link without inertia is a frame.
        if inertial is None:
            return
        # Files often give zeros where they mean that there is no inertia.
        if inertial.mass == 0.0 and not any(inertial.moments):
            self.empty.append(f"'{link.name}'")
            return
        self._add_inertia(node, inertial)

    def _add_inertia(self, node: str, inertial: Inertial) -> None:
        # Equations of motion hold about the centre of mass; moments are about the axes of the
        # inertial frame, which the arm turns to.
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
            # URDF gives the entries of the tensor, so that products of inertia keep their signs.
            inertia=[[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
        )

    def _place(self, edge: str, first: str, second: str, pose: Pose, weld: bool = False) -> None:
        """Add an arm between two nodes, or a weld if they coincide."""
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
        """List the elements that were not read, and those that were renamed."""
        if self.robot.ignored:
            counts = sorted(self.robot.ignored.items())
            yield "not read: " + _quoted(f"{n} <{brief(tag)}>" for tag, n in counts)
        if self.empty:
            yield f"an inertia of zero, as if they had none, have links {_quoted(self.empty)}"
        if self.fixed_mimics:
            yield f"fixed, so that they follow nothing: joints {_quoted(self.fixed_mimics)}"
        if self.free_mimics:
            yield f"free to move, as mimic is False: joints {_quoted(self.free_mimics)}"
        yield from renaming_notes(self.namer.changed)


def _quoted(items: Iterable[str]) -> str:
    """List the first few items, each cut short where it is long."""
    return listed(brief(item, 140) for item in items)
