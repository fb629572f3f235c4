"""Derivatives along many directions as one map of many columns.

Along parameter j the unknowns' derivatives solve ``A w_j = b_x s_j + b_j``, where b_x s is the same
for all and b_j is what the parameter itself changes. Statements written out for each parameter use
what vanishes in it; those of a map are written once and C takes several columns at a time. Both
ways are counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.linear_map import apply_map, form_map
from cotree.dag.traverse import dependent, reachable, substitute
from cotree.program.counts import count_operations

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.linear_map import LinearMap
    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Derivative, Equations
    from cotree.formulation.elimination import Solver

#: Columns that C takes at a time, on most machines.
_LANES = 4
#: Fewer operations than these are written out for each direction.
_FEW_OPERATIONS = 600
#: What one value costs that goes into a vector, or comes out of it.
_MOVE = 2
#: Of the operations written out, those of a map may cost this share.
_WORTH = 0.75
#: Values of all columns that a kernel keeps on its stack: 800 kB.
_MOST_VALUES = 100_000
#: Directions that are written out to see what one costs.
_SAMPLES = 5


def rates_along_sensitivities(
    equations: Equations, factors: Solver, solved: Mapping[Node, Node], rates: Sequence[Node]
) -> list[Node] | None:
    """Form the rates of all sensitivities, direction by direction, as one map.

    Parameters
    ----------
    equations : Equations
        The equations.
    factors : Solver
        Their factorised matrix.
    solved : mapping of Node to Node
        The unknowns' symbols and values.
    rates : sequence of Node
        Rates of the states, solved.

    Returns
    -------
    list of Node or None
        None where it costs more, or where a map cannot be formed.
    """
    common, dag, n = equations.direction, equations.dag, len(equations.states)
    if common is None or equations.n_algebraic:
        return None
    states = [dag.symbol("s", i) for i in range(n)]
    alone = _at_rest(equations, solved)
    touched = sorted({place for column in alone for place in column})
    own = {place: dag.symbol("own", i) for i, place in enumerate(touched)}
    size = len(common.forcing)
    forcing = [
        node + own.get(k, dag.zero) for k, node in enumerate(substitute(common.forcing, solved))
    ]
    tangents = dict(zip(equations.unknown_tangents, factors.solve(forcing), strict=True))
    found = dict(
        zip(
            common.rates,
            substitute(substitute(list(common.rates.values()), solved), tangents),
            strict=True,
        )
    )
    results = [found.get(i, dag.zero) + own.get(size + i, dag.zero) for i in range(n)]
    columns = [
        [dag.symbol("s", j * n + i) for i in range(n)]
        + [column.get(place, dag.zero) for place in touched]
        for j, column in enumerate(alone)
    ]
    formed = _formed(dag, results, [*states, *own.values()], columns)
    if formed is None:
        return None
    linear, shared = formed
    written_out = [
        _solved_along(equations.sensitivities[j], factors, solved, equations.unknown_tangents)
        for j in _sample(len(columns))
    ]
    if not _is_worth(linear, [*rates, *shared], columns, written_out):
        return None
    return [node for column in apply_map(dag, linear, shared, columns) for node in column]


def rates_along_states(
    equations: Equations, factors: Solver, solved: Mapping[Node, Node], rates: Sequence[Node]
) -> list[dict[int, Node]] | None:
    """Form the columns of the Jacobian, their unknowns' derivatives as one map.

    Parameters and results are those of :func:`rates_along_sensitivities`, the latter by place.
    """
    dag, rows = equations.dag, equations.columns
    if equations.n_algebraic or not equations.unknowns:
        return None
    solving = _common_rates(rows, equations.unknown_tangents)
    if not solving:
        return None
    size = len(equations.forcing)
    entries = iter(substitute([node for row in rows for node in row.forcing], solved))
    forced = [{k: node for k in range(size) if not (node := next(entries)).is_zero} for _ in rows]
    moving = [j for j, forcing in enumerate(forced) if forcing]
    if not moving:
        return None
    touched = sorted({place for forcing in forced for place in forcing})
    own = {place: dag.symbol("own", i) for i, place in enumerate(touched)}
    tangents = factors.solve([own.get(k, dag.zero) for k in range(size)])
    known = dict(zip(equations.unknown_tangents, tangents, strict=True))
    results = substitute(substitute(list(solving.values()), solved), known)
    columns = [[forced[j].get(place, dag.zero) for place in touched] for j in moving]
    formed = _formed(dag, results, list(own.values()), columns)
    if formed is None:
        return None
    linear, shared = formed
    written_out = [
        _solved_along(rows[moving[k]], factors, solved, equations.unknown_tangents)
        for k in _sample(len(moving))
    ]
    if not _is_worth(linear, [*rates, *shared], columns, written_out):
        return None
    apart = [{i: node for i, node in row.rates.items() if i not in solving} for row in rows]
    kept = [dict(zip(own, substitute(own.values(), solved), strict=True)) for own in apart]
    masks = _dependence(linear)
    for j, values in zip(moving, apply_map(dag, linear, shared, columns), strict=True):
        given = sum(1 << k for k, place in enumerate(touched) if place in forced[j])
        kept[j] |= {
            i: value for i, value, mask in zip(solving, values, masks, strict=True) if mask & given
        }
    return kept


def _common_rates(rows: Sequence[Derivative], unknowns: Sequence[Node]) -> dict[int, Node]:
    """Give the rates that all directions have in terms of unknowns; none where they differ."""
    solving = dependent(reachable(node for row in rows for node in row.rates.values()), unknowns)
    found: dict[int, Node] = {}
    for row in rows:
        for i, node in row.rates.items():
            if node in solving and found.setdefault(i, node) is not node:
                return {}
    return found


def _dependence(linear: LinearMap) -> list[int]:
    """Tell which inputs each result depends on, as bits."""
    bits: dict[Node, int] = {}
    for node in linear.order:
        own = 1 << node.data[1] if node.op == "symbol" and node.data[0] == "column" else 0
        for arg in node.args:
            own |= bits[arg]
        bits[node] = own
    return [bits[root] for root in linear.results]


def _formed(
    dag: Dag, results: Sequence[Node], inputs: Sequence[Node], columns: Sequence[Sequence[Node]]
) -> tuple[LinearMap, tuple[Node, ...]] | None:
    if len(columns) * (len(inputs) + len(results)) > _MOST_VALUES:
        return None
    return form_map(dag, results, inputs, len(columns))


def _at_rest(equations: Equations, solved: Mapping[Node, Node]) -> list[dict[int, Node]]:
    """Give what each parameter changes by itself: places of the forcing, then of the rates."""
    dag, rows = equations.dag, equations.sensitivities
    moving = (dag.symbol("s", i) for i in range(len(equations.states) * len(rows)))
    still = dict.fromkeys((*equations.unknown_tangents, *moving), dag.zero)
    nodes = [node for row in rows for node in (*row.forcing, *row.rates.values())]
    # One substitution for all: what they share is visited once.
    known = iter(substitute(nodes, {**solved, **still}))
    found = []
    for row in rows:
        size = len(row.forcing)
        places = (*range(size), *(size + i for i in row.rates))
        found.append({place: node for place in places if not (node := next(known)).is_zero})
    return found


def _solved_along(
    row: Derivative, factors: Solver, solved: Mapping[Node, Node], unknowns: Sequence[Node]
) -> list[Node]:
    """Write the rates along one direction out."""
    size = len(row.forcing)
    known = substitute([*row.forcing, *row.rates.values()], solved)
    tangents = dict(zip(unknowns, factors.solve(known[:size]), strict=True))
    return substitute(known[size:], tangents)


def _sample(n: int) -> list[int]:
    """Choose a few of n, evenly."""
    times = min(n, _SAMPLES)
    return [(2 * i + 1) * n // (2 * times) for i in range(times)]


def _is_worth(
    linear: LinearMap,
    known: Sequence[Node],
    columns: Sequence[Sequence[Node]],
    written_out: Sequence[Sequence[Node]],
) -> bool:
    """Compare the cost of a map with that of statements for each direction."""
    shared = set(reachable([*known, *(node for column in columns for node in column)]))
    scalar = count_operations(shared).total
    apart = sum(
        count_operations(node for node in reachable(nodes) if node not in shared).total
        for nodes in written_out
    )
    longhand = scalar + apart * len(columns) / len(written_out)
    groups = -(-len(columns) // _LANES)
    moved = _MOVE * (linear.n_inputs + len(linear.results))
    cost = scalar + groups * (linear.counts.total() + moved)
    return longhand > _FEW_OPERATIONS and cost < _WORTH * longhand
