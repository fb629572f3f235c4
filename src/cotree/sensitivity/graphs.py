"""Sensitivity graphs G2, G3, ...: the formulation in dual numbers.

Columns of the Jacobian, parameter sensitivities and initial-value sensitivities differ only in
their seeds. Each direction yields one :class:`~cotree.equations.Derivative`.
"""

from __future__ import annotations

from collections import Counter, defaultdict
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING, Any

from cotree.components import FreeRotation
from cotree.dag.derivative import tangents
from cotree.dag.dual import is_varied, tangent_of, value_of, varied
from cotree.dag.nodes import (
    PARAMETER_CHANGE,
    SENSITIVITY,
    STATE_CHANGE,
    STATE_RATE,
    UNKNOWN_CHANGE,
    Node,
    substitute,
    symbols_in,
    symbols_of_each,
)
from cotree.equations import (
    ConstraintSet,
    Derivative,
    DerivedParameter,
    Equations,
    HeldUnknown,
    Quantity,
    RedundantRow,
    substituted,
)
from cotree.errors import ParameterError, nearest
from cotree.formulation.constraints import stabilised
from cotree.formulation.elements import Action, Sums, Wrench, act
from cotree.formulation.initial_states import given_names
from cotree.formulation.outputs import output_tangents, units_of_expressions
from cotree.formulation.through import Balance, Loads, gather_chords, loads_of, project_cutsets
from cotree.scene.expressions import Expression
from cotree.sensitivity.turning import Seed, Support, derivatives_labelled, view_along

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from cotree.formulation.across import Motion, View
    from cotree.formulation.first_graph import FirstGraph
    from cotree.formulation.laws import Applied
    from cotree.formulation.measures import Measure, Pull
    from cotree.formulation.networks.states import Redundant


class Changes(Sums):
    """Sums of wrenches on clusters; sums that change along the seed are dual numbers."""

    def __init__(self, motion: Motion, first: Balance) -> None:
        super().__init__(len(motion.omega))
        self._frames, self._first = motion.frames, first.totals

    def gather(self, cluster: int, wrench: Wrench) -> None:
        """Add the tangent of a wrench to a cluster's sum."""
        if is_varied(wrench.force, wrench.torque):
            # The first graph's sum already contains the value, so only the tangent is added.
            super().gather(cluster, Wrench(tangent_of(wrench.force), tangent_of(wrench.torque)))

    def at(self, cluster: int) -> Wrench | None:
        """Return a cluster's sum, or None if neither the sum nor the cluster's motion changes."""
        # Projections and moments are products, so their tangents also need the value of the sum.
        first, change = self._first[cluster], super().at(cluster)
        if change is None:
            # The sum is constant, but the motion spaces onto which it is projected may rotate.
            return None if self._frames.is_kept(cluster) else first
        return Wrench(varied(first.force, change.force), varied(first.torque, change.torque))

    def takes(self, cluster: int, *parts: Any) -> bool:
        """Return whether a wrench that is formed from ``parts`` changes along the seed."""
        return not self._frames.is_kept(cluster) or is_varied(*parts)


def residual_tangents(
    view: View, loads: Loads, balance: Balance, applied: Sequence[Applied]
) -> list[Node]:
    """Form the tangents of the projected f-cutset equations, one per coordinate.

    Coordinate accelerations are constant; ``loads`` and ``balance`` are the first graph's.
    """
    motion = view.motion
    # Repeat the first graph's traversal in dual numbers: terminal equations (Eq. (4)), f-cutsets
    # (Eq. (1)), and projection onto the motion spaces (Eq. (5)).
    changes, loaded = Changes(motion, balance), _loads(view, loads, applied)
    gather_chords(motion, loaded, view.across, changes)
    rows = project_cutsets(motion, loaded, changes)
    # The values of the rows are the first graph's balances, which are zero.
    return [tangent_of(row) for row in rows]


def _loads(view: View, first: Loads, applied: Sequence[Applied]) -> Loads:
    """Return the loads that change along the seed, and the inertias of all clusters."""
    motion = view.motion
    elements = []
    for action in first.actions:
        if _is_reached(motion, action):
            with motion.system.dag.labelled(f"terminal equation of {action.edge.name}"):
                elements.append(act(motion, action.edge))
    return loads_of(motion, elements, first).plus(list(_pulls(view, applied)))


