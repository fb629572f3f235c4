"""Through variables along measures: laws of chord joints, of bushings, and user-defined laws.

The arguments of a law are values and rates of measures, and fields of the edge.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.components import Acts, Freedom, Role
from cotree.components.mechanical import VELOCITY_SOURCES, counterpart_of
from cotree.dag import vector
from cotree.dag.derivative import tangents
from cotree.errors import SceneError, nearest
from cotree.formulation.chords import Constraint, chord_measure, named_measure, whole_angle
from cotree.formulation.measures import (
    Angle,
    AxisLength,
    Coincidence,
    Composite,
    Cosine,
    Distance,
    Measure,
    Pull,
    Spin,
    carried_by,
    chord_ends,
)
from cotree.naming import split_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.across import Motion, View
    from cotree.formulation.fields import BoundEdge


@dataclass(frozen=True)
class Applied:
    """A through variable that acts along a measure."""

    #: Name of the edge, and name of the through variable in the edge.
    edge: str
    name: str
    measure: Measure  # measure that is dual to the through variable
    pull: Pull  # wrenches and efforts per unit of the through variable
    magnitude: Node  # value of the through variable
    formula: Node | None = None  # law in the symbols of ``arguments``; None for a multiplier
    #: Measure of each symbol, and whether the symbol is the rate of the measure.
    arguments: Mapping[Node, tuple[Measure, bool]] = field(default_factory=dict)
    potential: Node | None = None  # stored energy of a linear spring; None for other laws

    def amount(self, view: View) -> Any:
        """Return the value of the law in a view."""
        assert self.formula is not None  # a multiplier (constraint force) has no law
        return view.formula(self.formula, _seen(self.arguments, view))


def _seen(arguments: Mapping[Node, tuple[Measure, bool]], view: View) -> dict[Node, Any]:
    return {
        symbol: measure.rate(view) if is_rate else measure.value(view)
        for symbol, (measure, is_rate) in arguments.items()
    }


def applied_laws(motion: Motion, view: View) -> list[Applied]:
    """Evaluate all laws that act along measures."""
    found: list[Applied] = []
    for edge in motion.system.edges.values():
        role = edge.component.role
        with motion.system.dag.labelled(f"terminal equation of {edge.name}"):
            if role is Role.JOINT:
                found += _chord_joint(motion, edge, view)
            elif role is Role.BUSHING:
                found += _bushing(motion, edge, view)
            elif role is Role.LAW:
                found += _user_law(motion, edge, view)
    return found


def _act(
    edge: BoundEdge,
    name: str,
    measure: Measure,
    formula: Node,
    arguments: Mapping[Node, tuple[Measure, bool]],
    view: View,
    potential: Node | None = None,
) -> Applied:
    seen = _seen(arguments, view)
    stored = None if potential is None else view.formula(potential, seen)
    magnitude = view.formula(formula, seen)
    return Applied(
        edge.name, name, measure, measure.pull(view), magnitude, formula, arguments, stored
    )


def _symbols(motion: Motion) -> tuple[Node, Node]:
    dag = motion.system.dag
    return dag.symbol("measure", 0), dag.symbol("measure rate", 0)


def _chord_joint(motion: Motion, edge: BoundEdge, view: View) -> Iterator[Applied]:
    law = edge.component.law
    if law is None:
        return
    step = edge.component.motion_space[0]
    assert isinstance(step, Freedom)
    # If the joint is a branch, the law acts along its speed; see ``through._joint_efforts``.
    if motion.system.trees.is_branch(edge.name, step.rotates):
        return
    measure = chord_measure(motion, edge, step.name)
    value, rate = _symbols(motion)
    if measure is None:
        return
    scalars = edge.scalars
    formula = law.value(motion.system.dag, {**scalars, step.name: value, f"{step.name}_dot": rate})
    if formula.is_zero:
        return
    # A law that depends on the angle, and not only on its rate, would jump at half a turn.
    if isinstance(measure, Angle) and not tangents([formula], {value: value.dag.one})[0].is_zero:
        measure = whole_angle(motion, edge)
    stored = stored_energy(scalars, value) if "stiffness" in scalars else None
    arguments = {value: (measure, False), rate: (measure, True)}
    yield _act(edge, f"{edge.name}.law", measure, formula, arguments, view, stored)


def stored_energy(scalars: Mapping[str, Node], at: Node) -> Node:
    """Return the energy of a linear spring at a length or an angle."""
    rest = scalars.get("free_angle", scalars.get("free_length"))
    # Without ``free_length`` or ``free_angle``, the free value is zero.
    stretch = at if rest is None else at - rest
    return 0.5 * scalars["stiffness"] * (stretch * stretch)


def _bushing(motion: Motion, edge: BoundEdge, view: View) -> Iterator[Applied]:
    ends, units = chord_ends(motion, edge), vector.identity(motion.system.dag)
    a = [carried_by(motion, ends, 0, unit) for unit in units]
    b = [carried_by(motion, ends, 1, unit) for unit in units]
    value, rate = _symbols(motion)
    dag = motion.system.dag
    first, second, third = (dag.symbol("measure", i) for i in range(3))
    # 2 q_i^2 of the relative quaternion q, which is 1 - cos for a rotation about axis i. Unlike
    # three successive angles, this is smooth at every orientation.
    bend = 0.5 * (1.0 + first - second - third)
    along = tuple(Cosine(ends, a[i], b[i]) for i in range(3))
    for i, letter in enumerate("xyz"):
        j, k = (i + 1) % 3, (i + 2) % 3
        length, spin = AxisLength(ends, a[i]), Spin(ends, a[i])
        turn = Composite((along[i], along[j], along[k]), bend, motion.system.time)
        pull, drag, twist, turning = (
            edge.vectors.get(name, vector.zeros(dag))[i]
            for name in ("stiffness", "damping", "rotation_stiffness", "rotation_damping")
        )
        # Through variables act on the second node, against measures and rates. The torque per unit
        # of a measure is the derivative of the energy.
        rows = (
            ("", length, -(pull * value + drag * rate), stored_energy({"stiffness": pull}, value)),
            ("rotation_", turn, -twist, twist * value),
            ("rotation_damping_", spin, -(turning * rate), None),
        )
        for prefix, measure, formula, stored in rows:
            if not formula.is_zero:
                # A spin has a rate but no value.
                arguments = {rate: (measure, True)}
                if stored is not None:
                    arguments[value] = measure, False
                name = f"{edge.name}.{prefix}{letter}"
                yield _act(edge, name, measure, formula, arguments, view, stored)


def _user_law(motion: Motion, edge: BoundEdge, view: View) -> Iterator[Applied]:
    """Evaluate a user-defined law: a Python function, or an expression of the scene."""
    ends = chord_ends(motion, edge)
    if edge.component.acts is Acts.VELOCITY:
        yield from _against_motion(motion, edge, view)
        return
    measure: Measure = Distance(ends)
    # A length along an axis has a sign; the distance between two nodes does not.
    if "axis" in edge.vectors:
        measure = AxisLength(ends, carried_by(motion, ends, 0, edge.vectors["axis"]))
    value, rate = _symbols(motion)
    law = edge.component.law
    if law is None:
        # In a law, its arguments take precedence over other names.
        own, signals = {"length": value, "rate": rate}, motion.system.signals
        formula = edge.expressions["force"].lower(
            motion.system.dag, lambda name: own[name] if name in own else signals.node(name)
        )
    else:
        known = {**edge.scalars, "length": value, "rate": rate, "t": motion.system.time}
        formula = law.value(motion.system.dag, known)
    arguments = {value: (measure, False), rate: (measure, True)}
    yield _act(edge, f"{edge.name}.law", measure, formula, arguments, view)


def _against_motion(motion: Motion, edge: BoundEdge, view: View) -> Iterator[Applied]:
    """Evaluate a law of speed: law(speed) / speed times the relative velocity, reversed."""
    dag, ends = motion.system.dag, chord_ends(motion, edge)
    law = edge.component.law
    assert law is not None
    # Three through variables with a common factor, along the axes of the nodes' common ancestor.
    parts = [Coincidence(ends, unit) for unit in vector.identity(dag)]
    rates = [dag.symbol("measure rate", i) for i in range(3)]
    arguments = {rate: (part, True) for rate, part in zip(rates, parts, strict=True)}
    square = rates[0] * rates[0] + rates[1] * rates[1] + rates[2] * rates[2]
    known = {**edge.scalars, "speed": dag.function("sqrt", square), "t": motion.system.time}
    # Dividing by the speed symbolically avoids 0 / 0 at rest if the limit exists.
    factor = law.over("speed").value(dag, known)
    for letter, part, rate in zip("xyz", parts, rates, strict=True):
        yield _act(edge, f"{edge.name}.{letter}", part, factor * rate, arguments, view)


@dataclass(frozen=True)
class JointElement:
    """A component that acts on a joint's coordinate."""

    #: Name of the edge, and its component type.
    edge: str
    type: str
    turns: bool  # whether it prescribes a rotation instead of a translation


