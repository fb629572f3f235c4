"""From equations to a program: eliminate the unknowns and collect the kernels.

Projection kernels take a step of minimum kinetic energy: the solution of the governing equations
with constraint residuals instead of forces.

For models with algebraic unknowns, ``x' = f(x, z), 0 = g(x, z)``, explicit methods need further
kernels. They are formed from rates, residuals and their derivatives, all with the same factors of
g_z in straight-line code:

- the *extended* rates x' and ``z' = -g_z^-1 (g_x x' + g_t)``. Unknowns are integrated like states,
  from a solution, and projected onto a solution after each step. Their sensitivities follow without
  integration: ``S_z = -g_z^-1 (g_x S_x + g_p)``.
- a step from a guess of z towards the solution, and the rates of x at its end. The step is a Taylor
  series: along ``g(z(s)) = (1 - s) g(z(0))`` the derivatives with respect to s are

      z' = -g_z^-1 g,    z'' = -g_z^-1 (g_zz z' z'),

  and z(1) is the solution. The remainder is of third order in the step. The kernel also estimates
  the validity of the series: the length of the step relative to the distance over which the
  curvature of any function changes.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate, chain
from typing import TYPE_CHECKING, TypeVar

from cotree.dag.derivative import tangents
from cotree.dag.nodes import (
    PACKED_SENSITIVITY,
    SENSITIVITY,
    STATE_RATE,
    STEP,
    Dag,
    Node,
    dependent,
    reachable,
    substitute,
    symbols_in,
)
from cotree.dag.switching_times import acts_in_part, find_longest_steps, find_time_events
from cotree.equations import Equations, Quantity, spread
from cotree.errors import ParameterError
from cotree.linear.factors import SparseFactors, factorise_unsymmetric
from cotree.program.columns import map_rates
from cotree.program.counts import count_operations
from cotree.program.kernels import KERNELS
from cotree.program.layout import Layout
from cotree.program.program import Kernel, Program
from cotree.program.sensitivity_pattern import (
    followers,
    pack_rates,
    reached_states,
    timed_by,
    without_vanishing,
)
from cotree.program.solved import Along, SolvedSystem
from cotree.tolerances import TINY

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence


#: Rank tolerance of projections. Constraints count as redundant if the distance from a singular
#: configuration is below its square root: corrections would amplify rounding errors there.
_RANK = 1e-8


def constraint_quantities(equations: Equations) -> tuple[Quantity, ...]:
    """Return names and units of the results of the kernel ``constraints``."""
    rows = equations.constraints
    held = zip(rows.rows, rows.values, strict=True)
    values = [row for row, value in held if value is not None]
    rates = [
        row
        if value is None
        else Quantity(f"{row.name}_dot", f"{row.unit}/s" if row.unit else "1/s")
        for row, value in zip(rows.rows, rows.values, strict=True)
    ]
    norms = [Quantity(f"{edge}.norm") for edge, _ in rows.quaternions]
    return (*values, *rates, *norms)


def projection_kernels(equations: Equations, solved: SolvedSystem) -> dict[str, list[Node]]:
    """Form the results of the constraint kernels; they are empty if there are no constraints."""
    rows = equations.constraints
    results: dict[str, list[Node]] = {
        "constraints": [],
        "constraint_sensitivity": [],
        "gradient": [],
        "projection": [],
        "sensitivity_projection": [],
        "start": list(rows.start_values),
        "start_gradient": [entry for row in rows.start_gradient for entry in row],
        "start_sensitivity": [node for row in equations.sensitivities for node in row.start],
    }
    if not rows.rows and not rows.quaternions:
        return results
    norms = [_square(q) - 1.0 for _, q in rows.quaternions]
    with equations.dag.labelled("constraints"):
        results["constraints"] = [*(v for v in rows.values if v is not None), *rows.rates, *norms]
        results["gradient"] = [entry for row in rows.gradient for entry in row]
    with equations.dag.labelled("projection"):
        zero = equations.dag.zero
        # Constraints on speeds alone have no position residual.
        values = [zero if v is None else v for v in rows.values]
        shrink: dict[Node, Node] = {}
        # To first order, rotations keep the norms of quaternions: correct these norms separately.
        for (_, q), norm in zip(rows.quaternions, norms, strict=True):
            # Newton's step along q for |q|^2 = 1, no rotation: dq = -q (|q|^2 - 1) / (2 |q|^2).
            factor = norm / (2.0 * _square(q))
            shrink |= {entry: -(factor * entry) for entry in q}
        results["projection"] = _step(equations, solved, values, rows.rates, shrink)
        for row in equations.sensitivities:
            d_norms = tangents(norms, row.seed)
            held = [d for d, v in zip(row.held, rows.values, strict=True) if v is not None]
            results["constraint_sensitivity"] += [*held, *row.held_rates, *d_norms]
            shrink = {}
            for (_, q), d_norm in zip(rows.quaternions, d_norms, strict=True):
                factor = d_norm / (2.0 * _square(q))
                shrink |= {entry: -(factor * entry) for entry in q}
            results["sensitivity_projection"] += _step(
                equations, solved, row.held, row.held_rates, shrink
            )
    return results


def _square(q: Sequence[Node]) -> Node:
    total = q[0].dag.zero
    for entry in q:
        total = total + entry * entry
    return total


def _step(
    equations: Equations,
    solved: SolvedSystem,
    values: Sequence[Node],
    rates: Sequence[Node],
    shrink: dict[Node, Node],
) -> list[Node]:
    """Form the change of states that removes the constraint residuals ``values`` and ``rates``."""
    n, n_coordinates = equations.n_speeds, equations.n_coordinates
    zeros = [equations.dag.zero] * n
    # The lower rows of [M, -G^T; -G, 0] [v; *] = [0; c] are G v + c = 0: to first order, the
    # residual vanishes. Of all such v, the solution has minimum kinetic energy.
    shift = solved.bare.solve([*zeros, *values], _RANK)[:n]
    speed = solved.bare.solve([*zeros, *rates], _RANK)[:n]
    speeds = [state.symbol for state in equations.states[n_coordinates : n_coordinates + n]]
    # Coordinate rates are linear in the speeds: for the shift, they are changes of coordinates.
    known = dict(zip(speeds, shift, strict=True))
    moved = substitute(equations.rates[:n_coordinates], known)
    coordinates = [state.symbol for state in equations.states[:n_coordinates]]
    return [
        *(d + shrink.get(q, equations.dag.zero) for q, d in zip(coordinates, moved, strict=True)),
        *speed,
        *([equations.dag.zero] * (len(equations.states) - n_coordinates - n)),
    ]


#: Maximum numbers of unknowns, of factor updates, and of operations of kernels that eliminate
#: algebraic unknowns. Larger kernels take longer to compile than dense matrix loops to run.
_MOST_UNKNOWNS, _MOST_UPDATES, _MOST_OPERATIONS = 100, 2000, 3000

# Functions whose curvature changes if the argument changes by 1; functions that change curvature,
# or have a kink, if the argument changes by its own magnitude.
_OF_CHANGE = frozenset({"exp", "sin", "cos", "sinh", "cosh", "tanh", "atan"})
_OF_SHARE = frozenset({"sqrt", "log", "abs", "sign"})


def reduced_kernels(
    equations: Equations,
    rates: Sequence[Node],
    columns: Sequence[Mapping[int, Node]],
    along: Sequence[Along],
    motion: Along,
    reached: Sequence[Sequence[int]],
) -> dict[str, list[Node]]:
    """Form the results of the kernels for explicit methods with algebraic unknowns.

    ``rates`` are f, then g; ``columns`` has their derivatives with respect to each state, by rate
    index; ``along`` has derivatives along each parameter, as functions of state sensitivities;
    ``motion`` along the motion, as functions of state rates. ``reached`` contains the states with
    sensitivities to each parameter. Results are empty without algebraic unknowns, or if kernels
    would be too long.
    """
    found: dict[str, list[Node]] = {
        "algebraic_step": [],
        "extended_rhs": [],
        "extended_augmented_rhs": [],
        "algebraic_sensitivity": [],
    }
    cut = len(rates) - equations.n_algebraic
    if not 0 < equations.n_algebraic <= _MOST_UNKNOWNS:
        return found
    with equations.dag.labelled("elimination of algebraic unknowns"):
        # The last rates are residuals. Their derivatives with respect to all unknowns are g_z.
        slopes = _rows_of(columns[cut:], cut, len(rates))
        factorised = factorise_unsymmetric(equations.dag, slopes, _MOST_UPDATES)
        if factorised is None:
            return found
        factors, doubt = factorised
        symbols = [state.symbol for state in equations.states[cut:]]
        found["algebraic_step"] = [*_newton_step(factors, rates, slopes, symbols), doubt]
        # With constraints, a different projection is used.
        is_held = equations.constraints.rows or equations.constraints.quaternions
        if cut > 0 and equations.motion is not None and not is_held:
            extended = [*rates[:cut], *_unknown_rates(equations, factors, rates, motion)]
            along_rates, along_unknowns = _sensitivities(
                equations, factors, columns[cut:], along, reached
            )
            # This kernel serves runs without sensitivities.
            found["extended_rhs"] = extended
            if along:
                found["extended_augmented_rhs"] = [*extended, *along_rates]
            found["algebraic_sensitivity"] = along_unknowns
    return {
        # Kernels that are too long are omitted; the engine then solves dense systems.
        name: nodes if count_operations(reachable(nodes)).total <= _MOST_OPERATIONS else []
        for name, nodes in found.items()
    }


def _rows_of(columns: Sequence[Mapping[int, Node]], low: int, high: int) -> list[dict[int, Node]]:
    """Return the rows from ``low`` to ``high`` of a matrix from its columns."""
    rows: list[dict[int, Node]] = [{} for _ in range(low, high)]
    for j, column in enumerate(columns):
        for i, node in column.items():
            if low <= i < high:
                rows[i - low][j] = node
    return rows


def _newton_step(
    factors: SparseFactors,
    rates: Sequence[Node],
    slopes: Sequence[Mapping[int, Node]],
    symbols: Sequence[Node],
) -> list[Node]:
    """Form the rates at the end of a step, the step, its second-order part and its validity."""
    dag, cut = factors.dag, len(rates) - len(symbols)
    first = factors.solve([-node for node in rates[cut:]])
    # Second derivatives use symbols for z', which are then replaced by its long expressions.
    known = {dag.symbol(STEP, j): node for j, node in enumerate(first)}
    seed = dict(zip(symbols, known, strict=True))
    changes, reach = _bends(dag, rates, seed), dag.one
    last = [dag.zero] * len(first)
    if changes is not None:
        reach = sum(substitute(changes, known), dag.zero)
        curved = substitute(_curvature(dag, slopes, seed), known)
        # The last term of the series is z''/2, since s goes from 0 to 1.
        last = factors.solve([-0.5 * node for node in curved])
    step = [a + b for a, b in zip(first, last, strict=True)]
    ends = _values_after(rates[:cut], dict(zip(symbols, step, strict=True)))
    return [*ends, *step, *last, reach]


def _curvature(
    dag: Dag, slopes: Sequence[Mapping[int, Node]], seed: Mapping[Node, Node]
) -> list[Node]:
    """Form g_zz z' z' by differentiating the rows of first derivatives along a step."""
    steps = list(seed.values())
    changes = iter(tangents([node for row in slopes for node in row.values()], seed))
    return [sum((next(changes) * steps[j] for j in row), dag.zero) for row in slopes]


def _values_after(values: Sequence[Node], step: Mapping[Node, Node]) -> list[Node]:
    """Return values at the end of a step; costly exponentials are replaced by series."""
    new = {symbol: symbol + change for symbol, change in step.items()}
    order = reachable(values)
    changing = dependent(order, step)
    for node in order:
        if node.op == "exp" and node in changing:
            # exp(a + d) = exp(a) (1 + d + d^2/2) has an error of third order, like the step itself.
            change = tangents(node.args, step)[0]
            # The tangent equals the argument's change only if the argument is linear in the step.
            if not changing.isdisjoint(reachable([change], stop=set(step.values()))):
                change = substitute(node.args, new)[0] - node.args[0]
            new[node] = node + node * (change + 0.5 * (change * change))
    return substitute(values, new)


def _bends(dag: Dag, roots: Sequence[Node], seed: Mapping[Node, Node]) -> list[Node] | None:
    """Return the length of a step relative to the validity of the linear model, for each function.

    The linear model of a function fails at a length of about one. Return None if the length is
    unknown for a function, such as a table or an external function.
    """
    order = reachable(roots)
    changing = dependent(order, seed)
    of_change: dict[Node, None] = {}
    of_share: dict[Node, None] = {}
    for node in order:
        inner = [arg for arg in node.args if arg in changing]
        # Sums are linear in the step, and so are products and quotients with one changing factor.
        if not inner or node.op in ("add", "sub", "neg"):
            continue
        if node.op in _OF_CHANGE:
            of_change |= dict.fromkeys(inner)
        elif node.op in _OF_SHARE or (node.op == "mul" and len(inner) == 2):
            of_share |= dict.fromkeys(inner)
        elif node.op == "div" and node.args[1] in changing:
            of_share[node.args[1]] = None
        elif node.op == "pow" and node.args[1] not in changing:
            of_share[node.args[0]] = None
        elif node.op == "select":
            if node.args[0] in changing:
                of_share[node.args[0]] = None
        elif node.op not in ("mul", "div"):
            return None
    changes = tangents([*of_change, *of_share], seed)
    sizes = [dag.function("abs", change) for change in changes]
    shares = [
        # The fraction tends to one if the change exceeds the value.
        size / (dag.function("abs", arg) + size + TINY)
        for arg, size in zip(of_share, sizes[len(of_change) :], strict=True)
    ]
    return [*sizes[: len(of_change)], *shares]


def _moved(
    values: Sequence[Node], columns: Sequence[Mapping[int, Node]], step: Sequence[Node]
) -> list[Node]:
    """Return values to first order after a step of the unknowns."""
    moved = list(values)
    for column, change in zip(columns, step, strict=True):
        for i, slope in column.items():
            if i < len(moved):
                moved[i] = moved[i] + slope * change
    return moved


def _unknown_rates(
    equations: Equations, factors: SparseFactors, rates: Sequence[Node], motion: Along
) -> list[Node]:
    """Form z' such that the residuals remain zero during the motion."""
    dag, n = equations.dag, len(rates)
    cut = n - equations.n_algebraic
    # With z held constant, the residuals change at the rate g_x x' + g_t.
    moving = {dag.symbol(STATE_RATE, i): rates[i] if i < cut else dag.zero for i in range(n)}
    changes = substitute([motion.rates.get(i, dag.zero) for i in range(cut, n)], moving)
    return factors.solve([-node for node in changes])


