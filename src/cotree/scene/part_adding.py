"""Addition of parts to a scene: checks of names, creation of declarations, and storage."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import takewhile
from math import prod
from typing import TYPE_CHECKING, Any

from cotree.arguments import is_list, plain
from cotree.errors import ModelError, SceneError, brief, nearest
from cotree.naming import RESERVED, check_name, check_path
from cotree.scene.description import LARGEST_SCENE, TABLES
from cotree.scene.expressions import table_scope
from cotree.scene.parameters import check_cycle
from cotree.scene.part import Part, PartRows, Renaming, in_name, in_value, owner_of

if TYPE_CHECKING:
    from cotree.scene.description import SceneDescription


#: Kinds of bindings, in the order in which they are searched.
KINDS = ("nodes", "parameters", "inputs")
#: Keys of a part in addition to the names that it binds.
RESERVED_ENTRIES = ("scene", "count", "index", *KINDS, "set")
_INDEX = ("i", "j", "k")


def make_part(
    name: str,
    scene: SceneDescription,
    given: Mapping[str, Any],
    outer: SceneDescription,
    source: str,
) -> Part:
    """Create a part of the scene ``outer`` from its statement ``given``; raise SceneError."""
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
        # Booleans are numbers in Python, but they are not valid counts.
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
        raise SceneError("index has the same name twice")
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
    """Raise an error if a part does not name a scene."""
    if "scene" not in given:
        near = [key for key in given if nearest(key, ["scene"]).endswith("?")]
        hint = f"; did you mean it by '{brief(near[0])}'?" if near else ""
        raise SceneError(f"needs the entry 'scene': a file, or the name of a shipped part{hint}")
    if not isinstance(given["scene"], str):
        raise SceneError(f"scene is {brief(given['scene'])}: give a file or a name in quotes")


def statement_of(part: Part) -> dict[str, Any]:
    """Return the table of a part in a scene file; ambiguous bindings are in one table per kind."""
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


_KEY = r'(?:[A-Za-z0-9_-]+|"[^"]*")'
_HEADING = re.compile(rf"\s*\[\[?\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*\]")
_ENTRY = re.compile(r"\s*\"?([A-Za-z_][A-Za-z0-9_-]*)\"?\s*[=.]")
_STEP = re.compile(_KEY)
#: Kinds of declarations in parts, and all kinds of statements by the name of their table.
_DECLARED = ("edge", "parameter", "input", "output", "mode", "event")
_KINDS = {f"{kind}s": kind for kind in (*_DECLARED, "part", "table")}


def statement_lines(text: str, section: str = "") -> dict[tuple[str, str], int]:
    """Return the lines of all declarations in a section of a scene file; the first line is 1."""
    found: dict[tuple[str, str], int] = {}
    within = section.split(".") if section else []
    table, is_own = "", False
    for number, line in enumerate(text.splitlines(), 1):
        if heading := _HEADING.match(line):
            steps = [step.strip('"') for step in _STEP.findall(heading[1])]
            # All other tables of the file do not belong to the scene.
            steps = steps[len(within) :] if steps[: len(within)] == within else []
            table = steps[0] if steps else ""
            # Keys in [edges.k] are fields of k; keys in [edges] are edges.
            is_own = len(steps) > 1
            if is_own and table in _KINDS:
                found.setdefault((_KINDS[table], steps[1]), number)
        elif not is_own and table in _KINDS and (entry := _ENTRY.match(line)):
            found.setdefault((_KINDS[table], entry[1]), number)
    return found


_NAMED = re.compile(r"'([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+)'")
_MOST = 3  # maximum number of names in a message whose declarations are located


def origin_note(
    message: str, members: Mapping[str, Part], outer: SceneDescription | None = None
) -> str:
    """Return a note that locates the declarations of parts that a message names."""
    found: dict[str, str] = {}
    for name in dict.fromkeys(_NAMED.findall(message)):
        if note := _statement_of(name, members, outer):
            found.setdefault(note, name)
    rows = [note.format(name=f"'{name}'") for note, name in list(found.items())[:_MOST]]
    return f" ({'; '.join(rows)})" if rows else ""


def origin_of(name: str, members: Mapping[str, Part]) -> tuple[Part, str] | None:
    """Return the innermost part that contains a name, and the name within that part."""
    member, dot, local = name.partition(".")
    part = members.get(member) if dot else None
    if part is None:
        return None
    return origin_of(local, part.scene.members) or (part, local)


def _statement_of(name: str, members: Mapping[str, Part], outer: SceneDescription | None) -> str:
    """Return a text on where a part's name is declared, with the placeholder ``{name}``."""
    member, dot, local = name.partition(".")
    part = members.get(member) if dot else None
    if part is None:
        return ""
    if name in part.set or local in part.parameters or local in part.inputs:
        if outer is None:
            return ""
        return f"{{name}} is given by part '{part.name}' of {place_of(outer, 'part', part.name)}"
    if local.partition(".")[0] in part.scene.members:
        return _statement_of(local, part.scene.members, part.scene)
    # For a variable, use the declaration of its edge. Names of edges and variables may have dots.
    while local:
        for kind in _DECLARED:
            if local in getattr(part.scene, f"{kind}s"):
                return f"{{name}} is {kind} '{local}' of {place_of(part.scene, kind, local)}"
        if local in part.node_names:
            return f"{{name}} is node '{local}' of {place_of(part.scene, 'node', local)}"
        local = local.rpartition(".")[0]
    local = name.partition(".")[2]
    known = {n for kind in _DECLARED for n in getattr(part.scene, f"{kind}s")} | part.node_names
    return f"part '{member}' has no '{local}'{nearest(local, known)}"


