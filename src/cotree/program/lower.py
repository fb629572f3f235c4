"""From equations to a program: eliminate the unknowns and collect the kernels."""

from __future__ import annotations

from dataclasses import replace
from itertools import accumulate, chain
from typing import TYPE_CHECKING, TypeVar

from cotree.dag.nodes import dependent, reachable, symbols_in
from cotree.dag.switching_times import TimeEvent, acts_in_part, find_longest_steps, find_time_events
from cotree.dag.time_events import time_events_along
from cotree.equations import Quantity, spread
from cotree.errors import ParameterError
from cotree.program.columns import map_rates
from cotree.program.events import event_kernels
from cotree.program.kernels import KERNELS
from cotree.program.layout import Layout
from cotree.program.program import Kernel, Program
from cotree.program.projection import constraint_quantities, projection_kernels
from cotree.program.reduced import reduced_kernels
from cotree.program.sensitivity_pattern import (
    followers,
    pack_rates,
    reached_states,
    timed_by,
    without_vanishing,
)
from cotree.program.solved import Along, SolvedSystem

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Equations

_Found = TypeVar("_Found")


def lower(equations: Equations) -> Program:
    """Turn governing and sensitivity equations into a program.

    The matrix is factorised once; every derivative reuses the factors. Raises ParameterError if a
    sensitivity to an algebraic unknown is requested.
    """
    # The pattern is determined before derivatives are formed: values that follow from zero
    # sensitivities then fold away.
    _check_sensitivities(equations)
    solved = SolvedSystem.of(equations)
    rates = solved.put(equations.rates)
    watched = solved.put([equations.output_values[row.watched] for row in equations.events])
    reached = reached_states(equations, solved, timed_by(equations, rates, watched))
    equations = without_vanishing(equations, reached)
    outputs = solved.put(equations.output_values)
    zero, n, m = equations.dag.zero, len(equations.states), len(equations.outputs)
    mapped = map_rates(equations, solved, rates, reached)
    along, written_out, motion = _differentiate(
        equations,
        solved,
        is_mapped=bool(mapped.sensitivities),
        with_columns=not mapped.columns,
    )
    # Derivatives that are not maps are written out, direction by direction.
    columns = mapped.columns or [row.rates for row in written_out]
    sensitivity_rates = mapped.sensitivities or [
        node for row in along for node in spread(row.rates, n, zero)
    ]
    output_tangents = [node for row in along for node in spread(row.outputs, m, zero)]
    starts, rows, values = _compress(columns)
    packed = pack_rates(equations.dag, reached, n, sensitivity_rates)
    of_events, ranges = event_kernels(equations, solved, outputs, along, motion)
    results: dict[str, list[Node]] = {
        "prepare": [],
        "initial": [state.initial for state in equations.states],
        "initial_sensitivity": [
            node for row in equations.sensitivities for node in spread(row.initial, n, zero)
        ],
        "inputs": list(equations.input_values),
        "rhs": rates,
        "jacobian": values,
        # Both kernels contain the rates: one call then computes all that a step with sensitivities
        # needs.
        "augmented_rhs": [*rates, *packed] if equations.sensitivities else [],
        "sensitivity_rhs": packed,
        "outputs": outputs[:m],
        "output_sensitivity": output_tangents,
        **projection_kernels(equations, solved),
        **of_events,
        **reduced_kernels(equations, rates, columns, along, motion, reached),
    }
    names = [row.name for row in equations.parameters]
    watched = results["events"][: len(equations.events)]
    layout = replace(
        _layout(equations, starts, rows),
        sensitivity_starts=tuple(accumulate(map(len, reached), initial=0)),
        sensitivity_rows=tuple(chain.from_iterable(reached)),
        event_inputs=_inputs_in(equations, [*watched, *results["jumps"]]),
        ranges=ranges.places,
        n_quantities=len(ranges.quantities),
    )
    return Program(
        equations.dag,
        layout,
        {name: Kernel(spec, tuple(results[name]), {}) for name, spec in KERNELS.items()},
        tuple(guard.named(names) for guard in equations.guards),
        _timed(equations, _of_time(equations, [*rates, *watched], find_time_events)),
        # A long step might also skip event functions that are driven by a sine.
        _of_time(equations, [*rates, *watched], find_longest_steps)
        if acts_in_part(rates) or watched
        else {},
    )