def _sensitivities(
    equations: Equations,
    factors: SparseFactors,
    columns: Sequence[Mapping[int, Node]],
    along: Sequence[Along],
    reached: Sequence[Sequence[int]],
) -> tuple[list[Node], list[Node]]:
    """Form the rates of sensitivities and the sensitivities of the unknowns.

    The right-hand side for S_z is minus the derivative of the residuals at S_z = 0. The kernel
    argument s contains neither S_z nor sensitivities that are identically zero.
    """
    dag, n = factors.dag, len(equations.states)
    cut = n - len(columns)
    rates: list[Node] = []
    unknowns: list[Node] = []
    for j, (row, own) in enumerate(zip(along, reached, strict=True)):
        left = [i for i in own if i < cut]
        known = {dag.symbol(SENSITIVITY, j * n + i): dag.zero for i in range(n)}
        for k, i in enumerate(left, len(rates)):
            known[dag.symbol(SENSITIVITY, j * n + i)] = dag.symbol(PACKED_SENSITIVITY, k)
        at_rest = substitute(spread(row.rates, n, dag.zero), known)
        solved = factors.solve([-node for node in at_rest[cut:]])
        moved = _moved(at_rest[:cut], columns, solved)
        rates += [moved[i] for i in left]
        unknowns += solved
    return rates, unknowns


