"""Inputs of a scene: signals from outside, with what they are where a run gives nothing else."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.naming import check_text
from cotree.scene.statements import plain
from cotree.scene.tables import parse_signal
from cotree.units import check_unit

if TYPE_CHECKING:
    from cotree.dag.multi_output import Table
    from cotree.scene.expressions import Expression


@dataclass(frozen=True)
class Input:
    """A signal from outside: an expression of t and parameters, or a table over t.

    Attributes
    ----------
    name : str
        Its name in expressions.
    value : Expression or Table
        What it is where a run gives nothing else.
    unit, doc : str
        Its unit and meaning, for people.
    """

    name: str
    value: Expression | Table
    unit: str = ""
    doc: str = ""
    given: tuple[Any, str] | None = None  # where it was given in a unit that is not of SI


def make_input(name: str, value: Any, unit: str, doc: str) -> Input:
    """Check an input's value, unit and meaning.

    Raises
    ------
    SceneError, ExpressionError, UnitError
        If one of them is not accepted.
    """
    what = f"input '{name}'"
    text, doc = check_text(unit, f"unit of {what}"), check_text(doc, f"doc of {what}")
    own = check_unit(text, f"unit of {what}")
    signal, given = parse_signal(value, what, own), None
    if own is not None and not own.is_si:
        text, given = own.si, (plain(value), text)
    return Input(name, signal, text, doc, given)
