"""Checks of names in scenes, and their conversion to C identifiers.

Names and texts of a scene are untrusted. A name is checked here before any other use. Only checked
names reach C; free texts (units, documentation) are escaped.
"""

from __future__ import annotations

import keyword
import re
from typing import TYPE_CHECKING

from cotree.errors import SceneError, brief

if TYPE_CHECKING:
    from collections.abc import Container

_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}\Z")
_SCENE_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_-]{0,63}\Z")

_LONGEST_PATH = 1000  # maximum length of a name with the names of its nested parts

#: Names with a fixed meaning in expressions.
RESERVED = frozenset({"t", "pi"})

#: Keys of an edge in a scene file that are not component fields.
_OF_EDGES = frozenset({"name", "type", "nodes", "initial"})

#: Kinds that may have reserved words as names, since a dot follows in expressions: ``in.v``.
_DOTTED = frozenset({"node", "edge", "joint", "part"})

_C_KEYWORDS = frozenset(
    (
        *("auto", "break", "case", "char", "const", "continue", "default", "do", "double"),
        *("else", "enum", "extern", "float", "for", "goto", "if", "inline", "int", "long"),
        *("register", "restrict", "return", "short", "signed", "sizeof", "static", "struct"),
        *("switch", "typedef", "union", "unsigned", "void", "volatile", "while"),
    )
)


#: Lower-case names of functions, files and targets in every C project; prefix of cotree's names.
_NOT_OF_MODELS, _OWN = frozenset({"main", "makefile", "all", "install", "clean", "help"}), "cotree_"


def check_name(kind: str, name: object) -> str:
    """Raise SceneError for an invalid name of a node, edge, parameter, input or output.

    A name is a letter or underscore followed by at most 63 letters, digits or underscores. Only
    nodes and edges, whose names a dot follows, may have reserved words of expressions as names.
    """
    if not isinstance(name, str) or not _NAME.match(name):
        raise SceneError(
            f"{kind} name {brief(repr(name))} is not allowed: use a letter followed by at most 63 "
            "letters, digits or underscores"
        )
    if keyword.iskeyword(name) and kind not in _DOTTED:
        raise SceneError(f"{kind} name '{name}' is a reserved word of expressions: try '{name}_'")
    if kind in ("parameter", "input", "output", "mode") and name in RESERVED:
        raise SceneError(f"{kind} name '{name}' already means something in expressions: rename it")
    if kind in ("field", "port") and name in _OF_EDGES:
        raise SceneError(f"{kind} name '{name}' already means something of edges: rename it")
    return name


def check_path(kind: str, name: object) -> str:
    """Check a name, or names joined by dots, of a declaration in a part: ``leg1.foot``."""
    if isinstance(name, str) and "." in name and len(name) <= _LONGEST_PATH:
        for step in name.split("."):
            check_name(kind, step)
        return name
    return check_name(kind, name)


def split_name(name: str) -> tuple[str, str]:
    """Split a variable's name at the last dot; without a dot, the first part is empty."""
    owner, _, variable = name.rpartition(".")
    return owner, variable


def owner_among(name: str, owners: Container[str]) -> str:
    """Return the one of ``owners`` that a variable's name begins with, or "" if there is none.

    The rest may contain a dot: in ``M.shaft.tau``, ``shaft`` is a port of ``M``.
    """
    owner = name
    while owner and owner not in owners:
        owner = owner.rpartition(".")[0]
    return owner if owner != name else ""


def check_scene_name(name: object) -> str:
    """Check the name of a scene, which may also contain dashes."""
    if not isinstance(name, str) or not _SCENE_NAME.match(name):
        raise SceneError(
            f"scene name {brief(repr(name))} is not allowed: use a letter followed by at most 63 "
            "letters, digits, underscores or dashes"
        )
    return name


def check_text(value: object, what: str) -> str:
    """Check a text that is not evaluated, such as a unit or a description."""
    if not isinstance(value, str) or len(value) > 1000:
        raise SceneError(f"{what} must be a text of at most 1000 characters")
    if any("\ud800" <= char <= "\udfff" for char in value):
        raise SceneError(f"{what} has a lone surrogate, which files cannot store: remove it")
    return value


def c_identifier(name: str) -> str:
    """Convert a checked name to a C identifier."""
    identifier = name.replace("-", "_")
    lower = identifier.lower()
    taken = identifier in _C_KEYWORDS or lower in _NOT_OF_MODELS or lower.startswith(_OWN)
    return f"{identifier}_" if taken else identifier


def c_string(text: str) -> str:
    """Write a text as a C string literal in ASCII; other characters become '?'."""
    ascii_text = text.encode("ascii", "replace").decode()
    safe = "".join(char if char.isprintable() else " " for char in ascii_text)
    # '?' is escaped, since "??" begins a trigraph in C99.
    return '"' + safe.replace("\\", "\\\\").replace('"', '\\"').replace("?", "\\?") + '"'


def c_comment(text: str) -> str:
    """Escape a text for a C comment on one line."""
    ascii_text = text.encode("ascii", "replace").decode()
    safe = "".join(char if char.isprintable() else " " for char in ascii_text)
    return safe.replace("\\", "/").replace("??", "? ").replace("*/", "* /").replace("/*", "/ *")
