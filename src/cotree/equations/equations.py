"""Equations of a scene: ``A(x) w = b(x)`` and ``M x' = rates(x, w)``, with their derivatives.

The unknowns w, accelerations and multipliers, solve linear equations at each instant. M is
diagonal: one for states with a rate, zero for algebraic unknowns, which nonlinear equations give.
Those come last among the states, and their ``rates`` are the residuals of these equations. A
derivative along a direction has the same matrices on the left: ``A w_p = b_p`` and
``M x_p' = rates_p``. Everything is nodes of one arena.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag.symbols import PARAMETER
from cotree.dag.traverse import symbols_in
from cotree.equations.derivative import substituted
from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations.corner import CornerRow
    from cotree.equations.derivative import Derivative
    from cotree.equations.derived import DerivedParameter, PositionRow, RedundantRow
    from cotree.linear.tree import TreeLink

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
        these are several, in terms of these changes as symbols; see :mod:`cotree.dag.symbols`.
    corners : tuple of CornerRow
        What ends the pieces that steps hold; see :mod:`cotree.program.pieces`.
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
