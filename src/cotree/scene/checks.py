"""Checks of a scene: units of variables, dimensions of expressions, impossible inertias.

Numbers in products may have any unit unless they count as dimensionless.
"""

from __future__ import annotations

import ast
from collections.abc import Callable, Iterator, Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from cotree.components import Component, Shape
from cotree.dag.nodes import Dag
from cotree.domains import DOMAINS
from cotree.naming import owner_among, split_name
from cotree.scene.expressions import Expression, FieldValue, dotted, entries, table_of
from cotree.scene.fields import initial_units
from cotree.scene.graphs import motion_spaces
from cotree.scene.parameters import parameter_values
from cotree.units import Dimension, check_fits, read_unit, same_dimension, stated_unit, unit_text

if TYPE_CHECKING:
    import numpy.typing as npt

    from cotree.scene.description import Edge, SceneDescription


#: Function that returns the dimension of a name, or None if it is unknown.
Known = Callable[[str], "Dimension | None"]

_NONE = read_unit("1").dimension
_ANGLE = read_unit("rad").dimension
_OF_NUMBERS = {"sin", "cos", "tan", "sinh", "cosh", "tanh", "exp", "log", "erf"}
_KEEPING = {"abs", "floor", "min", "max", "mod"}
#: Numbers that are dimensionless in formulas of physics, as in m*v**2/2.
_PLAIN = {0.25, 0.5, 1.5, *map(float, range(1, 13))}

_XYZ = "xyz"

#: Variables of a node with their units; components are along the axes of the ground.
NODE_VARIABLES: dict[str, str] = {
    **dict.fromkeys(_XYZ, "m"),
    **{f"v{i}": "m/s" for i in _XYZ},
    **{f"a{i}": "m/s^2" for i in _XYZ},
    **{f"w{i}": "rad/s" for i in _XYZ},
    **{f"alpha{i}": "rad/s^2" for i in _XYZ},
    **{f"r{i}{j}": "" for i in "123" for j in "123"},
    **dict.fromkeys(("roll", "pitch", "yaw"), "rad"),
}

#: Variables of a joint, constraint or force element; forces act on its second node, in ground axes.
EDGE_VARIABLES: dict[str, str] = {
    **{f"f{i}": "N" for i in _XYZ},
    **{f"t{i}": "N m" for i in _XYZ},
    "power": "W",
}

ENERGIES: dict[str, str] = {"energy.kinetic": "J", "energy.potential": "J"}


def observed_unit(name: str) -> str:
    """Return the unit of an observable name, or "" if there is none."""
    variable = split_name(name)[1]
    return ENERGIES.get(name) or NODE_VARIABLES.get(variable) or EDGE_VARIABLES.get(variable, "")


class VariableUnits:
    """Units of the variables of a scene's edges and nodes."""

    def __init__(self, scene: SceneDescription) -> None:
        self._scene = scene
        self._of_component: dict[int, dict[str, str]] = {}  # by identity of the component

    def __call__(self, name: str) -> str:
        """Return the unit of ``edge.variable`` or ``node.variable``, or "" if there is none."""
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
        """Return the units of node potentials in all scalar networks, by ``node.symbol``."""
        found: dict[str, str] = {}
        for edge in self._scene.edges.values():
            for port, ends in zip(edge.component.ports, edge.ports, strict=True):
                row = DOMAINS[port.domain]
                for node in (ends.tail, ends.head):
                    found.setdefault(f"{node}.{row.across_symbol}", row.across_unit)
        return found


