"""Kernels for explicit methods, for models with algebraic unknowns.

In: rates and residuals ``x' = f(x, z), 0 = g(x, z)`` with their derivatives. Out, all with the same
factors of g_z in straight-line code:

- the *extended* rates: x', and ``z' = -g_z^-1 (g_x x' + g_t)``. Unknowns are integrated like
  states, from a solution, and projected onto one after each step. Sensitivities of z need no
  integration: ``S_z = -g_z^-1 (g_x S_x + g_p)``.
- a step from a guess of z towards the solution, and the rates of x at its end. It is a Taylor
  series: along ``g(z(s)) = (1 - s) g(z(0))`` the derivatives by s are

      z' = -g_z^-1 g,    z'' = -g_z^-1 (g_zz z' z'),

  and z(1) is the solution. The remainder is of third order in the step. The kernel also estimates
  the reach of the series: the length of the step relative to the distance over which any function
  in it bends.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.nodes import (
    PACKED_SENSITIVITY,
    SENSITIVITY,
    STATE_RATE,
    STEP,
    dependent,
    reachable,
    substitute,
)
from cotree.equations import spread
from cotree.linear.factors import factorise_unsymmetric
from cotree.program.counts import count_operations
from cotree.tolerances import TINY

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Equations
    from cotree.linear.factors import SparseFactors
    from cotree.program.solved import Along

#: Larger kernels take longer to compile than loops over dense matrices take to run.
_MOST_UNKNOWNS, _MOST_UPDATES, _MOST_OPERATIONS = 100, 2000, 3000

# Functions that change their curvature if their argument changes by 1; and those that do, or may
# have a kink, if it changes by its own magnitude.
_OF_CHANGE = frozenset({"exp", "sin", "cos", "sinh", "cosh", "tanh", "atan"})
_OF_SHARE = frozenset({"sqrt", "log", "abs", "sign"})


def reduced_kernels(
    equations: Equations,
    rates: Sequence[Node],
    columns: Sequence[Mapping[int, Node]],
    along: Sequence[Along],
    motion: Along,
    reached: Sequence[Sequence[int]],
) -> dict[str, list[Node]]:
    """Form the results of the kernels; empty if nothing can be eliminated, or too much.

    ``rates`` are f, then g; ``columns`` their derivatives by each state, by place; ``along`` the
    same along each parameter, in terms of the states' sensitivities, and ``motion`` along the
    motion, in terms of the states' rates. ``reached`` are the states with sensitivities to each
    parameter.
    """
    found: dict[str, list[Node]] = {
        "algebraic_step": [],
        "extended_rhs": [],
        "extended_augmented_rhs": [],
        "algebraic_sensitivity": [],
    }
    cut = len(rates) - equations.n_algebraic
    if not 0 < equations.n_algebraic <= _MOST_UNKNOWNS:
        return found
    with equations.dag.labelled("elimination of algebraic unknowns"):
        # Residuals are the last rates. Their rows, by all unknowns, are g_z.
        slopes = _rows_of(columns[cut:], cut, len(rates))
        factorised = factorise_unsymmetric(equations.dag, slopes, _MOST_UPDATES)
        if factorised is None:
            return found
        factors, doubt = factorised
        symbols = [state.symbol for state in equations.states[cut:]]
        found["algebraic_step"] = [*_step(factors, rates, slopes, symbols), doubt]
        # Constraints have projections of their own.
        is_held = equations.constraints.rows or equations.constraints.quaternions
        if cut > 0 and equations.motion is not None and not is_held:
            extended = [*rates[:cut], *_unknown_rates(equations, factors, rates, motion)]
            along_rates, along_unknowns = _sensitivities(
                equations, factors, columns[cut:], along, reached
            )
            # Runs without sensitivities integrate the states only.
            found["extended_rhs"] = extended
            if along:
                found["extended_augmented_rhs"] = [*extended, *along_rates]
            found["algebraic_sensitivity"] = along_unknowns
    return {
        # A kernel that is too long is dropped, and the engine solves dense systems instead.
        name: nodes if count_operations(reachable(nodes)).total <= _MOST_OPERATIONS else []
        for name, nodes in found.items()
    }


def _rows_of(columns: Sequence[Mapping[int, Node]], low: int, high: int) -> list[dict[int, Node]]:
    """List some rows of a matrix that is given by columns."""
    rows: list[dict[int, Node]] = [{} for _ in range(low, high)]
    for j, column in enumerate(columns):
        for i, node in column.items():
            if low <= i < high:
                rows[i - low][j] = node
    return rows


def _step(
    factors: SparseFactors,
    rates: Sequence[Node],
    slopes: Sequence[Mapping[int, Node]],
    symbols: Sequence[Node],
) -> list[Node]:
    """Form the rates at the end of a step, the step itself, its last part and its reach."""
    dag, cut = factors.dag, len(rates) - len(symbols)
    first = factors.solve([-node for node in rates[cut:]])
    # Symbols represent z' while second derivatives are formed; z' itself, a long expression, is
    # substituted afterwards.
    known = {dag.symbol(STEP, j): node for j, node in enumerate(first)}
    seed = dict(zip(symbols, known, strict=True))
    changes, reach = _bends(dag, rates, seed), dag.one
    last = [dag.zero] * len(first)
    if changes is not None:
        reach = sum(substitute(changes, known), dag.zero)
        curved = substitute(_curvature(dag, slopes, seed), known)
        # The series ends with z''/2, since s runs from 0 to 1.
        last = factors.solve([-0.5 * node for node in curved])
    step = [a + b for a, b in zip(first, last, strict=True)]
    ends = _values_after(rates[:cut], dict(zip(symbols, step, strict=True)))
    return [*ends, *step, *last, reach]


def _curvature(
    dag: Dag, slopes: Sequence[Mapping[int, Node]], seed: Mapping[Node, Node]
) -> list[Node]:
    """Return the second derivatives along a step, from rows of first ones."""
    steps = list(seed.values())
    changes = iter(tangents([node for row in slopes for node in row.values()], seed))
    return [sum((next(changes) * steps[j] for j in row), dag.zero) for row in slopes]


def _values_after(values: Sequence[Node], step: Mapping[Node, Node]) -> list[Node]:
    """Return values at the end of a step; exponentials, which are costly, by their series."""
    new = {symbol: symbol + change for symbol, change in step.items()}
    order = reachable(values)
    changing = dependent(order, step)
    for node in order:
        if node.op == "exp" and node in changing:
            # exp(a + d) = exp(a) (1 + d + d^2/2): the error is of third order, like that of the
            # step.
            change = tangents(node.args, step)[0]
            # The tangent is the change of the argument only if that is linear in the step.
            if not changing.isdisjoint(reachable([change], stop=set(step.values()))):
                change = substitute(node.args, new)[0] - node.args[0]
            new[node] = node + node * (change + 0.5 * (change * change))
    return substitute(values, new)


def _bends(dag: Dag, roots: Sequence[Node], seed: Mapping[Node, Node]) -> list[Node] | None:
    """Measure a step by each function that is not linear in it; near 1 the function bends.

    None if a function has no measure: a table, or an external function.
    """
    order = reachable(roots)
    changing = dependent(order, seed)
    of_change: dict[Node, None] = {}
    of_share: dict[Node, None] = {}
    for node in order:
        inner = [arg for arg in node.args if arg in changing]
        # Sums are linear in the step, and so are products and quotients with one changing factor,
        # of any size.
        if not inner or node.op in ("add", "sub", "neg"):
            continue
        if node.op in _OF_CHANGE:
            of_change |= dict.fromkeys(inner)
        elif node.op in _OF_SHARE or (node.op == "mul" and len(inner) == 2):
            of_share |= dict.fromkeys(inner)
        elif node.op == "div" and node.args[1] in changing:
            of_share[node.args[1]] = None
        elif node.op == "pow" and node.args[1] not in changing:
            of_share[node.args[0]] = None
        elif node.op == "select":
            if node.args[0] in changing:
                of_share[node.args[0]] = None
        elif node.op not in ("mul", "div"):
            return None
    changes = tangents([*of_change, *of_share], seed)
    sizes = [dag.function("abs", change) for change in changes]
    shares = [
        # The fraction tends to one if the change exceeds the value itself.
        size / (dag.function("abs", arg) + size + TINY)
        for arg, size in zip(of_share, sizes[len(of_change) :], strict=True)
    ]
    return [*sizes[: len(of_change)], *shares]


def _moved(
    values: Sequence[Node], columns: Sequence[Mapping[int, Node]], step: Sequence[Node]
) -> list[Node]:
    """Add the first-order changes of values by a step of the unknowns."""
    moved = list(values)
    for column, change in zip(columns, step, strict=True):
        for i, slope in column.items():
            if i < len(moved):
                moved[i] = moved[i] + slope * change
    return moved


def _unknown_rates(
    equations: Equations,
    factors: SparseFactors,
    rates: Sequence[Node],
    motion: Along,
) -> list[Node]:
    """Form z', which cancels the change of the residuals along the motion at constant z."""
    dag, n = equations.dag, len(rates)
    cut = n - equations.n_algebraic
    # The states move at their rates and z is constant, so that g_x x' + g_t remains.
    moving = {dag.symbol(STATE_RATE, i): rates[i] if i < cut else dag.zero for i in range(n)}
    changes = substitute([motion.rates.get(i, dag.zero) for i in range(cut, n)], moving)
    return factors.solve([-node for node in changes])