def _is_reached(motion: Motion, action: Action) -> bool:
    frames, edge = motion.frames, action.edge
    points = (action.first, action.second)
    # If an end of the edge moves, the across variable changes even if no field does.
    if not all(frames.is_kept(point.cluster) for point in points):
        return True
    if is_varied(*(frames.seen(value) for value in edge.scalars.values())):
        return True
    fields = (*edge.vectors.values(), *(point.local for point in points))
    return any(is_varied(*map(frames.seen, field)) for field in fields)


def _pulls(view: View, applied: Sequence[Applied]) -> Iterator[Pull]:
    """Yield the pulls of through variables that change; multipliers are held constant."""
    for row in applied:
        with view.motion.system.dag.labelled(f"through variable of {row.edge}"):
            # The derivative of a multiplier is an unknown on the left-hand side.
            amount = row.magnitude if row.formula is None else row.amount(view)
            yield row.measure.pull(view).scaled(amount)


@dataclass(frozen=True)
class Reach:
    """For each symbol, the indices of the values that depend on it, so that others are skipped."""

    #: Indices of outputs, and of initial values, by symbol.
    outputs: Mapping[Node, list[int]]
    initial: Mapping[Node, list[int]]
    #: Indices of outputs that depend on unknowns and so change along every direction.
    moving: tuple[int, ...]
    starts: tuple[Node, ...]  # initial values
    #: Indices of constraints, and of through variables along measures, by symbol.
    held: Mapping[Node, list[int]]
    pulled: Mapping[Node, list[int]]

    @classmethod
    def of(cls, first: FirstGraph, changing: Iterable[Node]) -> Reach:
        """Index the values in the equations by the symbols ``changing`` and the unknowns."""
        # Index only symbols that change along at least one direction.
        among = {*changing, *first.unknowns, *first.measured}
        outputs = _by_symbol(first.outputs.values, among)
        # Reactions in friction fields contain accelerations.
        unknowns = (*first.unknowns, *first.reactions)
        moving = {i for symbol in unknowns for i in outputs.get(symbol, ())}
        starts = tuple(state.initial for state in first.states)
        rows = first.constraints
        held = [
            # Position, rate and acceleration of a constraint may depend on different symbols.
            [*gradient, rate, bias, *([] if value is None else [value])]
            for gradient, rate, bias, value in zip(
                rows.gradient, rows.rates, rows.biases, rows.values, strict=True
            )
        ]
        held += [[*row.gradient, row.bias, row.jump, row.share] for row in first.holdings]
        pulled = [[row.magnitude, *row.pull.entries] for row in first.applied]
        return cls(
            outputs,
            _by_symbol(starts, among),
            tuple(moving),
            starts,
            _rows_by_symbol(held, among),
            _rows_by_symbol(pulled, among),
        )


def _by_symbol(nodes: Sequence[Node], among: set[Node]) -> dict[Node, list[int]]:
    return _rows_by_symbol([[node] for node in nodes], among)


def _rows_by_symbol(rows: Sequence[Sequence[Node]], among: set[Node]) -> dict[Node, list[int]]:
    found: defaultdict[Node, dict[int, None]] = defaultdict(dict)
    # One traversal covers all nodes of all rows; `places` contains the row of each node.
    places = [i for i, row in enumerate(rows) for _ in row]
    for i, symbols in zip(places, symbols_of_each([*chain(*rows)], among), strict=True):
        for symbol in symbols:
            found[symbol][i] = None
    return {symbol: list(own) for symbol, own in found.items()}


def rows_touched(rows: Mapping[Node, list[int]], symbols: Iterable[Node]) -> list[int]:
    """Return the sorted indices of the rows that depend on any of the symbols."""
    return sorted({i for symbol in symbols for i in rows.get(symbol, ())})


def derived_parameters(
    first: FirstGraph, units: Mapping[str, str] | None = None
) -> tuple[DerivedParameter, ...]:
    """Return the derived parameters of a scene with their units."""
    units = units or {}
    nodes, names = first.system.parameters, tuple(first.system.tunable)
    return tuple(
        DerivedParameter(
            row.name, units.get(row.name, row.unit), row.doc, row.value.text, nodes[row.name], names
        )
        for row in first.scene.parameters.values()
        if isinstance(row.value, Expression)
    )


