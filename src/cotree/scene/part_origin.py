"""Origins of the declarations of parts: the file of the part and the line in it.

Messages about the equations name an edge as the outer scene does, ``leg1.knee``; its statement
stands in another file, under another name.
"""

from __future__ import annotations

import os
import re
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING

from cotree.errors import FormulationError, ModelError, nearest
from cotree.scene.lines import statement_lines

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from cotree.scene.description import SceneDescription
    from cotree.scene.part import Part

_NAMED = re.compile(r"'([A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+)'")
_MOST = 3  # names of which one message says where they stand
_TABLES = (
    *(("edge", "edges"), ("parameter", "parameters"), ("input", "inputs")),
    *(("output", "outputs"), ("mode", "modes"), ("event", "events")),
)


def told_origins(
    message: str, members: Mapping[str, Part], outer: SceneDescription | None = None
) -> str:
    """Say where the declarations of parts that a message names are stated, as its end.

    Parameters
    ----------
    message : str
        The message.
    members : mapping of str to Part
        The parts of the scene, by the name of each.
    outer : SceneDescription, optional
        The scene, whose file gives values to its parts.
    """
    found: dict[str, str] = {}
    for name in dict.fromkeys(_NAMED.findall(message)):
        if told := _told(name, members, outer):
            found.setdefault(told, name)
    rows = [told.format(name=f"'{name}'") for told, name in list(found.items())[:_MOST]]
    return f" ({'; '.join(rows)})" if rows else ""


@contextmanager
def origins_told(scene: SceneDescription) -> Iterator[None]:
    """Let errors about a scene say, too, where the declarations of its parts are stated."""
    try:
        yield
    except (ModelError, FormulationError) as error:
        told = told_origins(str(error), scene.members, scene) if scene.members else ""
        if not told or told in str(error):
            raise
        raise type(error)(f"{error}{told}") from None


def origin_of(name: str, members: Mapping[str, Part]) -> tuple[Part, str] | None:
    """Find the innermost part that holds a name, and the name there."""
    member, dot, local = name.partition(".")
    part = members.get(member) if dot else None
    if part is None:
        return None
    return origin_of(local, part.scene.members) or (part, local)


def _told(name: str, members: Mapping[str, Part], outer: SceneDescription | None) -> str:
    """Say where a name of a part is stated, with ``{name}`` for itself."""
    member, dot, local = name.partition(".")
    part = members.get(member) if dot else None
    if part is None:
        return ""
    if name in part.set or local in part.parameters or local in part.inputs:
        if outer is None:
            return ""
        return f"{{name}} is given by part '{part.name}' of {place_of(outer, 'part', part.name)}"
    if local.partition(".")[0] in part.scene.members:
        return _told(local, part.scene.members, part.scene)
    # Of a variable the edge is stated; it may have a dot of its own, as those of ports have.
    while local:
        for kind, table in _TABLES:
            if local in getattr(part.scene, table):
                return f"{{name}} is {kind} '{local}' of {place_of(part.scene, kind, local)}"
        if local in part.node_names:
            return f"{{name}} is node '{local}' of {place_of(part.scene, 'node', local)}"
        local = local.rpartition(".")[0]
    return _unknown(name, part)


def _unknown(name: str, part: Part) -> str:
    """Say what a name within a part may be a slip of."""
    member, _, local = name.partition(".")
    known = {n for _, table in _TABLES for n in getattr(part.scene, table)} | part.node_names
    return f"part '{member}' has no '{local}'{nearest(local, known)}"


def place_of(scene: SceneDescription, kind: str, name: str) -> str:
    """Give the file of a scene with the line of a declaration; the scene's name without one."""
    line = line_of(scene, kind, name)
    file = os.path.basename(scene.file) or f"scene '{scene.name}'"
    return f"{file}, line {line}" if line else file


def line_of(scene: SceneDescription, kind: str, name: str) -> int | None:
    """Find the line of a scene's file in which something is declared; the first is 1."""
    if not scene.file.endswith(".toml"):
        return None
    try:
        status = os.stat(scene.file)
        lines = _lines(scene.file, status.st_mtime_ns, scene.section)
    except (OSError, UnicodeDecodeError):  # the file is gone, or has become something else
        return None
    return lines.get((kind, name))


@lru_cache(maxsize=64)
def _lines(file: str, changed: int, section: str) -> Mapping[tuple[str, str], int]:
    with open(file, encoding="utf-8") as stream:
        return statement_lines(stream.read(), section)