_Found = TypeVar("_Found")


def lower(equations: Equations) -> Program:
    """Build a program from equations; raise ParameterError for sensitivities to unknowns."""
    # Determine the pattern first, so that zero sensitivities simplify all further values.
    _check_sensitivities(equations)
    solved = SolvedSystem.of(equations)
    rates = solved.substitute(equations.rates)
    watched = solved.substitute([equations.output_values[row.watched] for row in equations.events])
    reached = reached_states(equations, solved, timed_by(equations, rates, watched))
    equations = without_vanishing(equations, reached)
    outputs = solved.substitute(equations.output_values)
    zero, n, m = equations.dag.zero, len(equations.states), len(equations.outputs)
    mapped = map_rates(equations, solved, rates, reached)
    along, written_out, motion = _differentiate(
        equations, solved, is_mapped=bool(mapped.sensitivities), with_columns=not mapped.columns
    )
    # Derivatives that maps do not compute are written out for each direction.
    columns = mapped.columns or [row.rates for row in written_out]
    sensitivity_rates = mapped.sensitivities or [
        node for row in along for node in spread(row.rates, n, zero)
    ]
    output_tangents = [node for row in along for node in spread(row.outputs, m, zero)]
    starts, rows, values = _compress(columns)
    packed = pack_rates(equations.dag, reached, n, sensitivity_rates)
    layout, of_events = _layout(equations, starts, rows), dict[str, list[Node]]()
    if equations.events or equations.kinks:
        from cotree.program.event_kernels import event_kernels

        of_events, ranges = event_kernels(equations, solved, outputs, along, motion)
        layout = replace(layout, ranges=ranges.places, n_quantities=len(ranges.quantities))
    results: dict[str, list[Node]] = {
        "prepare": [],
        "initial": [state.initial for state in equations.states],
        "initial_sensitivity": [
            node for row in equations.sensitivities for node in spread(row.initial, n, zero)
        ],
        "inputs": list(equations.input_values),
        "rhs": rates,
        "jacobian": values,
        # The rates are included: a stage with sensitivities then takes a single call.
        "augmented_rhs": [*rates, *packed] if equations.sensitivities else [],
        "sensitivity_rhs": packed,
        "outputs": outputs[:m],
        "output_sensitivity": output_tangents,
        **projection_kernels(equations, solved),
        **of_events,
        **reduced_kernels(equations, rates, columns, along, motion, reached),
    }
    names = [row.name for row in equations.parameters]
    watched = of_events.get("events", [])[: len(equations.events)]
    time_events = _of_time(equations, [*rates, *watched], find_time_events)
    if time_events:
        from cotree.dag.time_events import time_events_along

        seeds = [row.seed for row in equations.sensitivities]
        time_events = {name: time_events_along(own, seeds) for name, own in time_events.items()}
    layout = replace(
        layout,
        sensitivity_starts=tuple(accumulate(map(len, reached), initial=0)),
        sensitivity_rows=tuple(chain.from_iterable(reached)),
        event_inputs=_inputs_in(equations, [*watched, *of_events.get("jumps", [])]),
    )
    return Program(
        equations.dag,
        layout,
        {name: Kernel(spec, tuple(results.get(name, ())), {}) for name, spec in KERNELS.items()},
        tuple(guard.named(names) for guard in equations.guards),
        time_events,
        # Event functions are included: long steps could miss zeros caused by a sine of time.
        _of_time(equations, [*rates, *watched], find_longest_steps)
        if acts_in_part(rates) or watched
        else {},
    )


