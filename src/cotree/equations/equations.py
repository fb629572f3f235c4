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
    """A corner of the rates, which a value reaches where it passes through zero.

    Attributes
    ----------
    value : Node
        The value, relative to the end of the piece that is held.
    piece : int
        Which of the pieces that are held ends there.
    direction : int
        Zero where the piece is the sign of the value; else what is added to its number where the
        value passes through zero in that direction.
    """

    value: Node
    piece: int
    direction: int


def spread(row: Mapping[int, Node], n: int, zero: Node) -> list[Node]:
    """Write a sparse row out in full.

    Parameters
    ----------
    row : mapping of int to Node
        Its values by place.
    n : int
        Its length.
    zero : Node
        The value at the places that it leaves out.
    """
    return [row.get(i, zero) for i in range(n)]


@dataclass(frozen=True)
class Derivative:
    """Derivatives of the equations along one direction.

    Of states and outputs there may be many thousands, each direction changing a few: their
    derivatives are kept by place, those that vanish left out.

    Attributes
    ----------
    name : str
        The parameter or state that the direction belongs to.
    seed : mapping of Node to Node
        Tangents of the symbols.
    forcing : tuple of Node
        Right-hand side of ``A w_p = forcing``, unknowns held fixed.
    rates : mapping of int to Node
        Derivatives of the state rates, in terms of :attr:`Equations.unknown_tangents`.
    outputs : mapping of int to Node
        Derivatives of the outputs.
    initial : mapping of int to Node
        Derivatives of the initial values.
    held, held_rates : tuple of Node
        Derivatives of the constraints and of their rates.
    start : tuple of Node
        Derivatives of :attr:`ConstraintSet.start_values`.
    """

    name: str
    seed: Mapping[Node, Node]
    forcing: tuple[Node, ...]
    rates: Mapping[int, Node]
    outputs: Mapping[int, Node]
    initial: Mapping[int, Node]
    held: tuple[Node, ...]
    held_rates: tuple[Node, ...]
    start: tuple[Node, ...]

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
    """A state.

    Attributes
    ----------
    name, unit : str
        ``edge.coordinate`` or ``edge.coordinate_dot``, and its SI unit.
    symbol : Node
        The state as an argument of the program.
    initial : Node
        Its initial value, of parameters only.
    is_given : bool
        Whether the scene gives it, or it may change to satisfy constraints.
    is_algebraic : bool
        Whether an equation 0 = g, no rate, determines it; its initial value is then a guess.
    follower : str
        For a state that is the content of a storage, the algebraic unknown that follows from it.
    """

    name: str
    unit: str
    symbol: Node
    initial: Node
    is_given: bool = True
    is_algebraic: bool = False
    follower: str = ""


@dataclass(frozen=True)
class ConstraintSet:
    """Constraints that the states must satisfy.

    Attributes
    ----------
    rows : tuple of Quantity
        Name and unit of each constraint.
    edges : tuple of str
        The edge that each belongs to.
    values : tuple of Node or None
        The residual of each, which must be zero; None for constraints on rates only.
    rates : tuple of Node
        The rate of each, which must be zero too.
    gradient : tuple of rows of Node
        Derivatives of the rates by the speeds.
    sizes : tuple of rows of Node
        Sums of squares of the gradient's terms, before anything cancels.
    quaternions : tuple of (str, tuple of Node)
        Edges whose rotation is free, with the four states that are to keep the norm one.
    start_rows : tuple of Quantity
        Further start conditions: initial values of coordinates and rates that are not states.
    start_is_rate : tuple of bool
        Whether each is a rate.
    start_values : tuple of Node
        Their residuals; then the values of ``redundant`` by the states, then those that are given.
    start_gradient : tuple of rows of Node
        Derivatives by the speeds, of rates of coordinates by the speeds too.
    redundant : tuple of RedundantRow
        Initial values of networks that must agree with those of the states.
    """

    rows: tuple[Quantity, ...]
    edges: tuple[str, ...]
    # Levels of position and of velocity, which a projection enforces; the level of acceleration is
    # part of A w = b.
    values: tuple[Node | None, ...]
    rates: tuple[Node, ...]
    gradient: tuple[tuple[Node, ...], ...]
    sizes: tuple[tuple[Node, ...], ...]
    quaternions: tuple[tuple[str, tuple[Node, ...]], ...]
    # Conditions of the consistent start besides the constraints.
    start_rows: tuple[Quantity, ...]
    start_is_rate: tuple[bool, ...]
    start_values: tuple[Node, ...]
    start_gradient: tuple[tuple[Node, ...], ...]
    redundant: tuple[RedundantRow, ...] = ()


