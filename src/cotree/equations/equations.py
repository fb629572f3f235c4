"""Equations of a scene: ``A(x) w = b(x)`` and ``M x' = rates(x, w)``, with their derivatives.

The unknowns w, accelerations and multipliers, solve linear equations at each instant. M is
diagonal: one for states with a rate, zero for algebraic unknowns, which nonlinear equations give.
Those come last among the states, and their ``rates`` are the residuals of these equations. A
derivative along a direction has the same matrices on the left: ``A w_p = b_p`` and
``M x_p' = rates_p``. Everything is nodes of one arena.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from cotree.dag.nodes import PARAMETER, Dag, Node, substitute, symbols_in
from cotree.errors import ParameterError, listed

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.linear.tree import TreeLink


@dataclass(frozen=True)
class CornerRow:
    """A corner of the rates, which a value reaches where it passes through zero."""

    value: Node  # the value, relative to the end of the piece that is held
    piece: int  # which of the pieces that are held ends there
    #: Zero where the piece is the sign of the value; else what is added to its number where the
    #: value passes through zero in that direction.
    direction: int
    #: Whether the piece is the width of a band around zero within which roots are replaced.
    is_steep: bool = False


def spread(row: Mapping[int, Node], n: int, zero: Node) -> list[Node]:
    """Write a sparse row out in full, with ``zero`` at the places that it leaves out."""
    return [row.get(i, zero) for i in range(n)]


@dataclass(frozen=True)
class Derivative:
    """Derivatives of the equations along one direction.

    Of states and outputs there may be many thousands, each direction changing a few: their
    derivatives are kept by place, those that vanish left out.
    """

    name: str  # the parameter or state that the direction belongs to
    seed: Mapping[Node, Node]  # tangents of the symbols
    forcing: tuple[Node, ...]  # right-hand side of ``A w_p = forcing``, unknowns held fixed
    #: Derivatives of the state rates, in terms of :attr:`Equations.unknown_tangents`.
    rates: Mapping[int, Node]
    outputs: Mapping[int, Node]  # derivatives of the outputs
    initial: Mapping[int, Node]  # derivatives of the initial values
    #: Derivatives of the constraints and of their rates.
    held: tuple[Node, ...]
    held_rates: tuple[Node, ...]
    start: tuple[Node, ...]  # derivatives of :attr:`ConstraintSet.start_values`

    @property
    def nodes(self) -> list[Node]:
        """All its nodes but for those of the seed and of the initial values."""
        rates, outputs = self.rates.values(), self.outputs.values()
        return [*self.forcing, *rates, *outputs, *self.held, *self.held_rates, *self.start]


def substituted(
    rows: Sequence[Derivative], replacement: Mapping[Node, Node]
) -> tuple[Derivative, ...]:
    """Replace some nodes in derivatives, but not in their seeds and initial values."""
    # One call for all rows: values that they share are replaced once. The order is that of `nodes`.
    new = iter(substitute([node for row in rows for node in row.nodes], replacement))

    def again(row: Mapping[int, Node]) -> dict[int, Node]:
        # Taken from the iterator whether it vanishes or not, so that the order is kept.
        made = {i: next(new) for i in row}
        return {i: node for i, node in made.items() if not node.is_zero}

    return tuple(
        replace(
            row,
            forcing=tuple(next(new) for _ in row.forcing),
            rates=again(row.rates),
            outputs=again(row.outputs),
            held=tuple(next(new) for _ in row.held),
            held_rates=tuple(next(new) for _ in row.held_rates),
            start=tuple(next(new) for _ in row.start),
        )
        for row in rows
    )


#: Parameters that a message names.
_MOST_SHOWN = 5


@dataclass(frozen=True)
class Quantity:
    """A named parameter, input or output, with its unit and meaning."""

    name: str
    unit: str = ""
    doc: str = ""


@dataclass(frozen=True)
class State:
    """A state."""

    #: ``edge.coordinate`` or ``edge.coordinate_dot``, and its SI unit.
    name: str
    unit: str
    symbol: Node  # the state as an argument of the program
    initial: Node  # its initial value, of parameters only
    is_given: bool = True  # whether the scene gives it, or it may change to satisfy constraints
    #: Whether an equation 0 = g, no rate, determines it; its initial value is then a guess.
    is_algebraic: bool = False
    #: For a state that is the content of a storage, the algebraic unknown that follows from it.
    follower: str = ""


@dataclass(frozen=True)
class ConstraintSet:
    """Constraints that the states must satisfy."""

    rows: tuple[Quantity, ...]  # name and unit of each constraint
    edges: tuple[str, ...]  # the edge that each belongs to
    # Levels of position and of velocity, which a projection enforces; the level of acceleration is
    # part of A w = b.
    #: The residual of each, which must be zero; None for constraints on rates only.
    values: tuple[Node | None, ...]
    rates: tuple[Node, ...]  # the rate of each, which must be zero too
    gradient: tuple[tuple[Node, ...], ...]  # derivatives of the rates by the speeds
    #: Sums of squares of the gradient's terms, before anything cancels.
    sizes: tuple[tuple[Node, ...], ...]
    #: Edges whose rotation is free, with the four states that are to keep the norm one.
    quaternions: tuple[tuple[str, tuple[Node, ...]], ...]
    # Conditions of the consistent start besides the constraints.
    #: Further start conditions: initial values of coordinates and rates that are not states.
    start_rows: tuple[Quantity, ...]
    start_is_rate: tuple[bool, ...]  # whether each is a rate
    #: Their residuals; then the values of ``redundant`` by the states, then those that are given.
    start_values: tuple[Node, ...]
    #: Derivatives by the speeds, of rates of coordinates by the speeds too.
    start_gradient: tuple[tuple[Node, ...], ...]
    #: Initial values of networks that must agree with those of the states.
    redundant: tuple[RedundantRow, ...] = ()


@dataclass(frozen=True)
class Guard:
    """Condition on a function of parameters that the equations require."""

    value: Node
    what: str  # name of the value, as the subject of a message
    is_strict: bool  # whether it must be positive, or only not negative
    #: Predicate of the message if the condition fails; empty where the value itself says it.
    breach: str = ""
    parameters: tuple[str, ...] = ()  # names of the parameters that the value is made of

    def named(self, names: Sequence[str]) -> Guard:
        """Name the parameters that the value is made of, from the names of all of them."""
        symbols = symbols_in([self.value])
        # Symbols of parameters are numbered in the order of the tunable ones.
        places = sorted(symbol.data[1] for symbol in symbols if symbol.data[0] == PARAMETER)
        return replace(self, parameters=tuple(names[place] for place in places))

    @property
    def source(self) -> str:
        """The parameters as an appendix to a sentence."""
        if not self.parameters:
            return ""
        kind = "parameter" if len(self.parameters) == 1 else "parameters"
        shown = ", ".join(f"'{name}'" for name in self.parameters[:_MOST_SHOWN])
        # A guard on a long chain may depend on dozens of parameters.
        hidden = len(self.parameters) - _MOST_SHOWN
        return f" ({kind} {shown}{f' and {hidden} more' if hidden > 0 else ''})"

    @property
    def demand(self) -> str:
        """The condition as a sentence, without the number that the value has."""
        if self.breach:
            return f"{self.what} {self.breach}{self.source}"
        wanted = "be positive" if self.is_strict else "not be negative"
        return f"{self.what} must {wanted}{self.source}"

    def check(self, number: float) -> None:
        """Raise ParameterError if the number does not satisfy the guard."""
        # Written so that nan satisfies no guard.
        if number > 0.0 or (number == 0.0 and not self.is_strict):
            return
        if self.breach:
            raise ParameterError(self.demand)
        wanted = "be positive" if self.is_strict else "not be negative"
        raise ParameterError(f"{self.what} is {number:.6g}: it must {wanted}{self.source}")


@dataclass(frozen=True)
class EventRow:
    """An event at the passage of a value through zero."""

    name: str
    direction: int  # -1 for downwards, 1 for upwards, 0 for both
    is_stop: bool  # whether a run ends there
    # States that the event sets, and places of the values that it looks at and sets them to.
    #: The states that it sets: by expressions, then the speeds that its impact changes, all.
    targets: tuple[int, ...]
    watched: int  # place of the value among :attr:`Equations.output_values`
    new_values: range  # places of the expressions there, in the order of their targets
    #: Place of the coefficient of restitution there; None where there is no impact.
    restitution: int | None
    results: range  # places of the new values of all targets among those of all events
    #: Whether it sets the mode of a jump inside an expression, and its value counts from it.
    is_jump: bool = False
    is_count: bool = False
    #: What of an edge whose mode is chosen with those of others it looks at, see
    #: :class:`cotree.scene.events.ModePart`; zero where it is no such event.
    part: int = 0
    #: Whether it happens where an impact at a rigid stop ends in rest; whether it looks at the
    #: force of one; and whether it looks at the speed of friction that one presses together.
    is_rest: bool = False
    is_lift: bool = False
    is_pressed: bool = False

    @property
    def is_impact(self) -> bool:
        """Whether an impulse changes all speeds."""
        return self.restitution is not None

    @property
    def kept(self) -> tuple[int, ...]:
        """The states that expressions set, which constraints leave as they are."""
        # Targets of expressions come first, those of the impact after them.
        return self.targets[: len(self.new_values)]

    @property
    def causes(self) -> dict[int, int]:
        """The place of what each target is set by: an expression, or the restitution."""
        own = dict(zip(self.kept, self.new_values, strict=True))
        if self.restitution is None:
            return own
        # One coefficient of restitution sets all speeds, by the impulse of the impact.
        return own | dict.fromkeys(self.targets[len(own) :], self.restitution)


@dataclass(frozen=True)
class Equations:
    """Governing and sensitivity equations of a scene."""

    name: str  # name of the scene
    dag: Dag  # the arena
    states: tuple[State, ...]  # x: coordinates, speeds, states of networks, algebraic unknowns
    #: p, u and y, in the order of their symbols.
    parameters: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    # The scene's own values, where a run gives no others.
    parameter_values: tuple[float, ...]  # the scene's values of p
    #: The symbols of u, and the scene's own values of time and parameters.
    input_symbols: tuple[Node, ...]
    input_values: tuple[Node, ...]
    # A(x) w = b(x): accelerations and multipliers, eliminated when the equations are lowered.
    #: Symbols of w and of its derivatives.
    unknowns: tuple[Node, ...]
    unknown_tangents: tuple[Node, ...]
    matrix: Sequence[Sequence[Node]]  # A, symmetric
    forcing: tuple[Node, ...]  # b
    is_safe: tuple[bool, ...]  # whether each unknown's pivot is positive for every state
    #: The tree, where elimination along it costs less than that of the matrix; else empty.
    links: tuple[TreeLink, ...]
    # M x' = rates(x, w), and what has to hold besides.
    rates: tuple[Node, ...]  # M x' in terms of x and w
    balances: tuple[Node, ...]  # ``A w - b`` as the formulation wrote it, for people
    constraints: ConstraintSet  # constraints on the states; the last unknowns are their multipliers
    #: y; then the value of each event; then, event by event, new values and restitution.
    output_values: tuple[Node, ...]
    # Derivatives along directions: the same A and M, with right-hand sides of their own.
    #: Along each requested parameter together with its states' sensitivities, and along each state.
    sensitivities: tuple[Derivative, ...]
    columns: tuple[Derivative, ...]
    guards: tuple[Guard, ...]  # conditions that parameter values must satisfy
    # Layout of x: coordinates, speeds, modes, states of networks, algebraic unknowns.
    #: Number of modes and states of networks, algebraic unknowns not counted.
    n_network_states: int = 0
    n_modes: int = 0  # number of modes, which come first among these
    events: tuple[EventRow, ...] = ()
    #: Along the motion itself, where there are events or algebraic unknowns, in terms of rates of
    #: the states as symbols.
    motion: Derivative | None = None
    #: Along a change of all states and of the parameters that sensitivities are taken to, where
    #: these are several, in terms of these changes as symbols; see :mod:`cotree.dag.nodes`.
    direction: Derivative | None = None
    #: What ends the pieces that steps hold; see :mod:`cotree.program.surfaces`.
    corners: tuple[CornerRow, ...] = ()
    #: For each of these pieces the number of the one that an argument is in; zero for signs.
    pieces: tuple[Node, ...] = ()
    positions: tuple[PositionRow, ...] = ()  # positions in networks that are sums of states
    #: Names of the initial values of coordinates and rates that the scene gives, in its order.
    given: tuple[str, ...] = ()
    derived: tuple[DerivedParameter, ...] = ()  # parameters that follow from p

    @property
    def n_algebraic(self) -> int:
        """Number of algebraic unknowns, which come last among the states."""
        return sum(state.is_algebraic for state in self.states)

    @property
    def n_speeds(self) -> int:
        """Number of speeds, whose rates are the first of the unknowns."""
        # Each constraint has one multiplier among the unknowns.
        return len(self.unknowns) - len(self.constraints.rows)

    @property
    def n_coordinates(self) -> int:
        """Number of coordinates, which come first among the states."""
        # Free rotations have four coordinates and three speeds, so that the numbers differ.
        others = self.n_speeds + self.n_network_states + self.n_algebraic
        return len(self.states) - others

    def with_derivatives(self, replacement: Mapping[Node, Node]) -> Equations:
        """Replace some nodes in all derivatives; see :func:`substituted`."""
        return replace(
            self,
            sensitivities=substituted(self.sensitivities, replacement),
            columns=substituted(self.columns, replacement),
            motion=self.motion and substituted([self.motion], replacement)[0],
            direction=self.direction and substituted([self.direction], replacement)[0],
        )

    def summary(self) -> str:
        """Describe the equations in a few lines."""
        names = ", ".join(state.name for state in self.states)
        by = ", ".join(row.name for row in self.sensitivities) or "none"
        return (
            f"{self.name}: {len(self.states)} states ({names}), {len(self.unknowns)} unknowns, "
            f"{len(self.parameters)} parameters, sensitivities to: {by}"
        )


@dataclass(frozen=True)
class DerivedParameter:
    """A parameter that follows from others."""

    #: As of other parameters.
    name: str
    unit: str
    doc: str
    text: str  # the expression that gives it, as the scene has it
    node: Node = field(repr=False)  # its value, of the symbols of parameters
    #: Names of all parameters that are arguments, in the order of their symbols.
    arguments: tuple[str, ...] = field(repr=False)

    @property
    def sources(self) -> tuple[str, ...]:
        """The parameters that it follows from and a run may change."""
        symbols = symbols_in([self.node])
        places = sorted(symbol.data[1] for symbol in symbols if symbol.data[0] == PARAMETER)
        return tuple(self.arguments[place] for place in places)

    @property
    def told(self) -> str:
        """Describe the expression that cannot be chosen."""
        shown = listed(f"'{source}'" for source in self.sources)
        tail = f"; it follows from {shown}" if shown else ""
        return f"parameter '{self.name}' is derived, {self.name} = {self.text}{tail}"


@dataclass(frozen=True)
class RedundantRow:
    """An initial value of a variable that is not a state but follows from states."""

    name: str  # of the variable
    states: tuple[str, ...]  # the states that the variable follows from
    is_position: bool = False  # whether it is a position, which follows along an f-circuit


@dataclass(frozen=True)
class PositionRow:
    """A position that is no state: the sum of those along its f-circuit."""

    #: Of the position.
    name: str
    unit: str
    terms: tuple[tuple[int, int], ...]  # signs, and the states by their numbers

    def sum_of(self, values: Any) -> Any:
        """Sum an array of states, or of their sensitivities, along its last axis."""
        return sum(sign * values[..., i] for sign, i in self.terms)