def _inputs_in(equations: Equations, nodes: Sequence[Node]) -> tuple[str, ...]:
    read = set(symbols_in(nodes))
    pairs = zip(equations.inputs, equations.input_symbols, strict=True)
    return tuple(quantity.name for quantity, symbol in pairs if symbol in read)


def _of_time(
    equations: Equations,
    rates: Sequence[Node],
    find: Callable[[Dag, list[Node]], tuple[_Found, ...]],
) -> dict[str, tuple[_Found, ...]]:
    """Apply ``find`` to each input, keyed by its name, and to the rates, keyed by an empty name."""
    found = {"": find(equations.dag, list(rates))}
    for quantity, value in zip(equations.inputs, equations.input_values, strict=True):
        found[quantity.name] = find(equations.dag, [value])
    return {name: own for name, own in found.items() if own}


def _check_sensitivities(equations: Equations) -> None:
    """Raise ParameterError for sensitivities to initial values that follow from other values."""
    algebraic = {state.name for state in equations.states if state.is_algebraic}
    # Unknowns that follow from contents are allowed: their initial values may replace contents.
    algebraic -= {state.follower for state in equations.states}
    for row in equations.sensitivities:
        if row.name in algebraic:
            raise ParameterError(
                f"'{row.name}' is an algebraic unknown: its initial value is a guess, so it has "
                "no sensitivity; name a parameter, or a state that has a rate"
            )