def place_of(scene: SceneDescription, kind: str, name: str) -> str:
    """Return the file of a scene and, if known, the line of a declaration; or the scene's name."""
    line = line_of(scene, kind, name)
    file = os.path.basename(scene.file) or f"scene '{scene.name}'"
    return f"{file}, line {line}" if line else file


def line_of(scene: SceneDescription, kind: str, name: str) -> int | None:
    """Return the line of a declaration in a scene's file, counted from 1; None if unknown."""
    if not scene.file.endswith(".toml"):
        return None
    try:
        status = os.stat(scene.file)
        lines = _lines(scene.file, status.st_mtime_ns, scene.section)
    except (OSError, UnicodeDecodeError):  # the file was removed or changed after it was read
        return None
    return lines.get((kind, name))


@lru_cache(maxsize=64)
def _lines(file: str, changed: int, section: str) -> Mapping[tuple[str, str], int]:
    with open(file, encoding="utf-8") as stream:
        return statement_lines(stream.read(), section)


#: Names that parts must not have, because expressions use them before a dot.
_TAKEN = frozenset({"ground", "energy", *RESERVED})


def add_part(
    scene: SceneDescription,
    name: str,
    template: SceneDescription,
    given: Mapping[str, Any],
    source: str,
) -> None:
    """Add a part to a scene; see :meth:`PartMethods.add`."""
    _check_part_name(scene, name)
    for port in template.ports:
        if port not in template.nodes:
            hint = nearest(port, template.nodes)
            raise SceneError(
                f"port '{port}' of scene '{template.name}' is not one of its nodes{hint}"
            )
    try:
        part = make_part(name, template, given, scene, source)
    except ModelError as error:
        raise type(error)(f"part '{name}': {error}") from None
    members = dict.fromkeys((member for member, _ in part.members()), part)
    _check_members(scene, name, members)
    # Bindings may call the outer scene's tables.
    with table_scope(scene.tables):
        rows = _rows_of(scene, part)
    scene.parts[name] = part
    scene.members.update(members)
    scene.connected.update(part.nodes.values())
    for table in TABLES:
        _put_first(getattr(scene, table), getattr(rows, table))


def _put_first(own: dict[str, Any], added: Mapping[str, Any]) -> None:
    """Add declarations of a part, as in files: before the scene's own and after other parts'."""
    # Only the scene's own declarations are searched, because parts may add thousands.
    last = list(takewhile(lambda key: "." not in key, reversed(own)))
    kept = {key: own.pop(key) for key in reversed(last)}
    own.update(added)
    own.update(kept)


