"""Piecewise linear functions as numbers; :mod:`cotree.dag.multi_output` has their nodes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """A piecewise linear function, constant outside its range."""

    x: tuple[float, ...]  # ascending arguments, at least two
    y: tuple[float, ...]  # values at ``x``

    function = "cotree_table"

    @property
    def arrays(self) -> dict[str, tuple[float, ...]]:
        """Numbers that C reads, by the name of each row."""
        return {"x": self.x, "y": self.y}