class Dimensions:
    """Dimensions of expressions, and the contradictions found in them.

    If ``with_plain_numbers``, small numbers such as 2 and 0.5 count as dimensionless.
    """

    def __init__(self, known: Known, *, with_plain_numbers: bool = False) -> None:
        self._known, self._with_plain = known, with_plain_numbers
        self.faults: list[str] = []

    def of(self, tree: ast.expr) -> Dimension | None:
        """Return the dimension of a checked syntax tree, or None if it is unknown."""
        match tree:
            case ast.Constant(value=value):
                is_plain = self._with_plain and value in _PLAIN
                return _NONE if is_plain else None
            case ast.Name(id="pi"):
                return _NONE
            case ast.Name(id=name):
                return self._known(name)
            case ast.Attribute():
                return self._known(dotted(tree))
            case ast.UnaryOp(operand=operand):
                return self.of(operand)
            case ast.BinOp(left=left, op=ast.Pow(), right=right):
                return self._power(left, right)
            case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
                a, b = self.of(left), self.of(right)
                sign = 1.0 if isinstance(op, ast.Mult) else -1.0
                if a is None or b is None:
                    return None
                return tuple(x + sign * y for x, y in zip(a, b, strict=True))
            case ast.BinOp(left=left, right=right):
                return self._alike([left, right])
            case ast.Call(func=ast.Name(id="where"), args=[condition, *values]):
                self._condition(condition)
                return self._alike(values)
            case ast.Call(func=called, args=args) if table_of(called):
                for arg in args:
                    self.of(arg)
                return None  # tables have no stated unit
            case ast.Call(func=ast.Name(id=function), args=args):
                return self._call(function, args)
        return None

    def _alike(self, trees: list[ast.expr]) -> Dimension | None:
        """Return the common dimension of the trees; record a contradiction if they differ."""
        found: Dimension | None = None
        first: ast.expr | None = None
        for tree in trees:
            own = self.of(tree)
            if own is None:
                continue
            if found is None or first is None:
                found, first = own, tree
            elif not same_dimension(found, own):
                self.faults.append(
                    f"'{ast.unparse(first)}' is in {unit_text(found)} and '{ast.unparse(tree)}' in "
                    f"{unit_text(own)}"
                )
        return found

    def _power(self, left: ast.expr, right: ast.expr) -> Dimension | None:
        base, exponent = self.of(left), _number(right)
        if base is None or (exponent is None and base != _NONE):
            return None
        return tuple(x * (exponent or 0.0) for x in base)

    def _call(self, function: str, args: list[ast.expr]) -> Dimension | None:
        if function in _KEEPING:
            return self._alike(args)
        own = [self.of(arg) for arg in args]
        if function in _OF_NUMBERS and own[0] is not None and not same_dimension(own[0], _NONE):
            shown = f"'{ast.unparse(args[0])}' is in {unit_text(own[0])}"
            self.faults.append(f"{shown}, of which {function} has no value")
        if function == "sqrt":
            return None if own[0] is None else tuple(x / 2.0 for x in own[0])
        if function == "atan2":
            self._alike(args)
        return _ANGLE if function in ("asin", "acos", "atan", "atan2") else _NONE

    def _condition(self, tree: ast.expr) -> None:
        match tree:
            case ast.Compare(left=left, comparators=others):
                self._alike([left, *others])
            case ast.BoolOp(values=parts):
                for part in parts:
                    self._condition(part)
            case ast.UnaryOp(operand=part):
                self._condition(part)


def dimension_of_unit(text: str) -> Dimension | None:
    """Return the dimension of a field's or result's unit, or None if there is no unit."""
    unit = stated_unit(text)
    return None if unit is None else unit.dimension


def stated_values(edge: Edge) -> Iterator[tuple[str, str, Expression]]:
    """Yield the values that a scene states for an edge, as name, unit and expression."""
    for row in edge.component.fields:
        if row.unit and row.shape is not Shape.EXPRESSION and row.name not in _DIRECTIONS:
            for entry in entries(edge.fields.get(row.name)):
                yield f"{row.name} of edge '{edge.name}'", row.unit, entry
    units = initial_units(edge.component) if edge.initial else {}
    for name, value in edge.initial.items():
        for entry in entries(value):
            yield f"initial {name} of edge '{edge.name}'", units.get(name, ""), entry


#: Vectors that only state a direction: their length, and thus their unit, has no effect.
_DIRECTIONS = frozenset({"axis", "axis2", "normal"})


def check_scene_units(scene: SceneDescription) -> None:
    """Raise if a field consists of a single parameter or input with another dimension."""
    units = stated_units(scene)
    if not units:
        return
    for edge in scene.edges.values():
        for what, wanted, value in stated_values(edge):
            name = single_name(value)
            if name not in units:
                continue
            kind = "parameter" if name in scene.parameters else "input"
            check_fits(read_unit(units[name]), wanted, f"{what} is {kind} '{name}', which")


def stated_units(scene: SceneDescription) -> dict[str, str]:
    """Return the stated units of parameters and inputs."""
    rows: Mapping[str, str] = {n: row.unit for n, row in scene.inputs.items()}
    rows = {**rows, **{n: row.unit for n, row in scene.parameters.items()}}
    return {name: unit for name, unit in rows.items() if unit.strip()}


