"""Guards against, or refusals of, jumps of values whose rates are among the equations."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components.component import Role
from cotree.components.mechanical import PACED
from cotree.dag.continuity import are_seen, margins, may_jump
from cotree.dag.derivative import tangents
from cotree.dag.symbols import PARAMETER, TIME, kinds_in
from cotree.equations import Guard
from cotree.errors import FormulationError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.fields import BoundEdge


def guards_of(
    value: Node, moving: Sequence[Node], time: Node, what: str, breach: str
) -> Iterator[Guard]:
    """Refuse a value that jumps; where parameters decide it, guard them.

    Parameters
    ----------
    value : Node
        The value.
    moving : sequence of Node
        The symbols that change during a run, time among them.
    time : Node
        The symbol of time.
    what, breach : str
        Subject and predicate of the message: the name of the value, and what is wrong if it jumps.

    Raises
    ------
    FormulationError
        If the value jumps.
    """
    if not is_timed(value, time):
        if may_jump(value, moving, time):
            raise FormulationError(f"{what} {breach}")
        return
    # A margin is negative where the value jumps; one that is a number is known now.
    for margin in margins(time.dag, value, time):
        if margin.value is None:
            yield Guard(margin, what, False, breach)
        elif not margin.value >= 0.0:
            raise FormulationError(f"{what} {breach}")


def is_timed(value: Node, time: Node) -> bool:
    """Tell whether parameters and time alone decide where a value may jump, and when is known."""
    of_time = kinds_in([value]) <= {PARAMETER, TIME}
    return of_time and are_seen(time.dag, value, [time])


_BREACH = (
    "jumps, or its rate does, which would take an impulse: give an expression of t whose value and "
    "rate are continuous, such as max(0, t)**2 in place of max(0, t)"
)


def motion_guards(edge: BoundEdge, time: Node) -> Iterator[Guard]:
    """Refuse prescribed motions, and prescribed values of constraints, whose speed jumps.

    Raises
    ------
    FormulationError
        If one of them jumps, or its rate does.
    """
    if edge.component.role not in (Role.JOINT, Role.CONSTRAINT):
        return
    for name, value in edge.scalars.items():
        if edge.component.role is Role.JOINT and name != "motion":
            continue
        (rate,) = tangents([value], {time: time.dag.one})
        # A jump of the position, or of the speed, would take an impulse.
        for node in (value,) if edge.component.name in PACED else (value, rate):
            yield from guards_of(node, [time], time, f"{name} of edge '{edge.name}'", _BREACH)
