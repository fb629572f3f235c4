"""Conversion of scenes to TOML; comments and order of a file are kept (tomlkit).

This module writes new text itself, because other writers put each number of a list on a line.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.dag.lookup import LinearTable
from cotree.errors import ModelError, SceneError
from cotree.files import atomic_write, read_text
from cotree.scene.description import TABLES, SceneDescription, origin_table
from cotree.scene.expressions import Expression
from cotree.scene.part_adding import statement_of
from cotree.scene.settings import OF_SCENES, Simulation
from cotree.scene.toml_file import LARGEST_FILE, load_part, read_scene, shipped_parts

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from cotree.scene.events import Event
    from cotree.scene.tables import LookupTable

_Row = TypeVar("_Row")

_LARGEST_KEPT = 200_000  # maximum size of a file whose comments are kept, [byte]
_WIDEST = 99  # maximum number of columns
_BARE = re.compile(r"[A-Za-z0-9_-]+\Z")
_ESCAPES = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}


def save_scene(scene: SceneDescription, path: Path) -> None:
    """Write a scene to a file, either completely or not at all; see :func:`scene_text`."""
    if path.suffix.lower() != ".toml":
        raise SceneError(f"cannot save a scene as '{path}': name a file that ends in .toml")
    text = kept_scene_text(scene)
    with atomic_write(path, "the scene") as draft:
        draft.write_text(text, encoding="utf-8", newline="\n")


def kept_scene_text(scene: SceneDescription) -> str:
    """Return a scene as TOML text, if possible with the comments of its file."""
    text = scene_text(scene)
    return _kept_text(scene, text) or text


def _kept_text(scene: SceneDescription, text: str) -> str:
    """Return the text of a scene's file with its comments and the changes, or "" if impossible."""
    import tomlkit

    if not scene.file.endswith(".toml"):
        return ""
    # Entries that the new text lacks may state defaults: they are kept if possible, else removed.
    for has_removed in (False, True):
        try:
            old = tomlkit.parse(read_text(scene.file, _LARGEST_KEPT))
            _merge(old, tomlkit.parse(text), has_removed)
            kept = tomlkit.dumps(old)
            read = read_scene(kept, scene.name, SceneDescription)
        except (ModelError, tomlkit.exceptions.TOMLKitError):  # the file has been changed
            continue
        orders = [[list(getattr(made, name)) for name in TABLES] for made in (read, scene)]
        if orders[0] == orders[1] and not _changed_field(read, scene):
            return kept
    return ""


def _plain(item: Any) -> Any:
    """Return the plain value of an item of a document; booleans are already plain."""
    return item if isinstance(item, bool) else item.unwrap()


def _merge(old: Any, new: Any, has_removed: bool) -> None:
    """Change only those entries of a document's tables that differ."""
    for key in [key for key in old if has_removed and key not in new]:
        del old[key]
    for key, value in new.items():
        own = old.get(key)
        if isinstance(own, Mapping) and isinstance(value, Mapping):
            _merge(own, value, has_removed)
        elif own is None or _plain(own) != _plain(value):
            old[key] = value


def _changed_field(read: SceneDescription, scene: SceneDescription) -> str:
    names = (row.name for row in fields(SceneDescription))
    return next((name for name in names if getattr(read, name) != getattr(scene, name)), "")


def scene_text(scene: SceneDescription) -> str:
    """Return a scene as TOML text, and read it back to ensure that it describes this scene."""
    text = "\n".join(_lines(scene)) + "\n"
    if len(text.encode()) > LARGEST_FILE:
        raise SceneError(f"scene '{scene.name}' takes more than the {LARGEST_FILE} bytes of a file")
    try:
        read = read_scene(text, f"scene '{scene.name}' as a file", SceneDescription)
    except ModelError as error:
        raise SceneError(str(error)) from None
    if name := _changed_field(read, scene):
        raise SceneError(
            f"scene '{scene.name}' cannot be saved: its {name} were not changed by the "
            "methods of a scene"
        )
    return text


