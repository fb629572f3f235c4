"""Scene files, which may be untrusted: parts must be .toml files in the outermost file's folder."""

from __future__ import annotations

import difflib
import os
import re
import tomllib
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path, PureWindowsPath
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.components import COMPONENTS
from cotree.errors import ModelError, SceneError, brief, check_known, nearest
from cotree.files import read_text
from cotree.scene.description import SceneDescription, check_allowed, read_origin

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping


# Advice on error messages of the parser; the first pattern that matches is used.
_ADVICE = (
    (
        "Cannot overwrite a value",
        "this key occurs twice in its table: remove one, or restore the header, such as "
        "[edges.name], that is missing between them",
    ),
    (r"Cannot declare .* twice", "this header occurs twice: remove or rename one"),
    (r"Illegal character '\\n'", "the string that begins here has no closing quote"),
    ("Unterminated string", "a string has no closing quote"),
    (
        "Unclosed array",
        "the list should continue here with ',' or end with ']', unless the number before is "
        "mistyped or a quote is missing",
    ),
    (
        "Unclosed inline table",
        "the table should continue here with ',' or end with "
        "'}', unless the number before is mistyped or a quote is missing",
    ),
    ("Expected '=' after a key", "write name = value"),
    ("Invalid statement", "write name = value, or a header such as [outputs]"),
    ("Expected '.*' at the end of a table declaration", "a header ends with ']'"),
    ("Invalid initial character for a key", "a name is expected here, without quotes or signs"),
    (
        "Expected newline or end of document after a statement",
        "there is unexpected text after the value: numbers have a point, as 1.5, and "
        "exponents digits, as 1e-3; each statement has a line of its own",
    ),
    (
        "Invalid value",
        "after '=' write a number, a string in quotes, a list in [ ] or a table in { }",
    ),
    ("Cannot mutate immutable", "this table is written in { } elsewhere: extend it there"),
)


def advice(message: str, text: str) -> str:
    """Return advice on a parser error, given its message and the text."""
    lines = text.split("\n")
    place = re.search(r"\(at line (\d+), column (\d+)\)", message)
    number = int(place[1]) if place else len(lines)
    # If a bracket or quote is not closed, the parser reports the line after the error.
    while number > 1 and not lines[number - 1].strip():
        number -= 1
    line = brief(lines[number - 1], 80)
    remedy = next((text for pattern, text in _ADVICE if re.search(pattern, message)), "")
    return f", in `{line}`" + (f": {remedy}" if remedy else "")


# Keys that edges of all types have.
_OF_EDGES = ("type", "nodes", "initial")


def _check_keys(name: str, edge: Mapping[str, Any]) -> None:
    """Raise if a key is a misspelling of ``type``, ``nodes`` or ``initial``."""
    component = COMPONENTS.get(str(edge.get("type")))
    own = {row.name for row in component.fields} if component else set()
    absent = [key for key in _OF_EDGES if key not in edge]
    for key in edge:
        if key in _OF_EDGES or key in own:
            continue
        close = difflib.get_close_matches(str(key)[:80].lower(), absent, n=1, cutoff=0.74)
        if close:
            raise SceneError(
                f"edge '{name}' has no field '{brief(key)}'; did you mean '{close[0]}'?"
            )


if TYPE_CHECKING:
    #: Function that returns the scene that a part names, and the source of this scene.
    Parts = Callable[[str], tuple[SceneDescription, str]]
    #: Function that returns the text of a table's data file.
    Points = Callable[[str], str]

_Scene = TypeVar("_Scene", bound=SceneDescription)

_SECTIONS = (
    *("name", "gravity", "tables", "parameters", "inputs", "modes", "parts", "edges"),
    *("outputs", "events", "simulation", "allow", "ports", "scenes", "origin"),
)


