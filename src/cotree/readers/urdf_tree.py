"""The tree of a robot: which joint each link hangs on, and in which order they follow."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from cotree.errors import brief, nearest

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.readers.urdf_robot import Joint, Robot, RobotLink

_Named = TypeVar("_Named", "RobotLink", "Joint")


def order_joints(robot: Robot) -> tuple[RobotLink, tuple[Joint, ...]]:
    """Order the joints from the root outwards.

    Parameters
    ----------
    robot : Robot
        As it stands in the file.

    Returns
    -------
    root : RobotLink
        The link that is no joint's child.
    joints : tuple of Joint
        Every joint, each after the one that its parent hangs on; siblings as in the file.

    Raises
    ------
    SceneError
        If names occur twice, a joint names a link that is not there, or they make no tree.
    """
    links = _by_name("link", robot.links)
    _by_name("joint", robot.joints)
    # The joint that each link hangs on, and those that hang on each link.
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
                f"{what}: link '{brief(joint.child)}' hangs on joint "
                f"'{brief(onto[joint.child].name)}' too; URDF has no closed loops: cut one and "
                "close it in the scene"
            )
        onto[joint.child] = joint
        below[joint.parent].append(joint)
    # With one joint above each link but the root, links and joints make a tree unless some go round
    # in a circle apart from it.
    roots = [link for link in robot.links if link.name not in onto]
    if not roots:
        raise robot.links[0].at.error("the joints go round in a circle")
    if len(roots) > 1:
        first, second = (brief(link.name) for link in roots[:2])
        raise roots[1].at.error(f"links '{first}' and '{second}' both hang on no joint: join them")
    ordered: list[Joint] = []
    # Depth first, with siblings in the order of the file.
    waiting = below[roots[0].name][::-1]
    while waiting:
        joint = waiting.pop()
        ordered.append(joint)
        waiting += below[joint.child][::-1]
    if len(ordered) < len(robot.joints):
        reached = {joint.name for joint in ordered}
        lost = next(joint for joint in robot.joints if joint.name not in reached)
        raise lost.at.error(f"joint '{brief(lost.name)}' is part of a circle of joints")
    return roots[0], tuple(ordered)


def check_mimics(joints: Iterable[Joint]) -> None:
    """Require that every mimic follows a joint with one coordinate, and none follows itself.

    Raises
    ------
    SceneError
        If one does not.
    """
    by_name = {joint.name: joint for joint in joints}
    for joint in by_name.values():
        # A fixed joint has no coordinate that could follow another.
        if joint.mimic is None or joint.type == "fixed":
            continue
        what = f"joint '{brief(joint.name)}'"
        if not has_one_coordinate(joint):
            raise joint.at.error(
                f"{what} mimics, but has several coordinates: its type is {joint.type}"
            )
        leader = by_name.get(joint.mimic.joint)
        if leader is None:
            raise joint.at.error(
                f"{what} mimics '{brief(joint.mimic.joint)}', which is no joint"
                f"{nearest(joint.mimic.joint, by_name)}"
            )
        if not has_one_coordinate(leader):
            raise joint.at.error(
                f"{what} mimics '{brief(leader.name)}', which has not one coordinate: its type is "
                f"{leader.type}"
            )
    # Follow each chain of mimics until it ends or meets one that is known to end.
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
        # Chains that end are not followed again: the work is linear in the number of joints.
        settled |= trail


def has_one_coordinate(joint: Joint) -> bool:
    """Whether a joint turns about or slides along one axis."""
    return joint.type in ("revolute", "continuous", "prismatic")


def _by_name(kind: str, things: Iterable[_Named]) -> dict[str, _Named]:
    found: dict[str, _Named] = {}
    for thing in things:
        if thing.name in found:
            raise thing.at.error(
                f"{kind} '{brief(thing.name)}' is there twice, first on line "
                f"{found[thing.name].at.line}"
            )
        found[thing.name] = thing
    return found
