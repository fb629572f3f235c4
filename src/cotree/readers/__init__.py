"""Reading of other tools' files, and loading of scenes by name or path."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, TypeVar

from cotree.scene.description import SceneDescription
from cotree.scene.toml_file import load_scene

if TYPE_CHECKING:
    from pathlib import Path

_Scene = TypeVar("_Scene", bound=SceneDescription)

_START = 4096  # number of leading bytes that must contain the start of the outermost XML element
_COMMENT, _OUTERMOST = re.compile(rb"(?s)<!--.*?-->"), re.compile(rb"<([A-Za-z_][\w:.-]*)")


def is_urdf(source: str | Path) -> bool:
    """Return whether a file is a robot description, by its suffix or its outermost element."""
    return _has_ending(source, ".urdf") or _begins_with(source, "robot")


def is_sbml(source: str | Path) -> bool:
    """Return whether a file is an SBML model, judged by its suffix or its root element."""
    # The SBML reader rejects other XML files later.
    return _has_ending(source, ".sbml", ".xml") and not _begins_with(source, "robot")


def is_spice(source: str | Path) -> bool:
    """Return whether a file is a netlist, by its suffix."""
    return _has_ending(source, ".cir", ".sp", ".net")


def _has_ending(source: str | Path, *endings: str) -> bool:
    return str(source).lower().endswith(endings)


def _begins_with(source: str | Path, tag: str) -> bool:
    """Return whether the outermost element of an XML file has a tag; False if it is unreadable."""
    if not _has_ending(source, ".xml"):
        return False
    try:
        with open(source, "rb") as file:
            start = file.read(_START)
    except (OSError, ValueError):
        return False  # the reader will raise the error
    # Comments, declarations and processing instructions may precede the element.
    found = _OUTERMOST.search(_COMMENT.sub(b"", start))
    return found is not None and found[1] == tag.encode()


def load_source(source: str | Path, scene_type: type[_Scene]) -> _Scene:
    """Read a TOML file, a file of another tool or, by its name, a shipped scene.

    An ``.xml`` file is an SBML model or a robot description.
    """
    if is_urdf(source):
        from cotree.readers.urdf.scene import UrdfOptions, read_urdf_scene

        return read_urdf_scene(source, scene_type, UrdfOptions())
    if is_spice(source):
        from cotree.readers.spice.scene import read_spice_scene

        return read_spice_scene(source, scene_type)
    if is_sbml(source):
        from cotree.readers.sbml.scene import read_sbml_scene

        return read_sbml_scene(source, scene_type)
    return load_scene(source, scene_type)
