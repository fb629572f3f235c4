"""Units of outputs and derived parameters, where the names in them have one."""

from __future__ import annotations

import ast
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.domains import DOMAINS
from cotree.formulation.observed import observed_unit
from cotree.naming import owner_among
from cotree.scene.dimensions import Dimensions, dimension_of_unit, stated_units
from cotree.scene.expressions import Expression
from cotree.scene.fields import initial_units
from cotree.scene.grammar import dotted
from cotree.scene.parameters import in_order
from cotree.units import unit_text

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.components import Component
    from cotree.scene.description import SceneDescription
    from cotree.units import Dimension


def units_of_expressions(
    scene: SceneDescription, states: Mapping[str, str]
) -> tuple[dict[str, str], dict[str, str]]:
    """Give the unit of each output and derived parameter; nothing where a name in it has none.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    states : mapping of str to str
        Units of the states.

    Returns
    -------
    outputs, derived : dict of str to str
        The unit of a sum is written as its terms have it; that of a product in SI.
    """
    units = {**stated_units(scene), "t": "s", **states}
    found: dict[str, str] = {}
    pending: set[str] = set()
    variable_unit = VariableUnits(scene)

    def unit_of(name: str) -> str:
        if name in units:
            return units[name]
        if name in scene.outputs and name not in scene.parameters:
            return output(name)
        return variable_unit(name)

    def dimension_of(name: str) -> Dimension | None:
        return dimension_of_unit(unit_of(name))

    def output(name: str) -> str:
        # An output that is made of itself is refused elsewhere.
        if name not in found and name not in pending:
            pending.add(name)
            found[name] = unit_in(scene.outputs[name].tree)
        return found.get(name, "")

    def unit_in(tree: ast.expr) -> str:
        terms = {unit_of(term) for term in _terms(tree)}
        if _is_celsius(tree) and terms == {"K", ""}:
            return "degC"
        if len(terms) == 1 and terms != {""}:
            return terms.pop()
        dimension = Dimensions(dimension_of, with_plain_numbers=True).of(tree)
        return "" if dimension is None else unit_text(dimension)

    # Each after those it is made of, since chains may be longer than recursion goes.
    derived = {}
    for name in in_order(scene.parameters):
        value = scene.parameters[name].value
        if isinstance(value, Expression):
            units[name] = derived[name] = units.get(name) or unit_in(value.tree)
    return {name: output(name) for name in scene.outputs}, derived


class VariableUnits:
    """Units of the variables of a scene's edges and nodes.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    """

    def __init__(self, scene: SceneDescription) -> None:
        self._scene = scene
        self._of_component: dict[int, dict[str, str]] = {}  # by identity: most edges share theirs

    def __call__(self, name: str) -> str:
        """Give the unit of ``edge.variable`` or ``node.variable``; nothing where it has none."""
        edge = self._scene.edges.get(owner_among(name, self._scene.edges))
        own = self._units(edge.component) if edge is not None else {}
        rest = name[len(edge.name) + 1 :] if edge is not None else ""
        return own.get(rest, "") or observed_unit(name) or self._across.get(name, "")

    def _units(self, component: Component) -> dict[str, str]:
        found = self._of_component.get(id(component))
        if found is None:
            found = initial_units(component) | {m.name: m.unit for m in component.measures}
            self._of_component[id(component)] = found
        return found

    @cached_property
    def _across(self) -> dict[str, str]:
        """Units of the across variables of all nodes of scalar networks, by ``node.symbol``."""
        found: dict[str, str] = {}
        for edge in self._scene.edges.values():
            for port, ends in zip(edge.component.ports, edge.ports, strict=True):
                row = DOMAINS[port.domain]
                for node in (ends.tail, ends.head):
                    found.setdefault(f"{node}.{row.across_symbol}", row.across_unit)
        return found


def _is_celsius(tree: ast.expr) -> bool:
    """Whether the zero of temperatures is taken from something."""
    match tree:
        case ast.BinOp(op=ast.Sub(), right=ast.Constant(value=273.15)):
            return True
    return False


def _terms(tree: ast.expr) -> list[str]:
    """List the names that a sum is of; a term that is no name is an empty one."""
    match tree:
        case ast.UnaryOp(operand=operand):
            return _terms(operand)
        case ast.BinOp(left=left, op=ast.Add() | ast.Sub(), right=right):
            return _terms(left) + _terms(right)
        case ast.Call(func=ast.Name(id="abs" | "min" | "max"), args=args):
            return [term for arg in args for term in _terms(arg)]
        case ast.Name(id=name):
            return [name]
    return [dotted(tree)]