def check_wanted(first: FirstGraph, wanted: Sequence[str]) -> None:
    """Raise ParameterError if a name is repeated or has no sensitivity."""
    tunable = list(first.system.tunable)
    states = [state.name for state in first.states]
    derived = {row.name: row for row in derived_parameters(first)}
    for name, times in Counter(wanted).items():
        if times > 1:
            raise ParameterError(f"the sensitivity to '{name}' is requested twice")
        if name in tunable or name in states:
            continue
        if name in derived:
            raise ParameterError(
                f"{derived[name].dependence}: request sensitivities to these instead"
            )
        if name in first.scene.parameters:
            raise ParameterError(
                f"parameter '{name}' is not tunable, so it has no sensitivity: declare it tunable"
            )
        raise ParameterError(
            f"'{name}' is neither a parameter nor a state{nearest(name, [*tunable, *states])}"
        )


def differentiate(
    first: FirstGraph, directions: Mapping[str, Mapping[Node, Node]], support: Support
) -> list[Derivative]:
    """Evaluate sensitivity graphs; ``directions`` maps names to the tangents of symbols."""
    # The index limits the work along each direction to values that depend on its symbols.
    reach = Reach.of(first, {symbol for row in directions.values() for symbol in row})
    if first.network is None:
        return [
            _along(first, name, row, support, reach, {}, {}) for name, row in directions.items()
        ]
    from cotree.sensitivity.network_graphs import coupling_tangents, network_tangents

    # Fields of the networks may contain across variables of the multibody system.
    ahead = [{**row, **_measured_tangents(first, row)} for row in directions.values()]
    # Port measures link the mechanism to the networks; `seeds` link the networks to it.
    couplings = coupling_tangents(first, ahead, support)
    networks = network_tangents(first.network, ahead, couplings, support)
    return [
        _along(
            first,
            name,
            row,
            support,
            reach,
            networks.seeds.get(i, {}),
            networks.rates_along.get(i, {}),
        )
        for i, (name, row) in enumerate(zip(directions, ahead, strict=True))
    ]


def _tangents_at(
    nodes: Sequence[Node], places: Iterable[int], seed: Mapping[Node, Node]
) -> dict[int, Node]:
    """Differentiate the nodes with the indices ``places``; omit zero derivatives."""
    if not seed:
        return {}
    chosen = sorted(set(places))
    along = tangents([nodes[i] for i in chosen], seed)
    return {i: d for i, d in zip(chosen, along, strict=True) if not d.is_zero}


def _along(
    first: FirstGraph,
    name: str,
    symbols: Mapping[Node, Node],
    support: Support,
    reach: Reach,
    of_networks: Mapping[Node, Node],
    network_rates: Mapping[int, Node],
) -> Derivative:
    """Evaluate one multibody sensitivity graph, and add the tangents of the networks."""
    dag = first.system.dag
    # Across variables in fields are symbols, whose tangents follow from those of the states.
    symbols = {**symbols, **_measured_tangents(first, {**symbols, **of_networks})}
    seed = Seed(dag, symbols, support)
    with derivatives_labelled(dag):
        view = view_along(first, seed)
        touched = rows_touched(reach.pulled, symbols)
        pulled = [first.applied[i] for i in sorted({*touched, *_turned_pulls(first, view)})]
        residual = residual_tangents(view, first.loads, first.balance, pulled)
        rate = first.constraints.baumgarte
        # Constraints that do not depend on the direction have zero tangents at all levels.
        n_held = len(first.constraints.rows)
        held = [(dag.zero, dag.zero, dag.zero)] * n_held
        sticking = [dag.zero] * len(first.holdings)
        for i in rows_touched(reach.held, symbols):
            if i < n_held:
                held[i] = _held_tangents(view, first.constraints.rows[i].measure, rate)
                continue
            row = first.holdings[i - n_held]
            acceleration = row.measure.acceleration(view)
            share, jump = tangents([row.share, row.jump], symbols)
            sticking[i - n_held] = jump - row.share * tangent_of(acceleration)
            if not share.is_zero:
                sticking[i - n_held] -= share * (value_of(acceleration) + row.multiplier)
    with dag.labelled("derivatives of rates and outputs"):
        of_unknowns = dict(zip(first.unknowns, unknown_tangents(first), strict=True))
        # Reactions in joint friction depend on the accelerations.
        along = _measured_tangents(first, of_unknowns) if first.reactions else {}
        of_reactions = {symbol: d for symbol, d in along.items() if symbol in first.reactions}
        of_unknowns |= of_reactions
        # Friction forces depend on their multipliers.
        of_reactions |= {row.multiplier: of_unknowns[row.multiplier] for row in first.holdings}
        # The networks' rates come last; their tangents come from the networks' sensitivity graphs.
        n = len(first.rates) - (len(first.network.rates) if first.network else 0)
        rates = _tangents_at(first.rates, range(n), {**symbols, **of_unknowns})
        rates |= {n + i: changed for i, changed in network_rates.items()}
        # Sticking friction on a joint depends on accelerations, which change along any direction.
        for i, d in _tangents_at(first.rates, range(n, len(first.rates)), of_unknowns).items():
            rates[i] = rates[i] + d if i in rates else d
        # The sensitivity graph has the tangents of positions and velocities in outputs.
        of_networks = _with_reactions(first, of_networks, of_reactions)
        of_nodes = {**of_networks, **output_tangents(view.motion, first.outputs)}
        touched = [i for symbol in symbols for i in reach.outputs.get(symbol, ())]
        outputs = _tangents_at(
            first.outputs.values,
            [*touched, *reach.moving],
            {**symbols, **of_unknowns, **_sums(symbols, of_reactions), **of_nodes},
        )
        # Initial values depend on parameters, but not on states.
        started = [i for symbol in symbols for i in reach.initial.get(symbol, ())]
        initial = _tangents_at(reach.starts, started, symbols)
    return Derivative(
        name,
        dict(symbols),
        # A w_p = b_p - A_p w. The balances' residual is A w - b, while the rows of constraints
        # contain -G: the signs are opposite.
        (*(-row for row in residual), *(acceleration for _, _, acceleration in held), *sticking),
        rates,
        outputs,
        initial,
        tuple(value for value, _, _ in held),
        tuple(rate for _, rate, _ in held),
        _start_tangents(first, view, seed, of_networks),
    )


