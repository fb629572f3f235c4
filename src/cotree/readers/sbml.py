"""Scenes from SBML models.

A species becomes an edge with its name; a reaction becomes an output, its rate, and a molar flow
for each species that it changes; rules become outputs and states. See docs/sbml.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

from cotree.files import read_text
from cotree.readers.sbml_document import read_document
from cotree.readers.sbml_writer import SceneWriter
from cotree.scene.description import SceneDescription

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from cotree.readers.sbml_model import SbmlModel


_Scene = TypeVar("_Scene", bound=SceneDescription)

_LARGEST_FILE = 50_000_000  # bytes; large networks of the literature have ten million


def read_sbml_scene(source: str | Path, scene_type: type[_Scene]) -> _Scene:
    """Read a model from an SBML file.

    Parameters
    ----------
    source : str or Path
        Path of the file.
    scene_type : type
        Class of the scene.

    Raises
    ------
    Error
        If python-libsbml is not installed.
    SceneError
        If the file cannot be read, or contains something that is not supported; the message begins
        with file and line.
    """
    return read_sbml_model(source, scene_type).scene


def read_sbml_model(
    source: str | Path, scene_type: type[_Scene], values: Mapping[str, float] | None = None
) -> SbmlModel[_Scene]:
    """Read a model as a scene, with the quantities of the scene by identifiers of the model.

    Parameters
    ----------
    source : str or Path
        Path of the file.
    scene_type : type
        Class of the scene.
    values : mapping of str to float, optional
        Values of quantities, by identifier, for which the file gives none.

    Raises
    ------
    Error, SceneError
        As :func:`read_sbml_scene`.
    """
    text = read_text(source, _LARGEST_FILE)
    return read_sbml_text(text, str(source), scene_type, values)


def read_sbml_text(
    text: str,
    where: str,
    scene_type: type[_Scene],
    values: Mapping[str, float] | None = None,
) -> SbmlModel[_Scene]:
    """Read a model from the text of an SBML file; see :func:`read_sbml_model`."""
    content = read_document(text, where)
    return SceneWriter(scene_type, content, where, values or {}).write()