def _differentiate(
    equations: Equations, solved: SolvedSystem, *, is_mapped: bool, with_columns: bool
) -> tuple[list[Along], list[Along], Along]:
    """Differentiate along sensitivities, states and the motion, unless maps have the results."""
    nothing = Along((), {}, {})
    wanted = [row for row in equations.sensitivities if row.outputs or not is_mapped]
    motion = [] if equations.motion is None else [equations.motion]
    # Outputs are differentiated along all directions except those of the states.
    columns = [replace(row, outputs={}) for row in equations.columns] if with_columns else []
    # Directions share most values: differentiate all at once, then separate the results.
    found = iter(solved.along([*wanted, *motion, *columns]))
    along = [
        next(found) if row.outputs or not is_mapped else nothing for row in equations.sensitivities
    ]
    along_motion = next(found) if motion else nothing
    return along, list(found), along_motion


def _compress(columns: Sequence[Mapping[int, Node]]) -> tuple[list[int], list[int], list[Node]]:
    """Return the nonzeros of a matrix in CSC form: column starts, row indices, values."""
    starts, rows, values = [0], [], []
    for column in columns:
        for i, node in sorted(column.items()):
            # Some derivatives simplify to zero only here.
            if not node.is_zero:
                rows.append(i)
                values.append(node)
        starts.append(len(rows))
    return starts, rows, values


