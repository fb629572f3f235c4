"""Equations of a scene: ``A(x) w = b(x)`` and ``M x' = rates(x, w)``, with their derivatives.

The unknowns w, accelerations and multipliers, solve linear equations at each instant. M is
diagonal: one for states with a rate, zero for algebraic unknowns, which come last among the states
and whose ``rates`` are the residuals of their equations. A derivative along a direction has the
same matrices on the left: ``A w_p = b_p`` and ``M x_p' = rates_p``. All values are nodes of one
arena.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from cotree.dag.nodes import PARAMETER, Dag, Node, reachable, substitute, symbols_in
from cotree.errors import ParameterError, listed
from cotree.quantities import PositionRow as PositionRow  # noqa: TC001
from cotree.quantities import Quantity as Quantity  # noqa: TC001
from cotree.quantities import RedundantRow as RedundantRow  # noqa: TC001

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.linear.tree_elimination import TreeLink

#: Operations with branches.
_PIECEWISE = frozenset({"select", "abs", "sign", "table", "lookup"})


@dataclass(frozen=True)
class KinkRow:
    """A kink of the rates, at the zero of a value."""

    value: Node  # value whose zero is the end of the branch
    piece: int  # index of the frozen branch
    #: Increment of the branch number if the value crosses zero upwards. If it is zero, the branch
    #: is the sign of the value.
    direction: int
    #: Whether the branch is the half-width of a band around zero in which a root is regularised.
    is_steep: bool = False


def spread(row: Mapping[int, Node], n: int, zero: Node) -> list[Node]:
    """Convert a sparse row to a list of ``n`` nodes; absent entries become ``zero``."""
    return [row.get(i, zero) for i in range(n)]


@dataclass(frozen=True)
class Derivative:
    """Derivatives of the equations along one direction.

    Only nonzero derivatives are stored, by index, because most of them may be zero.
    """

    name: str  # parameter or state by which the equations are differentiated
    seed: Mapping[Node, Node]  # derivative (tangent) of each symbol in this direction
    forcing: tuple[Node, ...]  # right-hand side of ``A w_p = forcing``, with w constant
    #: Derivatives of the state rates, in terms of :attr:`Equations.unknown_tangents`.
    rates: Mapping[int, Node]
    outputs: Mapping[int, Node]  # derivatives of the outputs, by index
    initial: Mapping[int, Node]  # derivatives of the initial values, by state
    #: Derivatives of the constraints and of their rates.
    held: tuple[Node, ...]
    held_rates: tuple[Node, ...]
    start: tuple[Node, ...]  # derivatives of :attr:`ConstraintSet.start_values`

    @property
    def nodes(self) -> list[Node]:
        """All nodes of the derivative except the seed and the derivatives of the initial values."""
        rates, outputs = self.rates.values(), self.outputs.values()
        return [*self.forcing, *rates, *outputs, *self.held, *self.held_rates, *self.start]


def substituted(
    rows: Sequence[Derivative], replacement: Mapping[Node, Node]
) -> tuple[Derivative, ...]:
    """Replace nodes in derivatives, but not in their seeds and initial values."""
    # One call replaces shared values once for all rows; nodes are in the order of `nodes`.
    new = iter(substitute([node for row in rows for node in row.nodes], replacement))

    def again(row: Mapping[int, Node]) -> dict[int, Node]:
        # Every entry must advance the iterator, so remove zeros afterwards.
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


#: Largest number of parameters named in a message.
_MOST_SHOWN = 5


@dataclass(frozen=True)
class State:
    """A state of the equations, with its unit and initial value."""

    #: ``edge.coordinate`` or ``edge.coordinate_dot``, and its SI unit.
    name: str
    unit: str
    symbol: Node  # symbol of the state in the program
    initial: Node  # initial value as a function of parameters
    is_given: bool = True  # whether the value is prescribed; if not, constraints may change it
    #: Whether an algebraic equation 0 = g determines the state; its initial value is a guess.
    is_algebraic: bool = False
    #: If the state is the content of storages: name of the algebraic unknown computed from it.
    follower: str = ""


@dataclass(frozen=True)
class ConstraintSet:
    """Constraints that the states must satisfy."""

    rows: tuple[Quantity, ...]  # name and unit of each constraint equation
    edges: tuple[str, ...]  # name of the edge that causes each constraint equation
    # Residual of each constraint; None for constraints on rates only. Projection enforces
    # constraints and their rates; their second derivatives are part of A w = b.
    values: tuple[Node | None, ...]
    rates: tuple[Node, ...]  # time derivative of each constraint
    gradient: tuple[tuple[Node, ...], ...]  # derivatives of ``rates`` with respect to speeds
    #: For each entry of the gradient, the sum of the squares of its terms, which cannot cancel.
    sizes: tuple[tuple[Node, ...], ...]
    #: Edges with a free rotation, each with the four states of its unit quaternion.
    quaternions: tuple[tuple[str, tuple[Node, ...]], ...]
    # Conditions of a consistent start in addition to the constraints: initial values of coordinates
    # and rates that are not states.
    start_rows: tuple[Quantity, ...]
    start_is_rate: tuple[bool, ...]  # whether each condition is a rate
    #: Residuals of the conditions; then the values of the ``redundant`` variables, first those that
    #: follow from the states, then the prescribed ones.
    start_values: tuple[Node, ...]
    #: Derivatives of the conditions with respect to the speeds; for coordinates, of their rates.
    start_gradient: tuple[tuple[Node, ...], ...]
    #: Prescribed initial values of network variables that the states also determine.
    redundant: tuple[RedundantRow, ...] = ()


@dataclass(frozen=True)
class Guard:
    """A sign condition on a function of parameters, without which the equations are invalid."""

    value: Node
    what: str  # name of the value, used as the subject of a message
    is_strict: bool  # whether the value must be positive instead of nonnegative
    #: End of the message if the condition fails; empty for "must be positive" and the like.
    breach: str = ""
    parameters: tuple[str, ...] = ()  # names of the parameters on which the value depends

    def named(self, names: Sequence[str]) -> Guard:
        """Return the guard with its parameters' names; ``names`` are those of all parameters."""
        symbols = symbols_in([self.value])
        # The numbers of parameter symbols are indices of tunable parameters.
        places = sorted(symbol.data[1] for symbol in symbols if symbol.data[0] == PARAMETER)
        return replace(self, parameters=tuple(names[place] for place in places))

    @property
    def source(self) -> str:
        """The names of the parameters in parentheses, for the end of a sentence."""
        if not self.parameters:
            return ""
        kind = "parameter" if len(self.parameters) == 1 else "parameters"
        shown = ", ".join(f"'{name}'" for name in self.parameters[:_MOST_SHOWN])
        # A guard on a long chain may depend on dozens of parameters.
        hidden = len(self.parameters) - _MOST_SHOWN
        return f" ({kind} {shown}{f' and {hidden} more' if hidden > 0 else ''})"

    @property
    def demand(self) -> str:
        """The condition as a sentence that does not state the actual value."""
        if self.breach:
            return f"{self.what} {self.breach}{self.source}"
        wanted = "be positive" if self.is_strict else "not be negative"
        return f"{self.what} must {wanted}{self.source}"

    def check(self, number: float) -> None:
        """Raise ParameterError if the number does not satisfy the guard."""
        # A comparison with nan is false, so nan violates every guard.
        if number > 0.0 or (number == 0.0 and not self.is_strict):
            return
        if self.breach:
            raise ParameterError(self.demand)
        wanted = "be positive" if self.is_strict else "not be negative"
        raise ParameterError(f"{self.what} is {number:.6g}: it must {wanted}{self.source}")