@dataclass(frozen=True)
class PrescribedRate:
    """A coordinate whose rate is prescribed, while its value is free."""

    measure: Measure  # the coordinate as a measure
    #: Prescribed rate as a function of parameters and time, and the symbol of time.
    speed: Node
    time: Node

    def value(self, view: View) -> Any:
        """Return None, since the initial position is arbitrary."""
        return None

    def rate(self, view: View) -> Any:
        """Return the actual rate minus the prescribed rate."""
        return self.measure.rate(view) - view.formula(self.speed, {})

    def acceleration(self, view: View) -> Any:
        """Return the time derivative of :meth:`rate`."""
        (change,) = tangents([self.speed], {self.time: self.time.dag.one})
        return self.measure.acceleration(view) - view.formula(change, {})

    def pull(self, view: View) -> Pull:
        """Return a force or torque along the coordinate."""
        return self.measure.pull(view)


def prescribed_rate_rows(motion: Motion) -> Iterator[Constraint]:
    """Yield the constraint rows of velocity sources that act on joints."""
    for edge in motion.system.edges.values():
        if edge.component.role is Role.CONSTRAINT and edge.component.name in VELOCITY_SOURCES:
            turns, field = VELOCITY_SOURCES[edge.component.name]
            element = JointElement(edge.name, edge.component.name, turns)
            measure = joint_measure(element, edge.expressions["joint"].text.strip(), motion)
            prescribed = PrescribedRate(measure, edge.scalars[field], motion.system.time)
            yield Constraint(
                f"{edge.name}.motion", edge.name, "rad/s" if turns else "m/s", prescribed
            )


