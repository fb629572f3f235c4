"""Corners of the rates that depend on the state."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cotree.dag.nodes import Node


@dataclass(frozen=True)
class CornerRow:
    """A corner of the rates, which a value reaches where it passes through zero.

    Attributes
    ----------
    value : Node
        The value, relative to the end of the piece that is held.
    piece : int
        Which of the pieces that are held ends there.
    direction : int
        Zero where the piece is the sign of the value; else what is added to its number where the
        value passes through zero in that direction.
    """

    value: Node
    piece: int
    direction: int
