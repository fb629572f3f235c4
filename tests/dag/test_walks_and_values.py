from __future__ import annotations

import math

import numpy as np
import pytest

from cotree.dag.evaluate import evaluate
from cotree.dag.lookup import LinearTable
from cotree.dag.multi_output import Function, call, solve, solve_pivoted, table
from cotree.dag.nodes import dependent, reachable, substitute, symbols_in


def test_reachable_lists_arguments_first(dag, x, y):
    root = dag.function("sin", x * y) + x
    unused = x - y
    found = reachable([root])
    assert found == sorted(found, key=lambda node: node.index)
    assert root in found
    assert unused not in found


def test_reachable_stops_where_it_is_told(dag, x, y):
    product = x * y
    root = dag.function("sin", product)
    assert reachable([root], stop={product}) == [product, root]
    assert reachable([root], stop={root}) == [root]


def test_dependent_marks_what_a_source_reaches(dag, x, y):
    both, alone = x * y, y + 1.0
    marked = dependent(reachable([both, alone]), [x])
    assert x in marked
    assert both in marked
    assert alone not in marked


def test_substitute_folds_what_the_replacement_simplifies(dag, x, y):
    root = dag.function("sin", x) * y + y
    assert substitute([root], {x: dag.zero}) == [y]
    assert substitute([root], {}) == [root]
    assert substitute([x], {x: y}) == [y]
    (swapped,) = substitute([x - y], {x: y, y: x})
    assert swapped is y - x


def test_substitute_replaces_whole_values_and_nodes_with_several_results(dag, x, y):
    product = x * y
    assert substitute([product + x], {product: y}) == [x + y]
    unknown = solve(dag, [[x]], [y])[0]
    (moved,) = substitute([unknown * 2.0], {y: x * 3.0})
    assert evaluate([moved], {x: 0.7})[0] == pytest.approx(6.0, rel=1e-15)


def test_symbols_in(dag, x, y):
    p = dag.symbol("p", 3)
    assert symbols_in([p * y]) == [y, p]


def test_evaluate_needs_every_symbol(dag, x, y):
    with pytest.raises(KeyError):
        evaluate([x + y], {x: 1.0})
    assert evaluate([x * y], {x * y: 5.0}) == [5.0]  # values of inner nodes may be given
    assert evaluate([x / y], {x: -1.0, y: 0.0}) == [-math.inf]  # as in C


def test_evaluate_on_arrays(dag, x, y):
    t = np.linspace(-1.0, 1.0, 5)
    value, slope = table(dag, LinearTable((0.0, 1.0), (2.0, 3.0)), x)
    roots = [dag.select(x, x, 2.0 * y), dag.function("atan2", x, y), value, slope]
    found = evaluate(roots, {x: t, y: np.full(5, 0.5)}, "array")
    np.testing.assert_allclose(found[0], np.where(t >= 0, t, 1.0))
    np.testing.assert_allclose(found[1], np.arctan2(t, 0.5))
    np.testing.assert_allclose(found[2], np.interp(t, [0, 1], [2, 3]))
    np.testing.assert_allclose(found[3], [0.0, 0.0, 0.0, 1.0, 0.0])


def test_arrays_have_the_values_of_their_entries(dag, x, y):
    """A system is singular at the third entry, where a call is undefined."""
    data = LinearTable((0.0, 1.0, 3.0), (1.0, 4.0, 2.0))
    looked_up, solved = table(dag, data, x), solve(dag, [[x, y], [y, x]], [y, dag.one])
    at = {x: np.array([-1.0, 0.5, 2.0, 3.0, math.inf]), y: np.array([2.0, 1.5, -2.0, 4.0, 0.1])}
    found = np.array(evaluate([*looked_up, *solved], at, "array"))
    for i, (a, b) in enumerate(zip(at[x], at[y], strict=True)):
        alone = evaluate([*looked_up, *solved], {x: float(a), y: float(b)})
        # Solutions of arrays are nan where an argument is not finite.
        alone[2:] = alone[2:] if math.isfinite(a) else [math.nan] * 4
        # The condition number is seven at most, and arrays are factorised in another order.
        np.testing.assert_allclose(found[:, i], alone, rtol=1e-14)
    logarithm = Function("logarithm", 1, lambda a: [math.log(a[0])])
    (found,) = evaluate(call(dag, logarithm, [y]), at, "array")
    np.testing.assert_allclose(found, [*np.log([2.0, 1.5]), math.nan, *np.log([4.0, 0.1])])
    nowhere = evaluate([*looked_up, *solved, *call(dag, logarithm, [y])], {x: [], y: []}, "array")
    assert [len(value) for value in nowhere] == [0] * 7


