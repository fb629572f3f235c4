"""Reading of URDF robot descriptions to links and joints, which are ordered as a tree."""

from __future__ import annotations

import math
import re
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeVar

from cotree.errors import SceneError, brief, nearest
from cotree.scene.description import Visual

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.readers.names import SourceLine
    from cotree.readers.xml_tree import Element


_Named = TypeVar("_Named", "RobotLink", "Joint")


def order_joints(robot: Robot) -> tuple[RobotLink, tuple[Joint, ...]]:
    """Return the root link, and the joints depth first, with siblings in file order.

    Raise SceneError if a name occurs twice, a link is missing, or the joints do not form a tree.
    """
    links = _by_name("link", robot.links)
    _by_name("joint", robot.joints)
    # For each link, the joint of which it is the child, and the joints of which it is the parent.
    onto: dict[str, Joint] = {}
    below: dict[str, list[Joint]] = {name: [] for name in links}
    for joint in robot.joints:
        what = f"joint '{brief(joint.name)}'"
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise joint.at.error(
                    f"{what}: there is no link '{brief(name)}' for its {end}{nearest(name, links)}"
                )
        if joint.child in onto:
            raise joint.at.error(
                f"{what}: link '{brief(joint.child)}' is the child of joint "
                f"'{brief(onto[joint.child].name)}' too; URDF has no closed loops: cut the loop "
                "and close it in the scene"
            )
        onto[joint.child] = joint
        below[joint.parent].append(joint)
    # Each link except the root is the child of one joint: a tree, except for separate cycles.
    roots = [link for link in robot.links if link.name not in onto]
    if not roots:
        raise robot.links[0].at.error("the joints form a cycle")
    if len(roots) > 1:
        first, second = (brief(link.name) for link in roots[:2])
        raise roots[1].at.error(
            f"neither '{first}' nor '{second}' is the child of a joint: connect them"
        )
    ordered: list[Joint] = []
    # The order is depth first, with siblings in the order of the file.
    waiting = below[roots[0].name][::-1]
    while waiting:
        joint = waiting.pop()
        ordered.append(joint)
        waiting += below[joint.child][::-1]
    if len(ordered) < len(robot.joints):
        reached = {joint.name for joint in ordered}
        lost = next(joint for joint in robot.joints if joint.name not in reached)
        raise lost.at.error(f"joint '{brief(lost.name)}' is part of a cycle of joints")
    return roots[0], tuple(ordered)


def check_mimics(joints: Iterable[Joint]) -> None:
    """Raise an error if mimics form a cycle, or involve joints without exactly one coordinate."""
    by_name = {joint.name: joint for joint in joints}
    for joint in by_name.values():
        # A fixed joint has no coordinate.
        if joint.mimic is None or joint.type == "fixed":
            continue
        what = f"joint '{brief(joint.name)}'"
        if not has_one_coordinate(joint):
            raise joint.at.error(
                f"{what} mimics a joint, but has several coordinates: its type is {joint.type}"
            )
        leader = by_name.get(joint.mimic.joint)
        if leader is None:
            raise joint.at.error(
                f"{what} mimics '{brief(joint.mimic.joint)}', which is not a joint"
                f"{nearest(joint.mimic.joint, by_name)}"
            )
        if not has_one_coordinate(leader):
            raise joint.at.error(
                f"{what} mimics '{brief(leader.name)}', which has no or several coordinates: its "
                f"type is {leader.type}"
            )
    # Each chain of mimic joints is followed to its end, or to a joint that was already checked.
    settled: set[str] = set()
    for joint in by_name.values():
        trail: set[str] = set()
        follower: Joint | None = joint
        while follower is not None and follower.name not in settled:
            if follower.name in trail:
                raise joint.at.error(
                    f"joint '{brief(joint.name)}' mimics itself, through others or directly"
                )
            trail.add(follower.name)
            mimic = follower.mimic if follower.type != "fixed" else None
            follower = None if mimic is None else by_name[mimic.joint]
        settled |= trail


def has_one_coordinate(joint: Joint) -> bool:
    """Return whether a joint rotates about one axis or slides along one axis."""
    return joint.type in ("revolute", "continuous", "prismatic")


def _by_name(kind: str, things: Iterable[_Named]) -> dict[str, _Named]:
    found: dict[str, _Named] = {}
    for thing in things:
        if thing.name in found:
            raise thing.at.error(
                f"{kind} '{brief(thing.name)}' is defined twice, first on line "
                f"{found[thing.name].at.line}"
            )
        found[thing.name] = thing
    return found


Vector = tuple[float, float, float]