def single_name(value: Expression) -> str:
    """Return the name if an expression is a single name, possibly with a sign; otherwise ""."""
    tree = value.tree.operand if isinstance(value.tree, ast.UnaryOp) else value.tree
    name = tree.id if isinstance(tree, ast.Name) else dotted(tree)
    return name if type(value) is Expression else ""


def _number(tree: ast.expr) -> float | None:
    if isinstance(tree, ast.UnaryOp) and isinstance(tree.op, ast.USub):
        inner = _number(tree.operand)
        return None if inner is None else -inner
    return float(tree.value) if isinstance(tree, ast.Constant) else None  # type: ignore[arg-type]


# Relative tolerance of the triangle inequality, for moments of thin bodies rounded to six digits.
_WRITTEN = 2e-5

# Rounding errors of forces affect bodies below this fraction of the largest mass.
_TINY = 1e-8

#: Principal moments between zero and minus this fraction of their sum are rounding errors.
ROUNDING = 1e-12


def tiny_masses(scene: SceneDescription) -> Iterator[tuple[str, str]]:
    """Yield bodies so light that rounding of balanced forces shortens steps, with messages."""
    values = parameter_values(scene.parameters)
    dag = Dag()
    masses: dict[str, float] = {}
    for edge in scene.edges.values():
        given = edge.fields.get("mass")
        if not isinstance(given, Expression) or not all(name in values for name in given.names):
            continue
        number = given.lower(dag, lambda name: dag.constant(values[name])).value
        if number is not None and number > 0.0:
            masses[edge.name] = number
    heaviest = max(masses, key=masses.__getitem__, default="")
    for name, mass in masses.items():
        if mass < _TINY * masses[heaviest]:
            yield (
                name,
                f"mass of edge '{name}' is {mass:.3g}, {mass / masses[heaviest]:.1g} of that of "
                f"'{heaviest}': rounding errors of forces accelerate it, so steps become short and "
                "projections fail; give it more mass, or remove the body if constraints "
                "determine its motion",
            )


def impossible_inertias(scene: SceneDescription) -> Iterator[str]:
    """Yield the messages of :func:`inertia_faults`."""
    return (fault for _, fault in inertia_faults(scene))


def inertia_faults(scene: SceneDescription) -> Iterator[tuple[str, str]]:
    """Yield bodies with impossible moments of inertia, with messages.

    A moment must not be negative or, except in planar scenes, exceed the sum of the other two.
    """
    is_plane = bool(motion_spaces(scene).plane)
    for edge in scene.edges.values():
        for row in edge.component.fields:
            if row.shape is not Shape.INERTIA or row.name not in edge.fields:
                continue
            tensor = _numbers(scene, edge.fields[row.name])
            # Eigenvalues ascend. A tensor with only one nonzero entry is incomplete on purpose.
            least, middle, largest = np.linalg.eigvalsh(tensor)
            is_negative = least < -ROUNDING * np.trace(tensor)
            if is_negative:
                fault = "the least is negative"
            elif (
                not is_plane
                and np.count_nonzero(tensor) > 1
                and least + middle < (1.0 - _WRITTEN) * largest
            ):
                fault = "the largest exceeds the sum of the others"
            else:
                continue
            yield (
                edge.name,
                f"{row.name} of edge '{edge.name}' is physically impossible: of its principal "
                f"moments {least:.6g}, {middle:.6g} and {largest:.6g} {row.unit} {fault}; "
                "check the numbers, the signs of the products of inertia, and that they "
                "refer to the centre of mass",
            )


def _numbers(scene: SceneDescription, field: FieldValue) -> npt.NDArray[np.float64]:
    """Return a tensor, also from three principal moments, for the scene's parameter values."""
    # If all parameters are constants, expressions are folded to numbers.
    dag, values = Dag(), parameter_values(scene.parameters)

    def number(entry: Expression) -> float:
        node = entry.lower(dag, lambda name: dag.constant(values[name]))
        assert node.value is not None  # the expression contains no variables
        return node.value

    rows = [number(row) if isinstance(row, Expression) else [*map(number, row)] for row in field]  # type: ignore[union-attr]
    found = np.array(rows)
    return np.diag(found) if found.ndim == 1 else found
