"""Derivatives along many directions as maps, which apply the same statements to many columns.

In a sensitivity graph, the derivative of a terminal equation with respect to one of its parameters
contains a source, ``m' a`` in ``F' = m a' + m' a``. The further operations along f-circuits and
f-cutsets, applied to sources and state sensitivities, are the same for all parameters. This module
separates these common operations. Sources are as large as possible: each is the largest value that
depends on no state sensitivity.

For parameter j the derivatives of the unknowns solve ``A w_j = b_x s_j + b_j``, in which the matrix
b_x is the same for all parameters and b_j is the explicit derivative with respect to parameter j.
Statements that are written out for each parameter exploit its zeros. Statements of a map are
written once, and C processes several columns at a time. The columns of the Jacobian are a map of
unit vectors s. If the Jacobian has fewer columns than there are parameters, it can also be formed
first and then multiplied by each s_j. The cheapest of these alternatives is used.

Implicit methods need three further kernels. The second returns d(J s + f_p)/dx v for every
parameter and a direction v of the states, that is, second derivatives, and is evaluated once in
each stage of a method. The first computes those values for the second that do not depend on v. The
third returns the derivatives of the rates of states and sensitivities with respect to time at fixed
states, including the time dependence of the scene's inputs.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from itertools import chain, product
from operator import or_
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents, tangents_along
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


#: Cost of moving one value into or out of a vector, in operations.
_MOVE = 2
#: Maximum number of sweeps that exchange columns in pairs; no sweeps for more columns than this.
_SWEEPS, _MOST_COLUMNS = 4, 400


def cost_of_map(linear: LinearMap) -> int:
    """Return the estimated cost of a map in scalar operations."""
    blocks = [linear.given[at : at + BLOCK] for at in range(0, linear.n_columns, BLOCK)]
    n_given = sum(reduce(or_, block).bit_count() for block in blocks)
    # A vector operation per block and statement costs as much as a scalar operation.
    return linear.n_times + _MOVE * (n_given + len(blocks) * len(linear.results))


def gather_columns(linear: LinearMap) -> tuple[LinearMap, list[int]]:
    """Put columns with similar zeros into blocks; also return the original index of each column."""
    # Bit mask of the nonzero statements in each column.
    nonzero = [0] * linear.n_columns
    for k, node in enumerate(linear.statements):
        support = linear.supports[node]
        while support:
            lowest = support & -support
            nonzero[lowest.bit_length() - 1] |= 1 << k
            support ^= lowest
    # Omit columns whose results are all zero.
    found = reduce(or_, (linear.supports[root] for root in linear.results), 0)
    places = [j for j in range(linear.n_columns) if found >> j & 1]
    blocks = [places[at : at + BLOCK] for at in range(0, len(places), BLOCK)]
    for _ in range(_SWEEPS if len(places) <= _MOST_COLUMNS else 0):
        pairs = ((a, b) for a in range(len(blocks)) for b in range(a))
        # any() of a list, not of a generator, so that every pair is tried.
        if not any([_exchange(blocks[a], blocks[b], nonzero) for a, b in pairs]):
            break
    order = list(chain.from_iterable(blocks))
    return replace(linear, given=tuple(linear.given[j] for j in order)), order


def _exchange(first: list[int], second: list[int], nonzero: Sequence[int]) -> bool:
    """Exchange columns of two blocks if this saves operations; return whether any was exchanged."""
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
    """Return the number of values that are nonzero in at least one column of a block."""
    union = 0
    for column in block:
        union |= nonzero[column]
    return union.bit_count()


#: Operations that can be applied separately to the two parts of their arguments.
_SUMS = frozenset({"add", "sub", "neg"})


@dataclass(frozen=True)
class CommonDirection:
    """Derivatives along any direction, as functions of state sensitivities and sources."""

    direction: Derivative  # forcing and rates in terms of state changes and sources
    sources: tuple[Node, ...]  # symbols of the sources
    #: For each parameter: its nonzero sources, by index of the source.
    given: list[dict[int, Node]]


def part_sources(equations: Equations, unknowns: Mapping[Node, Node]) -> CommonDirection | None:
    """Separate sources from operations common to all directions; None if there are none."""
    common, dag = equations.direction, equations.dag
    if common is None:
        return None
    states = [dag.symbol(STATE_CHANGE, i) for i in range(len(equations.states))]
    changes = [dag.symbol(PARAMETER_CHANGE, j) for j in range(len(equations.sensitivities))]
    roots = substitute([*common.forcing, *common.rates.values()], unknowns)
    parting = _Parting(dag, roots, [*states, *equations.unknown_tangents], changes)
    # Values common to all parameters are formed once; only sources differ between parameters.
    parted, n = [parting.parted(root) for root in roots], len(common.forcing)
    rates = dict(zip(common.rates, parted[n:], strict=True))
    direction = replace(common, forcing=tuple(parted[:n]), rates=rates, outputs={})
    return CommonDirection(direction, tuple(parting.sources.values()), parting.given())


class _Parting:
    """Splits values into a part linear in state changes and a part linear in parameter changes."""

    def __init__(
        self, dag: Dag, roots: Sequence[Node], states: Sequence[Node], changes: Sequence[Node]
    ) -> None:
        order = reachable(roots)
        self.sources: dict[Node, Node] = {}
        self._dag, self._changes = dag, changes
        self._changed = dependent(order, changes)
        self._moved = dependent(order, states)
        # A result counts as a use: values with several uses are not split.
        self._n_readers = Counter(roots)
        for node in order:
            self._n_readers.update(node.args)
        self._parts: dict[Node, tuple[Node, Node]] = {}
        for node in order:
            if node in self._moved and node in self._changed:
                self._parts[node] = self._parts_of(node)

    def parted(self, node: Node) -> Node:
        """Return a value in terms of state changes and source symbols."""
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
        """Return for each parameter the nonzero sources for a unit change of this parameter."""
        nodes = list(self.sources)
        bits = {node: 1 << j for j, node in enumerate(self._changes)}
        supports = supports_of(reachable(nodes), bits)
        still = dict.fromkeys(self._changes, self._dag.zero)
        found = []
        for j, change in enumerate(self._changes):
            # Sources are linear in the changes: substitute a unit change of a single parameter.
            places = [i for i, node in enumerate(nodes) if supports[node] >> j & 1]
            along = substitute([nodes[i] for i in places], {**still, change: self._dag.one})
            pairs = zip(places, along, strict=True)
            found.append({i: value for i, value in pairs if not value.is_zero})
        return found

    def _source(self, node: Node) -> Node:
        return self.sources.setdefault(node, self._dag.symbol(SOURCE, len(self.sources)))

    def _parts_of(self, node: Node) -> tuple[Node, Node]:
        """Split a value into the part that depends on state changes, and the rest."""
        dag = self._dag
        if node.op not in _SUMS:
            # Add the parts of a factor first: multiplying both parts would cost twice as much.
            return dag.rebuild(node, tuple(self.parted(arg) for arg in node.args)), dag.zero
        terms = [self._term(arg) for arg in node.args]
        moved, alone = zip(*terms, strict=True)
        return dag.rebuild(node, moved), dag.rebuild(node, alone)

    def _term(self, node: Node) -> tuple[Node, Node]:
        """Return both parts of a term, which is split only if no other node uses it."""
        if node not in self._changed:
            return node, self._dag.zero
        if node not in self._moved:
            return self._dag.zero, node
        if self._n_readers[node] == 1:
            return self._parts[node]
        # Another node uses the term too, so splitting it would form it twice.
        return self.parted(node), self._dag.zero


#: If fewer operations suffice, statements are written out for each direction.
_FEW_OPERATIONS = 600
#: A map is used if its cost is below this fraction of the cost of written-out statements.
_WORTH = 0.75
#: Maximum number of column values that a kernel stores on the stack: 800 kB.
_MOST_VALUES = 100_000
#: Number of directions that are written out to estimate the average cost of a direction.
_SAMPLES = 5

#: Nonzero derivatives along one direction, by index of the rate.
_Row = dict[int, "Node"]


@dataclass(frozen=True)
class MappedRates:
    """Derivatives of the rates that are computed by maps; None if maps do not compute them."""

    columns: list[_Row] | None  # columns of the Jacobian
    sensitivities: list[Node] | None  # rates of all sensitivities, parameter by parameter


def map_rates(
    equations: Equations,
    solved: SolvedSystem,
    rates: Sequence[Node],
    reached: Sequence[Sequence[int]],
) -> MappedRates:
    """Form derivatives of the rates as maps if maps cost less than written-out statements.

    ``rates`` do not contain unknowns. ``reached`` contains the states that depend on each
    parameter; all other states have zero sensitivities.
    """
    # Algebraic unknowns are eliminated along each direction separately (cotree.program.lower).
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
    """A map with its arguments, and the order of its columns."""

    dag: Dag
    linear: LinearMap
    shared: tuple[Node, ...]
    columns: list[Sequence[Node]]
    order: list[int]
    n_directions: int
    places: list[int]  # indices of the results

    @property
    def known(self) -> list[Node]:
        """Arguments of the map, which must be computed before the map is applied."""
        return [*self.shared, *(value for column in self.columns for value in column)]

    @cached_property
    def rows(self) -> list[_Row]:
        """Nonzero results for each direction."""
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
    """Alternative forms of the rate derivatives, with their estimated costs."""

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
        """Symbols of the changes of all states."""
        return [self._dag.symbol(STATE_CHANGE, i) for i in range(len(self.equations.states))]

    @cached_property
    def _solving(self) -> list[int]:
        """Indices of the rates that depend on unknowns."""
        # Rates without unknowns are not part of the map; with_unsolved differentiates them.
        rates, unknowns = self.common.direction.rates, self.equations.unknown_tangents
        moving = dependent(reachable(rates.values()), unknowns)
        return [i for i, node in rates.items() if node in moving]

    def along_states(self) -> _Map | None:
        """Form the columns of the Jacobian, for rates with unknowns, as a map of unit vectors."""
        one, zero, places = self._dag.one, self._dag.zero, range(len(self._states))
        if _are_too_many(len(places), len(places), len(self._solving)):
            return None
        columns = [[one if i == j else zero for i in places] for j in places]
        results = self._rates_along(self._solving, self.common.sources)
        return self._map(results, self._solving, self._states, columns)

    def with_unsolved(self, along_states: _Map) -> list[_Row]:
        """Return the columns of the Jacobian, completed by the rates that depend on no unknowns."""
        dag, found = self._dag, [dict(row) for row in along_states.rows]
        without = dict.fromkeys(self.common.sources, dag.zero)
        for i in self.common.direction.rates.keys() - set(self._solving):
            # The derivative is linear, so a unit change of one state yields its column.
            (rate,) = substitute([self.common.direction.rates[i]], without)
            moving = [node for node in symbols_in([rate]) if node.data[0] == STATE_CHANGE]
            still = dict.fromkeys(moving, dag.zero)
            for node in moving:
                (value,) = substitute([rate], {**still, node: dag.one})
                if not value.is_zero:
                    found[node.data[1]][i] = value
        return found

    def along_sensitivities(self, along_states: _Map | None) -> list[_Map] | None:
        """Return the cheapest maps that form the sensitivity rates; the last map returns the rates.

        The alternatives are a single map of state changes and sources, and three maps: the
        Jacobian J, the explicit derivatives f_p with respect to parameters, and J s + f_p.
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
        # Columns stay in the order of ``s``, so that C reads sensitivities in place.
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
        # The products J s alone, two operations per nonzero, cost more than the single map.
        if 2 * sum(map(len, columns)) > len(at_once.linear.statements):
            return [at_once]
        alone = self._map(self._results(self._states), range(n), self.common.sources, given)
        if alone is None:
            return [at_once]
        in_turn = [along_states, alone, self._products(columns, alone.rows, changes)]
        return min([at_once], in_turn, key=self._cost)

    def _products(
        self, columns: Sequence[_Row], alone: Sequence[_Row], changes: Sequence[Sequence[Node]]
    ) -> _Map:
        """Form Jacobian times sensitivities, plus the explicit parameter derivatives."""
        dag, n = self._dag, len(self._states)
        places = sorted({i for row in alone for i in row})
        # The explicit parameter derivatives are further inputs of each column.
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
        assert found is not None  # sums of products are linear
        return found

    def _results(self, still: Sequence[Node]) -> list[Node]:
        """Return the derivatives of all rates along a direction; ``still`` symbols are zero."""
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
        """Form a map; return None if the results are not linear or the map is too large."""
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
        """Return the estimated cost of maps, including the values computed before them."""
        nodes = reachable([*self.rates, *(node for one in maps for node in one.known)])
        before = count_operations(node for node in nodes if node.op != "map").total
        return before + sum(cost_of_map(one.linear) for one in maps)

    def are_worth(self, maps: Sequence[_Map], rows: Sequence[Derivative]) -> bool:
        """Return whether maps cost clearly less than written-out statements for all of ``rows``."""
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
        # The other directions are assumed to cost as much as the sampled ones on average.
        longhand = scalar + apart * len(rows) / len(samples)
        return longhand > _FEW_OPERATIONS and self._cost(maps) < _WORTH * longhand