def _layout(equations: Equations, starts: list[int], rows: list[int]) -> Layout:
    n_coordinates, n_speeds = equations.n_coordinates, equations.n_speeds
    observed = equations.output_values[: len(equations.outputs)]
    # Accelerations precede multipliers in the list of unknowns.
    n_held = n_speeds + len(equations.constraints.rows)
    on_multipliers = dependent(reachable(observed), equations.unknowns[n_speeds:n_held])
    states: tuple[Quantity, ...] = tuple(Quantity(s.name, s.unit) for s in equations.states)
    return Layout(
        name=equations.name,
        states=states,
        parameters=equations.parameters,
        inputs=equations.inputs,
        outputs=equations.outputs,
        sensitivities=tuple(row.name for row in equations.sensitivities),
        parameter_values=equations.parameter_values,
        column_starts=tuple(starts),
        row_indices=tuple(rows),
        input_sensitivities=tuple(
            tuple(row.name for row in equations.sensitivities if symbol in row.seed)
            for symbol in equations.input_symbols
        ),
        uncertain=tuple(
            state.name.removesuffix("_dot")
            for state, is_safe in zip(
                equations.states[n_coordinates:], equations.is_safe, strict=False
            )
            if not is_safe
        ),
        constraints=constraint_quantities(equations),
        constraint_edges=equations.constraints.edges,
        n_coordinates=n_coordinates,
        n_speeds=n_speeds,
        algebraic=tuple(state.is_algebraic for state in equations.states),
        quaternions=tuple(
            next(i for i, state in enumerate(equations.states) if state.symbol is q[0])
            for _, q in equations.constraints.quaternions
        ),
        given=tuple(state.is_given for state in equations.states),
        start_rows=tuple(row.name for row in equations.constraints.start_rows),
        start_units=tuple(row.unit for row in equations.constraints.start_rows),
        start_is_rate=equations.constraints.start_is_rate,
        redundant=equations.constraints.redundant,
        uses_multipliers=tuple(node in on_multipliers for node in observed),
        followers=followers(equations),
        events=equations.events,
        kinks=tuple((row.piece, row.direction, row.is_steep) for row in equations.kinks),
        n_pieces=len(equations.pieces),
        positions=equations.positions,
        given_names=equations.given,
        derived=equations.derived,
    )
