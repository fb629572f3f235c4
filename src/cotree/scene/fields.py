"""Fields and initial values of an edge, checked against the component's rows.

The original statement is stored, because components are adapted to the fields of an edge.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from numbers import Number
from typing import TYPE_CHECKING, Any

from cotree.arguments import is_list, plain
from cotree.components import Component, Field, FreeRotation, Role, Shape, content_of, integral_of
from cotree.components.multibody import body_space
from cotree.domains import DOMAINS
from cotree.errors import SceneError, UnitError, check_known
from cotree.naming import check_text
from cotree.scene.expressions import Expression, FieldValue, check_number, parse
from cotree.units import Unit, check_fits, check_unit

if TYPE_CHECKING:
    from cotree.dag.lookup import LinearTable


def edge_statement(
    type: str, nodes: Sequence[object], fields: Mapping[str, Any], initial: Any
) -> dict[str, Any]:
    """Return the table of an edge in a scene file, without empty entries."""
    rows = {"type": type, "nodes": list(nodes), **fields, "initial": initial}
    return {
        key: value
        for key, value in rows.items()
        if value is not None and not (key in ("nodes", "initial") and not value)
    }


def check_fields(
    edge: str, component: Component, given: Mapping[str, Any]
) -> dict[str, FieldValue]:
    """Return the checked fields of an edge, with defaults for fields that are not stated."""
    known = {row.name for row in component.fields}
    check_known(given, known, f"edge '{edge}' of type '{component.name}' has no field")
    fields: dict[str, FieldValue] = {}
    # The order is that of the component's rows, not that of the statement.
    for row in component.fields:
        where = f"{row.name} of edge '{edge}'"
        if row.name in given:
            value = _in_si(given[row.name], row.unit, where)
            fields[row.name] = _check_field(row, value, where)
        elif row.required:
            raise SceneError(
                f"edge '{edge}' of type '{component.name}' needs the field '{row.name}'"
            )
        elif row.default is not None:
            fields[row.name] = parse(row.default, where)
    return fields


def check_initial(
    edge: str, component: Component, given: Mapping[str, Any]
) -> dict[str, FieldValue]:
    """Return the checked initial values of an edge."""
    if not isinstance(given, Mapping):
        raise SceneError(f"initial of edge '{edge}' must be a table of names and values")
    initial: dict[str, FieldValue] = {}
    units = initial_units(component)
    for name, value in _by_port(component, given):
        check_known((name,), units, f"edge '{edge}' has no coordinate")
        where = f"initial {name} of edge '{edge}'"
        value = _in_si(value, units.get(name, ""), where)
        # Orientations are stated as angles or a matrix, and become a quaternion.
        initial[name] = _rotation(value, where) if name == "rotation" else parse(value, where)
    return initial


def initial_units(component: Component) -> dict[str, str]:
    """Return the units of all variables that may have initial values in some tree of the scene."""
    if component.geometry is not None:
        return {}  # the initial values of a body determine its position
    if component.role is Role.NETWORK:
        return _network_units(component)
    spaces = [component.motion_space]
    if component.role is Role.BODY:
        # Names are the same in each plane, so the names of plane z are used.
        spaces = [body_space(plane, is_particle=False) for plane in ("", "z")]
    steps = [step for space in spaces for step in space]
    units = {name: unit for step in steps for name, unit in (*step.coordinates, *step.rates)}
    if any(isinstance(step, FreeRotation) for step in steps):
        units["rotation"] = "rad"
    return units


def _by_port(component: Component, given: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Yield the initial values; those in the table of a port have names ``port.name``."""
    ports = {port.port for port in component.ports}
    for name, value in given.items():
        if name in ports and isinstance(value, Mapping):
            yield from ((f"{name}.{own}", item) for own, item in value.items())
        else:
            yield name, value


def _network_units(component: Component) -> dict[str, str]:
    """Return units of possible states of a scalar component; ambiguous names are ``port.name``."""
    found: list[tuple[str, str, str]] = []
    for port in component.ports:
        row, integral = DOMAINS[port.domain], integral_of(port)
        # The tree determines which variables become states, so a scene may set any of them.
        names = [(row.across_symbol, row.across_unit), (row.through_symbol, row.through_unit)]
        names += [(integral.name, integral.unit)] if integral else []
        names += [content] if (content := content_of(port)) else []
        found += [(port.port, name, unit) for name, unit in names]
    # Short names must be unambiguous; long names are always accepted.
    count = Counter(name for _, name, _ in found)
    alone = {name: unit for _, name, unit in found if count[name] == 1}
    return alone | {f"{port}.{name}": unit for port, name, unit in found if port}


def check_vector(value: object, where: str) -> tuple[Expression, ...]:
    """Return a checked list of three numbers or expressions."""
    if not is_list(value) or len(value) != 3:
        raise SceneError(f"{where} must be a list of three numbers or expressions")
    return tuple(parse(item, f"component {'xyz'[i]} of {where}") for i, item in enumerate(value))