def _are_too_many(n_given: int, n_columns: int, n_results: int) -> bool:
    """Return whether inputs and results of all columns exceed the stack of a kernel."""
    return n_given + n_columns * n_results > _MOST_VALUES


def _sample(n: int) -> list[int]:
    """Return a few indices below n, evenly spaced."""
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
    "nonzero derivatives of the sensitivity rates along the direction v of the states",
)


@dataclass(frozen=True)
class Curvature:
    """Kernels of the second derivatives for implicit methods."""

    #: ``at`` is called once per point, ``along`` once per direction. Argument ``k`` of both
    #: contains prepared values; that of ``along`` also contains the results of ``at``.
    at: Kernel
    along: Kernel
    places: tuple[int, ...]  # indices of the results of ``along`` among the sensitivity rates


def form_curvature(program: Program) -> Curvature | None:
    """Return the kernels of d(J s + f_p)/dx v; None if these derivatives are zero."""
    dag, kernel = program.dag, program.kernels["sensitivity_rhs"]
    n = len(program.layout.states)
    direction = [dag.symbol(DIRECTION, i) for i in range(n)]
    found = tangents(kernel.results, {dag.symbol(STATE, i): direction[i] for i in range(n)})
    # Most of these derivatives are zero; only nonzero ones are results.
    places = tuple(i for i, node in enumerate(found) if not node.is_zero)
    if not places:
        return None
    whole = with_reciprocals(Kernel(_ALONG, tuple(found[i] for i in places), {}))
    order = reachable(whole.results)
    moving = dependent(order, direction)
    # ``along`` has only the arguments ``v`` and ``k``, so ``at`` returns all other values it reads.
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
    "time derivatives of the rates of the states, then of the sensitivities",
)


