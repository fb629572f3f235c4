"""A robot description as given in a file: links and joints, checked one by one.

In: the elements of a URDF file (the Unified Robot Description Format of ROS). Out: a
:class:`Robot`. What it says of itself only is checked here; that links and joints make a tree is
checked by :mod:`cotree.readers.urdf_tree`.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import SceneError, brief, nearest
from cotree.readers.urdf_values import child_of, name_of, number_of, pose_of, vector_of
from cotree.scene.origin import Visual

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.readers.source_line import SourceLine
    from cotree.readers.urdf_values import Pose, Vector
    from cotree.readers.xml_tree import Element

#: Types of joints, with whether they have an axis.
JOINT_TYPES = {
    "fixed": False,
    "revolute": True,
    "continuous": True,
    "prismatic": True,
    "planar": True,
    "floating": False,
}
#: Moments of inertia as the format names them.
MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


@dataclass(frozen=True)
class Inertial:
    """Inertia of a link.

    Attributes
    ----------
    pose : Pose
        Of the centre of mass, and of the axes that the moments are about, in the link's axes.
    mass : float
        [kg].
    moments : tuple of six float
        ixx, ixy, ixz, iyy, iyz, izz, [kg m^2].
    """

    pose: Pose
    mass: float
    moments: tuple[float, ...]


@dataclass(frozen=True)
class RobotLink:
    """A link: its name, the line where it begins, its inertia if it has any, and its shapes."""

    name: str
    at: SourceLine
    inertial: Inertial | None
    visuals: tuple[Visual, ...]


@dataclass(frozen=True)
class Mimic:
    """The coordinate of another joint, times a factor, plus an offset."""

    joint: str
    multiplier: float
    offset: float


@dataclass(frozen=True)
class Joint:
    """A joint.

    Attributes
    ----------
    name, type : str
        Its name, and one of :data:`JOINT_TYPES`.
    at : SourceLine
        Where it begins.
    parent, child : str
        Its links.
    pose : Pose
        Of the child's axes in the parent's, where its coordinate is zero.
    axis : Vector
        In the child's axes.
    damping, friction : float
        [N s/m or N m s/rad], [N or N m].
    mimic : Mimic or None
        Where its coordinate is that of another joint.
    """

    name: str
    type: str
    at: SourceLine
    parent: str
    child: str
    pose: Pose
    axis: Vector
    damping: float
    friction: float
    mimic: Mimic | None


@dataclass(frozen=True)
class Robot:
    """Contents of a file: name, links, joints, and counts of elements that are not read."""

    name: str
    links: tuple[RobotLink, ...]
    joints: tuple[Joint, ...]
    ignored: dict[str, int]


def read_robot(root: Element) -> Robot:
    """Read the elements of a URDF file, from the outermost one.

    Raises
    ------
    SceneError
        If an element is missing or wrong; the message begins with file and line.
    """
    if root.tag != "robot":
        raise root.at.error(f"the outermost element is <{brief(root.tag)}>, not <robot>")
    known = ("link", "joint")
    for child in root.children:
        if child.tag.startswith("xacro:"):
            raise child.at.error(f"<{brief(child.tag)}> is a macro: run xacro on the file first")
    links = tuple(_link(element) for element in root.all("link"))
    joints = tuple(_joint(element) for element in root.all("joint"))
    # Elements that are not read (materials, transmissions, plugins) are counted for a note.
    ignored = Counter(child.tag for child in root.children if child.tag not in known)
    if not links:
        raise root.at.error("the robot has no links")
    return Robot(root.attributes.get("name", "robot"), links, joints, dict(ignored))


def _link(element: Element) -> RobotLink:
    name = name_of(element, "link")
    inertial = element.first("inertial")
    return RobotLink(
        name,
        element.at,
        None if inertial is None else _inertial(inertial, f"link '{brief(name)}'"),
        tuple(_visuals(element.all("visual"))),
    )


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
    ends = [
        name_of(child_of(element, end, what), f"{end} of {what}", "link")
        for end in ("parent", "child")
    ]
    axis_element, axis = element.first("axis"), (1.0, 0.0, 0.0)
    # URDF's default axis is x. The length of an axis does not matter, but there must be a
    # direction.
    if JOINT_TYPES[kind] and axis_element is not None:
        axis = vector_of(axis_element, "xyz", what, axis)
        if max(map(abs, axis)) < 1e-6:
            raise axis_element.at.error(f"the axis of {what} has no length")
    damping, friction = _dynamics(element, what)
    return Joint(
        name,
        kind,
        element.at,
        ends[0],
        ends[1],
        pose_of(element, what),
        axis,
        damping,
        friction,
        _mimic(element, what),
    )


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
    """List the shapes that can be drawn; wrong ones are left out, since mechanics need none."""
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