def _rows_of(scene: SceneDescription, part: Part) -> PartRows:
    rows = PartRows()
    for member, index in part.members():
        what = f"part '{member}'"
        try:
            nodes = {
                own: check_node(scene, in_name(outer, index, f"node '{own}'"))
                for own, outer in part.nodes_of(member).items()
            }
            rows.add(Renaming(f"{member}.", nodes, part.scene))
            for own, value in part.parameters.items():
                full = f"{member}.{own}"
                rows.bind_parameter(full, in_value(value, index, f"parameter '{full}'"))
            for own, value in part.inputs.items():
                full = f"{member}.{own}"
                rows.bind_input(full, in_value(value, index, f"input '{full}'"), scene)
        except ModelError as error:
            note = origin_note(str(error), {member: part})
            raise type(error)(f"{what}: {error}{note}") from None
    for full, value in part.set.items():
        try:
            if not part.is_node(full):
                _bind(rows, full, value, scene)
        except ModelError as error:
            raise type(error)(f"set of part '{part.name}': {error}") from None
    return rows


def _bind(rows: PartRows, name: str, value: Any, scene: SceneDescription) -> None:
    if name in rows.parameters:
        rows.bind_parameter(name, value)
    elif name in rows.inputs or name in rows.outputs:
        rows.bind_input(name, value, scene)
    else:
        known = [*rows.parameters, *rows.inputs]
        raise SceneError(
            f"'{brief(name)}' is not a port, parameter or input of this part{nearest(name, known)}"
        )


def set_in_part(scene: SceneDescription, name: str, value: Any, unit: str = "") -> bool:
    """Set a parameter or input in a part and its statement; return whether a part has the name."""
    found = owner_of(scene, name)
    if found is None or name not in {**scene.parameters, **scene.inputs}:
        return False
    part, value = found[0], plain(value)
    given = {"value": value, "unit": unit} if unit else value
    changed = replace(part, set={**part.set, name: given})
    rows = PartRows(
        parameters={k: scene.parameters[k] for k in (name,) if k in scene.parameters},
        inputs={k: scene.inputs[k] for k in (name,) if k in scene.inputs},
    )
    _bind(rows, name, given, scene)
    if rows.parameters:
        check_cycle({**scene.parameters, **rows.parameters}, name)
    scene.parameters.update(rows.parameters)
    if name in rows.outputs:
        del scene.inputs[name]
        _put_first(scene.outputs, {name: rows.outputs[name]})
    scene.inputs.update(rows.inputs)
    scene.parts[part.name] = changed
    scene.members.update({m: changed for m, _ in changed.members()})
    return True


def check_node(scene: SceneDescription, name: object) -> str:
    """Check the name of a node, which must exist if it belongs to a part."""
    node = check_path("node", name)
    if node in scene.members:
        raise SceneError(f"'{node}' is a part, not a node: name one of its nodes, '{node}.node'")
    if "." not in node:
        return node
    found = owner_of(scene, node)
    if found is None:
        first = node.partition(".")[0]
        raise SceneError(
            f"node '{node}' belongs to the unknown part '{first}': declare the part before "
            f"what connects to it{nearest(first, scene.members)}"
        )
    part, member, local = found
    connected = part.nodes_of(member)
    if local in connected:
        index = next(index for name, index in part.members() if name == member)
        raise SceneError(
            f"node '{local}' of part '{member}' is connected to a node of this scene: use its "
            f"name, '{in_name(connected[local], index, node)}'"
        )
    if local not in part.node_names:
        hint = nearest(node, (f"{member}.{other}" for other in part.node_names))
        raise SceneError(f"part '{member}' has no node '{brief(local)}'{hint}")
    return node


def _check_part_name(scene: SceneDescription, name: object) -> None:
    check_name("part", name)
    if name in _TAKEN:
        raise SceneError(f"part name '{name}' already has a meaning in expressions: rename it")
    if name in scene.parts:
        raise SceneError(f"the name of part '{name}' is taken: every part needs its own")


def _check_members(scene: SceneDescription, name: str, members: Mapping[str, Part]) -> None:
    own_edges = takewhile(lambda key: "." not in key, reversed(scene.edges))
    own_nodes = {node for key in own_edges for node in scene.edges[key].nodes}
    taken = {"edge": scene.edges, "node": own_nodes | scene.connected, "part": scene.members}
    for member in members:
        check_name("part", member)
        kind = next((kind for kind, names in taken.items() if member in names), "")
        if kind:
            array = "" if member == name else f" of the array '{name}'"
            raise SceneError(
                f"the name of part '{member}'{array} is also that of a {kind}, so that "
                "expressions would be ambiguous: rename one"
            )
