from __future__ import annotations

import math
import random

import numpy as np
import pytest

from cotree.dag.derivative import PARTIALS, adjoints, tangent, tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.lookup import LinearTable
from cotree.dag.multi_output import Function, SolveShape, call, solve, table
from cotree.dag.nodes import Dag
from cotree.dag.operations import OPERATIONS

#: Arguments of each operation, away from its kinks.
POINTS = {
    "add": [(0.3, -1.2)],
    "sub": [(0.3, -1.2)],
    "mul": [(0.3, -1.2)],
    "div": [(0.3, -1.2), (2.0, 0.1)],
    "neg": [(0.7,)],
    "sqrt": [(0.7,), (9.0,)],
    "sin": [(0.7,), (-2.0,)],
    "cos": [(0.7,), (-2.0,)],
    "tan": [(0.7,), (-1.0,)],
    "asin": [(0.7,), (-0.4,)],
    "acos": [(0.7,), (-0.4,)],
    "atan": [(0.7,), (-3.0,)],
    "sinh": [(0.7,), (-2.0,)],
    "cosh": [(0.7,), (-2.0,)],
    "tanh": [(0.7,), (-2.0,)],
    "exp": [(0.7,), (-2.0,)],
    "erf": [(0.7,), (-2.0,)],
    "log": [(0.7,), (3.0,)],
    "abs": [(0.7,), (-2.0,)],
    "sign": [(0.7,), (-2.0,)],
    "floor": [(0.7,), (-2.3,)],
    "atan2": [(0.3, -1.2), (-0.5, 0.8), (-0.5, -0.8), (2.0, 0.0)],
    "pow": [(1.7, 2.3), (0.4, -1.5)],
    "select": [(0.5, 1.3, -0.7), (-0.5, 1.3, -0.7)],
}
CASES = [(op, point) for op, points in POINTS.items() for point in points]


def _make(dag, op, args):
    return dag.rebuild(dag._intern(op, tuple(args)), tuple(args))


def test_every_operation_has_points_and_partials():
    # A selection has no partial derivatives: it is differentiated branch by branch.
    assert set(POINTS) == set(OPERATIONS) == {*PARTIALS, "select"}
    for name, row in OPERATIONS.items():
        assert row.arity == len(POINTS[name][0]) == len(PARTIALS.get(name, POINTS[name][0]))


@pytest.mark.parametrize(("op", "point"), CASES)
def test_kinds_of_numbers_agree(op, point):
    row = OPERATIONS[op]
    real = row.real(*point)
    # Libraries may differ by a few roundings.
    assert complex(row.complex_(*map(complex, point))).real == pytest.approx(real, rel=1e-14)
    array = row.array(*[np.array([value, value]) for value in point])
    assert np.asarray(array).tolist() == pytest.approx([real, real], rel=1e-14)


@pytest.mark.parametrize(("op", "point"), CASES)
def test_tangent_against_complex_step_and_differences(op, point):
    dag = Dag()
    args = [dag.symbol("x", i) for i in range(len(point))]
    node = _make(dag, op, args)
    values = dict(zip(args, point, strict=True))
    for i, arg in enumerate(args):
        exact = evaluate([tangent(node, {arg: dag.one})], values)[0]
        stepped = evaluate([node], {**values, arg: point[i] + 1e-30j}, "complex_")[0]
        # The complex step has no truncation error at 1e-30: only roundings remain.
        assert exact == pytest.approx(complex(stepped).imag * 1e30, rel=1e-13, abs=1e-15)
        h = 1e-6
        above, below = (evaluate([node], {**values, arg: point[i] + s * h})[0] for s in (1, -1))
        # Truncation h**2 and rounding eps/h are both below 1e-9.
        assert exact == pytest.approx((above - below) / (2 * h), rel=1e-8, abs=1e-8)


@pytest.mark.parametrize(("op", "point"), CASES)
def test_reverse_is_the_transpose_of_forward(op, point):
    dag = Dag()
    args = [dag.symbol("x", i) for i in range(len(point))]
    _check_dot_product(dag, [_make(dag, op, args)], dict(zip(args, point, strict=True)))


