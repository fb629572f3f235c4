"""Kernels of events: what they look at, what they set, and the derivatives of both."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.program.impacts import form_impact

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations
    from cotree.program.solved import Along, SolvedSystem


def event_kernels(
    equations: Equations,
    solved: SolvedSystem,
    values: Sequence[Node],
    along: Sequence[Along],
    motion: Along,
) -> dict[str, list[Node]]:
    """Form the results of the kernels of events; empty where there are none.

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
    if not equations.events:
        return {name: [] for name in ("events", "jumps", "event_sensitivity", "event_rates")}
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

    def derivatives(changes: Mapping[int, Node], seed: Mapping[Node, Node]) -> list[Node]:
        # All watched values first, then event by event what it sets, as in the kernels of values.
        found = [changes.get(row.watched, dag.zero) for row in rows]
        for row, impact in zip(rows, impacts, strict=True):
            found += [changes.get(i, dag.zero) for i in row.new_values]
            if impact is not None and row.restitution is not None:
                found += impact.tangent(solved, seed, changes.get(row.restitution, dag.zero))
        return found

    assert equations.motion is not None  # it comes with the events
    directions = zip(along, equations.sensitivities, strict=True)
    # Algebraic unknowns are the last states.
    n_rated = len(equations.states) - equations.n_algebraic
    # The rates of algebraic unknowns are their residuals, which stand behind all others.
    residuals = (motion.rates.get(i, dag.zero) for i in range(n_rated, len(equations.states)))
    return {
        "events": [values[row.watched] for row in rows],
        "jumps": jumps,
        "event_sensitivity": [
            node for row, own in directions for node in derivatives(row.outputs, own.seed)
        ],
        "event_rates": [*derivatives(motion.outputs, equations.motion.seed), *residuals],
    }
