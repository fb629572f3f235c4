"""Kernels of events: what they look at, what they set, and the derivatives of both."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.equations import spread
from cotree.program.impacts import form_impact

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations, EventRow
    from cotree.program.solved import Along, Solved


def event_quantities(equations: Equations) -> tuple[EventRow, ...]:
    """Name the events, with the states that each sets, those of its impact included."""
    n, first = equations.n_speeds, equations.n_coordinates
    speeds = tuple(range(first, first + n))
    return tuple(
        replace(row, targets=(*row.targets, *speeds)) if row.is_impact else row
        for row in equations.events
    )


def event_kernels(
    equations: Equations,
    solved: Solved,
    values: Sequence[Node],
    along: Sequence[Along],
    motion: Along,
) -> dict[str, list[Node]]:
    """Form the results of the kernels of events; empty where there are none.

    Parameters
    ----------
    equations : Equations
        The equations.
    solved : Solved
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
    dag, start = equations.dag, len(equations.outputs)
    n_events = len(equations.events)
    # For each event, the places of its new values, and of its restitution.
    places, place = [], start + n_events
    for row in equations.events:
        places.append((range(place, place + len(row.targets)), place + len(row.targets)))
        place += len(row.targets) + row.is_impact
    impacts = [
        form_impact(equations, solved, start + i, values[last], row.name) if row.is_impact else None
        for i, (row, (_, last)) in enumerate(zip(equations.events, places, strict=True))
    ]
    jumps: list[Node] = []
    for (own, _), impact in zip(places, impacts, strict=True):
        jumps += [*(values[i] for i in own), *(impact.speeds if impact else ())]

    def derivatives(row: Mapping[int, Node], seed: Mapping[Node, Node]) -> list[Node]:
        whole = spread(row, len(values), dag.zero)
        found = whole[start : start + n_events]
        for (own, last), impact in zip(places, impacts, strict=True):
            found += [whole[i] for i in own]
            if impact is not None:
                found += impact.tangent(solved, seed, whole[last])
        return found

    assert equations.motion is not None  # it comes with the events
    directions = zip(along, equations.sensitivities, strict=True)
    n_rated = len(equations.states) - equations.n_algebraic
    residuals = (motion.rates.get(i, dag.zero) for i in range(n_rated, len(equations.states)))
    return {
        "events": list(values[start : start + n_events]),
        "jumps": jumps,
        "event_sensitivity": [
            node for row, own in directions for node in derivatives(row.outputs, own.seed)
        ],
        "event_rates": [*derivatives(motion.outputs, equations.motion.seed), *residuals],
    }
