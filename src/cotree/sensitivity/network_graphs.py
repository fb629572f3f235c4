"""Sensitivity graphs of the scalar networks, for all directions at once."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter
from typing import TYPE_CHECKING, TypeVar

from cotree.dag.derivative import tangents
from cotree.dag.dual import tangent_of
from cotree.sensitivity.turning import Seed, Support, derivatives_labelled, view_along

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.formulation.first_graph import FirstGraph
    from cotree.formulation.networks.network import Network
    from cotree.formulation.networks.rules import Tangent

_Key = TypeVar("_Key")


@dataclass(frozen=True)
class NetworkTangents:
    """Derivatives of the networks along several numbered directions."""

    rates: tuple[Tangent, ...]  # tangents of state rates and of residuals
    #: Derivatives of the values that occur in outputs, fields and initial values.
    observed: Mapping[Node, Tangent]

    @cached_property
    def rates_along(self) -> Mapping[Hashable, dict[int, Node]]:
        """Nonzero derivatives of the rates, by direction and index."""
        return _turned(enumerate(self.rates))

    @cached_property
    def seeds(self) -> Mapping[Hashable, dict[Node, Node]]:
        """Nonzero derivatives of observed values, by direction."""
        return _turned(self.observed.items())


def _turned(rows: Iterable[tuple[_Key, Tangent]]) -> Mapping[Hashable, dict[_Key, Node]]:
    """Group derivatives by direction instead of by key."""
    found: defaultdict[Hashable, dict[_Key, Node]] = defaultdict(dict)
    for key, row in rows:
        for direction, node in row.items():
            found[direction][key] = node
    return found


@dataclass
class _Seeds:
    """Derivatives of symbols and fields along the directions on which they depend."""

    directions: Sequence[Mapping[Node, Node]]
    couplings: Mapping[Node, Tangent]
    support: Support
    _by_symbol: dict[Node, dict[Hashable, Node]] = field(default_factory=lambda: defaultdict(dict))

    def __post_init__(self) -> None:
        for i, symbols in enumerate(self.directions):
            for symbol, d in symbols.items():
                if not d.is_zero:
                    # By symbol, because each field needs only the directions that change it.
                    self._by_symbol[symbol][i] = d

    def __call__(self, node: Node, replacements: Mapping[Node, Node]) -> Tangent:
        if node.op == "symbol":
            return self._by_symbol.get(node, {})
        # The mechanism's sensitivity graphs have the tangents of its across variables.
        if node in self.couplings:
            return self.couplings[node]
        if node.value is not None:
            return {}
        # For each direction, the tangents of the symbols in the field.
        touched: dict[Hashable, dict[Node, Node]] = defaultdict(dict)
        # Sorted, because the generated text depends on the order and sets have none.
        for symbol in sorted(self.support.of(node), key=attrgetter("index")):
            for i, d in self._by_symbol.get(symbol, {}).items():
                touched[i][symbol] = d
        found = {i: tangents([node], seed, replacements)[0] for i, seed in touched.items()}
        return {i: d for i, d in found.items() if not d.is_zero}


def network_tangents(
    network: Network,
    directions: Sequence[Mapping[Node, Node]],
    couplings: Mapping[Node, Tangent],
    support: Support,
) -> NetworkTangents:
    """Differentiate the networks; ``couplings`` are tangents of multibody variables at ports."""
    from cotree.formulation.networks.solve_plan import differentiate_plan

    # Evaluating all directions together forms each partial derivative of a law only once.
    d = differentiate_plan(network.solved, _Seeds(directions, couplings, support))
    return NetworkTangents(
        tuple(d[variable] for variable in network.rates),
        {
            network.solved.values[variable]: d[variable]
            for variable in network.watched
            # Constants have no derivative; also, several variables may be the same constant node.
            if network.solved.values[variable].value is None
        },
    )


def coupling_tangents(
    first: FirstGraph, directions: Sequence[Mapping[Node, Node]], support: Support
) -> dict[Node, Tangent]:
    """Differentiate the values, rates and accelerations that the networks' ports measure."""
    measured = {
        getattr(coupling, form): (coupling.measure, form)
        for coupling in first.couplings
        for form in ("value", "rate", "acceleration")
    }
    # The seed already contains the tangents of symbols.
    found: dict[Node, Tangent] = {node: {} for node in measured if node is not None and node.args}
    for i, symbols in enumerate(directions):
        # A direction that changes no port measure needs no sensitivity graph.
        touched = [node for node in found if not support.of(node).isdisjoint(symbols)]
        if touched:
            with derivatives_labelled(first.system.dag):
                view = view_along(first, Seed(first.system.dag, symbols, support))
                for node in touched:
                    measure, form = measured[node]
                    d = tangent_of(getattr(measure, form)(view))
                    if not d.is_zero:
                        found[node][i] = d
    return found