def _with_reactions(
    first: FirstGraph, of_networks: Mapping[Node, Node], of_reactions: Mapping[Node, Node]
) -> Mapping[Node, Node]:
    """Add the effect of changing reactions to the tangents of observed variables."""
    if first.network is None or not of_reactions:
        return of_networks
    values = [first.network.solved.values[variable] for variable in first.network.watched]
    values = [value for value in dict.fromkeys(values) if value.value is None]
    along = dict(zip(values, tangents(values, of_reactions), strict=True))
    return {**of_networks, **along, **_sums(of_networks, along)}


def _sums(first: Mapping[Node, Node], second: Mapping[Node, Node]) -> dict[Node, Node]:
    return {node: first[node] + second[node] for node in first if node in second}


def _measured_tangents(first: FirstGraph, symbols: Mapping[Node, Node]) -> dict[Node, Node]:
    along = tangents(list(first.measured.values()), symbols)
    return {key: d for key, d in zip(first.measured, along, strict=True) if not d.is_zero}


def _turned_pulls(first: FirstGraph, view: View) -> list[int]:
    """Return the indices of the pulls whose basis rotates along the seed."""
    turned = view.motion.frames.turned
    if not turned:
        return []
    return [
        i
        for i, row in enumerate(first.applied)
        if any(cluster in turned for cluster, _, _ in row.pull.wrenches)
    ]


def _held_tangents(view: View, measure: Measure, baumgarte: float) -> tuple[Node, Node, Node]:
    value = measure.value(view)
    zero = view.motion.system.dag.zero
    return (
        zero if value is None else tangent_of(value),
        tangent_of(measure.rate(view)),
        tangent_of(stabilised(measure, view, baumgarte)),
    )


def state_columns(first: FirstGraph, support: Support) -> tuple[Derivative, ...]:
    """Return the derivatives along each state, which are the columns of the Jacobian."""
    one = first.system.dag.one
    # The direction of a column is a unit change of one state.
    directions = {state.name: {state.symbol: one} for state in first.states}
    return tuple(differentiate(first, directions, support))


def input_columns(first: FirstGraph) -> tuple[Derivative, ...]:
    """Return the derivatives along each input."""
    support, one = Support(), first.system.dag.one
    directions = {name: {symbol: one} for name, symbol in first.system.inputs.items()}
    columns = differentiate(first, directions, support)
    return substituted(columns, first.measured)


