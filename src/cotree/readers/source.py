"""Loading of scenes by name: shipped scenes, TOML files, and files of other tools by suffix."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from cotree.scene.description import SceneDescription
from cotree.scene.toml_file import load_scene

if TYPE_CHECKING:
    from pathlib import Path

_Scene = TypeVar("_Scene", bound=SceneDescription)


def is_urdf(source: str | Path) -> bool:
    """Whether a file is a robot description, by its ending."""
    return str(source).lower().endswith(".urdf")


def is_spice(source: str | Path) -> bool:
    """Whether a file is a netlist, by its ending."""
    return str(source).lower().endswith((".cir", ".sp", ".net"))


def load_source(source: str | Path, scene_type: type[_Scene]) -> _Scene:
    """Read a shipped scene, a TOML file, or a file of another tool.

    Parameters
    ----------
    source : str or Path
        Name of a shipped scene, or path of a file: ``.urdf`` is a robot description, ``.cir``,
        ``.sp`` and ``.net`` are netlists, anything else TOML.
    scene_type : type
        The class to make.

    Raises
    ------
    ModelError
        If there is no such scene, or it is wrong.
    """
    # The ending decides; shipped scenes have none and are found by the last branch.
    if is_urdf(source):
        from cotree.readers.urdf import UrdfOptions, read_urdf_scene

        return read_urdf_scene(source, scene_type, UrdfOptions())
    if is_spice(source):
        from cotree.readers.spice import read_spice_scene

        return read_spice_scene(source, scene_type)
    return load_scene(source, scene_type)