def _check_dot_product(dag, roots, values, rel=1e-13):
    """Compare <w, J v> with <J^T w, v> for random v and w."""
    rng = random.Random(1)
    symbols = list(values)
    v = [rng.uniform(-1, 1) for _ in symbols]
    w = [rng.uniform(-1, 1) for _ in roots]
    forward = tangents(roots, {s: dag.constant(d) for s, d in zip(symbols, v, strict=True)})
    backward = adjoints(roots, [dag.constant(d) for d in w], symbols)
    left = math.fsum(a * b for a, b in zip(w, evaluate(forward, values), strict=True))
    right = math.fsum(a * b for a, b in zip(v, evaluate(backward, values), strict=True))
    assert left == pytest.approx(right, rel=rel, abs=1e-14)


def _solve_case(dag):
    args = [dag.symbol("x", i) for i in range(6)]
    x = solve(dag, [args[0:2], args[2:4]], args[4:6])
    roots = [dag.function("sin", x[0]) + x[1] * args[0], x[1]]
    return roots, dict(zip(args, (2.0, 0.3, -0.4, 1.5, 0.7, -1.1), strict=True))


def _table_case(dag):
    x = dag.symbol("x", 0)
    value, slope = table(dag, LinearTable((0.0, 1.0, 3.0), (1.0, 4.0, 2.0)), x * x)
    return [value * x, slope * x], {x: 1.3}


def _call_case(dag):
    jacobian = Function("swirl_partials", 4, lambda a: [a[1], a[0], math.cos(1.0) * 0 + 1.0, 2.0])
    function = Function("swirl", 2, lambda a: [a[0] * a[1], a[0] + 2.0 * a[1]], jacobian)
    args = [dag.symbol("x", i) for i in range(2)]
    first, second = call(dag, function, [args[0], args[1] * args[0]])
    return [first * second, second], dict(zip(args, (0.8, -1.7), strict=True))


SEVERAL_CASES = {"solve": _solve_case, "table": _table_case, "call": _call_case}


@pytest.mark.parametrize("name", SEVERAL_CASES)
def test_tangents_of_nodes_with_several_results(name):
    dag = Dag()
    roots, values = SEVERAL_CASES[name](dag)
    for arg in values:
        exact = evaluate(tangents(roots, {arg: dag.one}), values)
        stepped = evaluate(roots, {**values, arg: values[arg] + 1e-30j}, "complex_")
        # A 2 by 2 elimination of condition about 2 rounds a few times.
        assert exact == pytest.approx([complex(z).imag * 1e30 for z in stepped], rel=1e-13)


@pytest.mark.parametrize("name", SEVERAL_CASES)
def test_reverse_of_nodes_with_several_results(name):
    dag = Dag()
    roots, values = SEVERAL_CASES[name](dag)
    _check_dot_product(dag, roots, values)


def test_a_call_without_partials_cannot_be_differentiated():
    dag = Dag()
    x = dag.symbol("x", 0)
    (y,) = call(dag, Function("opaque", 1, lambda a: [a[0]]), [x])
    with pytest.raises(ArithmeticError, match="'opaque' has no partial derivatives"):
        tangent(y, {x: dag.one})


def test_long_chain_by_both_ways():
    dag = Dag()
    symbols = [dag.symbol("x", i) for i in range(3)]
    a, b, c = symbols
    roots = []
    for _ in range(20):
        a, b, c = dag.function("sin", a * b), b + dag.function("exp", -c * c), a / (b * b + 1.0)
        roots += [a, b, c]
    values = dict(zip(symbols, (0.3, -0.8, 1.4), strict=True))
    # Derivatives of 60 values are summed in different orders: a thousand roundings.
    _check_dot_product(dag, roots, values, rel=1e-12)


