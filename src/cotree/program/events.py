"""Kernels of events: what they look at, what they set, and the derivatives of both."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.symbols import STATE_RATE, TIME
from cotree.program.event_ranges import EventRanges, find_ranges
from cotree.program.impacts import form_impact

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations
    from cotree.program.solved import Along, SolvedSystem


_NAMES = ("events", "jumps", "event_sensitivity", "event_rates", "event_ranges")


def event_kernels(
    equations: Equations,
    solved: SolvedSystem,
    values: Sequence[Node],
    along: Sequence[Along],
    motion: Along,
) -> tuple[dict[str, list[Node]], EventRanges]:
    """Form the results of the kernels of events, and the ranges among them; empty for none.

    Parameters
    ----------
    equations : Equations
        The equations.
    solved : SolvedSystem
        Their solution.
    values : sequence of Node
        Outputs, then the expressions of events, unknowns eliminated.
    along : sequence of Along
        Derivatives along each parameter; outputs are followed by these expressions.
    motion : Along
        Derivatives along the motion.
    """
    if not (equations.events or equations.corners):
        return {name: [] for name in _NAMES}, EventRanges((), (), ())
    dag, rows = equations.dag, equations.events
    # Events without a restitution set states, and have no impulse.
    impacts = [
        None if row.restitution is None else form_impact(equations, solved, row, values)
        for row in rows
    ]
    # For each event the new values come first, then the speeds after its impact.
    jumps: list[Node] = []
    for row, impact in zip(rows, impacts, strict=True):
        jumps += [*(values[i] for i in row.new_values), *(impact.speeds if impact else ())]

    corners = solved.put([row.value for row in equations.corners])
    # What decides whether an impact ends in rest is read at impacts only.
    crossed = [dag.zero if row.is_rest else values[row.watched] for row in rows]
    found_ranges = find_ranges(equations, [*crossed, *corners])
    seed_of_motion = _along_the_motion(equations)
    still = [dag.zero] * len(corners)

    def derivatives(
        changes: Mapping[int, Node], seed: Mapping[Node, Node], of_corners: Sequence[Node]
    ) -> list[Node]:
        # All watched values first, then event by event what it sets, as in the kernels of values.
        found = [*(changes.get(row.watched, dag.zero) for row in rows), *of_corners]
        for row, impact in zip(rows, impacts, strict=True):
            found += [changes.get(i, dag.zero) for i in row.new_values]
            if impact is not None and row.restitution is not None:
                found += impact.tangent(solved, seed, changes.get(row.restitution, dag.zero))
        return found

    directions = zip(along, equations.sensitivities, strict=True)
    # Algebraic unknowns are the last states.
    n_rated = len(equations.states) - equations.n_algebraic
    # The rates of algebraic unknowns are their residuals, which stand behind all others.
    residuals = (motion.rates.get(i, dag.zero) for i in range(n_rated, len(equations.states)))
    kernels = {
        "events": [
            *(values[row.watched] for row in rows),
            *corners,
            *solved.put(equations.pieces),
            *found_ranges.quantities,
        ],
        "jumps": jumps,
        "event_sensitivity": [
            # Nothing jumps at a corner, whenever it is.
            node
            for row, own in directions
            for node in derivatives(row.outputs, own.seed, still)
        ],
        "event_rates": [
            *derivatives(motion.outputs, seed_of_motion, tangents(corners, seed_of_motion)),
            *residuals,
        ],
        "event_ranges": [*found_ranges.results],
    }
    return kernels, found_ranges


def _along_the_motion(equations: Equations) -> Mapping[Node, Node]:
    """Give the tangents along the motion: of states symbols, of inputs the scene's own."""
    if equations.motion is not None:
        return equations.motion.seed
    dag = equations.dag
    time = dag.symbol(TIME, 0)
    inputs = zip(
        equations.input_symbols, tangents(equations.input_values, {time: dag.one}), strict=True
    )
    seed = {state.symbol: dag.symbol(STATE_RATE, i) for i, state in enumerate(equations.states)}
    return seed | {s: d for s, d in inputs if not d.is_zero} | {time: dag.one}
