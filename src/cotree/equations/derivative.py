"""Derivatives of equations along a direction."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag.traverse import substitute

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Node


def spread(row: Mapping[int, Node], n: int, zero: Node) -> list[Node]:
    """Write a sparse row out in full.

    Parameters
    ----------
    row : mapping of int to Node
        Its values by place.
    n : int
        Its length.
    zero : Node
        The value at the places that it leaves out.
    """
    return [row.get(i, zero) for i in range(n)]


@dataclass(frozen=True)
class Derivative:
    """Derivatives of the equations along one direction.

    Of states and outputs there may be many thousands, each direction changing a few: their
    derivatives are kept by place, those that vanish left out.

    Attributes
    ----------
    name : str
        The parameter or state that the direction belongs to.
    seed : mapping of Node to Node
        Tangents of the symbols.
    forcing : tuple of Node
        Right-hand side of ``A w_p = forcing``, unknowns held fixed.
    rates : mapping of int to Node
        Derivatives of the state rates, in terms of :attr:`Equations.unknown_tangents`.
    outputs : mapping of int to Node
        Derivatives of the outputs.
    initial : mapping of int to Node
        Derivatives of the initial values.
    held, held_rates : tuple of Node
        Derivatives of the constraints and of their rates.
    start : tuple of Node
        Derivatives of :attr:`ConstraintSet.start_values`.
    """

    name: str
    seed: Mapping[Node, Node]
    forcing: tuple[Node, ...]
    rates: Mapping[int, Node]
    outputs: Mapping[int, Node]
    initial: Mapping[int, Node]
    held: tuple[Node, ...]
    held_rates: tuple[Node, ...]
    start: tuple[Node, ...]

    @property
    def nodes(self) -> list[Node]:
        """All its nodes but for those of the seed and of the initial values."""
        rates, outputs = self.rates.values(), self.outputs.values()
        return [*self.forcing, *rates, *outputs, *self.held, *self.held_rates, *self.start]


def substituted(
    rows: Sequence[Derivative], replacement: Mapping[Node, Node]
) -> tuple[Derivative, ...]:
    """Replace some nodes in derivatives, but not in their seeds and initial values."""
    # One call for all rows: values that they share are replaced once. The order is that of `nodes`.
    new = iter(substitute([node for row in rows for node in row.nodes], replacement))

    def again(row: Mapping[int, Node]) -> dict[int, Node]:
        # Taken from the iterator whether it vanishes or not, so that the order is kept.
        made = {i: next(new) for i in row}
        return {i: node for i, node in made.items() if not node.is_zero}

    return tuple(
        replace(
            row,
            forcing=tuple(next(new) for _ in row.forcing),
            rates=again(row.rates),
            outputs=again(row.outputs),
            held=tuple(next(new) for _ in row.held),
            held_rates=tuple(next(new) for _ in row.held_rates),
            start=tuple(next(new) for _ in row.start),
        )
        for row in rows
    )
