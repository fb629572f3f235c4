"""Statements about edges as a scene file writes them.

Components are adapted to the fields of a scene, heat goes to further nodes, and transistors have
inner nodes: the original statement cannot be recovered from the resulting edge.
"""

from __future__ import annotations

import numbers
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, TypeGuard

# Larger integers are not all exact as doubles.
_LARGEST_INTEGER = 2**53
_DEEPEST = 4  # more levels than any field has; a list may hold itself


def plain(value: Any, depth: int = 0) -> Any:
    """Copy a value with its lists and tables, numbers becoming Python's own.

    Values of other types stay as they are, for others to refuse.
    """
    if isinstance(value, (str, bytes, bool)) or depth > _DEEPEST:
        return value
    # Numbers of numpy become Python's own, which TOML can write and comparisons treat alike.
    if isinstance(value, numbers.Integral) and abs(int(value)) <= _LARGEST_INTEGER:
        return int(value)
    if isinstance(value, numbers.Real):
        try:
            return float(value)
        except (OverflowError, ValueError):
            return value
    if hasattr(value, "tolist"):  # arrays
        return plain(value.tolist(), depth + 1)
    if isinstance(value, Mapping):
        return {key: plain(item, depth + 1) for key, item in value.items()}
    if isinstance(value, Iterable):
        return [plain(item, depth + 1) for item in value]
    return value


def edge_statement(
    type: str, nodes: Sequence[object], fields: Mapping[str, Any], initial: Any
) -> dict[str, Any]:
    """Make the table of an edge in a scene file, of values that are plain.

    Fields that are None are left out, as are nodes and initial values where there are none.

    Parameters
    ----------
    type : str
        Name of the component type.
    nodes : sequence of str
        Its nodes.
    fields : mapping of str to object
        Its fields.
    initial : mapping or None
        Its initial values.
    """
    rows = {"type": type, "nodes": list(nodes), **fields, "initial": initial}
    return {
        key: value
        for key, value in rows.items()
        if value is not None and not (key in ("nodes", "initial") and not value)
    }


def is_list(value: object) -> TypeGuard[Sequence[Any]]:
    """Whether a value is a list, as of nodes or of numbers; a text is none."""
    return isinstance(value, Sequence) and not isinstance(value, str)