def _inputs_in(equations: Equations, nodes: Sequence[Node]) -> tuple[str, ...]:
    """Return the names of the inputs on which some values depend."""
    read = set(symbols_in(nodes))
    pairs = zip(equations.inputs, equations.input_symbols, strict=True)
    return tuple(quantity.name for quantity, symbol in pairs if symbol in read)


def _of_time(
    equations: Equations,
    rates: Sequence[Node],
    find: Callable[[Dag, list[Node]], tuple[_Found, ...]],
) -> dict[str, tuple[_Found, ...]]:
    """Apply a search to each input, by its name, and to the rates, by the empty name."""
    found = {"": find(equations.dag, list(rates))}
    for quantity, value in zip(equations.inputs, equations.input_values, strict=True):
        found[quantity.name] = find(equations.dag, [value])
    return {name: own for name, own in found.items() if own}


def _timed(
    equations: Equations, stops: Mapping[str, tuple[TimeEvent, ...]]
) -> dict[str, tuple[TimeEvent, ...]]:
    """Differentiate time events along each sensitivity."""
    seeds = [row.seed for row in equations.sensitivities]
    return {name: time_events_along(own, seeds) for name, own in stops.items()}


def _check_sensitivities(equations: Equations) -> None:
    """Raise for sensitivities to states that have no initial value of their own."""
    algebraic = {state.name for state in equations.states if state.is_algebraic}
    # The unknown that follows from the state of a storage may be given instead, so that its initial
    # value counts.
    algebraic -= {state.follower for state in equations.states}
    for row in equations.sensitivities:
        if row.name in algebraic:
            raise ParameterError(
                f"'{row.name}' is an algebraic unknown: its initial value is a guess, so that "
                "no sensitivity to it exists; name a parameter, or a state that has a rate"
            )


def _differentiate(
    equations: Equations, solved: SolvedSystem, *, is_mapped: bool, with_columns: bool
) -> tuple[list[Along], list[Along], Along]:
    """Differentiate along each sensitivity, along each state, and along the motion.

    Rates of sensitivities that are a map, and columns that are one, are not written out. Without
    events or algebraic unknowns there is no motion.
    """
    nothing = Along((), {}, {})
    wanted = [row for row in equations.sensitivities if row.outputs or not is_mapped]
    motion = [] if equations.motion is None else [equations.motion]
    # Outputs are differentiated along all directions except the states.
    columns = [replace(row, outputs={}) for row in equations.columns] if with_columns else []
    # All directions at once, since they share most of their values. They are separated in this
    # order.
    found = iter(solved.along([*wanted, *motion, *columns]))
    along = [
        next(found) if row.outputs or not is_mapped else nothing for row in equations.sensitivities
    ]
    along_motion = next(found) if motion else nothing
    return along, list(found), along_motion


def _compress(columns: Sequence[Mapping[int, Node]]) -> tuple[list[int], list[int], list[Node]]:
    """Return the nonzeros in compressed columns."""
    starts, rows, values = [0], [], []
    for column in columns:
        for i, node in sorted(column.items()):
            # A derivative may be formed and still fold to zero.
            if not node.is_zero:
                rows.append(i)
                values.append(node)
        starts.append(len(rows))
    return starts, rows, values


def _layout(equations: Equations, starts: list[int], rows: list[int]) -> Layout:
    n_coordinates, n_speeds = equations.n_coordinates, equations.n_speeds
    observed = equations.output_values[: len(equations.outputs)]
    # The unknowns are accelerations of the speeds, then multipliers.
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
        corners=tuple((row.piece, row.direction, row.is_steep) for row in equations.corners),
        n_pieces=len(equations.pieces),
        positions=equations.positions,
        given_names=equations.given,
        derived=equations.derived,
    )
