"""Derivatives along many directions as maps of many columns.

Along parameter j the unknowns' derivatives solve ``A w_j = b_x s_j + b_j``, where the matrix b_x
is the same for all and b_j is the explicit derivative by the parameter. Statements written out for
each parameter exploit its zeros; those of a map are written once, and C takes several columns at a
time. The columns of the Jacobian are one map of unit vectors s; where they are fewer than the
parameters, it is formed first and multiplied with each s_j. The costs of all ways are compared.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.dag.linear_map import apply_map, form_map
from cotree.dag.symbols import ENTRY, SENSITIVITY, STATE_CHANGE
from cotree.dag.traverse import dependent, reachable, substitute, symbols_in
from cotree.equations import spread
from cotree.program.column_grouping import cost_of_map, gather_columns
from cotree.program.counts import count_operations
from cotree.program.parameter_sources import CommonDirection, part_sources

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Derivative, Equations
    from cotree.program.solved import SolvedSystem

#: Fewer operations than these are written out for each direction.
_FEW_OPERATIONS = 600
#: A map is taken if it costs less than this share of the operations written out.
_WORTH = 0.75
#: Values of all columns that a kernel keeps on its stack: 800 kB.
_MOST_VALUES = 100_000
#: Directions that are written out to see what one costs.
_SAMPLES = 5

#: Derivatives along one direction, by place.
_Row = dict[int, "Node"]


@dataclass(frozen=True)
class MappedRates:
    """The rates along all states, and along all sensitivities; None where they are no map.

    Attributes
    ----------
    columns : list of dict of int to Node, or None
        Of the Jacobian, by place.
    sensitivities : list of Node or None
        Rates of all sensitivities, direction by direction.
    """

    columns: list[_Row] | None
    sensitivities: list[Node] | None


def map_rates(
    equations: Equations,
    solved: SolvedSystem,
    rates: Sequence[Node],
    reached: Sequence[Sequence[int]],
) -> MappedRates:
    """Form derivatives of the rates as maps, where that costs less than to write them out.

    Parameters
    ----------
    equations : Equations
        The equations.
    solved : SolvedSystem
        Their solution.
    rates : sequence of Node
        Rates of the states, solved.
    reached : sequence of sequences of int
        The states that each parameter reaches; sensitivities of all others are zero.
    """
    # The elimination of algebraic unknowns needs the derivatives along each direction by itself;
    # see cotree.program.reduced.
    if equations.n_algebraic:
        return MappedRates(None, None)
    common = part_sources(equations, solved.unknowns)
    if common is None:
        return MappedRates(None, None)
    ways = _Ways(equations, common, solved, rates, reached)
    along_states = ways.along_states() if equations.unknowns else None
    columns = None
    if along_states and ways.are_worth([along_states], equations.columns):
        columns = ways.with_unsolved(along_states)
    sensitivities = None
    if len(equations.sensitivities) > 1:
        chosen = ways.along_sensitivities(along_states)
        if chosen and ways.are_worth(chosen, equations.sensitivities):
            n = len(equations.states)
            sensitivities = [
                row.get(i, equations.dag.zero) for row in chosen[-1].rows for i in range(n)
            ]
    return MappedRates(columns, sensitivities)


@dataclass(frozen=True)
class _Map:
    """A map of columns, in the order in which they are taken."""

    dag: Dag
    linear: LinearMap
    shared: tuple[Node, ...]
    columns: list[Sequence[Node]]
    order: list[int]
    n_directions: int
    places: list[int]  # of its results

    @property
    def known(self) -> list[Node]:
        """Values that are computed before the map is applied."""
        return [*self.shared, *(value for column in self.columns for value in column)]

    @cached_property
    def rows(self) -> list[_Row]:
        """The results of each direction, those that vanish left out."""
        supports = [self.linear.supports[root] for root in self.linear.results]
        found: list[_Row] = [{} for _ in range(self.n_directions)]
        if not self.order:
            return found
        applied = apply_map(self.dag, self.linear, self.shared, self.columns)
        for k, values in enumerate(applied):
            found[self.order[k]] = {
                place: value
                for place, value, support in zip(self.places, values, supports, strict=True)
                if support >> k & 1
            }
        return found


@dataclass(frozen=True)
class _Ways:
    """The ways to form derivatives of the rates."""

    equations: Equations
    common: CommonDirection
    solved: SolvedSystem
    rates: Sequence[Node]
    reached: Sequence[Sequence[int]]

    @property
    def _dag(self) -> Dag:
        return self.equations.dag

    @cached_property
    def _states(self) -> list[Node]:
        """The symbols of a change of all states."""
        return [self._dag.symbol(STATE_CHANGE, i) for i in range(len(self.equations.states))]

    @cached_property
    def _solving(self) -> list[int]:
        """Places of the rates that depend on unknowns."""
        # Rates without unknowns take no part in this map: with_unsolved forms their derivatives
        # directly.
        rates, unknowns = self.common.direction.rates, self.equations.unknown_tangents
        moving = dependent(reachable(rates.values()), unknowns)
        return [i for i, node in rates.items() if node in moving]

    def along_states(self) -> _Map | None:
        """Map unit vectors: the columns of the Jacobian, as far as they depend on unknowns."""
        one, zero, places = self._dag.one, self._dag.zero, range(len(self._states))
        if _are_too_many(len(places), len(places), len(self._solving)):
            return None
        columns = [[one if i == j else zero for i in places] for j in places]
        results = self._rates_along(self._solving, self.common.sources)
        return self._map(results, self._solving, self._states, columns)

    def with_unsolved(self, along_states: _Map) -> list[_Row]:
        """Add the entries that do not depend on unknowns to the columns of the Jacobian."""
        dag, found = self._dag, [dict(row) for row in along_states.rows]
        without = dict.fromkeys(self.common.sources, dag.zero)
        for i in self.common.direction.rates.keys() - set(self._solving):
            # The rate is linear in the changes of states, so its derivative by one is its value
            # where this change is one and all others are zero.
            (rate,) = substitute([self.common.direction.rates[i]], without)
            moving = [node for node in symbols_in([rate]) if node.data[0] == STATE_CHANGE]
            still = dict.fromkeys(moving, dag.zero)
            for node in moving:
                (value,) = substitute([rate], {**still, node: dag.one})
                if not value.is_zero:
                    found[node.data[1]][i] = value
        return found

    def along_sensitivities(self, along_states: _Map | None) -> list[_Map] | None:
        """Choose the cheaper way to the rates of sensitivities; the last map gives them.

        Either one map of changes of states and of what parameters change, or the columns of the
        Jacobian, what parameters change by themselves, and a sum of products of both.
        """
        n, n_given = len(self._states), sum(map(len, (*self.reached, *self.common.given)))
        if _are_too_many(n_given, len(self.reached), n):
            return None
        changes = [
            [
                self._dag.symbol(SENSITIVITY, j * n + i) if i in some else self._dag.zero
                for i in range(n)
            ]
            for j, some in enumerate(map(frozenset, self.reached))
        ]
        n_sources = len(self.common.sources)
        given = [spread(row, n_sources, self._dag.zero) for row in self.common.given]
        # These columns stay in the order of ``s``, so that C reads sensitivities in place.
        at_once = self._map(
            self._results(()),
            range(n),
            [*self._states, *self.common.sources],
            [[*s, *values] for s, values in zip(changes, given, strict=True)],
            in_order=True,
        )
        if at_once is None or along_states is None:
            return None if at_once is None else [at_once]
        columns = self.with_unsolved(along_states)
        # The Jacobian costs a product and a sum for each nonzero and column. Where these alone
        # exceed the statements at once, the second way cannot win.
        if 2 * sum(map(len, columns)) > len(at_once.linear.statements):
            return [at_once]
        alone = self._map(self._results(self._states), range(n), self.common.sources, given)
        if alone is None:
            return [at_once]
        products = self._products(columns, alone.rows, changes)
        in_turn = [along_states, alone, products]
        return min([at_once], in_turn, key=self._cost)

    def _products(
        self, columns: Sequence[_Row], alone: Sequence[_Row], changes: Sequence[Sequence[Node]]
    ) -> _Map:
        """Multiply the Jacobian with the sensitivities, and add the derivatives by parameters."""
        dag, n = self._dag, len(self._states)
        places = sorted({i for row in alone for i in row})
        # The derivatives by parameters enter as further inputs of each column.
        own = {place: dag.symbol(ENTRY, k) for k, place in enumerate(places)}
        results = [own.get(i, dag.zero) for i in range(n)]
        for column, change in zip(columns, self._states, strict=True):
            for i, value in column.items():
                results[i] = results[i] + value * change
        given = [
            [*s, *(row.get(i, dag.zero) for i in places)]
            for s, row in zip(changes, alone, strict=True)
        ]
        found = self._map(results, range(n), [*self._states, *own.values()], given, in_order=True)
        assert found is not None  # sums of products
        return found

    def _results(self, still: Sequence[Node]) -> list[Node]:
        """Give the rates of all states along any direction, some symbols being zero."""
        places = self.common.direction.rates.keys()
        found = dict(zip(places, self._rates_along(places, still), strict=True))
        return spread(found, len(self._states), self._dag.zero)

    def _rates_along(self, places: Collection[int], still: Sequence[Node]) -> list[Node]:
        common = self.common.direction
        n, rates = len(common.forcing), [common.rates[i] for i in places]
        zeros = dict.fromkeys(still, self._dag.zero)
        known = substitute([*common.forcing, *rates], zeros)
        found = dict(zip(places, known[n:], strict=True))
        direction = replace(common, forcing=tuple(known[:n]), rates=found)
        return list(self.solved.along([direction])[0].rates.values())

    def _map(
        self,
        results: Sequence[Node],
        places: Iterable[int],
        inputs: Sequence[Node],
        columns: Sequence[Sequence[Node]],
        *,
        in_order: bool = False,
    ) -> _Map | None:
        """Form a map; None where none can be formed, or it is too large."""
        n_given = sum(not value.is_zero for column in columns for value in column)
        if _are_too_many(n_given, len(columns), len(results)):
            return None
        formed = form_map(self._dag, results, inputs, columns)
        if formed is None:
            return None
        linear, order = formed[0], list(range(len(columns)))
        if not in_order:
            linear, order = gather_columns(linear)
        taken = [columns[j] for j in order]
        return _Map(self._dag, linear, formed[1], taken, order, len(columns), list(places))

    def _cost(self, maps: Sequence[_Map]) -> int:
        """Estimate the cost of some maps, with that of the values computed before them."""
        return self._before(maps) + sum(cost_of_map(one.linear) for one in maps)

    def _before(self, maps: Sequence[_Map]) -> int:
        nodes = reachable([*self.rates, *(node for one in maps for node in one.known)])
        return count_operations(node for node in nodes if node.op != "map").total

    def are_worth(self, maps: Sequence[_Map], rows: Sequence[Derivative]) -> bool:
        """Compare the cost of maps with that of statements written out for each direction."""
        if not rows:
            return False
        known = reachable([*self.rates, *(node for one in maps for node in one.known)])
        shared = {node for node in known if node.op != "map"}
        scalar = count_operations(shared).total
        samples = [replace(rows[j], outputs={}) for j in _sample(len(rows))]
        written_out = [reachable(row.rates.values()) for row in self.solved.along(samples)]
        apart = sum(
            count_operations(node for node in order if node not in shared).total
            for order in written_out
        )
        # The cost of the sampled directions stands for that of all of them.
        longhand = scalar + apart * len(rows) / len(samples)
        return longhand > _FEW_OPERATIONS and self._cost(maps) < _WORTH * longhand


def _are_too_many(n_given: int, n_columns: int, n_results: int) -> bool:
    """Tell whether inputs and results of columns are more values than a kernel is to keep."""
    return n_given + n_columns * n_results > _MOST_VALUES


def _sample(n: int) -> list[int]:
    """Choose a few of n, evenly."""
    times = min(n, _SAMPLES)
    return [(2 * i + 1) * n // (2 * times) for i in range(times)]
