"""Seeds: what a sensitivity graph differentiates with respect to, or along.

A parameter, a coordinate, a rate, an initial value and a whole direction are the same to a
sensitivity graph: a tangent for each symbol that changes.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.traverse import symbols_in

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Dag, Node
    from cotree.dag.vector import Matrix, Vector


@dataclass
class Support:
    """The symbols that values depend on, found once for each value."""

    _known: dict[Node, frozenset[Node]] = field(default_factory=dict)

    def of(self, node: Node) -> frozenset[Node]:
        """Give the symbols that a value depends on."""
        if node not in self._known:
            self._known[node] = frozenset(symbols_in([node]))
        return self._known[node]


@dataclass(frozen=True)
class Seed:
    """Tangents of symbols, and of the fields that depend on them.

    Attributes
    ----------
    dag : Dag
        The arena.
    symbols : mapping of Node to Node
        Tangent of each symbol that changes; none of them zero.
    support : Support
        Shared by all seeds of one system.
    """

    dag: Dag
    symbols: Mapping[Node, Node]
    support: Support

    def of(self, node: Node) -> Node:
        """Differentiate a coordinate, or an expression of fields."""
        if node.op == "symbol":
            return self.symbols.get(node, self.dag.zero)
        # Most fields depend on no symbol of the seed: two sets tell, without a walk over the field.
        if node.value is not None or self.support.of(node).isdisjoint(self.symbols):
            return self.dag.zero
        return tangents([node], self.symbols)[0]

    def vector(self, a: Vector) -> Vector:
        """Differentiate the components of a vector field."""
        return (self.of(a[0]), self.of(a[1]), self.of(a[2]))

    def matrix(self, m: Matrix) -> Matrix:
        """Differentiate the entries of a tensor field."""
        return (self.vector(m[0]), self.vector(m[1]), self.vector(m[2]))
