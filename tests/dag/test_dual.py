"""Dual numbers against tangents of the same formulas."""

from __future__ import annotations

import random

import pytest

from cotree.dag import vector
from cotree.dag.derivative import tangents
from cotree.dag.dual import Dual, function, is_varied, tangent_of, value_of, varied
from cotree.dag.evaluate import evaluate
from cotree.dag.operations import OPERATIONS

#: Written with operators only, so that nodes and duals pass through alike.
FORMULAS = {
    "sum": lambda a, b: a + b,
    "sum with a number": lambda a, b: a + 2.0,
    "number and sum": lambda a, b: 2.0 + b,
    "difference": lambda a, b: a - b,
    "difference with a number": lambda a, b: a - 0.3,
    "number less": lambda a, b: 0.3 - b,
    "product": lambda a, b: a * b,
    "multiple": lambda a, b: a * 3.0 + 5.0 * b,
    "quotient": lambda a, b: a / b,
    "quotient by a number": lambda a, b: a / 4.0,
    "reciprocal": lambda a, b: 2.0 / b,
    "negative": lambda a, b: -a,
    "square": lambda a, b: a * a,
    "rational": lambda a, b: (a * b - 1.0) / (a * a + b * b + 2.0) - b / (1.0 - a),
    "itself": lambda a, b: a,
}


def _functions():
    """List the functions that take nodes, with how many they take."""
    infix = {"add", "sub", "mul", "div", "neg", "pow", "select"}
    return [(name, row.arity) for name, row in OPERATIONS.items() if name not in infix]


@pytest.fixture
def points(dag, x, y):
    """Return two duals and the values of their parts."""
    dx, dy = dag.symbol("s", 0), dag.symbol("s", 1)
    rng = random.Random(4)
    values = {node: rng.uniform(0.2, 0.9) for node in (x, y, dx, dy)}
    return Dual(x, dx), Dual(y, dy), values


def _check(found, formula, seed, values):
    (expected,) = tangents([formula], seed)
    value, d = evaluate([value_of(found), tangent_of(found)], values)
    # Derivatives of quotients are summed in another order.
    assert value == pytest.approx(evaluate([formula], values)[0], rel=1e-15)
    assert d == pytest.approx(evaluate([expected], values)[0], rel=1e-13)


@pytest.mark.parametrize("name", FORMULAS)
def test_operators(points, name):
    a, b, values = points
    formula = FORMULAS[name]
    _check(formula(a, b), formula(a.value, b.value), {a.value: a.d, b.value: b.d}, values)


@pytest.mark.parametrize(("name", "arity"), _functions())
def test_functions(dag, points, name, arity):
    a, b, values = points
    args = (a, b)[:arity]
    found = function(name, *args)
    formula = dag.function(name, *(arg.value for arg in args))
    _check(found, formula, {a.value: a.d, b.value: b.d}, values)


def test_functions_of_nodes_are_nodes(dag, x):
    assert function("sin", x) is dag.function("sin", x)


def test_functions_of_formulas(dag, points):
    a, b, values = points
    found = function("exp", function("sin", a * b) / b)
    x, y = a.value, b.value
    formula = dag.function("exp", dag.function("sin", x * y) / y)
    _check(found, formula, {x: a.d, y: b.d}, values)


def test_the_same_value_along_two_directions(dag, points):
    # A value may be given with a derivative that is not that of its formula's arguments.
    a, b, values = points
    found = function("atan2", Dual(a.value, a.d), Dual(a.value, b.d))
    x = values[a.value]
    expected = (x * values[a.d] - x * values[b.d]) / (2.0 * x * x)
    assert evaluate([found.d], values)[0] == pytest.approx(expected, rel=1e-14)


def _matrix(a, b):
    return vector.angular_acceleration_matrix(a, b)


#: Functions of two vectors, written once.
OF_VECTORS = {
    "sum": vector.add,
    "difference": vector.sub,
    "scalar product": vector.dot,
    "vector product": vector.cross,
    "multiple": lambda a, b: vector.scale(vector.dot(a, b), b),
    "negative": lambda a, b: vector.signed(-1, a),
    "entries": lambda a, b: a[1] * b[2] - next(iter(b)) / 3.0,
    "length": lambda a, b: vector.polar(vector.sub(a, b))[0],
    "direction": lambda a, b: vector.polar(vector.sub(a, b))[1],
    "matrix": lambda a, b: vector.times(_matrix(a, b), b),
    "transposed matrix": lambda a, b: vector.transposed_times(_matrix(a, b), b),
    "product of matrices": lambda a, b: vector.times(
        vector.matmul(_matrix(a, b), vector.transpose(_matrix(b, a))), b
    ),
    "sum of matrices": lambda a, b: vector.times(vector.matadd(_matrix(a, b), _matrix(b, a)), a),
}


@pytest.mark.parametrize("changing", [(), (0,), (1,), (0, 1)])
@pytest.mark.parametrize("name", OF_VECTORS)
def test_vectors(dag, name, changing):
    rng = random.Random(7)
    plain = [tuple(dag.symbol("x", 3 * i + k) for k in range(3)) for i in range(2)]
    along = [tuple(dag.symbol("s", 3 * i + k) for k in range(3)) for i in range(2)]
    seed = {x: d for i in changing for x, d in zip(plain[i], along[i], strict=True)}
    values = {node: rng.uniform(0.2, 0.9) for node in (*sum(plain, ()), *sum(along, ()))}
    vectors = [varied(a, along[i]) if i in changing else a for i, a in enumerate(plain)]
    found, formula = OF_VECTORS[name](*vectors), OF_VECTORS[name](*plain)
    assert value_of(found) == formula
    assert changing or not is_varied(found)
    d = tangent_of(found)
    entries = zip(d, formula, strict=True) if isinstance(d, tuple) else [(d, formula)]
    for entry, node in entries:
        (expected,) = evaluate(tangents([node], seed), values)
        # Sums of the same products in another order.
        assert evaluate([entry], values)[0] == pytest.approx(expected, rel=1e-12, abs=1e-14)


def test_what_does_not_change_is_plain(dag, x, y):
    dx = dag.symbol("s", 0)
    dual = varied(x, dx)
    assert not is_varied(dual - dual, dual * dag.zero, varied(x, dag.zero))
    assert is_varied(dual * 2.0, y * dual, 1.0 / dual, y - dual)
    assert varied((x, y, x), (dag.zero,) * 3) == (x, y, x)
    assert tangent_of((x, y, x)) == vector.zeros(dag)