def _sensitivities(
    equations: Equations,
    factors: SparseFactors,
    columns: Sequence[Mapping[int, Node]],
    along: Sequence[Along],
    reached: Sequence[Sequence[int]],
) -> tuple[list[Node], list[Node]]:
    """Form the rates of sensitivities and the sensitivities of the unknowns.

    The residuals at S_z = 0 are the right-hand side. The argument s contains neither S_z nor zero
    sensitivities.
    """
    dag, n = factors.dag, len(equations.states)
    cut = n - len(columns)
    rates: list[Node] = []
    unknowns: list[Node] = []
    # The argument of the kernel has the nonzero sensitivities of states one after another, and none
    # of z.
    for j, (row, own) in enumerate(zip(along, reached, strict=True)):
        left = [i for i in own if i < cut]
        known = {dag.symbol(SENSITIVITY, j * n + i): dag.zero for i in range(n)}
        for k, i in enumerate(left, len(rates)):
            known[dag.symbol(SENSITIVITY, j * n + i)] = dag.symbol(PACKED_SENSITIVITY, k)
        at_rest = substitute(spread(row.rates, n, dag.zero), known)
        solved = factors.solve([-node for node in at_rest[cut:]])
        moved = _moved(at_rest[:cut], columns, solved)
        rates += [moved[i] for i in left]
        unknowns += solved
    return rates, unknowns