def _in_si(value: Any, wanted: str, where: str) -> Any:
    """Convert values with a unit to SI, also in lists; other values are unchanged."""
    if is_list(value):
        return [_in_si(item, wanted, where) for item in value]
    if not isinstance(value, Mapping) or "unit" not in value:
        return value
    if set(value) != {"value", "unit"}:
        raise SceneError(f"{where} is a table with a unit: give it 'value' and 'unit', no more")
    own = check_unit(check_text(value["unit"], f"unit of {where}"), f"unit of {where}")
    if own is None:
        return value["value"]
    check_fits(own, wanted, where)
    return _converted(value["value"], own, where)


def _converted(value: Any, unit: Unit, where: str) -> Any:
    if is_list(value):
        return [_converted(item, unit, where) for item in value]
    return converted(parse(value, where), unit, where).canonical


def _check_field(row: Field, value: Any, where: str) -> FieldValue:
    if row.shape is Shape.VECTOR:
        return check_vector(value, where)
    if row.shape is Shape.INERTIA:
        return _inertia(value, where)
    if row.shape is Shape.ROTATION:
        return _rotation(value, where)
    if row.shape is Shape.SCALAR and isinstance(value, Mapping):
        from cotree.scene.tables import parse_lookup

        return parse_lookup(value, where)
    return parse(value, where)


def _inertia(value: object, where: str) -> FieldValue:
    if not is_list(value):
        scalar = parse(value, where)
        # A single moment applies to all axes.
        return (scalar, scalar, scalar)
    rows = _rows(value, where)
    if rows is None:
        return check_vector(value, where)
    # Symmetry is checked by text, because expressions have no values yet.
    if any(rows[i][j].text != rows[j][i].text for i in range(3) for j in range(i)):
        raise SceneError(f"{where} must be symmetric: write both halves alike")
    return rows


def _rotation(value: object, where: str) -> FieldValue:
    """Return a checked rotation: three angles, or three rows that form a rotation matrix."""
    if not is_list(value) or len(value) != 3:
        raise SceneError(f"{where} must be three angles (roll, pitch, yaw) or three rows of three")
    rows = _rows(value, where)
    if rows is None:
        return check_vector(value, where)
    numbers = [[entry.number for entry in row] for row in rows]
    # Entries must be numbers, because parameters could make the matrix non-orthogonal.
    if any(entry is None for row in numbers for entry in row):
        raise SceneError(
            f"{where} is a matrix: give it as numbers, or as roll, pitch and yaw, which may depend "
            "on parameters"
        )
    from cotree.dag.vector import quaternion_of_matrix

    if quaternion_of_matrix(numbers) is None:  # type: ignore[arg-type]
        raise SceneError(
            f"{where} is not a rotation matrix: its rows must be perpendicular unit vectors "
            "with determinant +1"
        )
    return rows


def _rows(value: Sequence[Any], where: str) -> tuple[tuple[Expression, ...], ...] | None:
    """Return three checked rows of a matrix, or None if the list contains no rows."""
    if len(value) != 3 or not all(map(is_list, value)):
        return None
    return tuple(check_vector(row, f"row {i} of {where}") for i, row in enumerate(value, 1))


def parse_signal(value: object, where: str, unit: Unit | None = None) -> Expression | LinearTable:
    """Return a checked number or expression, or the table of a pair (times, values)."""
    # An array without axes counts as a number; NumPy strings also have no axes.
    is_scalar = getattr(value, "shape", None) == () and not isinstance(value, str)
    if isinstance(value, Number) or is_scalar:
        value = check_number(value, where)
    if isinstance(value, (str, float)):
        return converted(parse(value, where), unit, where)
    from cotree.scene.tables import make_table

    made = make_table(value, where, "times")
    if unit is None or unit.is_si:
        return made
    return replace(made, y=tuple(map(unit.to_si, made.y)))


def converted(value: Expression, unit: Unit | None, where: str) -> Expression:
    """Convert a number to SI; raise UnitError if an expression has another unit."""
    if unit is None or unit.is_si:
        return value
    if value.number is None:
        raise UnitError(
            f"{where} is an expression, whose value is in SI: its unit is '{unit.si}', not "
            f"'{unit.text}'"
        )
    return parse(unit.to_si(value.number), where)


@dataclass(frozen=True)
class Input:
    """An input signal: an expression of t and parameters, or a table over t.

    Attributes
    ----------
    name : str
        Its name in expressions.
    value : Expression or LinearTable
        Its value in runs that do not replace it.
    unit, doc : str
        Its unit and its meaning as text.
    """

    name: str
    value: Expression | LinearTable
    unit: str = ""
    doc: str = ""
    given: tuple[Any, str] | None = None  # stated value and unit if the unit is not an SI unit


def make_input(name: str, value: Any, unit: str, doc: str) -> Input:
    """Create an input from its value, unit and meaning, which are checked."""
    what = f"input '{name}'"
    text, doc = check_text(unit, f"unit of {what}"), check_text(doc, f"doc of {what}")
    own = check_unit(text, f"unit of {what}")
    signal, given = parse_signal(value, what, own), None
    if own is not None and not own.is_si:
        text, given = own.si, (plain(value), text)
    return Input(name, signal, text, doc, given)
