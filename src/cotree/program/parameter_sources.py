"""Sources of the sensitivity graphs: what parameters change by themselves.

In a sensitivity graph the derivative of a terminal equation by a parameter that stands in it is a
source: ``F' = m a' + m' a``. What follows from sources and from the states' sensitivities, along
f-circuits and f-cutsets, is the same for all parameters. Here both are parted as far out as they
can be: sources are the largest values that depend on no sensitivity of a state.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag.symbols import PARAMETER_CHANGE, SOURCE, STATE_CHANGE
from cotree.dag.traverse import dependent, reachable, substitute

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Derivative, Equations

#: Operations that apply to both parts of their arguments separately.
_SUMS = frozenset({"add", "sub", "neg"})


@dataclass(frozen=True)
class CommonDirection:
    """Derivatives along any direction, from sensitivities of states and from sources.

    Attributes
    ----------
    direction : Derivative
        The forcing and the rates, in terms of both.
    sources : tuple of Node
        Symbols of the sources.
    given : list of dict of int to Node
        The sources of each parameter, by place, those that vanish left out.
    """

    direction: Derivative
    sources: tuple[Node, ...]
    given: list[dict[int, Node]]


def part_sources(equations: Equations, unknowns: Mapping[Node, Node]) -> CommonDirection | None:
    """Separate the common part of all directions from the sources; None if there is none.

    Parameters
    ----------
    equations : Equations
        The equations.
    unknowns : mapping of Node to Node
        The unknowns' symbols and values.
    """
    common, dag = equations.direction, equations.dag
    if common is None:
        return None
    states = [dag.symbol(STATE_CHANGE, i) for i in range(len(equations.states))]
    changes = [dag.symbol(PARAMETER_CHANGE, j) for j in range(len(equations.sensitivities))]
    roots = substitute([*common.forcing, *common.rates.values()], unknowns)
    parting = _Parting(dag, roots, [*states, *equations.unknown_tangents], changes)
    # All that follows from sensitivities and sources is formed once for all parameters; only the
    # values of the sources differ.
    parted, n = [parting.parted(root) for root in roots], len(common.forcing)
    rates = dict(zip(common.rates, parted[n:], strict=True))
    direction = replace(common, forcing=tuple(parted[:n]), rates=rates, outputs={})
    return CommonDirection(direction, tuple(parting.sources.values()), parting.given())


class _Parting:
    """Splits values that are linear in changes of states and of parameters.

    The sources of nested sums are summed up first: one value of each column is then added.
    """

    def __init__(
        self, dag: Dag, roots: Sequence[Node], states: Sequence[Node], changes: Sequence[Node]
    ) -> None:
        order = reachable(roots)
        self.sources: dict[Node, Node] = {}
        self._dag, self._changes = dag, changes
        self._changed = dependent(order, changes)
        self._moved = dependent(order, states)
        # Uses by results count, too: what is read twice must be formed as a whole.
        self._n_readers = Counter(roots)
        for node in order:
            self._n_readers.update(node.args)
        self._parts: dict[Node, tuple[Node, Node]] = {}
        for node in order:
            if node in self._moved and node in self._changed:
                self._parts[node] = self._parts_of(node)

    def parted(self, node: Node) -> Node:
        """Give a value with the symbols of sources in it."""
        if node not in self._changed:
            return node
        if node not in self._moved:
            return self._source(node)
        moved, alone = self._parts[node]
        if alone.is_zero:
            return moved
        source = self._source(alone)
        return source - moved.args[0] if moved.op == "neg" else moved + source

    def given(self) -> list[dict[int, Node]]:
        """Give the sources of each change by itself, by place, those that vanish left out."""
        nodes = list(self.sources)
        supports = _supports(reachable(nodes), self._changes)
        still = dict.fromkeys(self._changes, self._dag.zero)
        found = []
        for j, change in enumerate(self._changes):
            # Sources are linear in the changes: with one change equal to one and all others zero, a
            # source is its value for that parameter.
            places = [i for i, node in enumerate(nodes) if supports[node] >> j & 1]
            along = substitute([nodes[i] for i in places], {**still, change: self._dag.one})
            pairs = zip(places, along, strict=True)
            found.append({i: value for i, value in pairs if not value.is_zero})
        return found

    def _source(self, node: Node) -> Node:
        return self.sources.setdefault(node, self._dag.symbol(SOURCE, len(self.sources)))

    def _parts_of(self, node: Node) -> tuple[Node, Node]:
        """Write a value as the sum of a part that states change and one of parameters alone."""
        dag = self._dag
        if node.op not in _SUMS:
            # Products and quotients have one factor that changes. Its parts are joined before,
            # since to multiply both would cost twice.
            return dag.rebuild(node, tuple(self.parted(arg) for arg in node.args)), dag.zero
        terms = [self._term(arg) for arg in node.args]
        moved, alone = zip(*terms, strict=True)
        return dag.rebuild(node, moved), dag.rebuild(node, alone)

    def _term(self, node: Node) -> tuple[Node, Node]:
        """Give both parts of a term of a sum, if nothing else reads it."""
        if node not in self._changed:
            return node, self._dag.zero
        if node not in self._moved:
            return self._dag.zero, node
        if self._n_readers[node] == 1:
            return self._parts[node]
        # Something else reads the sum itself, so that parting it here would form it twice.
        return self.parted(node), self._dag.zero


def _supports(order: Sequence[Node], changes: Sequence[Node]) -> dict[Node, int]:
    """Give the changes that each value depends on, as bits; values without any are left out."""
    found = {node: 1 << j for j, node in enumerate(changes)}
    for node in order:
        bits = 0
        for arg in node.args:
            bits |= found.get(arg, 0)
        if bits:
            found[node] = bits
    return found
