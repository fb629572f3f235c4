"""Triggers of SBML's events as zero crossings, and checks of their values at the start."""

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
    """An expression that crosses zero where a condition becomes true.

    Attributes
    ----------
    text : str
        The expression.
    direction : int
        1 for a rising crossing, 0 for either direction.
    holds_at_zero : bool
        Whether the condition is true at zero.
    """

    text: str
    direction: int
    holds_at_zero: bool


def crossing_of(reader: FormulaReader, node: Any) -> Crossing:
    """Convert a condition to an expression that crosses zero where it becomes true.

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
        # Two values that change continuously become equal where their difference crosses zero.
        is_either = relation == "EQ"
        text = reader.make.operate(a, "-", b).text
        return Crossing(text, 0 if is_either else 1, relation in ("LEQ", "GEQ", "EQ"))
    made = reader.make.where(reader.condition(node), number(1.0), number(-1.0))
    return Crossing(made.text, 1, holds_at_zero=False)


def start_value(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> float:
    """Evaluate the expression of a trigger at the start."""
    return _at_start(scene, event, begin)[0]


def check_start(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> None:
    """Refuse an event whose occurrence at the start would be wrong in a run."""
    value, is_known = _at_start(scene, event, begin)
    # An event occurs at the start of a run if its value is zero and about to rise. That of a
    # comparison with the time rises; of others this is not known here.
    is_late = value > 0.0 or (value == 0.0 and begin.holds_at_zero and not is_known)
    is_early = value == 0.0 and begin.holds_at_zero
    if is_early if event.is_initially_true else is_late:
        raise event.trigger.at.error(
            f"the {event.trigger.what} is true at the start with initialValue="
            f"{str(event.is_initially_true).lower()}, which is not supported: include the event's "
            "assignments in the initial values"
        )


def _at_start(scene: SceneDescription, event: SbmlEvent, begin: Crossing) -> tuple[float, bool]:
    """Evaluate a trigger's expression at the start; also return whether it has no parameters."""
    rows = dict(scene.parameters)
    with located(event.trigger.at):
        # The description contains spaces, so that it differs from all names of the scene.
        row = make_parameter(event.trigger.what, begin.text, "", "", True)
        rows[row.name] = row
        value = parameter_values(rows)[row.name]
    return value, isinstance(row.value, float) or not row.value.names
