"""Joint coordinates that components of one dimension sit on, and velocities given there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.components import Freedom, Role
from cotree.components.counterparts import counterpart_of
from cotree.components.mechanical import PACED
from cotree.dag.derivative import tangents
from cotree.errors import SceneError, nearest
from cotree.formulation.chords import Row, named_measure
from cotree.naming import split_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion
    from cotree.formulation.endpoints import Pull
    from cotree.formulation.fields import BoundEdge
    from cotree.formulation.measures import Measure
    from cotree.formulation.views import View


@dataclass(frozen=True)
class Sitter:
    """A component that sits on a joint.

    Attributes
    ----------
    edge, type : str
        Its name and its type.
    turns : bool
        Whether it acts about an angle, not along a length.
    """

    edge: str
    type: str
    turns: bool


@dataclass(frozen=True)
class Paced:
    """A measure less a given course: its rate is held, and its value follows.

    Attributes
    ----------
    measure : Measure
        The coordinate.
    speed, time : Node
        The rate that it has, of parameters and time, and the symbol of time.
    """

    measure: Measure
    speed: Node
    time: Node

    def value(self, view: View) -> Any:
        """Give nothing: positions are free where the motion begins."""
        return None

    def rate(self, view: View) -> Any:
        """Give what the rate differs by."""
        return self.measure.rate(view) - view.formula(self.speed, {})

    def acceleration(self, view: View) -> Any:
        """Give the time derivative of that."""
        (change,) = tangents([self.speed], {self.time: self.time.dag.one})
        return self.measure.acceleration(view) - view.formula(change, {})

    def pull(self, view: View) -> Pull:
        """Act along the coordinate."""
        return self.measure.pull(view)


def paced_rows(motion: Motion) -> Iterator[Row]:
    """List the rows of sources of velocity on joints."""
    for edge in motion.system.edges.values():
        if edge.component.role is Role.CONSTRAINT and edge.component.name in PACED:
            turns, field = PACED[edge.component.name]
            sitter = Sitter(edge.name, edge.component.name, turns)
            measure = joint_measure(sitter, edge.expressions["joint"].text.strip(), motion)
            paced = Paced(measure, edge.scalars[field], motion.system.time)
            yield Row(f"{edge.name}.motion", edge.name, "rad/s" if turns else "m/s", paced)


def joint_measure(sitter: Sitter, place: str, motion: Motion) -> Measure:
    """Measure the coordinate of a joint that a component sits on.

    Parameters
    ----------
    sitter : Sitter
        The component.
    place : str
        The joint, or ``joint.coordinate``.
    motion : Motion
        The multibody system.

    Raises
    ------
    SceneError
        If there is no such joint or coordinate, or it slides where the component turns.
    """
    # A joint of a part has dots in its name.
    joint, wanted = (place, "") if place in motion.system.edges else split_name(place)
    joint, wanted = (joint, wanted) if joint else (wanted, "")
    edge = motion.system.edges.get(joint)
    if edge is None or edge.component.role is not Role.JOINT:
        known = [e.name for e in motion.system.edges.values() if e.component.role is Role.JOINT]
        raise SceneError(
            f"edge '{sitter.edge}' acts on '{joint}', which is no joint{nearest(joint, known)}"
        )
    # Components of rotation act about joints that turn, of translation along those that slide. A
    # free rotation has no single angle to act about.
    steps = [step for step in edge.component.motion_space if isinstance(step, Freedom)]
    known = [step.name for step in steps if step.rotates is sitter.turns]
    names = [name for name in known if wanted in ("", name)]
    if len(names) != 1:
        raise SceneError(_told(sitter, edge, wanted, known, bool(steps)))
    measure = named_measure(motion, f"{joint}.{names[0]}")
    if measure is None:
        raise SceneError(
            f"edge '{sitter.edge}' acts on '{joint}.{names[0]}', which closes a loop and cannot "
            "be measured there: name a tree that holds the joint"
        )
    return measure


def _told(
    sitter: Sitter, joint: BoundEdge, wanted: str, known: Sequence[str], has_others: bool
) -> str:
    """Say why a component cannot act on a joint, and what can."""
    own = f"edge '{sitter.edge}'"
    does, what = ("turns", "angle") if sitter.turns else ("slides", "length")
    on = f"joint '{joint.name}' of type '{joint.component.name}'"
    named = " or ".join(f'joint = "{joint.name}.{name}"' for name in known)
    if known and not wanted:
        return f"{own} acts on {on}, which has {len(known)} {what}s: name one, {named}"
    if known:
        place = f"{joint.name}.{wanted}"
        return f"{own} acts on '{place}', which is no {what} of {on}: name {named}"
    other, cure = counterpart_of(sitter.type), f"act on a joint that {does}"
    if other and has_others:
        cure = f"take a {other} in place of the {sitter.type}, or {cure}"
    return f"{own} {does}, but {on} has no {what} to act on: {cure}"
