"""Scene files: TOML to a scene, with the file named in every message."""

from __future__ import annotations

import os
import tomllib
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.errors import ModelError, SceneError, brief, check_known, nearest
from cotree.files import read_text
from cotree.scene.allowances import check_allowed
from cotree.scene.description import SceneDescription
from cotree.scene.events import check_event_table
from cotree.scene.origin import read_origin
from cotree.scene.toml_errors import advice, misspelt_key

if TYPE_CHECKING:
    from collections.abc import Mapping

_Scene = TypeVar("_Scene", bound=SceneDescription)


#: The longest scene file, in bytes.
LARGEST_FILE = 50_000_000

_SECTIONS = (
    *("name", "gravity", "parameters", "inputs", "modes", "edges", "outputs", "events"),
    *("simulation", "allow", "origin"),
)


def shipped_scenes() -> tuple[str, ...]:
    """Names of the scenes that come with cotree."""
    folder = resources.files("cotree") / "scenes"
    return tuple(sorted(f.name[:-5] for f in folder.iterdir() if f.name.endswith(".toml")))


def load_scene(source: str | Path, scene_type: type[_Scene]) -> _Scene:
    """Read a scene.

    Parameters
    ----------
    source : str or Path
        Name of a shipped scene, or path of a TOML file.
    scene_type : type
        The class to make.

    Raises
    ------
    SceneError
        If there is no such scene or the file cannot be read or is not TOML.
    ModelError
        If the scene is wrong; the message begins with the file.
    """
    shipped = shipped_scenes()
    # Names of shipped scenes go before files of the same name.
    if isinstance(source, str) and source in shipped:
        file = resources.files("cotree") / "scenes" / f"{source}.toml"
        made = read_scene(file.read_text(encoding="utf-8"), f"{source}.toml", scene_type)
        made.file = str(file)
        return made
    if not os.path.isfile(source):  # unlike Path.is_file, it takes names that are too long
        raise SceneError(
            f"'{source}' is neither a file nor a shipped scene{nearest(source, shipped)}"
        )
    made = read_scene(read_text(source, LARGEST_FILE), str(source), scene_type)
    made.file = str(source)
    return made


def read_scene(text: str, where: str, scene_type: type[_Scene]) -> _Scene:
    """Read a scene from TOML text.

    Parameters
    ----------
    text : str
        The text.
    where : str
        Names it in messages; its stem is the name of a scene that has none.
    scene_type : type
        The class to make.

    Raises
    ------
    ModelError
        If it is no valid TOML, or a statement is not accepted; the message names ``where``.
    """
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        what = f"{error}{advice(str(error), text)}"
        raise SceneError(f"{where}: not valid TOML: {what}") from None
    except RecursionError:
        raise SceneError(f"{where}: nested too deeply") from None
    try:
        return _fill(data, Path(where).stem, scene_type)
    except ModelError as error:
        # The type of the error stays, so that callers can tell faults of expressions from others.
        raise type(error)(f"{where}: {error}") from None


def _fill(data: Mapping[str, Any], stem: str, scene_type: type[_Scene]) -> _Scene:
    # Each statement is made by the method that Python users call, so that files are checked alike.
    for name, value in data.items():
        is_lost = name not in _SECTIONS and (not isinstance(value, dict) or "value" in value)
        if is_lost and not (hint := nearest(name, _SECTIONS)).endswith("?"):
            raise SceneError(
                f"unknown section '{brief(name)}'{hint}; is a header such as [parameters] missing "
                "above it?"
            )
    check_known(data, _SECTIONS, "unknown section")
    scene = scene_type(data.get("name", stem), gravity=data.get("gravity", (0.0, 0.0, 0.0)))
    for name, value in _table(data, "parameters").items():
        if isinstance(value, list):
            raise SceneError(
                f"parameter '{name}' is a list: give a number; or a header such as [edges.name] or "
                "[inputs] is missing above it"
            )
        scene.parameter(name, **_named_value("parameter", name, value, ("unit", "doc", "tunable")))
    for name, value in _table(data, "inputs").items():
        scene.input(name, **_named_value("input", name, value, ("unit", "doc")))
    for name, value in _table(data, "modes").items():
        given = _named_value("mode", name, value, ("doc",))
        scene.mode(name, given["value"], doc=given.get("doc", ""))
    for name, edge in _table(data, "edges").items():
        _add_edge(scene, name, edge)
    for name, value in _table(data, "outputs").items():
        scene.output(name, value)
    for name, event in _table(data, "events").items():
        scene.event(name, **check_event_table(name, event))
    scene.simulation(**_table(data, "simulation"))
    scene.allow(*check_allowed(data.get("allow", [])))
    # Shapes name nodes, which are known after all edges.
    if "origin" in data:
        scene.origin = read_origin(data["origin"], set(scene.nodes))
    return scene


def _table(data: Mapping[str, Any], key: str) -> dict[str, Any]:
    table = data.get(key, {})
    if not isinstance(table, dict):
        raise SceneError(f"'{key}' must be a table")
    return table


def _named_value(kind: str, name: str, value: Any, extras: tuple[str, ...]) -> dict[str, Any]:
    if not isinstance(value, dict):
        return {"value": value}
    check_known(value, ("value", *extras), f"{kind} '{name}' has no field")
    if "value" not in value:
        raise SceneError(f"{kind} '{name}' needs a value")
    return value


def _add_edge(scene: SceneDescription, name: str, edge: Any) -> None:
    if not isinstance(edge, dict):
        raise SceneError(f"edge '{name}' must be a table")
    rest = dict(edge)
    misspelt = misspelt_key(name, edge)
    if misspelt:
        raise SceneError(misspelt)
    if "type" not in rest:
        raise SceneError(f"edge '{name}' needs the field 'type'")
    nodes = rest.pop("nodes", [])
    if not isinstance(nodes, list):
        raise SceneError(f"nodes of edge '{name}' must be a list of names")
    if "name" in rest:
        raise SceneError(f"edge '{name}' has no field 'name'")
    scene.edge(name, rest.pop("type"), *nodes, initial=rest.pop("initial", None), **rest)