# Unlike float(), this pattern rejects nan, inf, underscores and digits of other scripts.
_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,4})?\Z")
_LARGEST = 1e15  # largest number in SI units, so that products do not overflow
_LONGEST_NAME = 500
_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Pose:
    """Position, [m], and roll, pitch and yaw about fixed axes, [rad], of a frame."""

    xyz: Vector = _ZERO
    rpy: Vector = _ZERO


def child_of(element: Element, tag: str, what: str) -> Element:
    """Return the first child element with a tag; raise an error if there is none."""
    found = element.first(tag)
    if found is None:
        raise element.at.error(f"<{element.tag}> of {what} has no <{tag}>")
    return found


def name_of(element: Element, what: str, attribute: str = "name") -> str:
    """Return the name of an element; raise an error if it has none."""
    found = element.attributes.get(attribute, "").strip()
    if not found:
        raise element.at.error(f'the {what} has no name: write {attribute}="..."')
    if len(found) > _LONGEST_NAME:
        raise element.at.error(f"the name of the {what} has more than {_LONGEST_NAME} characters")
    return found


def number_of(element: Element, name: str, what: str, default: float | None = None) -> float:
    """Return the number in an attribute; raise an error if it and the default are missing."""
    if name not in element.attributes and default is not None:
        return default
    return _number(element, name, _text(element, name, what).strip(), what)


def vector_of(element: Element, name: str, what: str, default: Vector | None = _ZERO) -> Vector:
    """Return three numbers in an attribute, which is required if the default is None."""
    if name not in element.attributes and default is not None:
        return default
    parts = _text(element, name, what).split()
    if len(parts) != 3:
        raise element.at.error(
            f"{name} of <{element.tag}> of {what} has {len(parts)} parts: give three numbers"
        )
    x, y, z = (_number(element, name, part, what) for part in parts)
    return (x, y, z)


def pose_of(element: Element, what: str) -> Pose:
    """Return the pose in an element's <origin>, or zero if there is none."""
    origin = element.first("origin")
    if origin is None:
        return Pose()
    return Pose(vector_of(origin, "xyz", what), vector_of(origin, "rpy", what))


def _text(element: Element, name: str, what: str) -> str:
    text = element.attributes.get(name)
    if text is None:
        raise element.at.error(f'<{element.tag}> of {what} has no {name}="..."')
    return text


def _number(element: Element, name: str, text: str, what: str) -> float:
    where = f"{name} of <{element.tag}> of {what} is"
    if not _NUMBER.match(text):
        hint = ": run xacro on the file first" if "${" in text else ""
        raise element.at.error(f"{where} '{brief(text)}', not a number{hint}")
    value = float(text)
    if not math.isfinite(value) or abs(value) > _LARGEST:
        raise element.at.error(f"{where} {brief(text)}: too large")
    return value


#: Joint types, and whether each has an axis.
JOINT_TYPES = {
    "fixed": False,
    "revolute": True,
    "continuous": True,
    "prismatic": True,
    "planar": True,
    "floating": False,
}
#: Attribute names of the moments of inertia.
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class Inertial:
    """Mass and moments of inertia of a link."""

    #: Pose of the inertial frame relative to the link, with its origin at the centre of mass.
    pose: Pose
    mass: float  # mass of the link, [kg]
    moments: tuple[float, ...]  # moments of inertia ixx, ixy, ixz, iyy, iyz, izz, [kg m^2]


@dataclass(frozen=True)
class RobotLink:
    """A link, with its name, its line, its inertia if there is one, and its shapes."""

    name: str
    at: SourceLine
    inertial: Inertial | None
    visuals: tuple[Visual, ...]


