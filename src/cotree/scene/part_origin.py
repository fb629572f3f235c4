"""Where the declarations of parts were stated: the file of the part and the line in it.

Messages about the equations name an edge as the outer scene does, ``leg1.knee``; its statement
stands in another file, under another name.
"""

from __future__ import annotations

import os
import re
from contextlib import contextmanager
from functools import lru_cache
from typing import TYPE_CHECKING

from cotree.errors import FormulationError, ModelError
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


def told_origins(message: str, members: Mapping[str, Part]) -> str:
    """Say where the declarations of parts that a message names are stated, as its end.

    Parameters
    ----------
    message : str
        The message.
    members : mapping of str to Part
        The parts of the scene, by the name of each.
    """
    found = {}
    for name in dict.fromkeys(_NAMED.findall(message)):
        if told := _told(name, members):
            found[name] = told
    rows = [f"'{name}' is {told}" for name, told in list(found.items())[:_MOST]]
    return f" ({'; '.join(rows)})" if rows else ""


@contextmanager
def origins_told(scene: SceneDescription) -> Iterator[None]:
    """Let errors about a scene say, too, where the declarations of its parts are stated."""
    try:
        yield
    except (ModelError, FormulationError) as error:
        told = told_origins(str(error), scene.members) if scene.members else ""
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


def _told(name: str, members: Mapping[str, Part]) -> str:
    found = origin_of(name, members)
    if found is None:
        return ""
    part, local = found
    scene = part.scene
    # Of a variable the edge is stated; it may have a dot of its own, as those of ports have.
    while local:
        for kind, table in _TABLES:
            if local in getattr(scene, table):
                return f"{kind} '{local}' of {place_of(scene, kind, local)}"
        local = local.rpartition(".")[0]
    return ""


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
