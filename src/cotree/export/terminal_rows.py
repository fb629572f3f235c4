"""Terminal equations, motion and reaction spaces of a scene's edges, as lines of text."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.export.blackboard import NOTHING, Formula, Pair, vector

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.export.terminal import Terminal
    from cotree.scene.description import Edge

#: What an edge's variable is, and what it equals.
Row = tuple[Pair, Pair]

_GROUND_AXES = ("î", "ĵ", "k̂")


def through_rows(terminal: Terminal, edge: Edge) -> list[Row]:
    """Write what an edge's terminal equations say of its through variables."""
    if edge.component.role in (Role.ARM, Role.JOINT):
        return _projections(terminal, edge)
    rows = []
    if "translation" in edge.component.domains:
        rows.append((terminal.symbol("F", edge.name), terminal.force(edge, terminal.symbol)))
    if "rotation" in edge.component.domains:
        rows.append((terminal.symbol("T", edge.name), terminal.torque(edge, terminal.symbol)))
    return rows


def _projections(terminal: Terminal, edge: Edge) -> list[Row]:
    """Write what a joint exerts along the directions of its motion space."""
    return [
        (
            terminal.symbol("T" if rotates else "F", edge.name).dot(terminal.axis(edge)),
            terminal.effort(edge, freedom),
        )
        for rotates in (False, True)
        for freedom in terminal.motion(edge, rotates)
    ]


def across_rows(terminal: Terminal, edge: Edge) -> list[Row]:
    """Write what an edge's terminal equations say of its across variables."""
    if edge.component.role is Role.ARM or edge.name in terminal.branches:
        values = terminal.across(edge)
        return [_across_row(terminal, edge, letter, value) for letter, value in values.items()]
    return _held_rows(terminal, edge) if edge.component.role is Role.JOINT else []


def _across_row(terminal: Terminal, edge: Edge, letter: str, value: Pair) -> Row:
    symbol = terminal.symbol(letter, edge.name)
    if letter == "R":  # the derivative of an orientation is a rotation vector
        if value.value.is_zero:
            value = Pair(vector("1"), value.d)
        symbol = Pair(symbol.value, terminal.symbol("φ", edge.name).d)
    return symbol, value


def _held_rows(terminal: Terminal, edge: Edge) -> list[Row]:
    """Write what a joint that is a chord holds: nothing moves along its reaction space."""
    rows: list[Row] = []
    for letters, rotates in (("rva", False), ("Rωα", True)):
        if not terminal.motion(edge, rotates):
            rows += [_across_row(terminal, edge, letter, NOTHING) for letter in letters]
            continue
        moving = terminal.symbol("ω" if rotates else "r", edge.name)
        index = terminal.axis_index(edge)
        if index is None:
            rows.append((moving.cross(terminal.axis(edge)), NOTHING))
            continue
        normals = (terminal.unit_vector(i, edge.nodes[0]) for i in range(3) if i != index)
        rows += [(moving.dot(normal), NOTHING) for normal in normals]
    return rows


def gathered(rows: Sequence[tuple[Formula, Formula]]) -> list[str]:
    """Write equations, those that equal zero as one."""
    shown = [f"{left} = {right}" for left, right in rows if not right.is_zero]
    zeros = [str(left) for left, right in rows if right.is_zero]
    if zeros:
        shown.append(" = ".join([*zeros, "0"]))
    return shown


def definitions(terminal: Terminal, second: bool) -> list[str]:
    """Explain the symbols that the terminal equations use, or those of their derivatives."""
    lines: list[str] = []
    gravity = terminal.components(terminal.scene.gravity, "ground")
    _define(lines, terminal.gravity(), gravity, second, ", the acceleration of free fall")
    for edge in terminal.scene.edges.values():
        if "inertia" in edge.fields:
            lines += _tensor_lines(terminal, edge, second)
        if "axis" in edge.fields and terminal.axis_index(edge) is None:
            lines += _axis_lines(terminal, edge, second)
        if edge.component.role is Role.LINE and "axis" not in edge.fields:
            lines += _line_lines(terminal, edge, second)
    moving = terminal.fields.moving
    lines += [
        f"{moving[name]}: derivative of the input {name}"
        for name in terminal.scene.inputs
        if second and name in moving
    ]
    if any(edge.nodes[0] in terminal.turning for edge in terminal.scene.edges.values()):
        lines.append(_node_line(terminal, second))
    return lines


