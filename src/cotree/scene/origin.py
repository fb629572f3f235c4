"""Origin and drawn shapes of a scene that was read from another tool's file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.errors import SceneError, brief, check_known, nearest

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

#: Shapes that a visual may have.
_SHAPES = ("box", "cylinder", "capsule", "sphere", "mesh")

_VECTORS = ("size", "xyz", "rpy")
_LARGEST = 1e300  # numbers that scale drawings
_ZERO = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Visual:
    """A shape fixed to a node, for drawings only."""

    node: str  # the node that carries it
    shape: str  # ``box``, ``cylinder``, ``capsule``, ``sphere`` or ``mesh``
    #: Lengths along x, y, z of a box; radius, radius, length of a cylinder or capsule; the radius
    #: of a sphere three times, [m]; scale factors of a mesh.
    size: tuple[float, float, float]
    file: str = ""  # file name of a mesh as written; only animations open it
    #: Its position in the node's axes, [m], and its roll, pitch and yaw, [rad].
    xyz: tuple[float, float, float] = _ZERO
    rpy: tuple[float, float, float] = _ZERO


@dataclass(frozen=True)
class Origin:
    """Data of another tool's file besides the edges of a scene.

    Attributes
    ----------
    file : str
        The file.
    notes : tuple of str
        Items that were not read or were renamed, one sentence each.
    names : mapping of (str, str) to str
        Names in the scene, by kind and name in the file; only those that differ.
    visuals : tuple of Visual
        Shapes of the bodies.
    """

    file: str
    notes: tuple[str, ...] = ()
    names: Mapping[tuple[str, str], str] = field(default_factory=dict)
    visuals: tuple[Visual, ...] = ()


def origin_table(origin: Origin) -> dict[str, Any]:
    """Return the table of an origin: ``file``, ``notes``, ``names``, ``visuals``."""
    names: dict[str, dict[str, str]] = {}
    for (kind, old), new in origin.names.items():
        # TOML keys cannot be pairs: tables by kind contain tables by old name.
        names.setdefault(kind, {})[old] = new
    table: dict[str, Any] = {"file": origin.file, "notes": list(origin.notes), "names": names}
    visuals = [
        {key: value for key, value in vars(visual).items() if value not in ("", _ZERO)}
        for visual in origin.visuals
    ]
    return {key: value for key, value in table.items() if value} | {"visuals": visuals}


def read_origin(table: object, nodes: Collection[str]) -> Origin:
    """Check the table of an origin in a scene file."""
    # The table may be written by hand, or come with a scene from an untrusted source.
    rows = _entries(table, Origin, "the origin")
    notes, names, visuals = rows.get("notes", []), rows.get("names", {}), rows.get("visuals", [])
    if not _is_list_of_texts(notes):
        raise SceneError("notes of the origin must be a list of texts")
    if not isinstance(names, dict) or not all(
        isinstance(row, dict) and _is_list_of_texts(list(row.values())) for row in names.values()
    ):
        raise SceneError("names of the origin must be a table for each kind: old name = 'new name'")
    if not isinstance(visuals, list):
        raise SceneError("visuals of the origin must be tables: [[origin.visuals]]")
    return Origin(
        _text(rows, "file", "the origin"),
        tuple(notes),
        {(kind, old): new for kind, row in names.items() for old, new in row.items()},
        tuple(_visual(row, i, nodes) for i, row in enumerate(visuals, 1)),
    )


def _visual(table: object, number: int, nodes: Collection[str]) -> Visual:
    where = f"visual {number} of the origin"
    rows = _entries(table, Visual, where)
    node, shape, file = (_text(rows, key, where) for key in ("node", "shape", "file"))
    if node not in nodes:
        raise SceneError(f"{where} is at the unknown node '{brief(node)}'{nearest(node, nodes)}")
    check_known((shape,), _SHAPES, f"{where} has the unknown shape")
    size, xyz, rpy = (_three(rows.get(key, _ZERO), f"{key} of {where}") for key in _VECTORS)
    return Visual(node, shape, size, file, xyz, rpy)


def _entries(table: object, row: type, where: str) -> dict[str, Any]:
    if not isinstance(table, dict):
        raise SceneError(f"{where} must be a table")
    known = row.__dataclass_fields__  # type: ignore[attr-defined]
    check_known(table, known, f"{where} has no entry")
    return table


def _text(rows: Mapping[str, Any], key: str, where: str) -> str:
    value = rows.get(key, "")
    if not isinstance(value, str):
        raise SceneError(f"{key} of {where} must be a string")
    return value


def _three(value: object, where: str) -> tuple[float, float, float]:
    if not isinstance(value, (list, tuple)) or len(value) != 3 or not all(map(_is_number, value)):
        raise SceneError(f"{where} must be a list of three numbers")
    x, y, z = map(float, value)
    return x, y, z


def _is_number(value: object) -> bool:
    # Python's booleans are numbers; as a coordinate they are a mistake.
    is_real = isinstance(value, (int, float)) and not isinstance(value, bool)
    return is_real and abs(value) <= _LARGEST  # type: ignore[arg-type]


def _is_list_of_texts(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(item, str) for item in value)
