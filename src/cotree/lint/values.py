"""Rules about values: dimensions, magnitudes, inertias, and expressions without an effect."""

from __future__ import annotations

import math
from collections import defaultdict
from contextlib import suppress
from itertools import chain
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.components.terminal import Kind
from cotree.dag.nodes import Dag
from cotree.errors import Error
from cotree.formulation.output_units import VariableUnits
from cotree.lint.findings import Finding
from cotree.scene.dimensions import (
    Dimensions,
    alone,
    dimension_of_unit,
    entries,
    stated_units,
    stated_values,
)
from cotree.scene.expressions import Expression
from cotree.scene.inertias import inertia_faults, tiny_masses
from cotree.scene.parameters import in_order, parameter_values
from cotree.units import same_dimension, unit_text

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.scene.description import Edge, SceneDescription
    from cotree.units import Dimension

_LONGEST_ARM = 1000.0  # m
_LARGEST_ANGLE = 4.0 * math.pi  # rad; more is taken for degrees
_LARGEST_GRAVITY = 300.0  # m/s^2, that of the sun
#: Batteries have capacitances that no single capacitor has.
_LARGEST = {"capacitor": 1e4, "inductor": 1e4}


def findings(scene: SceneDescription) -> Iterator[Finding]:
    """Find contradicting dimensions, unusual magnitudes, and what is constant or of no effect."""
    yield from _dimensions(scene)
    yield from _shared(scene)
    yield from _magnitudes(scene)
    yield from _inertias(scene)
    yield from _constants(scene)
    yield from _without_effect(scene)


def _expressions(scene: SceneDescription) -> Iterator[tuple[str, str, str, str, Expression]]:
    """List kind and name of the culprit, what it is, its unit, and the expression."""
    for edge in scene.edges.values():
        for what, unit, value in stated_values(edge):
            yield "edge", edge.name, what, unit, value
    for name, row in scene.parameters.items():
        if isinstance(row.value, Expression):
            yield "parameter", name, f"parameter '{name}'", row.unit, row.value
    for name, signal in scene.inputs.items():
        if isinstance(signal.value, Expression):
            yield "input", name, f"input '{name}'", signal.unit, signal.value
    for name, output in scene.outputs.items():
        yield "output", name, f"output '{name}'", "", output
    for event in scene.events.values():
        yield "event", event.name, f"'when' of event '{event.name}'", "", event.when


class _Known:
    """Dimensions of the names of a scene."""

    def __init__(self, scene: SceneDescription) -> None:
        # Time stays out of it: many write exp(-t) or 1 + t, and mean a factor of one.
        self._scene, self._units = scene, {"t": "", **stated_units(scene)}
        self._pending: set[str] = set()
        self._variable_unit = VariableUnits(scene)
        self._derived: dict[str, Dimension | None] = {}
        with suppress(Error):  # a circle is told by another rule
            for name in in_order(scene.parameters):
                value = scene.parameters[name].value
                if isinstance(value, Expression):
                    self._derived[name] = Dimensions(self).of(value.tree)

    def states_any(self, value: Expression) -> bool:
        """Whether the scene states the unit of a name in an expression."""
        if any(self.states(name) for name in value.names):
            return True
        rows = (self._scene.parameters.get(name) for name in value.names)
        derived = [row.value for row in rows if row and isinstance(row.value, Expression)]
        return any(self.states(name) for inner in derived for name in inner.names)

    def states(self, name: str) -> bool:
        """Whether the scene states the unit of a name."""
        return bool(self._units.get(name))

    def __call__(self, name: str) -> Dimension | None:
        if name in self._units:
            return dimension_of_unit(self._units[name])
        scene = self._scene
        if name in scene.parameters:
            return self._derived.get(name)
        if name not in scene.outputs:
            return dimension_of_unit(self._variable_unit(name))
        if name in self._pending:
            return None
        self._pending.add(name)
        found = Dimensions(self).of(scene.outputs[name].tree)
        self._pending.remove(name)
        return found


def _dimensions(scene: SceneDescription) -> Iterator[Finding]:
    known = _Known(scene)
    for kind, name, what, unit, value in _expressions(scene):
        # One name of another dimension is refused when the equations are formed. Expressions
        # without any unit of the user's own may follow another system.
        if known.states(alone(value)) or not known.states_any(value):
            continue
        dimensions = Dimensions(known)
        found, stated = dimensions.of(value.tree), dimension_of_unit(unit)
        told = f"{what} is '{value.text}'"
        for fault in dimensions.faults:
            yield Finding("dimension", kind, name, f"{told}, where {fault}")
        is_table = type(value) is not Expression  # its expression is the argument of a table
        if found is None or stated is None or dimensions.faults or is_table:
            continue
        if not same_dimension(found, stated):
            yield Finding(
                "dimension", kind, name, f"{told} in {unit_text(found)}, but is in {unit}"
            )


