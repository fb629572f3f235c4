"""The tree of a robot: which joint each link hangs on, and in which order they follow."""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING, TypeVar

from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.readers.urdf_robot import Joint, Robot, RobotLink

_Named = TypeVar("_Named", "RobotLink", "Joint")


def order_joints(robot: Robot, where: str) -> tuple[RobotLink, tuple[Joint, ...]]:
    """Order the joints from the root outwards.

    Parameters
    ----------
    robot : Robot
        As it stands in the file.
    where : str
        The file, for messages.

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
    links = _by_name("link", robot.links, where)
    _by_name("joint", robot.joints, where)
    onto: dict[str, Joint] = {}
    below: dict[str, list[Joint]] = {name: [] for name in links}
    for joint in robot.joints:
        at = f"{where}:{joint.line}: joint '{_short(joint.name)}'"
        for end, name in (("parent", joint.parent), ("child", joint.child)):
            if name not in links:
                raise SceneError(
                    f"{at}: there is no link '{_short(name)}' for its {end}{_meant(name, links)}"
                )
        if joint.child in onto:
            raise SceneError(
                f"{at}: link '{_short(joint.child)}' hangs on joint "
                f"'{_short(onto[joint.child].name)}' too; URDF has no closed loops: cut one and "
                "close it in the scene"
            )
        onto[joint.child] = joint
        below[joint.parent].append(joint)
    roots = [link for link in robot.links if link.name not in onto]
    if not roots:
        raise SceneError(f"{where}:{robot.links[0].line}: the joints go round in a circle")
    if len(roots) > 1:
        raise SceneError(
            f"{where}:{roots[1].line}: links '{_short(roots[0].name)}' and "
            f"'{_short(roots[1].name)}' both hang on no joint: join them"
        )
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
        raise SceneError(
            f"{where}:{lost.line}: joint '{_short(lost.name)}' is part of a circle of joints"
        )
    return roots[0], tuple(ordered)


def check_mimics(joints: Iterable[Joint], where: str) -> None:
    """Require that every mimic follows a joint with one coordinate, and none follows itself.

    Raises
    ------
    SceneError
        If one does not.
    """
    by_name = {joint.name: joint for joint in joints}
    for joint in by_name.values():
        if joint.mimic is None or joint.type == "fixed":
            continue
        at = f"{where}:{joint.line}: joint '{_short(joint.name)}'"
        if not has_one_coordinate(joint):
            raise SceneError(f"{at} mimics, but has several coordinates: its type is {joint.type}")
        leader = by_name.get(joint.mimic.joint)
        if leader is None:
            raise SceneError(
                f"{at} mimics '{_short(joint.mimic.joint)}', which is no joint"
                f"{_meant(joint.mimic.joint, by_name)}"
            )
        if not has_one_coordinate(leader):
            raise SceneError(
                f"{at} mimics '{_short(leader.name)}', which has not one coordinate: its type is "
                f"{leader.type}"
            )
    # Follow each chain of mimics until it ends or meets one that is known to end.
    settled: set[str] = set()
    for joint in by_name.values():
        trail: set[str] = set()
        follower: Joint | None = joint
        while follower is not None and follower.name not in settled:
            if follower.name in trail:
                raise SceneError(
                    f"{where}:{joint.line}: joint '{_short(joint.name)}' mimics itself, through "
                    "others or directly"
                )
            trail.add(follower.name)
            mimic = follower.mimic if follower.type != "fixed" else None
            follower = None if mimic is None else by_name[mimic.joint]
        settled |= trail


def has_one_coordinate(joint: Joint) -> bool:
    """Whether a joint turns about or slides along one axis."""
    return joint.type in ("revolute", "continuous", "prismatic")


def _by_name(kind: str, things: Iterable[_Named], where: str) -> dict[str, _Named]:
    found: dict[str, _Named] = {}
    for thing in things:
        if thing.name in found:
            raise SceneError(
                f"{where}:{thing.line}: {kind} '{_short(thing.name)}' is there twice, first on "
                f"line {found[thing.name].line}"
            )
        found[thing.name] = thing
    return found


def _meant(name: str, known: Iterable[str]) -> str:
    """Suggest the name that was probably meant; a robot has too many to list."""
    close = difflib.get_close_matches(name[:80], list(known)[:1000], n=1)
    return f"; did you mean '{_short(close[0])}'?" if close else ""


def _short(name: str) -> str:
    return name if len(name) <= 60 else f"{name[:57]}..."