def fill(
    data: Mapping[str, Any], stem: str, scene_type: type[_Scene], parts: Parts, points: Points
) -> _Scene:
    """Create a scene from the tables of its file; ``stem`` is the default name."""
    # Each statement calls the method for Python users, so files are checked in the same way.
    for name, value in data.items():
        is_lost = name not in _SECTIONS and (not isinstance(value, dict) or "value" in value)
        if is_lost and not (hint := nearest(name, _SECTIONS)).endswith("?"):
            raise SceneError(
                f"unknown section '{brief(name)}'{hint}; is a header such as [parameters] missing "
                "above it?"
            )
    check_known(data, _SECTIONS, "unknown section")
    scene = scene_type(data.get("name", stem), gravity=data.get("gravity", (0.0, 0.0, 0.0)))
    # Tables come first, because expressions call them.
    for name, table in _table(data, "tables").items():
        if not isinstance(table, dict):
            raise SceneError(f"table '{brief(name)}' must be a table with 'x' and its values")
        from cotree.scene.tables import add_table

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
    # Edges come after parts, because they may connect to nodes of parts.
    for name, part in _table(data, "parts").items():
        _add_part(scene, name, part, parts)
    for name, edge in _table(data, "edges").items():
        _add_edge(scene, name, edge)
    for name, value in _table(data, "outputs").items():
        scene.output(name, value)
    for name, event in _table(data, "events").items():
        scene.event(name, **_event(name, event))
    scene.simulation(**_table(data, "simulation"))
    scene.allow(*check_allowed(data.get("allow", [])))
    scene.port(*_ports(data.get("ports", []), scene))
    # Shapes come after edges, because they name nodes of edges.
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
    check_known(given, scene.nodes, "ports names", ", which is no node")
    return given


_EVENT = ("when", "direction", "set", "stop", "impact")


def _event(name: str, table: Any) -> Mapping[str, Any]:
    if not isinstance(table, dict):
        raise SceneError(f"event '{name}' must be a table")
    check_known(table, _EVENT, f"event '{name}' has no field")
    if "when" not in table:
        raise SceneError(f"event '{name}' needs the field 'when'")
    return table


def _add_part(scene: SceneDescription, name: str, part: Any, parts: Parts) -> None:
    if not isinstance(part, dict):
        raise SceneError(f"part '{name}' must be a table")
    from cotree.scene.part_adding import add_part, check_entries

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
    _check_keys(name, edge)
    if "type" not in rest:
        raise SceneError(f"edge '{name}' needs the field 'type'")
    nodes = rest.pop("nodes", [])
    if not isinstance(nodes, list):
        raise SceneError(f"nodes of edge '{name}' must be a list of names")
    if "name" in rest:
        raise SceneError(f"edge '{name}' has no field 'name'")
    scene.edge(name, rest.pop("type"), *nodes, initial=rest.pop("initial", None), **rest)


#: Maximum size of a scene file, [byte].
LARGEST_FILE = 50_000_000


def shipped_scenes() -> tuple[str, ...]:
    """Return the names of the shipped scenes."""
    return _shipped("scenes")


def shipped_parts() -> tuple[str, ...]:
    """Return the names of the shipped parts."""
    return _shipped("parts")


def load_scene(source: str | Path, scene_type: type[_Scene]) -> _Scene:
    """Read a scene from a file, or a shipped scene by name."""
    # Names of shipped scenes and parts take precedence over files with the same name.
    known = {name: folder for folder in ("parts", "scenes") for name in _shipped(folder)}
    if isinstance(source, str) and source in known:
        return _read_shipped(known[source], source, scene_type)
    if not os.path.isfile(source):  # Path.is_file would raise an error for names that are too long
        raise SceneError(
            f"'{source}' is neither a file nor a shipped scene{nearest(source, known)}"
        )
    return _read_file(source, scene_type)


def load_part(source: str | Path) -> tuple[SceneDescription, str]:
    """Read the scene of a part; return the scene and its source."""
    known = shipped_parts()
    if isinstance(source, str) and source in known:
        return _read_shipped("parts", source, SceneDescription), source
    if not os.path.isfile(source):
        raise SceneError(f"'{source}' is neither a file nor a shipped part{nearest(source, known)}")
    return _read_file(source, SceneDescription), str(source)


