"""Replacement of state-dependent jumps inside expressions by modes and events.

Each ``sign``, ``floor``, ``mod`` or comparison of variables becomes a mode with events that change
it. Events locate all jumps, restart the integration there and change the sensitivities. Two kinds
are not replaced: conditions that are piecewise linear in time, whose times are known before a run
(:mod:`cotree.dag.switching_times`), and kinks such as ``v*sign(v)`` that are proved to be
continuous, which :mod:`cotree.program.surfaces` locates without modes.
"""

from __future__ import annotations

import ast
import copy
from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

from cotree.dag.nodes import Dag
from cotree.dag.switching_times import is_cut
from cotree.hybrid.branches import (
    boundary_of,
    check_contents,
    check_located,
    clipped,
    has_only_kink,
    jumps_in,
    may_branch,
    with_branches,
)
from cotree.scene.events import Event, Mode
from cotree.scene.expressions import (
    COMPARISONS,
    Expression,
    entries,
    fill,
    map_names,
    map_tree,
    names_in,
    number_tree,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.scene.description import Edge, SceneDescription

    _Row = tuple[int, ast.expr, ast.expr]

# Maximum length of a text that is used as a name; longer names would be illegible.
_LONGEST_NAME = 60

#: Functions that jump; ``mod`` jumps because it contains a floor.
_JUMPING = ("sign", "floor", "mod", "where")


def lower_discontinuities(scene: SceneDescription, *, has_sensitivities: bool) -> SceneDescription:
    """Replace state-dependent jumps by modes and events; return scenes without jumps unchanged.

    Raise an error if the content of a storage jumps. With sensitivities, also raise an error if the
    law of a force element jumps, because that jump is not an event.
    """
    for edge in scene.edges.values():
        check_contents(scene, edge)
    if has_sensitivities:
        for edge in scene.edges.values():
            check_located(edge, scene.parameters)
    has_laws = any(may_branch(edge) for edge in scene.edges.values())
    if not has_laws and not any(_may_jump(expression) for expression in _acting(scene)):
        return scene
    return _Rewriting(scene).scene


def jump_values(scene: SceneDescription) -> dict[str, Expression]:
    """Return initial values of the modes that replace jumps, as expressions without such modes."""
    found: dict[str, Expression] = {}
    # In this order, each mode follows the modes on which its initial value depends.
    for name, mode in lower_discontinuities(scene, has_sensitivities=False).modes.items():
        if mode.is_jump:
            found[name] = mode.initial.map_names(
                lambda own: found[own].tree if own in found else own, mode.doc
            )
    return found


def _may_jump(expression: Expression) -> bool:
    """Return whether an expression may jump, judging by its text."""
    # Comparisons occur only within ``where``, so each jump contains one of these functions.
    return any(f"{name}(" in expression.text.replace(" ", "") for name in _JUMPING)


def _acting(scene: SceneDescription) -> list[Expression]:
    """Return all expressions that may affect the motion."""
    found = [*scene.outputs.values(), *(event.when for event in scene.events.values())]
    for edge in scene.edges.values():
        found += _of_edge(edge)
    return found


def _of_edge(edge: Edge) -> list[Expression]:
    return [item for value in edge.fields.values() for item in entries(value)]


class _Rewriting:
    def __init__(self, scene: SceneDescription) -> None:
        self._old = scene
        self._modes: dict[str, Mode] = {}
        self._events: dict[str, Event] = {}
        #: Names of modes by the text that they replace; equal texts share a mode.
        self._known: dict[str, str] = {}
        self.scene = copy.copy(scene)
        self.scene.edges = {name: self._edge(edge) for name, edge in scene.edges.items()}
        events = {
            name: replace(event, when=self._expression(event.when, is_watched=True))
            for name, event in scene.events.items()
        }
        # Jumps in all other outputs are kept, because no state depends on them.
        used = self._used()
        self.scene.outputs = {
            name: self._expression(item) if name in used else item
            for name, item in scene.outputs.items()
        }
        self.scene.modes = {**scene.modes, **self._modes}
        # Events that change a mode precede events that may depend on it.
        self.scene.events = {**self._events, **events}

    def _used(self) -> set[str]:
        """Return the names of outputs on which fields and events depend."""
        outputs = self._old.outputs
        read = [item.names for edge in self._old.edges.values() for item in _of_edge(edge)]
        read += [event.when.names for event in self._old.events.values()]
        waiting = [name for names in read for name in names if name in outputs]
        found: set[str] = set()
        while waiting:
            name = waiting.pop()
            if name not in found:
                found.add(name)
                waiting += [other for other in outputs[name].names if other in outputs]
        return found

    def _edge(self, edge: Edge) -> Edge:
        # Constant fields depend only on parameters, so they do not jump during a run.
        constant = {field.name for field in edge.component.fields if field.constant}
        stored = {
            name for port in edge.component.ports if (law := port.content) for name in law.arguments
        }
        fields = {
            name: value if name in constant else self._value(value, is_stored=name in stored)
            for name, value in edge.fields.items()
        }
        if fields != edge.fields:
            edge = replace(edge, fields=fields)
        if not may_branch(edge):
            return edge
        return with_branches(
            edge,
            lambda tree, where: _Tree(self, where, frozenset()).rewritten(tree),
            self._old.parameters,
        )

    def _value(self, value: Any, *, is_stored: bool = False) -> Any:
        if isinstance(value, Expression):
            return self._expression(value, is_stored=is_stored)
        return tuple(self._value(part) for part in value)

    def _expression(
        self, expression: Expression, *, is_watched: bool = False, is_stored: bool = False
    ) -> Expression:
        """Replace the jumps in an expression and, for a storage's content, also the kinks.

        A watched expression is the condition of an event. It is unchanged if it jumps only at known
        times, because steps end there.
        """
        if not _may_jump(expression) or (is_watched and not self._moves(expression.names)):
            return expression
        whole = expression.tree
        kinks = [] if is_stored else jumps_in(whole)
        kept = frozenset(
            id(part) for part in kinks if has_only_kink(whole, part, self._old.parameters)
        )
        tree = _Tree(self, expression.where, kept).rewritten(whole)
        if ast.dump(tree) == ast.dump(expression.tree):
            return expression
        return replace(expression, tree=tree, names=names_in(tree))

    def _moves(self, names: frozenset[str]) -> bool:
        """Return whether the names include variables other than time and parameters."""
        return any(name not in self._old.parameters and name not in ("t", "pi") for name in names)

    def is_located(self, tree: ast.expr) -> bool:
        """Return whether a value may cross zero at times that are unknown before the run."""
        names = names_in(tree)
        if self._moves(names):
            return True
        # Values that depend only on parameters are constant during a run.
        if "t" not in names:
            return False
        symbols = self._symbols
        return not is_cut(Expression.of_tree(tree).lower(symbols["t"].dag, symbols.__getitem__))

    def clipped(self, branch: ast.expr, boundary: ast.expr) -> ast.expr:
        """Clip arguments of roots in a branch to zero beyond the branch's boundary."""
        return clipped(branch, boundary, self._old.parameters)

    @cached_property
    def _symbols(self) -> dict[str, Any]:
        dag = Dag()
        names = enumerate(self._old.parameters)
        return {"t": dag.symbol("t", 0), **{name: dag.symbol("p", i) for i, name in names}}

    def mode(self, text: str, call: ast.expr, where: str, rows: Sequence[_Row]) -> ast.expr:
        """Return the tree of the mode that replaces the call with the text ``text``.

        Each row is an event: its direction, its function, and the mode's new value. In these trees,
        the name "" denotes the mode itself.
        """
        # Equal texts jump at the same times, so they share a mode and its events.
        if text not in self._known:
            name = self._new_name(text)
            self._known[text] = name
            self._modes[name] = Mode(name, Expression.of_tree(call, where), where, is_jump=True)
            for direction, looked_at, value in rows:
                event = f"{name} {'up' if direction > 0 else 'down'}"
                when, new = (
                    Expression.of_tree(map_names(tree, lambda own: own or ast.Name(name)), where)
                    for tree in (looked_at, value)
                )
                self._events[event] = Event(event, when, direction, {name: new}, is_jump=True)
        return ast.Name(self._known[text])

    def _new_name(self, text: str) -> str:
        short = text if len(text) <= _LONGEST_NAME else f"{text[: _LONGEST_NAME - 3]}..."
        name, n = short, 1
        while name in self._modes:
            n += 1
            name = f"{short} ({n})"
        return name


_ITSELF = ast.Name("")


class _Tree:
    def __init__(self, scene: _Rewriting, where: str, kept: frozenset[int]) -> None:
        self._scene, self._where, self._kept = scene, where, kept

    def rewritten(self, tree: ast.expr) -> ast.expr:
        """Return a copy of the tree in which modes replace jumps."""
        return map_tree(tree, self._change)

    def _change(self, node: ast.expr) -> ast.expr | None:
        if isinstance(node, ast.Compare):
            return self._compare(node)
        return self._call(node) if isinstance(node, ast.Call) else None

    def _call(self, given: ast.Call) -> ast.expr:
        assert isinstance(given.func, ast.Name)  # checked when the text was parsed
        function, args = given.func.id, [self.rewritten(arg) for arg in given.args]
        node = ast.Call(given.func, args, [])
        if function == "mod":
            a, b = args
            ratio = fill("a/b", a, b)
            if self._scene.is_located(ratio):
                return fill("a - b*c", a, b, self._floor(ratio))
        if function == "floor" and self._scene.is_located(args[0]):
            return self._floor(args[0])
        if function == "where":
            args[1:] = self._clipped(given.args[0], args[1:])
            node = ast.Call(given.func, args, [])
        if id(given) not in self._kept and function == "sign" and self._scene.is_located(args[0]):
            rows = [(side, args[0], number_tree(float(side))) for side in (1, -1)]
            return self._scene.mode(ast.unparse(node), node, self._where, rows)
        return node

    def _clipped(self, condition: ast.expr, branches: list[ast.expr]) -> list[ast.expr]:
        """Clip arguments of roots in branches beyond comparisons that jump in their condition."""
        for part in jumps_in(condition):
            boundary, _ = boundary_of(part)
            if id(part) not in self._kept and self._scene.is_located(boundary):
                branches = [self._scene.clipped(branch, boundary) for branch in branches]
        return branches

    def _floor(self, value: ast.expr) -> ast.expr:
        """Replace a floor by a mode that changes when the value reaches another integer."""
        # At an event the value is an integer up to rounding, so the mode changes by at least one.
        new = "{}(b {} 1.0, floor(a))"
        up = (1, fill("a - b - 1.0", value, _ITSELF), fill(new.format("max", "+"), value, _ITSELF))
        down = (-1, fill("a - b", value, _ITSELF), fill(new.format("min", "-"), value, _ITSELF))
        call = fill("floor(a)", value)
        return self._scene.mode(ast.unparse(call), call, self._where, (up, down))

    def _compare(self, node: ast.Compare) -> ast.expr:
        """Replace each comparison by a mode: one if the comparison is true, otherwise zero."""
        sides = [self.rewritten(side) for side in (node.left, *node.comparators)]
        if id(node) in self._kept:
            return ast.Compare(sides[0], node.ops, sides[1:])
        # A chain of comparisons is a conjunction, with one mode for each comparison.
        parts = [
            self._comparison(ast.Compare(a, [op], [b]))
            for a, op, b in zip(sides[:-1], node.ops, sides[1:], strict=True)
        ]
        return parts[0] if len(parts) == 1 else ast.BoolOp(ast.And(), parts)

    def _comparison(self, node: ast.Compare) -> ast.expr:
        a, b = node.left, node.comparators[0]
        is_larger, _ = COMPARISONS[type(node.ops[0])]
        excess = fill("a - b", a, b) if is_larger else fill("a - b", b, a)
        if not self._scene.is_located(excess):
            return node
        rows = ((1, excess, ast.Constant(1.0)), (-1, excess, ast.Constant(0.0)))
        # The mode is named after the comparison; its initial value is the comparison as a number.
        conditional = fill("where(a, 1.0, 0.0)", node)
        mode = self._scene.mode(ast.unparse(node), conditional, self._where, rows)
        # The mode is exactly one or zero, so rounding cannot change this comparison.
        return fill("a > 0.5", mode)