def joint_measure(element: JointElement, place: str, motion: Motion) -> Measure:
    """Return the measure of ``joint`` or ``joint.coordinate`` on which a component acts."""
    # The name of a joint in a part contains dots.
    joint, wanted = (place, "") if place in motion.system.edges else split_name(place)
    joint, wanted = (joint, wanted) if joint else (wanted, "")
    edge = motion.system.edges.get(joint)
    if edge is None or edge.component.role is not Role.JOINT:
        known = [e.name for e in motion.system.edges.values() if e.component.role is Role.JOINT]
        raise SceneError(
            f"edge '{element.edge}' acts on the unknown joint '{joint}'{nearest(joint, known)}"
        )
    # A component acts on a single angle or displacement, which a free rotation does not have.
    steps = [step for step in edge.component.motion_space if isinstance(step, Freedom)]
    known = [step.name for step in steps if step.rotates is element.turns]
    names = [name for name in known if wanted in ("", name)]
    if len(names) != 1:
        raise SceneError(_joint_message(element, edge, wanted, known, bool(steps)))
    measure = named_measure(motion, f"{joint}.{names[0]}")
    if measure is None:
        raise SceneError(
            f"edge '{element.edge}' acts on '{joint}.{names[0]}', which closes a loop and "
            "cannot be measured there: name a tree that contains the joint"
        )
    return measure


def _joint_message(
    element: JointElement, joint: BoundEdge, wanted: str, known: Sequence[str], has_others: bool
) -> str:
    """Return a message: why a component cannot act on a joint, and on which joints it can act."""
    own = f"edge '{element.edge}'"
    does, what = ("turns", "angle") if element.turns else ("slides", "length")
    on = f"joint '{joint.name}' of type '{joint.component.name}'"
    named = " or ".join(f'joint = "{joint.name}.{name}"' for name in known)
    if known and not wanted:
        return f"{own} acts on {on}, which has {len(known)} {what}s: name one, {named}"
    if known:
        place = f"{joint.name}.{wanted}"
        return f"{own} acts on '{place}', which is no {what} of {on}: name {named}"
    other, cure = counterpart_of(element.type), f"act on a joint that {does}"
    if other and has_others:
        cure = f"use a {other} instead of the {element.type}, or {cure}"
    return f"{own} {does}, but {on} has no {what} to act on: {cure}"
