"""Edges as Python: the call of the method that adds them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

_WIDEST = 88  # columns


def edge_call(name: str, statement: Mapping[str, Any]) -> str:
    """Write an edge as a call of the method of its component.

    Parameters
    ----------
    name : str
        Name of the edge.
    statement : mapping
        The edge as the table of a scene file.

    Examples
    --------
    >>> print(edge_call("R", {"type": "resistor", "nodes": ["a", "b"], "resistance": "R0"}))
    scene.resistor("R", "a", "b", resistance="R0")
    """
    rest = {key: value for key, value in statement.items() if key not in ("type", "nodes")}
    arguments = [_value(item) for item in (name, *statement.get("nodes", ()))]
    keywords = [f"{key}={_value(item)}" for key, item in rest.items()]
    call = f"scene.{statement['type']}"
    line = f"{call}({', '.join([*arguments, *keywords])})"
    if len(line) <= _WIDEST:
        return line
    arguments += [f"{key}={_in_rows(item)}" for key, item in rest.items()]
    return "\n".join([f"{call}(", *(f"    {argument}," for argument in arguments), ")"])


def _in_rows(value: object) -> str:
    """Write a table on several lines where it is long."""
    line = _value(value)
    if not isinstance(value, Mapping) or len(line) <= _WIDEST - 20:
        return line
    rows = (f"        {_value(key)}: {_value(item)}," for key, item in value.items())
    return "\n".join(["{", *rows, "    }"])


def _value(value: object) -> str:
    # Texts are quoted as formatters quote them, which repr() does not.
    if isinstance(value, str):
        return '"' + value.replace("\\", "\\\\").replace('"', '\\"') + '"'
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_value(k)}: {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, Sequence):
        return f"[{', '.join(map(_value, value))}]"
    return repr(value)
