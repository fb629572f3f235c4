"""Triggers of SBML's events: what passes through zero, and whether it may at the start."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.readers.sbml_located import located
from cotree.readers.sbml_math import RELATIONS, FormulaReader
from cotree.readers.sbml_nodes import children, kind_of
from cotree.readers.sbml_trees import number
from cotree.scene.parameters import make_parameter, parameter_values

if TYPE_CHECKING:
    from cotree.readers.sbml_content import SbmlEvent
    from cotree.scene.description import SceneDescription


@dataclass(frozen=True)
class Crossing:
    """An expression that passes through zero where a condition begins to hold.

    Attributes
    ----------
    text : str
        The expression.
    direction : int
        1 where it rises, 0 where it may pass either way.
    holds_at_zero : bool
        Whether the condition holds at zero itself.
    """

    text: str
    direction: int
    holds_at_zero: bool


def crossing_of(reader: FormulaReader, node: Any) -> Crossing:
    """Turn a condition into what passes through zero where it begins to hold.

    Raises
    ------
    ExpressionError
        As :meth:`FormulaReader.read`.
    """
    relation = kind_of(node).removeprefix("RELATIONAL_")
    if relation in (*RELATIONS, "EQ") and node.getNumChildren() == 2:
        a, b = (reader.read(part) for part in children(node))
        if relation in ("LT", "LEQ"):
            a, b = b, a
        # Two values that change continuously are equal only where one passes the other.
        is_either = relation == "EQ"
        text = reader.make.operate(a, "-", b).text
        return Crossing(text, 0 if is_either else 1, relation in ("LEQ", "GEQ", "EQ"))
    made = reader.make.where(reader.condition(node), number(1.0), number(-1.0))
    return Crossing(made.text, 1, holds_at_zero=False)


def start_value(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> float:
    """Evaluate what a trigger's crossing is at the start."""
    return _at_start(scene, event, begin)[0]


def check_start(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> None:
    """Refuse an event at the start that a run would not have, or have though it must not."""
    value, is_known = _at_start(scene, event, begin)
    # A run has an event at its start where the value is zero and about to rise, as that of a
    # comparison with the time is; whether another one rises is not known here.
    is_late = value > 0.0 or (value == 0.0 and begin.holds_at_zero and not is_known)
    is_early = value == 0.0 and begin.holds_at_zero
    if is_early if event.is_initially_true else is_late:
        raise event.trigger.at.error(
            f"the {event.trigger.what} holds at the start, where initialValue="
            f"{str(event.is_initially_true).lower()} decides whether the event happens: "
            "write what it sets into the initial values"
        )


def _at_start(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> tuple[float, bool]:
    """Evaluate a crossing at the start, and tell whether it depends on no parameter."""
    rows = dict(scene.parameters)
    with located(event.trigger.at):
        # No parameter of a scene has a name of several words.
        row = make_parameter(event.trigger.what, begin.text, "", "", True)
        rows[row.name] = row
        value = parameter_values(rows)[row.name]
    return value, isinstance(row.value, float) or not row.value.names