def form_derivatives(
    first: FirstGraph, wanted: Sequence[str], support: Support | None = None
) -> tuple[Derivative, ...]:
    """Differentiate along parameters or initial values, including the sensitivities of the states.

    The sensitivity of state i to quantity j is the symbol ``(SENSITIVITY, j * n_states + i)``; see
    :mod:`cotree.dag.nodes`.
    """
    check_wanted(first, wanted)
    dag, n = first.system.dag, len(first.states)
    support = support or Support()
    directions = {}
    for j, name in enumerate(wanted):
        # The states change too: their sensitivities are states of the extended system.
        directions[name] = {
            state.symbol: dag.symbol(SENSITIVITY, j * n + i) for i, state in enumerate(first.states)
        }
        if name in first.system.tunable:
            directions[name] |= _with_inputs(first, {first.system.tunable[name]: dag.one})
    return tuple(
        row if row.name in first.system.tunable else _initial_value(row, first)
        for row in differentiate(first, directions, support)
    )


def _with_inputs(first: FirstGraph, changes: Mapping[Node, Node]) -> dict[Node, Node]:
    """Add the tangents of scene inputs that depend on changing parameters or on time."""
    system = first.system
    along = tangents(system.input_values, changes)
    inputs = zip(system.inputs.values(), along, strict=True)
    return {**changes, **{symbol: tangent for symbol, tangent in inputs if not tangent.is_zero}}


def _initial_value(direction: Derivative, first: FirstGraph) -> Derivative:
    """Return the direction along which only the initial value of one state changes, by one."""
    own = next(i for i, state in enumerate(first.states) if state.name == direction.name)
    # Initial values affect only the start, at which the derivative of the state is one.
    return replace(direction, initial={own: first.system.dag.one})


def unknown_tangents(first: FirstGraph) -> tuple[Node, ...]:
    """Return the symbols of the derivatives of the unknowns."""
    dag = first.system.dag
    return tuple(dag.symbol(UNKNOWN_CHANGE, i) for i in range(len(first.unknowns)))


def form_equations(
    first: FirstGraph, sensitivities: Sequence[str], *, with_columns: bool = True
) -> Equations:
    """Add sensitivity graphs to the first graph; without ``with_columns``, omit the Jacobian."""
    scene, system = first.scene, first.system
    support = Support()
    parameters = [scene.parameters[name] for name in system.tunable]
    own = {state.name: state.unit for state in first.states}
    units, derived = units_of_expressions(scene, own)
    equations = Equations(
        name=scene.name,
        dag=system.dag,
        states=first.states,
        parameters=tuple(Quantity(p.name, p.unit, p.doc) for p in parameters),
        inputs=tuple(Quantity(row.name, row.unit, row.doc) for row in scene.inputs.values()),
        outputs=tuple(Quantity(name, unit) for name, unit in units.items()),
        parameter_values=tuple(p.number for p in parameters),
        derived=derived_parameters(first, derived),
        input_symbols=tuple(system.inputs.values()),
        input_values=system.input_values,
        unknowns=first.unknowns,
        unknown_tangents=unknown_tangents(first),
        matrix=first.matrix,
        forcing=first.forcing,
        is_safe=first.is_safe,
        holding=tuple(HeldUnknown(row.name, row.column, row.sizes) for row in first.holdings),
        links=first.links,
        rates=first.rates,
        balances=first.balance.residual,
        constraints=_gather_constraints(first),
        output_values=first.outputs.values,
        sensitivities=form_derivatives(first, sensitivities, support),
        columns=state_columns(first, support) if with_columns else (),
        guards=first.guards,
        # Modes are counted here because they lie between the speeds and the networks' states.
        n_network_states=len(system.modes) + (first.network.n_differential if first.network else 0),
        n_modes=len(system.modes),
        events=first.events,
        positions=first.network.positions if first.network else (),
        given=given_names(scene),
        motion=(
            differentiate(first, {"t": _motion_seed(first)}, support)[0]
            if scene.events or any(state.is_algebraic for state in first.states)
            else None
        ),
        direction=(
            _common_direction(first, sensitivities, support)
            if len(sensitivities) > 1 or (with_columns and first.unknowns)
            else None
        ),
    )
    return _closed(equations, first.measured) if first.measured else equations


def _motion_seed(first: FirstGraph) -> dict[Node, Node]:
    """Return tangents along the motion: symbols for rates of states, rates of inputs, dt/dt = 1."""
    dag = first.system.dag
    seed = {state.symbol: dag.symbol(STATE_RATE, i) for i, state in enumerate(first.states)}
    return seed | _with_inputs(first, {first.system.time: dag.one})


