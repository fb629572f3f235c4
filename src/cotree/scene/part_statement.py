"""Statements of parts, checked: what is connected, what has which value, how many there are."""

from __future__ import annotations

from collections.abc import Mapping
from math import prod
from typing import TYPE_CHECKING, Any

from cotree.errors import SceneError, brief, nearest
from cotree.naming import RESERVED, check_name
from cotree.scene.part import TABLES, Part
from cotree.scene.statements import is_list, plain

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.scene.description import SceneDescription

#: Kinds of bindings, in the order in which a name is looked for.
KINDS = ("nodes", "parameters", "inputs")
#: Entries of a part besides its bindings.
RESERVED_ENTRIES = ("scene", "count", "index", *KINDS, "set")
_INDEX = ("i", "j", "k")
#: Edges of a scene, and declarations that come with parts: a bound on what untrusted input may ask
#: for.
LARGEST_SCENE = 250_000


def make_part(
    name: str,
    scene: SceneDescription,
    given: Mapping[str, Any],
    outer: SceneDescription,
    source: str,
) -> Part:
    """Make a part of its statement.

    Parameters
    ----------
    name : str
        Its name.
    scene : SceneDescription
        What it is made of.
    given : mapping of str to object
        What was said: ``count``, ``index``, ``nodes``, ``parameters``, ``inputs``, ``set``, and
        bindings by the name of a node, a parameter or an input.
    outer : SceneDescription
        The scene that it becomes a part of.
    source : str
        What the scene was read from, for messages.

    Raises
    ------
    SceneError
        If an entry is unknown or not of its kind, or a port is left open.
    """
    rest: dict[str, Any] = plain(given)
    counts = _counts(rest.pop("count", None))
    index = _index(rest.pop("index", None), counts, outer)
    bound = {kind: _table(rest.pop(kind, {}), kind) for kind in KINDS}
    own = _table(rest.pop("set", {}), "set")
    known: dict[str, Sequence[str]] = {
        "nodes": scene.ports or tuple(n for n in scene.nodes if n != "ground"),
        "parameters": tuple(scene.parameters),
        "inputs": tuple(scene.inputs),
    }
    for key, value in rest.items():
        kinds = [kind for kind in KINDS if key in known[kind]]
        if not kinds:
            raise SceneError(_unknown(key, scene, known))
        if len(kinds) > 1:
            raise SceneError(
                f"'{brief(key)}' is a name among {' and '.join(kinds)} of {scene.name}: give it in "
                f"one of these tables, {kinds[0]} = {{ {key} = ... }}"
            )
        if key in bound[kinds[0]]:
            raise SceneError(f"'{brief(key)}' is given twice, alone and among {kinds[0]}")
        bound[kinds[0]][key] = value
    for kind in KINDS:
        for key in bound[kind]:
            if key not in known[kind]:
                raise SceneError(_unknown(key, scene, {kind: known[kind]}))
    for key, value in bound["nodes"].items():
        if not isinstance(value, str):
            raise SceneError(f"node '{key}' is {brief(value)}: give the name of a node in quotes")
    for key, value in own.items():
        if key.rpartition(".")[2] in known["nodes"] and not isinstance(value, (str, int, float)):
            raise SceneError(f"'{brief(key)}' in set is {brief(value)}: give a node in quotes")
    for port in scene.ports:
        if port not in bound["nodes"]:
            raise SceneError(
                f"port '{port}' of {scene.name} is left open: connect it, {port} = \"node\""
            )
    _check_size(scene, counts, outer)
    return Part(name, scene, counts, index, **bound, set=own, source=source)