def _shipped(folder: str) -> tuple[str, ...]:
    found = resources.files("cotree") / folder
    return tuple(sorted(f.name[:-5] for f in found.iterdir() if f.name.endswith(".toml")))


def _read_shipped(folder: str, name: str, scene_type: type[_Scene]) -> _Scene:
    file = resources.files("cotree") / folder / f"{name}.toml"
    text = file.read_text(encoding="utf-8")
    return _Reading(text, f"{name}.toml", str(file), trail=(f"{name}.toml",)).scene(scene_type)


def _read_file(path: str | Path, scene_type: type[_Scene]) -> _Scene:
    text, real = read_text(path, LARGEST_FILE), os.path.realpath(path)
    root = os.path.dirname(real)
    return _Reading(text, str(path), str(path), root, root, (real,)).scene(scene_type)


def read_scene(text: str, where: str, scene_type: type[_Scene]) -> _Scene:
    """Read a scene from TOML text; its parts are shipped ones, or scenes in the same text."""
    return _Reading(text, where).scene(scene_type)


_NAMED = re.compile(r"(edge|part|parameter|input|output|mode|event|table) '([^']+)'")
_DEEPEST = 20  # maximum depth of nested parts


@dataclass(frozen=True)
class _Reading:
    """Reader of one file, and of the files and scenes that its parts name."""

    #: Text of the file, and its name in error messages.
    text: str
    where: str
    file: str = ""  # path of the file; empty if the text is not from a file
    #: Folder that must contain the files of parts, and folder of this file; empty without files.
    root: str = ""
    folder: str = ""
    trail: tuple[str, ...] = ()  # files that are currently being read, the outermost first
    #: Scenes that have already been read, by path.
    made: dict[str, SceneDescription] = field(default_factory=dict)

    def scene(self, scene_type: type[_Scene]) -> _Scene:
        """Return the scene that the file describes."""
        try:
            data = tomllib.loads(self.text)
        except tomllib.TOMLDecodeError as error:
            what = f"{error}{advice(str(error), self.text)}"
            raise SceneError(f"{self.where}: not valid TOML: {what}") from None
        except ValueError:  # Python refuses to read integers of thousands of digits
            raise SceneError(f"{self.where}: holds an integer of thousands of digits") from None
        except RecursionError:
            raise SceneError(f"{self.where}: nested too deeply") from None
        try:
            scenes = _Scenes(self, "", _table(data, "scenes"))
            made = fill(data, Path(self.where).stem, scene_type, scenes.find, self.points)
        except ModelError as error:
            raise self.located(error, self.where, "") from None
        made.file = self.file
        return made

    def located(self, error: ModelError, where: str, section: str) -> ModelError:
        """Return the error with its file and the line of the first declaration that it names."""
        from cotree.scene.part_adding import statement_lines

        lines = statement_lines(self.text, section)
        named = _NAMED.findall(str(error))
        # Parts of an array are declared under the array's name, without the number.
        named += [(kind, name.rstrip("0123456789_")) for kind, name in named if kind == "part"]
        found = (lines.get(key) for key in named)
        line = next((number for number in found if number), 0)
        place = f"{where}, line {line}" if line else where
        # The type of the error is kept, so that callers can distinguish errors in expressions.
        return type(error)(f"{place}: {error}")

    def part_file(self, name: str) -> tuple[SceneDescription, str]:
        """Read the scene file that a part names."""
        hint = "name a shipped part, or a scene of the same text, [scenes.name]"
        path, real = self.place(name, "scene", hint, "add the part in Python", ".toml")
        self.check_trail(real)
        if real not in self.made:
            below = _Reading(
                read_text(path, LARGEST_FILE),
                os.path.relpath(path, self.root),
                path,
                self.root,
                os.path.dirname(real),
                (*self.trail, real),
                self.made,
            )
            self.made[real] = below.scene(SceneDescription)
        return self.made[real], name

    def points(self, name: str) -> str:
        """Read the data file that a table names."""
        if not isinstance(name, str):
            raise SceneError(f"file {brief(repr(name))} of a table must be a path in quotes")
        path, _ = self.place(name, "file", "write the points here", "add the table in Python", "")
        from cotree.scene.tables import LARGEST_POINTS

        return read_text(path, LARGEST_POINTS)

    def place(self, name: str, kind: str, here: str, beside: str, suffix: str) -> tuple[str, str]:
        """Return path and real path of a file that this file names, in its folder or below."""
        if not self.folder:
            raise SceneError(
                f"{kind} '{brief(name)}' is a file, but the scene that names it was not read "
                f"from a file, so its folder is unknown: {here}"
            )
        if os.path.isabs(name) or PureWindowsPath(name).drive or "\\" in name:
            raise SceneError(
                f"{kind} '{brief(name)}' is not relative to this file: give a path from its "
                "folder, with '/' between folders"
            )
        path = os.path.join(self.folder, name)
        real = os.path.realpath(path)
        if os.path.commonpath([real, self.root]) != self.root:
            raise SceneError(
                f"{kind} '{brief(name)}' is outside the folder of the scene: move the file "
                f"into it, or {beside}"
            )
        if not os.path.isfile(real):
            near = [f for f in _listed(os.path.dirname(real)) if f.endswith(suffix)]
            hint = nearest(os.path.basename(name), near)
            raise SceneError(f"{kind} '{brief(name)}' is not a file in this folder{hint}")
        return path, real

    def check_trail(self, place: str) -> None:
        """Raise if a part contains itself, or if parts are nested too deeply."""
        if place in self.trail:
            way = [*self.trail[self.trail.index(place) :], place]
            names = " -> ".join(os.path.basename(step) for step in way)
            raise SceneError(f"the scene contains itself: {names}; remove one of these parts")
        if len(self.trail) > _DEEPEST:
            raise SceneError(f"parts are nested deeper than {_DEEPEST} levels")


