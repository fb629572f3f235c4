"""Impacts: the speeds after an impulse along the gradient of an expression of positions.

The impulse L acts along D, the derivatives of the expression's rate by the speeds, and constraints
pass it on without work: ``[M, -G^T; -G, 0] [a; *] = [D; 0]`` gives the change a of the speeds for
a unit of it. ``L = -(1 + e) g' / (D a)`` turns the rate g' of the expression into -e g'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.symbols import INPUT, PARAMETER, STATE, STATE_RATE, TIME
from cotree.dag.traverse import substitute, symbols_in
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.equations import Equations, EventRow
    from cotree.program.solved import SolvedSystem


@dataclass(frozen=True)
class Impact:
    """One impact, in terms of the values before it.

    Attributes
    ----------
    gradient : tuple of Node
        D, one entry for each speed.
    response : tuple of Node
        a, then multipliers.
    rate : Node
        g'.
    restitution : Node
        e.
    speeds : tuple of Node
        The speeds after it.
    """

    gradient: tuple[Node, ...]
    response: tuple[Node, ...]
    rate: Node
    restitution: Node
    speeds: tuple[Node, ...]

    def tangent(
        self, solved: SolvedSystem, seed: Mapping[Node, Node], restitution: Node
    ) -> list[Node]:
        """Differentiate the speeds after it along a direction.

        Parameters
        ----------
        solved : SolvedSystem
            The equations of motion, whose matrix is that of the impulse, too.
        seed : mapping of Node to Node
            The direction: tangents of symbols.
        restitution : Node
            The derivative of e along it.
        """
        n = len(self.gradient)
        gradient = tangents(self.gradient, seed)
        # [M, -G^T; -G, 0] [a; *] = [D; 0] is differentiated with the same matrix; zeros belong to
        # the multipliers.
        forcing = [*gradient, *([solved.dag.zero] * (len(self.response) - n))]
        response = solved.solve_again(forcing, self.response, seed)[:n]
        # The chain rule: what the speeds were formed of is seeded, so that none of it is
        # differentiated again.
        known = {**seed, self.restitution: restitution, self.rate: tangents([self.rate], seed)[0]}
        known |= dict(zip(self.gradient, gradient, strict=True))
        known |= dict(zip(self.response, response, strict=False))
        return tangents(self.speeds, known)


def form_impact(
    equations: Equations, solved: SolvedSystem, event: EventRow, values: Sequence[Node]
) -> Impact:
    """Form the impact of an event.

    Parameters
    ----------
    equations : Equations
        The equations.
    solved : SolvedSystem
        Their solution.
    event : EventRow
        The event, with an impact.
    values : sequence of Node
        The output values, unknowns eliminated.

    Raises
    ------
    SceneError
        If the expression is none of positions, or no speed changes it.
    """
    assert event.restitution is not None
    restitution, place, name = values[event.restitution], event.watched, event.name
    dag, n, first = equations.dag, equations.n_speeds, equations.n_coordinates
    _check_positions(equations, place, name)
    rates = equations.rates[:first]
    gradient = []
    # D_k = sum over the coordinates of dg/dq_i dq_i'/dv_k, from g' = sum of dg/dq_i q_i'.
    for state in equations.states[first : first + n]:
        moved = tangents(rates, {state.symbol: dag.one})
        total = dag.zero
        for column, d in zip(equations.columns, moved, strict=False):
            total = total + column.outputs.get(place, dag.zero) * d
        gradient.append(total)
    if all(entry.is_zero for entry in gradient):
        raise SceneError(
            f"when of event '{name}' does not change with any joint or body of the multibody "
            "system, which its impact acts on: set states instead"
        )
    assert equations.motion is not None  # it comes with the events
    # The derivative along the motion is in terms of rates as symbols; only those of coordinates
    # occur, since an impact needs an expression of positions.
    moving = {dag.symbol(STATE_RATE, i): rate for i, rate in enumerate(rates)}
    along = equations.motion.outputs.get(place, dag.zero)
    with dag.labelled(f"impact of {name}"):
        rate = substitute([along], moving)[0]
        zeros = [dag.zero] * (len(equations.unknowns) - n)
        response = solved.factors.solve([*gradient, *zeros])
        answer = dag.zero
        for d, a in zip(gradient, response, strict=False):
            answer = answer + d * a
        impulse = -((1.0 + restitution) * rate) / answer
        before = [state.symbol for state in equations.states[first : first + n]]
        after = [v + a * impulse for v, a in zip(before, response, strict=False)]
    return Impact(tuple(gradient), tuple(response), rate, restitution, tuple(after))


def _check_positions(equations: Equations, place: int, name: str) -> None:
    """Refuse expressions of speeds, accelerations, inputs or states of networks."""
    # Positions are coordinates, and modes, which are constant between events.
    first, n = equations.n_coordinates, equations.n_coordinates + equations.n_speeds
    allowed = {*range(first), *range(n, n + equations.n_modes)}
    for symbol in symbols_in([equations.output_values[place]]):
        kind, i = symbol.data
        if kind in (PARAMETER, TIME) or (kind == STATE and i in allowed):
            continue
        named = {STATE: equations.states, INPUT: equations.inputs}.get(kind)
        what = f"'{named[i].name}'" if named is not None else "accelerations or reactions"
        raise SceneError(
            f"when of event '{name}' depends on {what}, but an impact needs an expression of "
            "positions, parameters and t"
        )
