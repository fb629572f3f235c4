"""Kernels that project the states onto the constraints.

The step is that of minimum kinetic energy: its left-hand side is the matrix of the governing
equations, with the constraints' residuals instead of the forces.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.nodes import substitute
from cotree.equations import Quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations
    from cotree.program.solved import SolvedSystem


#: Constraints are nearly redundant closer to a singular configuration than the square root of this:
#: corrections there would amplify rounding by the inverse distance.
_RANK = 1e-8


def constraint_quantities(equations: Equations) -> tuple[Quantity, ...]:
    """Return the names of the results of the kernel ``constraints``."""
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
    """Form the results of the kernels of constraints; empty if there are none."""
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
        # Constraints on speeds alone have no residual of positions.
        values = [zero if v is None else v for v in rows.values]
        shrink: dict[Node, Node] = {}
        # A rotation preserves the norm of a quaternion to first order, so norms are corrected
        # separately.
        for (_, q), norm in zip(rows.quaternions, norms, strict=True):
            # Newton's step for |q|^2 = 1 along q itself: dq = -q (|q|^2 - 1) / (2 |q|^2), which
            # does not rotate the frame.
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
    """Form the change of the states that removes given residuals."""
    n, n_coordinates = equations.n_speeds, equations.n_coordinates
    zeros = [equations.dag.zero] * n
    # In [M, -G^T; -G, 0] [v; *] = [0; c] the lower rows are G v + c = 0: the residual vanishes to
    # first order, and of all such v this one has minimum kinetic energy.
    shift = solved.bare.solve([*zeros, *values], _RANK)[:n]
    speed = solved.bare.solve([*zeros, *rates], _RANK)[:n]
    speeds = [state.symbol for state in equations.states[n_coordinates : n_coordinates + n]]
    # Rates of coordinates are linear in the speeds. With the shift in place of the speeds they are
    # the change of the coordinates, quaternions included.
    known = dict(zip(speeds, shift, strict=True))
    moved = substitute(equations.rates[:n_coordinates], known)
    coordinates = [state.symbol for state in equations.states[:n_coordinates]]
    return [
        *(d + shrink.get(q, equations.dag.zero) for q, d in zip(coordinates, moved, strict=True)),
        *speed,
        *([equations.dag.zero] * (len(equations.states) - n_coordinates - n)),
    ]