@pytest.mark.parametrize(
    ("at", "value", "slope"),
    [
        (-5.0, 1.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.5, 2.5, 3.0),
        (1.0, 4.0, -1.0),
        (2.0, 3.0, -1.0),
        (3.0, 2.0, 0.0),
        (9.0, 2.0, 0.0),
    ],
)
def test_table(dag, x, at, value, slope):
    roots = table(dag, LinearTable((0.0, 1.0, 3.0), (1.0, 4.0, 2.0)), x)
    assert evaluate(roots, {x: at}) == [value, slope]


def test_call(dag, x, y):
    roots = call(dag, Function("both", 2, lambda a: [a[0] + a[1], a[0] * a[1]]), [x, y])
    assert evaluate(roots, {x: 2.0, y: 3.0}) == [5.0, 6.0]


def test_solve_pivoted_well_conditioned():
    rng = np.random.default_rng(3)
    a, x = rng.normal(size=(6, 6)), rng.normal(size=6)
    solution, rank, is_determined = solve_pivoted(a, a @ x)
    assert (rank, is_determined) == (6, True)
    # The condition number is about 20; each of 6 steps rounds.
    np.testing.assert_allclose(solution, x, rtol=1e-12)


def test_solve_pivoted_needs_no_diagonal():
    a = np.array([[0.0, 0.0, 2.0], [3.0, 0.0, 0.0], [0.0, 4.0, 0.0]])
    solution, rank, is_determined = solve_pivoted(a, np.array([2.0, 6.0, 12.0]))
    assert (rank, is_determined) == (3, True)
    assert solution.tolist() == [2.0, 3.0, 1.0]


def test_solve_pivoted_singular_and_consistent():
    a = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [1.0, 0.0, 1.0]])
    b = a @ np.array([1.0, -2.0, 0.5])
    solution, rank, is_determined = solve_pivoted(a, b)
    assert (rank, is_determined) == (2, False)
    # The residual rounds a few times at size 10.
    np.testing.assert_allclose(a @ solution, b, atol=1e-14)
    # Both take the solution of least norm, (1.5, -1.5, 0); the condition number is about 10.
    least = np.linalg.lstsq(a, b, rcond=1e-10)[0]
    np.testing.assert_allclose(solution, least, rtol=1e-13, atol=1e-14)


def test_solve_pivoted_of_zeros_and_of_complex_numbers():
    solution, rank, is_determined = solve_pivoted(np.zeros((2, 2)), np.zeros(2))
    assert (solution.tolist(), rank, is_determined) == ([0.0, 0.0], 0, False)
    solution, rank, is_determined = solve_pivoted(np.array([[2.0 + 1e-30j]]), np.array([4.0]))
    assert (rank, is_determined) == (1, True)
    assert solution[0].imag == pytest.approx(-1e-30, rel=1e-14)


def test_rank_is_decided_relative_to_the_largest_entry():
    small = np.diag([1e-200, 3e-200])
    assert solve_pivoted(small, np.ones(2) * 1e-200)[1] == 2
    assert solve_pivoted(np.diag([1.0, 1e-14]), np.ones(2))[1] == 1
    assert math.isclose(solve_pivoted(np.diag([1.0, 1e-12]), np.ones(2))[0][1], 1e12)