def _common_direction(first: FirstGraph, wanted: Sequence[str], support: Support) -> Derivative:
    """Differentiate along a common change of all states and parameters."""
    dag, parameters = first.system.dag, first.system.tunable
    seed = {state.symbol: dag.symbol(STATE_CHANGE, i) for i, state in enumerate(first.states)}
    changes = {
        parameters[name]: dag.symbol(PARAMETER_CHANGE, j)
        for j, name in enumerate(wanted)
        if name in parameters
    }
    return differentiate(first, {"": {**seed, **_with_inputs(first, changes)}}, support)[0]


def _closed(equations: Equations, measured: Mapping[Node, Node]) -> Equations:
    """Replace the symbols in fields by the across variables that they represent."""
    # Measured network variables may depend on measured multibody variables.
    known = dict(zip(measured, substitute(list(measured.values()), measured), strict=True))

    def closed(nodes: Sequence[Node]) -> tuple[Node, ...]:
        return tuple(substitute(nodes, known))

    # The matrix contains the inertias of storages that are coupled to joints.
    still = {unknown: equations.dag.zero for unknown in equations.unknowns}
    return replace(
        equations.with_derivatives(known),
        # Terms of accelerations in fields are part of the matrix, hence zero in the forcing.
        forcing=tuple(substitute(closed(equations.forcing), still)),
        rates=closed(equations.rates),
        balances=closed(equations.balances),
        output_values=closed(equations.output_values),
    )


def _gather_constraints(first: FirstGraph) -> ConstraintSet:
    """Collect the constraints for projection, for the start and for reports."""
    rows = first.constraints
    steps = [step for own in first.system.steps.values() for step in own]
    redundant = first.network.redundant if first.network else ()
    followed = _followed(first, redundant)
    return ConstraintSet(
        rows=tuple(Quantity(row.name, row.unit) for row in rows.rows),
        edges=tuple(row.edge for row in rows.rows),
        values=rows.values,
        rates=rows.rates,
        gradient=rows.gradient,
        sizes=rows.sizes,
        quaternions=tuple(
            (step.edge, tuple(c.symbol for c in step.coordinates))
            for step in steps
            if isinstance(step.kind, FreeRotation)
        ),
        start_rows=tuple(Quantity(row.name, row.unit) for row in first.conditions),
        start_is_rate=tuple(row.is_rate for row in first.conditions),
        # The start requires this order: conditions on chords, values of redundant variables that
        # follow from states, prescribed initial values of these variables.
        start_values=(
            *(
                (row.measure.rate(first.view) if row.is_rate else row.measure.value(first.view))
                - row.given
                for row in first.conditions
            ),
            *followed,
            *(row.given for row in redundant),
        ),
        start_gradient=tuple(row.gradient for row in first.conditions),
        redundant=tuple(
            RedundantRow(row.name, tuple(_states_in(first, value)), row.variable[0] == "stretch")
            for row, value in zip(redundant, followed, strict=True)
        ),
    )


def _start_tangents(
    first: FirstGraph, view: View, seed: Seed, of_networks: Mapping[Node, Node]
) -> tuple[Node, ...]:
    """Differentiate :attr:`ConstraintSet.start_values`; ``of_networks`` are network tangents."""
    network = first.network
    redundant = network.redundant if network else ()
    # The order of the three blocks is that of `start_values`.
    values = [network.solved.values[row.variable] for row in redundant] if network else []
    return (
        *(
            tangent_of(row.measure.rate(view) if row.is_rate else row.measure.value(view))
            - seed.of(row.given)
            for row in first.conditions
        ),
        *(of_networks.get(value, seed.dag.zero) for value in values),
        *(seed.of(row.given) for row in redundant),
    )


def _followed(first: FirstGraph, redundant: Sequence[Redundant]) -> list[Node]:
    """Return the values of redundant variables that follow from states and sources."""
    if first.network is None or not redundant:
        return []
    measured = first.measured
    # Measured values may contain other measured values, so substitute twice.
    known = dict(zip(measured, substitute(list(measured.values()), measured), strict=True))
    values = substitute([first.network.solved.values[row.variable] for row in redundant], known)
    unknowns = set(first.unknowns)
    for row, value in zip(redundant, values, strict=True):
        # The start depends only on states and parameters; accelerations are computed later.
        if not unknowns.isdisjoint(symbols_in([value])):
            raise ParameterError(
                f"'{row.name}' depends on accelerations, so it cannot have an initial value: "
                "remove it"
            )
    return values


def _states_in(first: FirstGraph, value: Node) -> list[str]:
    own = set(symbols_in([value]))
    return [state.name for state in first.states if state.symbol in own]