@dataclass(frozen=True)
class Guard:
    """Condition on a function of parameters that the equations require.

    Attributes
    ----------
    value : Node
        The value.
    what : str
        Name of the value, as the subject of a message.
    is_strict : bool
        Whether it must be positive, or only not negative.
    breach : str
        Predicate of the message if the condition fails; empty where the value itself says it.
    parameters : tuple of str
        Names of the parameters that the value is made of.
    """

    value: Node
    what: str
    is_strict: bool
    breach: str = ""
    parameters: tuple[str, ...] = ()

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
    """An event at the passage of a value through zero.

    Attributes
    ----------
    name : str
        Its name.
    direction : int
        -1 for downwards, 1 for upwards, 0 for both.
    is_stop : bool
        Whether a run ends there.
    targets : tuple of int
        The states that it sets: by expressions, then the speeds that its impact changes, all.
    watched : int
        Place of the value among :attr:`Equations.output_values`.
    new_values : range
        Places of the expressions there, in the order of their targets.
    restitution : int or None
        Place of the coefficient of restitution there; None where there is no impact.
    results : range
        Places of the new values of all targets among those of all events.
    is_jump, is_count : bool
        Whether it sets the mode of a jump inside an expression, and its value counts from it.
    part : int
        What of an edge whose mode is chosen with those of others it looks at, see
        :class:`cotree.scene.events.ModePart`; zero where it is no such event.
    is_rest, is_lift, is_pressed : bool
        Whether it happens where an impact at a rigid stop ends in rest; whether it looks at the
        force of one; and whether it looks at the speed of friction that one presses together.
    """

    name: str
    direction: int
    is_stop: bool
    # States that the event sets, and places of the values that it looks at and sets them to.
    targets: tuple[int, ...]
    watched: int
    new_values: range
    restitution: int | None
    results: range
    is_jump: bool = False
    is_count: bool = False
    part: int = 0
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
    """Governing and sensitivity equations of a scene.

    Attributes
    ----------
    name : str
        Name of the scene.
    dag : Dag
        The arena.
    states : tuple of State
        x: coordinates, speeds, states of networks, algebraic unknowns.
    parameters, inputs, outputs : tuple of Quantity
        p, u and y, in the order of their symbols.
    parameter_values : tuple of float
        The scene's values of p.
    derived : tuple of DerivedParameter
        Parameters that follow from p.
    input_symbols, input_values : tuple of Node
        The symbols of u, and the scene's own values of time and parameters.
    unknowns, unknown_tangents : tuple of Node
        Symbols of w and of its derivatives.
    matrix : sequence of rows of Node
        A, symmetric.
    forcing : tuple of Node
        b.
    is_safe : tuple of bool
        Whether each unknown's pivot is positive for every state.
    links : tuple of TreeLink
        The tree, where elimination along it costs less than that of the matrix; else empty.
    rates : tuple of Node
        M x' in terms of x and w.
    balances : tuple of Node
        ``A w - b`` as the formulation wrote it, for people.
    constraints : ConstraintSet
        Constraints on the states; the last unknowns are their multipliers.
    output_values : tuple of Node
        y; then the value of each event; then, event by event, new values and restitution.
    sensitivities, columns : tuple of Derivative
        Along each requested parameter together with its states' sensitivities, and along each
        state.
    guards : tuple of Guard
        Conditions that parameter values must satisfy.
    n_network_states : int
        Number of modes and states of networks, algebraic unknowns not counted.
    n_modes : int
        Number of modes, which come first among these.
    events : tuple of EventRow
        The events.
    motion : Derivative or None
        Along the motion itself, where there are events or algebraic unknowns, in terms of rates of
        the states as symbols.
    direction : Derivative or None
        Along a change of all states and of the parameters that sensitivities are taken to, where
        these are several, in terms of these changes as symbols; see :mod:`cotree.dag.nodes`.
    corners : tuple of CornerRow
        What ends the pieces that steps hold; see :mod:`cotree.program.surfaces`.
    positions : tuple of PositionRow
        Positions in networks that are sums of states.
    given : tuple of str
        Names of the initial values of coordinates and rates that the scene gives, in its order.
    pieces : tuple of Node
        For each of these pieces the number of the one that an argument is in; zero for signs.
    """

    name: str
    dag: Dag
    states: tuple[State, ...]
    parameters: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    # The scene's own values, where a run gives no others.
    parameter_values: tuple[float, ...]
    input_symbols: tuple[Node, ...]
    input_values: tuple[Node, ...]
    # A(x) w = b(x): accelerations and multipliers, eliminated when the equations are lowered.
    unknowns: tuple[Node, ...]
    unknown_tangents: tuple[Node, ...]
    matrix: Sequence[Sequence[Node]]
    forcing: tuple[Node, ...]
    is_safe: tuple[bool, ...]
    links: tuple[TreeLink, ...]
    # M x' = rates(x, w), and what has to hold besides.
    rates: tuple[Node, ...]
    balances: tuple[Node, ...]
    constraints: ConstraintSet
    output_values: tuple[Node, ...]
    # Derivatives along directions: the same A and M, with right-hand sides of their own.
    sensitivities: tuple[Derivative, ...]
    columns: tuple[Derivative, ...]
    guards: tuple[Guard, ...]
    # Layout of x: coordinates, speeds, modes, states of networks, algebraic unknowns.
    n_network_states: int = 0
    n_modes: int = 0
    events: tuple[EventRow, ...] = ()
    motion: Derivative | None = None
    direction: Derivative | None = None
    corners: tuple[CornerRow, ...] = ()
    pieces: tuple[Node, ...] = ()
    positions: tuple[PositionRow, ...] = ()
    given: tuple[str, ...] = ()
    derived: tuple[DerivedParameter, ...] = ()

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
    """A parameter that follows from others.

    Attributes
    ----------
    name, unit, doc : str
        As of other parameters.
    text : str
        The expression that gives it, as the scene has it.
    node : Node
        Its value, of the symbols of parameters.
    arguments : tuple of str
        Names of all parameters that are arguments, in the order of their symbols.
    """

    name: str
    unit: str
    doc: str
    text: str
    node: Node = field(repr=False)
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
    """An initial value of a variable that is not a state but follows from states.

    Attributes
    ----------
    name : str
        Of the variable.
    states : tuple of str
        The states that the variable follows from.
    is_position : bool
        Whether it is a position, which follows along an f-circuit.
    """

    name: str
    states: tuple[str, ...]
    is_position: bool = False


@dataclass(frozen=True)
class PositionRow:
    """A position that is no state: the sum of those along its f-circuit.

    Attributes
    ----------
    name, unit : str
        Of the position.
    terms : tuple of (int, int)
        Signs, and the states by their numbers.
    """

    name: str
    unit: str
    terms: tuple[tuple[int, int], ...]

    def sum_of(self, values: Any) -> Any:
        """Sum an array of states, or of their sensitivities, along its last axis."""
        return sum(sign * values[..., i] for sign, i in self.terms)
