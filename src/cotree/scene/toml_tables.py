"""The tables of a scene file, made into a scene by the methods that users of Python call."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeVar

from cotree.errors import ModelError, SceneError, brief, check_known, nearest
from cotree.scene.allowances import check_allowed
from cotree.scene.description import SceneDescription
from cotree.scene.events import check_event_table
from cotree.scene.origin import read_origin
from cotree.scene.part_adding import add_part
from cotree.scene.part_statement import check_entries
from cotree.scene.table_methods import add_table
from cotree.scene.toml_errors import misspelt_key

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    #: Gives the scene that a part names, and what it was read from.
    Parts = Callable[[str], tuple[SceneDescription, str]]
    #: Gives the text of a file that a table names.
    Points = Callable[[str], str]

_Scene = TypeVar("_Scene", bound=SceneDescription)

_SECTIONS = (
    *(
        "name",
        "gravity",
        "tables",
        "parameters",
        "inputs",
        "modes",
        "parts",
        "edges",
        "outputs",
        "events",
    ),
    *("simulation", "allow", "ports", "scenes", "origin"),
)


def fill(
    data: Mapping[str, Any], stem: str, scene_type: type[_Scene], parts: Parts, points: Points
) -> _Scene:
    """Make a scene of the tables of its file.

    Parameters
    ----------
    data : mapping
        The tables.
    stem : str
        The name of a scene that has none.
    scene_type : type
        The class to make.
    parts : callable
        Gives the scene that a part names, and what it was read from.
    points : callable
        Gives the text of a file that a table names.

    Raises
    ------
    ModelError
        If a statement is not accepted.
    """
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
    # Expressions call tables, which therefore come first.
    for name, table in _table(data, "tables").items():
        if not isinstance(table, dict):
            raise SceneError(f"table '{brief(name)}' must be a table with 'x' and its values")
        add_table(scene, name, table, points)
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
    # Edges may connect to nodes of parts.
    for name, part in _table(data, "parts").items():
        _add_part(scene, name, part, parts)
    for name, edge in _table(data, "edges").items():
        _add_edge(scene, name, edge)
    for name, value in _table(data, "outputs").items():
        scene.output(name, value)
    for name, event in _table(data, "events").items():
        scene.event(name, **check_event_table(name, event))
    scene.simulation(**_table(data, "simulation"))
    scene.allow(*check_allowed(data.get("allow", [])))
    scene.port(*_ports(data.get("ports", []), scene))
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


def _ports(given: object, scene: SceneDescription) -> list[str]:
    if not isinstance(given, list):
        raise SceneError("ports must be a list of names of nodes")
    nodes = scene.nodes
    for port in given:
        if port not in nodes:
            hint = nearest(port, nodes)
            raise SceneError(f"ports names '{brief(port)}', which is no node{hint}")
    return given


def _add_part(scene: SceneDescription, name: str, part: Any, parts: Parts) -> None:
    if not isinstance(part, dict):
        raise SceneError(f"part '{name}' must be a table")
    rest = dict(part)
    try:
        check_entries(rest)
        made, source = parts(rest.pop("scene"))
    except ModelError as error:
        raise type(error)(f"part '{name}': {error}") from None
    add_part(scene, name, made, rest, source)


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