def _node_line(terminal: Terminal, second: bool) -> str:
    """Explain the variables of nodes that turn."""
    letters = [f"{letter}{terminal.subscript}" for letter in "φωα"] if second else ["ω", "α"]
    of_node = ", ".join(f"{letter}(B)" for letter in letters)
    line = f"{of_node}: sums of {', '.join(letters)} over the branches from the ground to a node B"
    return line if second else f"{line}; î(B), ĵ(B), k̂(B): unit vectors fixed in its axes"


def _define(lines: list[str], symbol: Pair, value: Pair, second: bool, what: str) -> None:
    left, right = (symbol.d, value.d) if second else (symbol.value, value.value)
    if not left.is_zero:
        lines.append(f"{left} = {right}{'' if second else what}")


def _tensor_lines(terminal: Terminal, edge: Edge, second: bool) -> list[str]:
    tensor, node = terminal.tensor(edge), edge.nodes[1]
    turns = node in terminal.turning
    where = f" in the axes of {node}" if turns else ""
    entries = [terminal.fields.pair(value) for value in terminal.tensor_entries(edge)]
    if not second:
        return [f"{tensor.value} = {_matrix([e.value for e in entries])}{where}"]
    if tensor.d.is_zero:
        return []
    parts = []
    if any(not e.d.is_zero for e in entries):
        parts.append(f"{_matrix([e.d for e in entries])}{where}")
    if turns:
        spin = f"φ{terminal.subscript}({node})"
        parts.append(f"{spin} × {tensor.value} - {tensor.value} × {spin}")
    return [f"{tensor.d} = {', plus '.join(parts)}"]


def _matrix(entries: Sequence[Formula]) -> str:
    if len(entries) == 3:
        return f"diag({', '.join(map(str, entries))})"
    rows = (", ".join(map(str, entries[3 * i : 3 * i + 3])) for i in range(3))
    return f"[{'; '.join(rows)}]"


def _axis_lines(terminal: Terminal, edge: Edge, second: bool) -> list[str]:
    axis = terminal.axis(edge)
    along = terminal.axis_components(edge)
    if not second:
        return [f"{axis.value}: unit vector along {along.value}"]
    is_own = str(axis.d).startswith("u")
    return [f"{axis.d}: derivative of the unit vector {axis.value}"] if is_own else []


def _line_lines(terminal: Terminal, edge: Edge, second: bool) -> list[str]:
    e, r = terminal.symbol("e", edge.name), terminal.symbol("r", edge.name)
    if not second:
        return [f"{e.value} = {r.value}/|{r.value}|"]
    return [f"{e.d} = ({r.d} - ({r.d}·{e.value}) {e.value})/|{r.value}|"]


def spaces_text(terminal: Terminal, edge: Edge) -> str:
    """Write the motion and reaction spaces of a branch."""
    parts = []
    for domain, rotates in (("translation", False), ("rotation", True)):
        freedoms = terminal.motion(edge, rotates)
        motion = [str(terminal.direction(edge, freedom).value) for freedom in freedoms]
        reaction = [axis for axis in _GROUND_AXES if axis not in motion]
        if motion and edge.component.role is Role.JOINT:
            reaction = _normal_to(terminal, edge)
        parts.append(f"{domain}: motion {_set(motion)}, reaction {_set(reaction)}")
    return "; ".join(parts)


def _normal_to(terminal: Terminal, edge: Edge) -> list[str]:
    """Name two directions normal to a joint's axis."""
    index = terminal.axis_index(edge)
    if index is None:
        return [f"normal to {terminal.axis(edge).value}"]
    tail = edge.nodes[0]
    return [str(terminal.unit_vector(i, tail).value) for i in range(3) if i != index]


def _set(names: Sequence[str]) -> str:
    return "{" + ", ".join(names) + "}"
