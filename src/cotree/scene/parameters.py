"""Parameters of a scene: numbers, and expressions derived from other parameters.

A derived parameter is a node of the expression graph, so derivatives include its effect.
"""

from __future__ import annotations

from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, ParameterError, SceneError, UnitError, nearest
from cotree.naming import check_text
from cotree.scene.expressions import Expression, check_number, parse
from cotree.units import check_unit

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.dag.nodes import Dag, Node


@dataclass(frozen=True)
class Parameter:
    """A named number with unit and meaning; runs may change it if it is tunable.

    Attributes
    ----------
    name : str
        Its name in expressions.
    value : float or Expression
        A number or, for a derived parameter, an expression of other parameters.
    unit, doc : str
        Its SI unit, and its meaning as text.
    tunable : bool
        Whether a run may change the value.
    given : (float, str) or None
        The stated number and unit if the unit is not an SI unit.
    """

    name: str
    value: float | Expression
    unit: str = ""
    doc: str = ""
    tunable: bool = True
    given: tuple[float, str] | None = None

    @property
    def is_derived(self) -> bool:
        """Whether the parameter is derived from other parameters."""
        return isinstance(self.value, Expression)

    @property
    def number(self) -> float:
        """The value of a parameter that is not derived."""
        assert not isinstance(self.value, Expression)  # only called for numbers
        return self.value

    def cells(self) -> tuple[str, float | str, str, str]:
        """Return the cells of a table row: name, value or expression, unit and meaning."""
        value = self.value.text if isinstance(self.value, Expression) else self.value
        return self.name, value, self.unit, self.doc

    @property
    def is_argument(self) -> bool:
        """Whether a run may change the parameter: whether it is tunable and not derived."""
        return self.tunable and not self.is_derived


def make_parameter(
    name: str, value: object, unit: object, doc: object, tunable: object
) -> Parameter:
    """Create a parameter from its value, unit, meaning and flag, which are checked."""
    what = f"parameter '{name}'"
    number = parse(value, what) if isinstance(value, str) else check_number(value, what)
    if isinstance(number, Expression) and number.number is not None:
        raise ParameterError(f"{what} is a number in quotes, '{number.text}': remove the quotes")
    if not isinstance(tunable, bool):
        raise SceneError(f"tunable of {what} must be true or false")
    if isinstance(number, Expression) and not tunable:
        raise ParameterError(
            f"{what} follows from others by '{number.text}': remove tunable here, and set it "
            "for those"
        )
    text, doc = check_text(unit, f"unit of {what}"), check_text(doc, f"doc of {what}")
    own = check_unit(text, f"unit of {what}")
    if own is None or own.is_si:
        return Parameter(name, number, text, doc, tunable)
    if isinstance(number, Expression):
        raise UnitError(
            f"{what} is an expression, whose value is in SI: its unit is '{own.si}', not '{text}'"
        )
    return Parameter(name, own.to_si(number), own.si, doc, tunable, (number, text))


def check_cycle(parameters: Mapping[str, Parameter], name: str) -> None:
    """Raise if a derived parameter depends on itself."""
    uses = _uses(parameters, name)
    try:
        TopologicalSorter(uses).prepare()
    except CycleError as error:
        # In the cycle that the sorter reports, each name precedes the one that uses it.
        way = list(reversed(error.args[1]))
        raise ParameterError(
            f"parameter '{way[0]}' depends on itself: {' -> '.join(way)}; give one of these a "
            "number"
        ) from None


def sources(parameters: Mapping[str, Parameter], name: str) -> tuple[str, ...]:
    """Return the numeric parameters on which a derived one depends, in the scene's order."""
    reached = _uses(parameters, name)
    return tuple(n for n, row in parameters.items() if n in reached and not row.is_derived)


def parameter_nodes(
    parameters: Mapping[str, Parameter], dag: Dag, numbers: Callable[[Parameter], Node]
) -> dict[str, Node]:
    """Return the node of every parameter; ``numbers`` creates the nodes of numeric ones."""
    found = {name: numbers(row) for name, row in parameters.items() if not row.is_derived}
    if len(found) == len(parameters):
        return found

    def resolve(name: str) -> Node:
        if name not in found:
            raise ExpressionError(f"uses the unknown parameter '{name}'{nearest(name, parameters)}")
        return found[name]

    for name in in_order(parameters):
        value = parameters[name].value
        if isinstance(value, Expression):
            with dag.labelled(f"parameter {name}"):
                found[name] = value.lower(dag, resolve)
                dag.note_origin(found[name], f"parameter '{name}'")
    return {name: found[name] for name in parameters}


def parameter_values(parameters: Mapping[str, Parameter]) -> dict[str, float]:
    """Return the scene's values of all parameters."""
    from cotree.dag.nodes import Dag

    dag = Dag()
    nodes = parameter_nodes(parameters, dag, lambda row: dag.constant(row.number))
    return {name: _value(node) for name, node in nodes.items()}


def in_order(parameters: Mapping[str, Parameter]) -> list[str]:
    """Return the names of parameters, each one after those on which it depends."""
    uses = {name: _own_uses(row) for name, row in parameters.items()}
    try:
        return [name for name in TopologicalSorter(uses).static_order() if name in parameters]
    except CycleError as error:
        check_cycle(parameters, error.args[1][0])
        raise AssertionError("the names of a cycle depend on each other") from None


def _value(node: Node) -> float:
    assert node.value is not None  # constant expressions fold
    return node.value


def _own_uses(row: Parameter) -> frozenset[str]:
    return row.value.names - {"pi"} if isinstance(row.value, Expression) else frozenset()


def _uses(parameters: Mapping[str, Parameter], name: str) -> dict[str, frozenset[str]]:
    """Return, for a parameter and all on which it depends, the names that each one uses."""
    found: dict[str, frozenset[str]] = {}
    waiting = [name]
    while waiting:
        own = waiting.pop()
        if own in parameters and own not in found:
            found[own] = _own_uses(parameters[own])
            waiting += found[own]
    return found