def table_text(name: str, rows: Mapping[str, Any]) -> str:
    """Return one table as TOML text, preceded by an empty line."""
    return "\n".join(_table(name, rows)) + "\n"


def _lines(scene: SceneDescription) -> Iterator[str]:
    found: dict[str, SceneDescription] = {}
    names: dict[int, str] = {}
    _scenes_of_parts(scene, found, names)
    yield from _scene(scene, "", names)
    for name, made in found.items():
        yield from ("", f"[scenes.{name}]")
        yield from _scene(made, f"scenes.{name}.", names)


def _scene(scene: SceneDescription, at: str, names: Mapping[int, str]) -> Iterator[str]:
    """Yield the lines of a scene's tables; in the file, these are below the table ``at``."""
    yield f"name = {_text(scene.name)}"
    # Here and below, default values are omitted.
    if any(item.text != "0.0" for item in scene.gravity):
        yield f"gravity = {_value([item.canonical for item in scene.gravity])}"
    if scene.allowed:
        yield f"allow = {_value(list(scene.allowed))}"
    if scene.ports:
        yield f"ports = {_value(list(scene.ports))}"
    for name, lookup in _own(scene.tables):
        yield from _table(f"{at}tables.{name}", _lookup(lookup))
    parameters, inputs = _own(scene.parameters), _own(scene.inputs)
    yield from _rows(f"{at}parameters", {n: _named(p, p.value) for n, p in parameters})
    yield from _rows(f"{at}inputs", {n: _named(i, i.value) for n, i in inputs})
    modes = _own(scene.modes)
    yield from _rows(f"{at}modes", {n: _named(m, m.initial) for n, m in modes})
    for name, part in scene.parts.items():
        own = {"scene": names[id(part.scene)], **statement_of(part)}
        yield from _table(f"{at}parts.{name}", own)
    for name, edge in _own(scene.edges):
        yield from _table(f"{at}edges.{name}", edge.statement)
    yield from _rows(f"{at}outputs", {name: item.canonical for name, item in _own(scene.outputs)})
    for name, event in _own(scene.events):
        yield from _table(f"{at}events.{name}", _event(event))
    settings = _settings(scene.defaults)
    if settings:
        yield from _table(f"{at}simulation", settings)
    if scene.origin is not None:
        table = origin_table(scene.origin)
        # An array of tables comes after the table to which it belongs.
        visuals = table.pop("visuals")
        yield from _table(f"{at}origin", table)
        for visual in visuals:
            yield from _table(f"{at}origin.visuals", visual, "[[{}]]")


def _own(rows: Mapping[str, _Row]) -> list[tuple[str, _Row]]:
    return [(name, row) for name, row in rows.items() if "." not in name]


def _scenes_of_parts(
    scene: SceneDescription, found: dict[str, SceneDescription], names: dict[int, str]
) -> None:
    """Collect names for the scenes of all parts, inner ones first, in ``found`` and ``names``."""
    for part in scene.parts.values():
        made = part.scene
        if id(made) in names:
            continue
        # Only shipped parts are written by name, so that the file does not depend on other files.
        if part.source in shipped_parts() and load_part(part.source)[0] == made:
            names[id(made)] = part.source
            continue
        _scenes_of_parts(made, found, names)
        name, n = made.name, 1
        while name in shipped_parts() or found.get(name, made) != made:
            n += 1
            name = f"{made.name}_{n}"
        found[name] = made
        names[id(made)] = name


def _lookup(table: LookupTable) -> dict[str, object]:
    """Return a lookup table with its points inline, including those that were read from a file."""
    values = [value.canonical for value in table.values]
    found: dict[str, object] = {"x": list(table.x)}
    if table.y:
        width = len(table.y)
        rows = [values[i : i + width] for i in range(0, len(values), width)]
        found |= {"y": list(table.y), "values": rows}
    else:
        found["y"] = values
    usual = {"interpolation": "linear", "beyond": "hold", "doc": ""}
    return found | {k: getattr(table, k) for k, v in usual.items() if getattr(table, k) != v}


