"""Derivatives along many directions as maps of many columns.

In a sensitivity graph the derivative of a terminal equation by one of its parameters is a source:
``F' = m a' + m' a``. Along f-circuits and f-cutsets, the values that follow from sources and from
the states' sensitivities are the same for all parameters. This module separates the common part,
which is as large as possible: sources are the largest values that depend on no sensitivity of a
state.

Along parameter j the unknowns' derivatives solve ``A w_j = b_x s_j + b_j``, in which the matrix b_x
is common to all and b_j is the explicit derivative by the parameter. Statements written out for
each parameter exploit its zeros; those of a map are written once, and C processes several columns
at a time. The columns of the Jacobian are one map of unit vectors s; if they are fewer than the
parameters, it is formed first and multiplied by each s_j. The costs of these alternatives are
compared.

Implicit methods need three further kernels. The first prepares, at a point, values for the second.
The second is linear in a direction v of the states and is evaluated once in each stage of a
method: it returns d(J s + f_p)/dx v for every parameter, by differentiating the sensitivities once
more. The third returns the derivatives of the rates of states and sensitivities with respect to
time at fixed states; the inputs of the scene vary with time.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import chain, product
from operator import or_
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.multi_output import BLOCK, SEVERAL, LinearMap, apply_map, form_map
from cotree.dag.nodes import (
    DIRECTION,
    ENTRY,
    INPUT,
    PARAMETER_CHANGE,
    SENSITIVITY,
    SOURCE,
    STATE,
    STATE_CHANGE,
    TIME,
    Dag,
    Node,
    dependent,
    reachable,
    substitute,
    supports_of,
    symbols_in,
)
from cotree.equations import Derivative, Equations, spread
from cotree.program.counts import count_operations
from cotree.program.kernels import KERNELS, KernelSpec
from cotree.program.passes import with_reciprocals
from cotree.program.program import Kernel, Program

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Mapping, Sequence

    from cotree.program.solved import SolvedSystem


#: Number of operations to move one nonzero value into a vector, or out of it.
_MOVE = 2
#: Number of sweeps in which exchanges of all pairs of columns are tried, and maximum number of
#: columns.
_SWEEPS, _MOST_COLUMNS = 4, 400


def cost_of_map(linear: LinearMap) -> int:
    """Estimate the cost of a map, in scalar operations."""
    blocks = [linear.given[at : at + BLOCK] for at in range(0, linear.n_columns, BLOCK)]
    n_given = sum(reduce(or_, block).bit_count() for block in blocks)
    # A statement of one block is one vector operation, counted like a scalar one.
    return linear.n_times + _MOVE * (n_given + len(blocks) * len(linear.results))


def gather_columns(linear: LinearMap) -> tuple[LinearMap, list[int]]:
    """Put columns with similar zeros into one block, and leave out zero columns.

    Columns of different blocks are exchanged in pairs until no exchange reduces the number of
    computed values. Also returns the original place of each column.
    """
    # For each column, the statements that are nonzero there, as a bit mask.
    nonzero = [0] * linear.n_columns
    for k, node in enumerate(linear.statements):
        support = linear.supports[node]
        while support:
            lowest = support & -support
            nonzero[lowest.bit_length() - 1] |= 1 << k
            support ^= lowest
    # A column whose results are all zero is omitted.
    found = reduce(or_, (linear.supports[root] for root in linear.results), 0)
    places = [j for j in range(linear.n_columns) if found >> j & 1]
    blocks = [places[at : at + BLOCK] for at in range(0, len(places), BLOCK)]
    for _ in range(_SWEEPS if len(places) <= _MOST_COLUMNS else 0):
        pairs = ((a, b) for a in range(len(blocks)) for b in range(a))
        # Every pair is tried, whether or not the previous one was exchanged.
        if not any([_exchange(blocks[a], blocks[b], nonzero) for a, b in pairs]):
            break
    order = list(chain.from_iterable(blocks))
    return replace(linear, given=tuple(linear.given[j] for j in order)), order


def _exchange(first: list[int], second: list[int], nonzero: Sequence[int]) -> bool:
    """Swap columns of two blocks if this reduces their operations."""
    least = _n_together(first, nonzero) + _n_together(second, nonzero)
    has_changed = False
    for i, k in product(range(len(first)), range(len(second))):
        first[i], second[k] = second[k], first[i]
        found = _n_together(first, nonzero) + _n_together(second, nonzero)
        if found < least:
            least, has_changed = found, True
        else:
            first[i], second[k] = second[k], first[i]
    return has_changed


def _n_together(block: Sequence[int], nonzero: Sequence[int]) -> int:
    """Count the values that are nonzero in at least one column of a block."""
    union = 0
    for column in block:
        union |= nonzero[column]
    return union.bit_count()


#: Operations that can be applied separately to both parts of their arguments.
_SUMS = frozenset({"add", "sub", "neg"})


@dataclass(frozen=True)
class CommonDirection:
    """Derivatives along any direction, from sensitivities of states and from sources."""

    direction: Derivative  # forcing and rates, in terms of changes and sources
    sources: tuple[Node, ...]  # symbols of the source terms
    #: Nonzero sources of each parameter, by index.
    given: list[dict[int, Node]]


def part_sources(equations: Equations, unknowns: Mapping[Node, Node]) -> CommonDirection | None:
    """Separate the common part of all directions from the sources; None if there are no sources.

    ``unknowns`` are their symbols and values.
    """
    common, dag = equations.direction, equations.dag
    if common is None:
        return None
    states = [dag.symbol(STATE_CHANGE, i) for i in range(len(equations.states))]
    changes = [dag.symbol(PARAMETER_CHANGE, j) for j in range(len(equations.sensitivities))]
    roots = substitute([*common.forcing, *common.rates.values()], unknowns)
    parting = _Parting(dag, roots, [*states, *equations.unknown_tangents], changes)
    # Values that depend on sensitivities and sources are formed once for all parameters; only the
    # values of the sources differ.
    parted, n = [parting.parted(root) for root in roots], len(common.forcing)
    rates = dict(zip(common.rates, parted[n:], strict=True))
    direction = replace(common, forcing=tuple(parted[:n]), rates=rates, outputs={})
    return CommonDirection(direction, tuple(parting.sources.values()), parting.given())


class _Parting:
    """Splits values that are linear in changes of states and of parameters into two parts.

    The sources of nested sums are added first, so that each column contributes one value.
    """

    def __init__(
        self, dag: Dag, roots: Sequence[Node], states: Sequence[Node], changes: Sequence[Node]
    ) -> None:
        order = reachable(roots)
        self.sources: dict[Node, Node] = {}
        self._dag, self._changes = dag, changes
        self._changed = dependent(order, changes)
        self._moved = dependent(order, states)
        # Results count as uses: a value with two uses must be formed as a whole.
        self._n_readers = Counter(roots)
        for node in order:
            self._n_readers.update(node.args)
        self._parts: dict[Node, tuple[Node, Node]] = {}
        for node in order:
            if node in self._moved and node in self._changed:
                self._parts[node] = self._parts_of(node)

    def parted(self, node: Node) -> Node:
        """Return a value in terms of the symbols of sources."""
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
        """Return the nonzero sources of each single change, by place."""
        nodes = list(self.sources)
        bits = {node: 1 << j for j, node in enumerate(self._changes)}
        supports = supports_of(reachable(nodes), bits)
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
        """Split a value into parts that depend on states, and on parameters only."""
        dag = self._dag
        if node.op not in _SUMS:
            # Products and quotients have one factor that changes. Its two parts are added first,
            # since multiplying both would cost twice as much.
            return dag.rebuild(node, tuple(self.parted(arg) for arg in node.args)), dag.zero
        terms = [self._term(arg) for arg in node.args]
        moved, alone = zip(*terms, strict=True)
        return dag.rebuild(node, moved), dag.rebuild(node, alone)

    def _term(self, node: Node) -> tuple[Node, Node]:
        """Return both parts of a term of a sum, if the term has no other user."""
        if node not in self._changed:
            return node, self._dag.zero
        if node not in self._moved:
            return self._dag.zero, node
        if self._n_readers[node] == 1:
            return self._parts[node]
        # The sum has another user, so splitting it here would form it twice.
        return self.parted(node), self._dag.zero


#: Number of operations below which the code is written out for each direction.
_FEW_OPERATIONS = 600
#: A map is used if it costs less than this fraction of the written-out operations.
_WORTH = 0.75
#: Maximum number of column values that a kernel stores on the stack: 800 kB.
_MOST_VALUES = 100_000
#: Number of directions that are written out to estimate the cost of one.
_SAMPLES = 5

#: Derivatives along one direction, by index.
_Row = dict[int, "Node"]


@dataclass(frozen=True)
class MappedRates:
    """The rates along all states, and along all sensitivities; None if they are not a map."""

    columns: list[_Row] | None  # columns of the Jacobian, by index
    sensitivities: list[Node] | None  # rates of all sensitivities, by direction; None: no map


def map_rates(
    equations: Equations,
    solved: SolvedSystem,
    rates: Sequence[Node],
    reached: Sequence[Sequence[int]],
) -> MappedRates:
    """Form derivatives of the rates as maps if that costs less than writing them out.

    ``rates`` are solved; ``reached`` are the states that depend on each parameter, the
    sensitivities of all others being zero.
    """
    # Eliminating algebraic unknowns needs the derivatives along each direction separately; see
    # cotree.program.lower.
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
    """A map of columns, in the order of its columns."""

    dag: Dag
    linear: LinearMap
    shared: tuple[Node, ...]
    columns: list[Sequence[Node]]
    order: list[int]
    n_directions: int
    places: list[int]  # indices of the results

    @property
    def known(self) -> list[Node]:
        """Values that are computed before the map is applied."""
        return [*self.shared, *(value for column in self.columns for value in column)]

    @cached_property
    def rows(self) -> list[_Row]:
        """The nonzero results of each direction."""
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
    """Alternative forms of the derivatives of the rates."""

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
        # Rates without unknowns are not part of this map; with_unsolved forms their derivatives
        # directly.
        rates, unknowns = self.common.direction.rates, self.equations.unknown_tangents
        moving = dependent(reachable(rates.values()), unknowns)
        return [i for i, node in rates.items() if node in moving]

    def along_states(self) -> _Map | None:
        """Map unit vectors: the columns of the Jacobian, for rates that depend on unknowns."""
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
            # with this change equal to one and all others zero.
            (rate,) = substitute([self.common.direction.rates[i]], without)
            moving = [node for node in symbols_in([rate]) if node.data[0] == STATE_CHANGE]
            still = dict.fromkeys(moving, dag.zero)
            for node in moving:
                (value,) = substitute([rate], {**still, node: dag.one})
                if not value.is_zero:
                    found[node.data[1]][i] = value
        return found

    def along_sensitivities(self, along_states: _Map | None) -> list[_Map] | None:
        """Choose the cheaper form of the rates of sensitivities; the last map returns them.

        It is either one map of changes of states and of sources, or the columns of the Jacobian,
        the explicit derivatives by parameters, and a sum of products of both.
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
        # These columns keep the order of ``s``, so that C reads sensitivities in place.
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
        # The Jacobian requires a product and a sum for each nonzero and column. If these exceed the
        # statements of the first form, the second form cannot be cheaper.
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
        """Multiply the Jacobian by the sensitivities, and add the derivatives by parameters."""
        dag, n = self._dag, len(self._states)
        places = sorted({i for row in alone for i in row})
        # The derivatives by parameters are additional inputs of each column.
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
        assert found is not None  # the terms are sums of products
        return found

    def _results(self, still: Sequence[Node]) -> list[Node]:
        """Return the rates of all states along any direction, with some symbols zero."""
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
        """Form a map; None if that is impossible, or it is too large."""
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
        """Return whether maps cost less than statements written out for each direction."""
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
        # The average cost of the sampled directions is used for all of them.
        longhand = scalar + apart * len(rows) / len(samples)
        return longhand > _FEW_OPERATIONS and self._cost(maps) < _WORTH * longhand