@dataclass(frozen=True)
class _Scenes:
    """Scenes that a file defines for its parts; definitions in inner tables take precedence."""

    reading: _Reading  # the file that contains the tables
    section: str  # table of the file that contains the scenes; empty at the top level
    tables: Mapping[str, Any]  # tables of these scenes by name
    around: _Scenes | None = None  # scenes of the enclosing table

    def find(self, name: str) -> tuple[SceneDescription, str]:
        """Return the scene that a part names: in this file, in another file, or a shipped one."""
        if name in self.tables:
            return self._defined(name), name
        if self.around is not None:
            return self.around.find(name)
        if name.endswith(".toml"):
            return self.reading.part_file(name)
        known = shipped_parts()
        if name in known:
            if name not in self.reading.made:
                self.reading.check_trail(f"{name}.toml")
                self.reading.made[name] = _read_shipped("parts", name, SceneDescription)
            return self.reading.made[name], name
        hint = nearest(name, [*self.tables, *known])
        raise SceneError(
            f"scene '{brief(name)}' is neither a shipped part nor a scene of this file; files end "
            f"in .toml{hint}"
        )

    def _defined(self, name: str) -> SceneDescription:
        own = f"{self.section}.scenes.{name}".removeprefix(".")
        place = f"{self.reading.file or self.reading.where}#{own}"
        self.reading.check_trail(place)
        if place in self.reading.made:
            return self.reading.made[place]
        table = self.tables[name]
        if not isinstance(table, dict):
            raise SceneError(f"scene '{brief(name)}' must be a table")
        reading = replace(self.reading, trail=(*self.reading.trail, place))
        try:
            below = _Scenes(reading, own, _table(table, "scenes"), replace(self, reading=reading))
            made = fill(table, name, SceneDescription, below.find, reading.points)
        except ModelError as error:
            raise self.reading.located(error, f"scene '{brief(name)}'", own) from None
        made.file, made.section = self.reading.file, own
        self.reading.made[place] = made
        return made


def _listed(folder: str) -> list[str]:
    try:
        return sorted(os.listdir(folder))
    except OSError:
        return []