def _named(row: Any, value: Expression | LinearTable | float) -> object:
    """Return the value of a parameter, input or mode, or a table if there are other entries."""
    more = {key: getattr(row, key, "") for key in ("unit", "doc")}
    stated: object = value.canonical if isinstance(value, Expression) else value
    if isinstance(value, LinearTable):
        stated = [list(value.x), list(value.y)]
    if (given := getattr(row, "given", None)) is not None:
        stated, more["unit"] = given  # the file contains the value as the user stated it
    more = {key: text for key, text in more.items() if text}
    if not getattr(row, "tunable", True):
        more["tunable"] = False
    return {"value": stated, **more} if more else stated


def _event(event: Event) -> dict[str, object]:
    table: dict[str, object] = {"when": event.when.canonical}
    if event.direction:
        table["direction"] = event.direction
    if event.set:
        table["set"] = {name: value.canonical for name, value in event.set.items()}
    if event.is_terminal:
        table["stop"] = True
    if event.restitution is not None:
        table["impact"] = {"restitution": event.restitution.canonical}
    return table


def _settings(given: Simulation) -> dict[str, object]:
    # Omitted settings will follow the defaults of later versions.
    usual = Simulation()
    table = {
        key: value for key in OF_SCENES if (value := getattr(given, key)) != getattr(usual, key)
    }
    if given.held:
        table["held"] = {node: value.canonical for node, value in given.held}
    return table


def _rows(name: str, rows: Mapping[str, object]) -> Iterator[str]:
    """Yield a section as text, with its rows in order and one line per row."""
    if rows:
        yield from ("", f"[{name}]", *(f"{key} = {_value(value)}" for key, value in rows.items()))


def _table(name: str, rows: Mapping[str, Any], heading: str = "[{}]") -> Iterator[str]:
    """Yield a section as text; tables that are too long for a line follow as separate sections."""
    yield from ("", heading.format(name))
    long = {}
    for key, value in rows.items():
        # TOML keys must precede subsections, because a key after a subsection belongs to it.
        line = f"{_key(key)} = {_value(value)}"
        if isinstance(value, Mapping) and (len(line) > _WIDEST or "\n" in line):
            long[key] = value
        else:
            yield line
    for key, value in long.items():
        yield from _table(f"{name}.{_key(key)}", value)


def _key(key: str) -> str:
    return key if _BARE.match(key) else _text(key)


def _value(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, float)):
        return repr(value)  # repr returns the shortest digits from which the same number is read
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + " }"
    if isinstance(value, Sequence):
        return _list([_value(item) for item in value])
    raise SceneError(f"a scene file cannot hold {type(value).__name__}")


def _list(items: list[str]) -> str:
    """Return a list as text; if it is long, on several lines with one matrix row per line."""
    line = f"[{', '.join(items)}]"
    # Leave enough columns for a short key.
    if len(line) <= _WIDEST - 20 and "\n" not in line:
        return line
    lines = [""]
    for item in items:
        if item.startswith("[") or len(lines[-1]) + len(item) > _WIDEST - 2:
            lines.append("")
        lines[-1] += f"{item}, "
    return "\n".join(["[", *(f"  {row.rstrip()}" for row in lines if row), "]"])


def _text(text: str) -> str:
    """Return a string in quotes, with invisible characters escaped and lone surrogates as "?"."""
    whole = text.encode("utf-8", "replace").decode()
    return '"' + "".join(_escaped(char) for char in whole) + '"'


def _escaped(char: str) -> str:
    if char in _ESCAPES:
        return _ESCAPES[char]
    if char.isprintable():
        return char
    return f"\\u{ord(char):04x}" if ord(char) < 0x10000 else f"\\U{ord(char):08x}"
