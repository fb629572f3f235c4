"""Where a scene that was read from another tool's file comes from, and what it looks like."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Visual:
    """A shape fixed in a node, for drawings only.

    Attributes
    ----------
    node : str
        The node that carries it.
    shape : str
        ``box``, ``cylinder``, ``capsule``, ``sphere`` or ``mesh``.
    size : tuple of three float
        Lengths along x, y, z of a box; radius, radius, length of a cylinder or capsule; the radius
        of a sphere three times, [m]; factors of a mesh.
    file : str
        Name of a mesh's file as written. Only animations open it.
    xyz, rpy : tuple of three float
        Where it is in the node's axes, [m], and its roll, pitch and yaw, [rad].
    """

    node: str
    shape: str
    size: tuple[float, float, float]
    file: str = ""
    xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Origin:
    """What another tool's file said beside the edges of a scene.

    Attributes
    ----------
    file : str
        The file.
    notes : tuple of str
        What was not read, and what is called otherwise; a sentence each.
    names : mapping of (str, str) to str
        Names in the scene, by kind and name in the file; only those that differ.
    visuals : tuple of Visual
        Shapes of the bodies.
    """

    file: str
    notes: tuple[str, ...] = ()
    names: Mapping[tuple[str, str], str] = field(default_factory=dict)
    visuals: tuple[Visual, ...] = ()