def _shared(scene: SceneDescription) -> Iterator[Finding]:
    """Find parameters without a unit that stand in fields of different dimensions."""
    uses: dict[str, dict[str, str]] = defaultdict(dict)
    for edge in scene.edges.values():
        for what, unit, value in stated_values(edge):
            row = scene.parameters.get(alone(value))
            if row is not None and not row.unit and dimension_of_unit(unit) is not None:
                uses[row.name].setdefault(unit, what)
    for name, by_unit in uses.items():
        (first, what), *others = by_unit.items()
        dimension = dimension_of_unit(first)
        for unit, other in others:
            own = dimension_of_unit(unit)
            if dimension and own and not same_dimension(dimension, own):
                told = f"parameter '{name}' is {what}, in {first}, and {other}, in {unit}"
                yield Finding("dimension", "parameter", name, f"{told}: give each its own")
                break


def _values(scene: SceneDescription) -> dict[str, float]:
    try:
        return parameter_values(scene.parameters)
    except Error:
        return {}  # told by another rule


def _number(value: Expression, known: dict[str, float]) -> float:
    """Give the value of an expression of parameters; nan for others."""
    if value.number is not None:
        return value.number
    if not all(name in known or name == "pi" for name in value.names):
        return math.nan
    dag = Dag()
    try:
        found = value.lower(dag, lambda name: dag.constant(known[name])).value
    except Error:
        return math.nan
    return math.nan if found is None else found


def _magnitudes(scene: SceneDescription) -> Iterator[Finding]:
    known = _values(scene)
    gravity = math.hypot(*(_number(item, known) for item in scene.gravity))
    if gravity > _LARGEST_GRAVITY:
        told = f"gravity is {gravity:.4g} m/s^2: is it meant in another unit?"
        yield Finding("magnitude", "scene", scene.name, told)
    for edge in scene.edges.values():
        yield from _edge_magnitudes(edge, known)


def _edge_magnitudes(edge: Edge, known: dict[str, float]) -> Iterator[Finding]:
    for what, unit, value in stated_values(edge):
        size = abs(_number(value, known))
        is_initial = what.startswith("initial")
        told = ""
        if unit == "m" and edge.component.role is Role.ARM and size >= _LONGEST_ARM:
            told = 'm: if millimetres are meant, say unit = "mm"'
        elif unit == "rad" and size > _LARGEST_ANGLE and (is_initial or "rotation" in what):
            told = 'rad: if degrees are meant, say unit = "deg"'
        elif edge.component.name in _LARGEST and size > _LARGEST[edge.component.name]:
            told = f"{unit}: is a prefix missing?"
        if told:
            yield Finding("magnitude", "edge", edge.name, f"{what} is {size:.6g} {told}")
            return
    for row in edge.component.fields:
        given = edge.fields.get(row.name)
        if row.sign == "nonzero" and isinstance(given, Expression) and _number(given, known) < 0.0:
            told = (
                f"{row.name} of edge '{edge.name}' is {_number(given, known):.6g}: it feeds energy "
                "in; is the sign meant?"
            )
            yield Finding("magnitude", "edge", edge.name, told)
            return


def _inertias(scene: SceneDescription) -> Iterator[Finding]:
    try:
        for name, told in (*inertia_faults(scene), *tiny_masses(scene)):
            yield Finding("inertia", "edge", name, told)
    except Error:
        return  # told by another rule
    known = _values(scene)
    for edge in scene.edges.values():
        if edge.component.role is not Role.BODY:
            continue
        given = [e for name in ("mass", "inertia") for e in entries(edge.fields.get(name))]
        if given and all(_number(entry, known) == 0.0 for entry in given):
            told = f"edge '{edge.name}' has neither mass nor inertia: it does nothing"
            yield Finding("inertia", "edge", edge.name, told)


def _constants(scene: SceneDescription) -> Iterator[Finding]:
    for kind, name, what, _, value in _expressions(scene):
        names = value.names - {"pi"}
        if not names or type(value) is not Expression:
            continue
        dag = Dag()
        places = {own: dag.symbol("x", i) for i, own in enumerate(sorted(names))}
        try:
            found = value.lower(dag, places.__getitem__).value
        except Error:
            continue  # it has no value, which another rule tells
        if found is not None:
            told = f"{what} is '{value.text}', which is {found:.6g} whatever the names stand for"
            yield Finding("constant", kind, name, told)


def _without_effect(scene: SceneDescription) -> Iterator[Finding]:
    known = _values(scene)
    for edge in scene.edges.values() if scene.origin is None else ():
        sources = edge.component.ports and all(
            port.kind is Kind.THROUGH_SOURCE for port in edge.component.ports
        )
        if not (sources or edge.component.role in (Role.FORCE, Role.TORQUE)):
            continue
        given = list(chain.from_iterable(entries(value) for value in edge.fields.values()))
        is_plain = all(entry.number is not None for entry in given)
        if given and is_plain and all(_number(entry, known) == 0.0 for entry in given):
            told = f"edge '{edge.name}' of type '{edge.component.name}' gives nothing: all is zero"
            yield Finding("no-effect", "edge", edge.name, told)
    set_by_events = {name for event in scene.events.values() for name in event.set}
    for name, mode in scene.modes.items():
        if name not in set_by_events and not mode.is_jump:
            told = f"mode '{name}' is set by no event: it stays what it is, as a parameter does"
            yield Finding("no-effect", "mode", name, told)