@dataclass(frozen=True)
class EventRow:
    """An event at the zero crossing of a value."""

    name: str
    direction: int  # crossing direction: -1 downwards, 1 upwards, 0 both
    is_terminal: bool  # whether the event ends the run
    # Indices of the states that the event sets: by expressions, then by its impact.
    targets: tuple[int, ...]
    watched: int  # index of the event function in :attr:`Equations.output_values`
    new_values: range  # indices of the new values in :attr:`Equations.output_values`, by target
    #: Index of the coefficient of restitution in the new values; None without an impact.
    restitution: int | None
    results: range  # indices of the event's new values among the new values of all events
    #: Whether the event increments the mode of a jump in an expression.
    is_jump: bool = False
    is_count: bool = False
    #: Role of the event for an edge whose mode is chosen together with the modes of other edges,
    #: see :class:`cotree.scene.events.ModePart`; zero if there is none.
    part: int = 0
    #: Whether the event is an impact that a rigid stop ends at rest; whether its function is the
    #: force of a stop; whether its function is the slip of friction at a stop.
    is_rest: bool = False
    is_lift: bool = False
    is_pressed: bool = False

    @property
    def kept(self) -> tuple[int, ...]:
        """Indices of the states that expressions set, which projection must not change."""
        # Targets of expressions precede targets of the impact.
        return self.targets[: len(self.new_values)]

    @property
    def causes(self) -> dict[int, int]:
        """Index of the expression or of the coefficient of restitution that sets each target."""
        own = dict(zip(self.kept, self.new_values, strict=True))
        if self.restitution is None:
            return own
        # The coefficient of restitution and the impulse determine all speeds after an impact.
        return own | dict.fromkeys(self.targets[len(own) :], self.restitution)