def _are_too_many(n_given: int, n_columns: int, n_results: int) -> bool:
    """Return whether inputs and results of columns exceed the space on a kernel's stack."""
    return n_given + n_columns * n_results > _MOST_VALUES


def _sample(n: int) -> list[int]:
    """Choose a few of n indices, evenly spaced."""
    times = min(n, _SAMPLES)
    return [(2 * i + 1) * n // (2 * times) for i in range(times)]


_AT = KernelSpec(
    "curvature",
    KERNELS["augmented_rhs"].arguments,
    "c",
    "values at a point for curvature_along, independent of the direction",
)
_ALONG = KernelSpec(
    "curvature_along",
    ("v", "k"),
    "values",
    "derivatives of the sensitivities' rates along the direction v of the states: nonzeros",
)


@dataclass(frozen=True)
class Curvature:
    """Both kernels."""

    #: Kernels; ``k`` contains prepared values, and for ``along`` the values that ``at`` computes.
    at: Kernel
    along: Kernel
    places: tuple[int, ...]  # places of the results of ``along`` among the rates of sensitivities


def form_curvature(program: Program) -> Curvature | None:
    """Differentiate the rates of sensitivities by the states.

    None if these rates depend on the states through the sensitivities only.
    """
    dag, kernel = program.dag, program.kernels["sensitivity_rhs"]
    n = len(program.layout.states)
    direction = [dag.symbol(DIRECTION, i) for i in range(n)]
    seed = {dag.symbol(STATE, i): direction[i] for i in range(n)}
    found = tangents(kernel.results, seed)
    # Most of these derivatives are zero, and are omitted from the results.
    places = tuple(i for i, node in enumerate(found) if not node.is_zero)
    if not places:
        return None
    whole = with_reciprocals(Kernel(_ALONG, tuple(found[i] for i in places), {}))
    order = reachable(whole.results)
    moving = dependent(order, direction)
    # The second kernel has the arguments ``v`` and ``k`` only. All other values that it reads,
    # states and parameters included, are carried over from the first one.
    read = {arg for node in order if node in moving for arg in node.args}
    carried = [
        node
        for node in order
        if node in read and node not in moving and node.value is None and node.op not in SEVERAL
    ]
    return Curvature(
        Kernel(_AT, tuple(carried), kernel.prepared),
        replace(whole, prepared={node: i for i, node in enumerate(carried)}),
        places,
    )


_SPEC = KernelSpec(
    "time_slope",
    KERNELS["augmented_rhs"].arguments,
    "dz",
    "derivatives by time of the rates of the states, then of the sensitivities",
)


def form_time_slope(program: Program) -> Kernel | None:
    """Differentiate the rates by time; None if they depend on neither time nor inputs."""
    dag, kernels = program.dag, program.kernels
    rates = kernels["augmented_rhs"].results or kernels["rhs"].results
    time = {dag.symbol(TIME, 0): dag.one}
    # The inputs are the scene's functions of time, so that the chain rule includes them.
    moving = tangents(kernels["inputs"].results, time)
    # At a fixed state: states and sensitivities have no tangent.
    seed = {**time, **{dag.symbol(INPUT, i): node for i, node in enumerate(moving)}}
    found = tangents(rates, seed)
    if all(node.is_zero for node in found):
        return None
    return Kernel(_SPEC, tuple(found), kernels["rhs"].prepared)
