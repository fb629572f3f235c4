"""Nodes of the syntax trees that libsbml makes of formulas."""

from __future__ import annotations

from functools import cache
from typing import Any


@cache
def _kinds() -> dict[int, str]:
    """Name the types of libsbml's nodes, without the prefix."""
    import libsbml

    names = (n for n in dir(libsbml) if n.startswith("AST_"))
    # Of types with two names, the alphabetically first is assigned last and remains.
    return {getattr(libsbml, n): n.removeprefix("AST_") for n in sorted(names, reverse=True)}


def kind_of(node: Any) -> str:
    """Return the type of a node of libsbml: ``PLUS``, ``FUNCTION_SIN``."""
    return _kinds().get(node.getType(), "UNKNOWN")


def children(node: Any) -> list[Any]:
    """List the children of a node."""
    return [node.getChild(i) for i in range(node.getNumChildren())]