def test_second_derivatives():
    dag = Dag()
    x = dag.symbol("x", 0)
    second = tangent(tangent(dag.function("exp", 2.0 * x), {x: dag.one}), {x: dag.one})
    assert evaluate([second], {x: 0.4})[0] == pytest.approx(4.0 * math.exp(0.8), rel=1e-15)


def test_quotients_are_differentiated_with_one_division():
    dag = Dag()
    x, y = dag.symbol("x", 0), dag.symbol("x", 1)
    quotient = x / y
    n = len(dag)
    tangent(quotient, {x: dag.symbol("s", 0), y: dag.symbol("s", 1)})
    assert sum(node.op == "div" for node in dag.nodes[n:]) == 1


def test_seeded_values_hide_what_they_are_made_of():
    dag = Dag()
    x = dag.symbol("x", 0)
    square = x * x
    assert tangent(square + x, {square: dag.one}) is dag.one
    assert tangents([], {}) == []
    assert adjoints([], [], []) == []
    assert tangent(x, {}) is dag.zero


def test_powers_with_a_constant_exponent_take_no_logarithm():
    dag = Dag()
    x = dag.symbol("x", 0)
    tangent(x**2.5, {x: dag.one})
    assert not any(node.op == "log" for node in dag.nodes)


def test_a_power_of_zero_does_not_change_with_a_positive_exponent():
    dag = Dag()
    x, n = dag.symbol("x", 0), dag.symbol("x", 1)
    slope = tangent(x**n, {n: dag.one})
    # The limit of x^n log(x); away from zero the formula itself.
    assert evaluate([slope], {x: 0.0, n: 2.5}) == [0.0]
    assert evaluate([slope], {x: 0.5, n: 2.0}) == [pytest.approx(0.25 * math.log(0.5))]


def test_reverse_accumulates_roots_that_repeat():
    dag = Dag()
    x = dag.symbol("x", 0)
    (d,) = adjoints([x * x, x * x, x], [dag.one, dag.one, dag.one], [x])
    assert evaluate([d], {x: 3.0})[0] == 13.0


def _redundant(dag, a):
    """Return the determined unknowns of a saddle system whose third constraint repeats the others.

    Its Jacobian keeps its rank for every ``a``, as that of a closed loop in a plane does.
    """
    mass = [[2.0 + a * a, 0.3 * a, dag.zero], [0.3 * a, dag.constant(1.5), a], [dag.zero, a, a + 4]]
    first = [dag.one, a, dag.zero]
    second = [dag.zero, dag.one, 2.0 * a]
    third = [x + a * y for x, y in zip(first, second, strict=True)]
    rows = [first, second, third]
    zero = [dag.zero] * 3
    matrix = [m + [row[i] for row in rows] for i, m in enumerate(mass)]
    matrix += [row + zero for row in rows]
    right = [dag.function("sin", a), dag.one, a * a, a, 0.5 * a, a + 0.5 * a * a]
    return solve(dag, matrix, right, shape=SolveShape(6, 3)), matrix, right


def test_redundant_systems_are_differentiated_by_both_ways():
    dag = Dag()
    a = dag.symbol("x", 0)
    solution, matrix, right = _redundant(dag, a)
    values = {a: 0.7}
    assert evaluate(solution[6:], values) == [5.0, 1.0]

    def by_pseudoinverse(at):
        entries = evaluate([entry for row in matrix for entry in row], {a: at})
        b = evaluate(right, {a: at})
        return (np.linalg.pinv(np.array(entries).reshape(6, 6), rcond=1e-9) @ b)[:3]

    # Central differences of step h, then Richardson's: error h^4, and rounding 1e-15 / h.
    h = 1e-3
    coarse, fine = (
        (by_pseudoinverse(0.7 + step) - by_pseudoinverse(0.7 - step)) / (2.0 * step)
        for step in (2.0 * h, h)
    )
    expected = (4.0 * fine - coarse) / 3.0
    forward = evaluate(tangents(solution[:3], {a: dag.one}), values)
    np.testing.assert_allclose(forward, expected, rtol=1e-9)
    _check_dot_product(dag, list(solution[:3]), values, rel=1e-12)