@dataclass(frozen=True)
class HeldUnknown:
    """A multiplier: the force or torque of static friction or of a closed stop."""

    name: str
    column: tuple[Node, ...]  # generalised forces per unit of the unknown
    sizes: tuple[Node, ...]  # sums of the squared terms of each entry


@dataclass(frozen=True)
class Equations:
    """Governing and sensitivity equations of a scene."""

    name: str  # name of the scene
    dag: Dag  # arena of all nodes
    states: tuple[State, ...]  # states x, see ``n_network_states`` for their order
    #: Parameters p, inputs u and outputs y, in the order of their symbols.
    parameters: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    parameter_values: tuple[float, ...]  # values stated in the scene, which a run may replace
    #: Symbols of u, and values of u in the scene as functions of time and parameters.
    input_symbols: tuple[Node, ...]
    input_values: tuple[Node, ...]
    # Symbols of w in A(x) w = b(x) and of the derivatives of w. Lowering eliminates them.
    unknowns: tuple[Node, ...]
    unknown_tangents: tuple[Node, ...]
    matrix: Sequence[Sequence[Node]]  # matrix A of ``A w = b``, symmetric
    forcing: tuple[Node, ...]  # right-hand side b of ``A w = b``
    is_safe: tuple[bool, ...]  # whether each unknown has a positive pivot in every state
    holding: tuple[HeldUnknown, ...]  # multipliers of friction and stops, the last unknowns
    #: Links of the tree, if elimination along it costs less than elimination of the matrix.
    links: tuple[TreeLink, ...]
    rates: tuple[Node, ...]  # M x' as functions of x and w
    balances: tuple[Node, ...]  # ``A w - b`` as formulated, for display
    constraints: ConstraintSet  # constraints; their multipliers follow the accelerations in w
    #: Values of outputs y, of event functions, then new values and restitution, event by event.
    output_values: tuple[Node, ...]
    # Derivatives along directions, with the same A and M but different right-hand sides: along each
    # requested parameter together with the sensitivities of the states, and along each state.
    sensitivities: tuple[Derivative, ...]
    columns: tuple[Derivative, ...]
    guards: tuple[Guard, ...]  # conditions that parameter values must satisfy
    # Number of modes and network states, without algebraic unknowns. The order of x is:
    # coordinates, speeds, modes, network states, algebraic unknowns.
    n_network_states: int = 0
    n_modes: int = 0
    events: tuple[EventRow, ...] = ()
    #: Derivative along the motion, as a function of symbols for the state rates; None without
    #: events and algebraic unknowns.
    motion: Derivative | None = None
    #: Derivative along a common change of all states and of the parameters of several
    #: sensitivities, as a function of symbols for these changes; see :mod:`cotree.dag.nodes`.
    direction: Derivative | None = None
    #: Kinks at the ends of branches that are frozen during steps; see
    #: :mod:`cotree.program.surfaces`.
    kinks: tuple[KinkRow, ...] = ()
    #: Numbers of the current branches; zero for signs.
    pieces: tuple[Node, ...] = ()
    positions: tuple[PositionRow, ...] = ()  # network positions that are sums of states
    #: Names of coordinates and rates whose initial values the scene prescribes, in its order.
    given: tuple[str, ...] = ()
    derived: tuple[DerivedParameter, ...] = ()  # parameters derived from p

    @property
    def is_piecewise(self) -> bool:
        """Whether the rates have branches: selections, absolute values, signs or tables."""
        order = reachable([*self.forcing, *self.rates])
        return any(node.op in _PIECEWISE for node in order)

    @property
    def n_algebraic(self) -> int:
        """Number of algebraic unknowns, which come last among the states."""
        return sum(state.is_algebraic for state in self.states)

    @property
    def n_speeds(self) -> int:
        """Number of speeds; their rates are the first unknowns."""
        # Each constraint, and each edge held by friction, adds a multiplier to the unknowns.
        return len(self.unknowns) - len(self.constraints.rows) - len(self.holding)

    @property
    def n_coordinates(self) -> int:
        """Number of coordinates, which come first among the states."""
        # A free rotation has four coordinates but three speeds, so the numbers may differ.
        others = self.n_speeds + self.n_network_states + self.n_algebraic
        return len(self.states) - others

    def with_derivatives(self, replacement: Mapping[Node, Node]) -> Equations:
        """Return the equations with nodes replaced in all derivatives; see :func:`substituted`."""
        return replace(
            self,
            sensitivities=substituted(self.sensitivities, replacement),
            columns=substituted(self.columns, replacement),
            motion=self.motion and substituted([self.motion], replacement)[0],
            direction=self.direction and substituted([self.direction], replacement)[0],
        )

    def summary(self) -> str:
        """Return a summary: the names of the states, and the numbers of unknowns and parameters."""
        names = ", ".join(state.name for state in self.states)
        by = ", ".join(row.name for row in self.sensitivities) or "none"
        return (
            f"{self.name}: {len(self.states)} states ({names}), {len(self.unknowns)} unknowns, "
            f"{len(self.parameters)} parameters, sensitivities to: {by}"
        )


@dataclass(frozen=True)
class DerivedParameter:
    """A parameter that follows from others."""

    #: Name, unit and description of the parameter.
    name: str
    unit: str
    doc: str
    text: str  # expression of the value, as stated in the scene
    node: Node = field(repr=False)  # value as a function of parameters
    #: Names of the model's parameters, in the order of their symbols.
    arguments: tuple[str, ...] = field(repr=False)

    @property
    def sources(self) -> tuple[str, ...]:
        """Names of the tunable parameters in its expression."""
        symbols = symbols_in([self.node])
        places = sorted(symbol.data[1] for symbol in symbols if symbol.data[0] == PARAMETER)
        return tuple(self.arguments[place] for place in places)

    @property
    def dependence(self) -> str:
        """A clause that explains why its value cannot be set."""
        shown = listed(f"'{source}'" for source in self.sources)
        tail = f"; it follows from {shown}" if shown else ""
        return f"parameter '{self.name}' is derived, {self.name} = {self.text}{tail}"