@dataclass(frozen=True)
class Mimic:
    """A coordinate that equals the coordinate of another joint times a factor, plus an offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Joint:
    """A joint between two links."""

    #: Name of the joint and its type, a key of :data:`JOINT_TYPES`.
    name: str
    type: str
    at: SourceLine  # file and first line of the element
    #: Names of the parent and child links.
    parent: str
    child: str
    pose: Pose  # pose of the child relative to the parent for coordinate zero
    axis: Vector  # direction of the joint axis in the child's axes
    damping: float  # viscous damping, [N s/m] or [N m s/rad]
    friction: float  # dry friction, [N] or [N m]
    mimic: Mimic | None  # mimic, if the coordinate follows that of another joint


@dataclass(frozen=True)
class Robot:
    """A robot, with its name, links and joints, and the numbers of ignored elements by tag."""

    name: str
    links: tuple[RobotLink, ...]
    joints: tuple[Joint, ...]
    ignored: dict[str, int]


def read_robot(root: Element) -> Robot:
    """Read a robot from the outermost element of a URDF file."""
    if root.tag != "robot":
        raise root.at.error(f"the outermost element is <{brief(root.tag)}>, not <robot>")
    for child in root.children:
        if child.tag.startswith("xacro:"):
            raise child.at.error(f"<{brief(child.tag)}> is a macro: run xacro on the file first")
    links = tuple(_link(element) for element in root.all("link"))
    joints = tuple(_joint(element) for element in root.all("joint"))
    # A note lists ignored elements, such as materials, transmissions and plugins.
    ignored = Counter(child.tag for child in root.children if child.tag not in ("link", "joint"))
    if not links:
        raise root.at.error("the robot has no links")
    return Robot(root.attributes.get("name", "robot"), links, joints, dict(ignored))


def _link(element: Element) -> RobotLink:
    name = name_of(element, "link")
    found = element.first("inertial")
    inertial = None if found is None else _inertial(found, f"link '{brief(name)}'")
    return RobotLink(name, element.at, inertial, tuple(_visuals(element.all("visual"))))


def _inertial(element: Element, what: str) -> Inertial:
    mass_element = child_of(element, "mass", what)
    mass = number_of(mass_element, "value", what)
    if mass < 0.0:
        raise mass_element.at.error(f"{what} has the negative mass {mass:g}")
    tensor = child_of(element, "inertia", what)
    moments = {name: number_of(tensor, name, what, 0.0) for name in MOMENTS}
    # Products of inertia may have any sign.
    for name in ("ixx", "iyy", "izz"):
        if moments[name] < 0.0:
            raise tensor.at.error(f"{what} has the negative moment of inertia {name}")
    return Inertial(pose_of(element, what), mass, tuple(moments.values()))


def _joint(element: Element) -> Joint:
    name = name_of(element, "joint")
    what = f"joint '{brief(name)}'"
    kind = element.attributes.get("type")
    if kind is None:
        raise element.at.error(f'{what} has no type: give type="revolute", for example')
    if kind not in JOINT_TYPES:
        hint = nearest(kind, JOINT_TYPES)
        raise element.at.error(f"{what} has the unknown type '{brief(kind)}'{hint}")
    parent, child = (
        name_of(child_of(element, end, what), f"{end} of {what}", "link")
        for end in ("parent", "child")
    )
    axis_element, axis = element.first("axis"), (1.0, 0.0, 0.0)
    # The default axis is x. An axis may have any length except zero.
    if JOINT_TYPES[kind] and axis_element is not None:
        axis = vector_of(axis_element, "xyz", what, axis)
        if max(map(abs, axis)) < 1e-6:
            raise axis_element.at.error(f"the axis of {what} has no length")
    damping, friction = _dynamics(element, what)
    pose, mimic = pose_of(element, what), _mimic(element, what)
    return Joint(name, kind, element.at, parent, child, pose, axis, damping, friction, mimic)


def _dynamics(joint: Element, what: str) -> tuple[float, float]:
    element = joint.first("dynamics")
    if element is None:
        return 0.0, 0.0
    found = [number_of(element, name, what, 0.0) for name in ("damping", "friction")]
    for name, value in zip(("damping", "friction"), found, strict=True):
        if value < 0.0:
            raise element.at.error(f"{what} has the negative {name} {value:g}")
    return found[0], found[1]


def _mimic(joint: Element, what: str) -> Mimic | None:
    element = joint.first("mimic")
    if element is None:
        return None
    leader = name_of(element, f"mimic of {what}", "joint")
    multiplier = number_of(element, "multiplier", what, 1.0)
    return Mimic(leader, multiplier, number_of(element, "offset", what, 0.0))


def _visuals(elements: Sequence[Element]) -> list[Visual]:
    """Return the shapes for drawings; invalid ones are omitted."""
    found = []
    for element in elements:
        geometry = element.first("geometry")
        shape = geometry.children[0] if geometry is not None and geometry.children else None
        if shape is None:
            continue
        try:
            pose = pose_of(element, "visual")
            if shape.tag == "mesh":
                size = vector_of(shape, "scale", "mesh", (1.0, 1.0, 1.0))
            elif shape.tag == "box":
                size = vector_of(shape, "size", "box", None)
            elif shape.tag in ("cylinder", "capsule"):
                radius = number_of(shape, "radius", shape.tag)
                size = (radius, radius, number_of(shape, "length", shape.tag))
            elif shape.tag == "sphere":
                radius = number_of(shape, "radius", "sphere")
                size = (radius, radius, radius)
            else:
                continue
        except SceneError:
            continue
        file = shape.attributes.get("filename", "") if shape.tag == "mesh" else ""
        found.append(Visual("", shape.tag, size, file, pose.xyz, pose.rpy))
    return found