def _unknown(key: object, scene: SceneDescription, known: Mapping[str, Sequence[str]]) -> str:
    singular = {"nodes": "port" if scene.ports else "node"}
    words = [singular.get(kind, kind[:-1]) for kind in known]
    listed = f"{', '.join(words[:-1])} or {words[-1]}" if len(words) > 1 else words[0]
    names = [name for group in known.values() for name in group]
    if key == "ground":
        return "'ground' is the reference of all scenes and cannot be connected: use another node"
    if scene.ports and isinstance(key, str) and key in scene.nodes and "nodes" in known:
        ports = ", ".join(scene.ports)
        return f"'{brief(key)}' is a node of {scene.name}, but none of its ports: {ports}"
    return f"{scene.name} has no {listed} '{brief(key)}'{nearest(key, names)}"


def _table(value: object, what: str) -> dict[str, Any]:
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise SceneError(f"{what} must be a table of names and values")
    return dict(value)


def _counts(given: object) -> tuple[int, ...]:
    if given is None:
        return ()
    rows: list[Any] = list(given) if is_list(given) else [given]
    if not 1 <= len(rows) <= len(_INDEX):
        raise SceneError(f"count has {len(rows)} numbers: give one, two or three")
    for row in rows:
        # Python's booleans are numbers; as a count they are a mistake.
        if isinstance(row, bool) or not isinstance(row, int) or row < 1:
            raise SceneError(f"count is {brief(repr(row))}: give a whole number from 1 on")
    return tuple(rows)


def _index(given: object, counts: Sequence[int], outer: SceneDescription) -> tuple[str, ...]:
    if given is None:
        names: list[Any] = list(_INDEX[: len(counts)])
    else:
        names = list(given) if is_list(given) else [given]
        if len(names) != len(counts):
            raise SceneError(f"index has {len(names)} names for {len(counts)} counts")
    for name in names:
        check_name("index", name)
        taken = {**outer.parameters, **outer.inputs, **outer.outputs, **outer.modes}
        if name in taken or name in RESERVED:
            raise SceneError(
                f"index '{name}' is a name of the scene, too: give it another, index = \"n\""
            )
    if len(set(names)) < len(names):
        raise SceneError("index names one number twice")
    return tuple(names)


def _check_size(scene: SceneDescription, counts: Sequence[int], outer: SceneDescription) -> None:
    n, rows, others = prod(counts), _size(scene), _size(outer)
    if n * max(rows, 1) + others > LARGEST_SCENE:
        raise SceneError(
            f"{n} parts of {rows} declarations each would make the scene larger than "
            f"{LARGEST_SCENE}"
        )


def _size(scene: SceneDescription) -> int:
    return sum(len(getattr(scene, table)) for table in TABLES)


def check_entries(given: Mapping[str, Any]) -> None:
    """Refuse a part without a scene.

    Raises
    ------
    SceneError
        If it has none, or names it by something other than a text.
    """
    if "scene" not in given:
        near = [key for key in given if nearest(key, ["scene"]).endswith("?")]
        hint = f"; did you mean it by '{brief(near[0])}'?" if near else ""
        raise SceneError(f"needs the entry 'scene': a file, or the name of a shipped part{hint}")
    if not isinstance(given["scene"], str):
        raise SceneError(f"scene is {brief(given['scene'])}: give a file or a name in quotes")


def statement_of(part: Part) -> dict[str, Any]:
    """Write a part as the table of a scene file, without its scene.

    Bindings stand alone where their names are clear, and in tables of their kind where not.
    """
    table: dict[str, Any] = {}
    if part.counts:
        table["count"] = part.counts[0] if len(part.counts) == 1 else list(part.counts)
        if part.index != _INDEX[: len(part.counts)]:
            table["index"] = part.index[0] if len(part.index) == 1 else list(part.index)
    scene = part.scene
    names = {"nodes": scene.nodes, "parameters": scene.parameters, "inputs": scene.inputs}
    for kind in KINDS:
        for key, value in getattr(part, kind).items():
            is_clear = sum(key in group for group in names.values()) == 1
            if is_clear and key not in RESERVED_ENTRIES and "." not in key:
                table[key] = value
            else:
                table.setdefault(kind, {})[key] = value
    if part.set:
        table["set"] = dict(part.set)
    return table
