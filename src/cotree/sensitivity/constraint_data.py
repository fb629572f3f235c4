"""Constraints in the form that projection, starts and reports need."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.components import FreeRotation
from cotree.dag.dual import tangent_of
from cotree.dag.nodes import substitute, symbols_in
from cotree.equations import ConstraintSet, Quantity, RedundantRow
from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.across import View
    from cotree.formulation.first_graph import FirstGraph
    from cotree.formulation.networks.states import Redundant
    from cotree.sensitivity.turning import Seed


def gather_constraints(first: FirstGraph) -> ConstraintSet:
    """Collect the constraints in the form that projection, starts and reports need.

    Raises ParameterError if a redundant initial value belongs to a variable that accelerations
    determine.
    """
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
        # Three blocks, in an order on which the start relies: conditions on chords, the values of
        # redundant variables that states determine, and the given values.
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


def start_tangents(
    first: FirstGraph, view: View, seed: Seed, of_networks: Mapping[Node, Node]
) -> tuple[Node, ...]:
    """Differentiate :attr:`ConstraintSet.start_values`; ``of_networks`` are known derivatives."""
    network = first.network
    redundant = network.redundant if network else ()
    # The same three blocks as in `start_values`.
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
    """Form the values that redundant initial values must agree with, from states and sources."""
    if first.network is None or not redundant:
        return []
    measured = first.measured
    # Measured values may depend on other measured ones: substitute them into themselves, then into
    # the values of the networks.
    known = dict(zip(measured, substitute(list(measured.values()), measured), strict=True))
    values = substitute([first.network.solved.values[row.variable] for row in redundant], known)
    unknowns = set(first.unknowns)
    for row, value in zip(redundant, values, strict=True):
        # A start depends on states and parameters; accelerations are computed later.
        if not unknowns.isdisjoint(symbols_in([value])):
            raise ParameterError(
                f"'{row.name}' follows from accelerations, so that its initial value cannot "
                "be given: remove it"
            )
    return values


def _states_in(first: FirstGraph, value: Node) -> list[str]:
    own = set(symbols_in([value]))
    return [state.name for state in first.states if state.symbol in own]
