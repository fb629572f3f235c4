"""Units of outputs, where the names in them have one."""

from __future__ import annotations

import ast
from typing import TYPE_CHECKING

from cotree.domains import DOMAINS
from cotree.formulation.observed import observed_unit
from cotree.scene.dimensions import Dimensions, dimension_of_unit, stated_units
from cotree.scene.fields import initial_units
from cotree.units import unit_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.scene.description import SceneDescription
    from cotree.units import Dimension


def output_units(scene: SceneDescription, states: Mapping[str, str]) -> dict[str, str]:
    """Give the unit of each output; nothing where one of its names has none.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    states : mapping of str to str
        Units of the states.

    Returns
    -------
    dict of str to str
        The unit of a sum is written as its terms have it; that of a product in SI.
    """
    units = {**stated_units(scene), "t": "s", **states}
    found: dict[str, str] = {}
    pending: set[str] = set()

    def unit_of(name: str) -> str:
        if name in units:
            return units[name]
        if name in scene.outputs and name not in scene.parameters:
            return output(name)
        return variable_unit(scene, name)

    def dimension_of(name: str) -> Dimension | None:
        return dimension_of_unit(unit_of(name))

    def output(name: str) -> str:
        # An output that is made of itself is refused elsewhere.
        if name not in found and name not in pending:
            pending.add(name)
            tree = scene.outputs[name].tree
            terms = {unit_of(ast.unparse(term)) for term in _terms(tree)}
            if _is_celsius(tree) and terms == {"K", ""}:
                found[name] = "degC"
            elif len(terms) == 1 and terms != {""}:
                found[name] = terms.pop()
            else:
                dimension = Dimensions(dimension_of, with_plain_numbers=True).of(tree)
                found[name] = "" if dimension is None else unit_text(dimension)
        return found.get(name, "")

    return {name: output(name) for name in scene.outputs}


def variable_unit(scene: SceneDescription, name: str) -> str:
    """Give the unit of a variable of an edge or a node; nothing where it has none."""
    first, _, rest = name.partition(".")
    edge = scene.edges.get(first)
    own = {}
    if edge is not None and rest:
        own = initial_units(edge.component) | {m.name: m.unit for m in edge.component.measures}
    return own.get(rest, "") or observed_unit(name) or _across_unit(scene, first, rest)


def _across_unit(scene: SceneDescription, node: str, symbol: str) -> str:
    """Give the unit of the across variable of a node of a scalar network; nothing for others."""
    for edge in scene.edges.values():
        for port, ends in zip(edge.component.ports, edge.ports, strict=True):
            row = DOMAINS[port.domain]
            if node in (ends.tail, ends.head) and symbol == row.across_symbol:
                return row.across_unit
    return ""


def _is_celsius(tree: ast.expr) -> bool:
    """Whether the zero of temperatures is taken from something."""
    match tree:
        case ast.BinOp(op=ast.Sub(), right=ast.Constant(value=273.15)):
            return True
    return False


def _terms(tree: ast.expr) -> list[ast.expr]:
    """List the terms of a sum; of anything but a sum of names, a term that has no unit."""
    match tree:
        case ast.UnaryOp(operand=operand):
            return _terms(operand)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return _terms(left) + _terms(right)
        case ast.Call(func=ast.Name(id="abs" | "min" | "max"), args=args):
            return [term for arg in args for term in _terms(arg)]
    return [tree]