def form_time_slope(program: Program) -> Kernel | None:
    """Differentiate the rates with respect to time; None if they depend on no time and no input."""
    dag, kernels = program.dag, program.kernels
    rates = kernels["augmented_rhs"].results or kernels["rhs"].results
    time = {dag.symbol(TIME, 0): dag.one}
    # Inputs are functions of time in the scene, so the chain rule includes their derivatives.
    moving = tangents(kernels["inputs"].results, time)
    # States and sensitivities are fixed: they have no tangents.
    seed = {**time, **{dag.symbol(INPUT, i): node for i, node in enumerate(moving)}}
    found = tangents(rates, seed)
    if all(node.is_zero for node in found):
        return None
    return Kernel(_SPEC, tuple(found), kernels["rhs"].prepared)


#: Kernel that only bridges to other tools need, compiled at its first use.
INPUT_JACOBIAN = KernelSpec(
    "input_jacobian",
    KERNELS["jacobian"].arguments,
    "values",
    "derivatives of rhs with respect to the inputs, row by row",
)


def form_input_jacobian(program: Program) -> Kernel:
    """Differentiate the rates with respect to the inputs."""
    dag, rhs = program.dag, program.kernels["rhs"]
    n_inputs = len(program.layout.inputs)
    seeds = [{dag.symbol(INPUT, i): dag.one} for i in range(n_inputs)]
    rows = tangents_along(rhs.results, seeds)
    found = (row.get(i, dag.zero) for row in rows for i in range(n_inputs))
    return Kernel(INPUT_JACOBIAN, tuple(found), rhs.prepared)
