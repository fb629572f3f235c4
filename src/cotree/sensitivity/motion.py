"""The direction of the motion itself, which tells how fast events come near."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.symbols import STATE_RATE

if TYPE_CHECKING:
    from cotree.dag.nodes import Node
    from cotree.formulation.first_graph import FirstGraph


def motion_seed(first: FirstGraph) -> dict[Node, Node]:
    """Give the tangents along the motion: every state moves at its rate, and time at one.

    Symbols stand for the rates of the states; see :mod:`cotree.dag.symbols`. The scene's
    own inputs change with time as they do.
    """
    system = first.system
    dag = system.dag
    along = tangents(system.input_values, {system.time: dag.one})
    inputs = zip(system.inputs.values(), along, strict=True)
    seed = {state.symbol: dag.symbol(STATE_RATE, i) for i, state in enumerate(first.states)}
    seed |= {symbol: tangent for symbol, tangent in inputs if not tangent.is_zero}
    return seed | {system.time: dag.one}
