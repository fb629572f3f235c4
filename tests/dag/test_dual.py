"""Dual numbers against tangents of the same formulas."""

from __future__ import annotations

import random

import pytest

from cotree.dag import vector
from cotree.dag.derivative import tangents
from cotree.dag.dual import Dual, function, paired
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
    """Give two duals and the values of what they are made of."""
    dx, dy = dag.symbol("s", 0), dag.symbol("s", 1)
    rng = random.Random(4)
    values = {node: rng.uniform(0.2, 0.9) for node in (x, y, dx, dy)}
    return Dual(x, dx), Dual(y, dy), values


def _check(found, formula, seed, values):
    (expected,) = tangents([formula], seed)
    value, d = evaluate([found.value, found.d], values)
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


def test_vectors_pass_through(dag, points):
    a, b, values = points
    first = paired((a.value, b.value, dag.one), (a.d, b.d, dag.zero))
    second = paired((b.value, dag.constant(0.4), a.value), (b.d, dag.zero, a.d))
    found = vector.cross(first, second)
    values_of = [tuple(entry.value for entry in row) for row in (first, second)]
    formulas = vector.cross(*values_of)
    for entry, formula in zip(found, formulas, strict=True):
        _check(entry, formula, {a.value: a.d, b.value: b.d}, values)


def test_numbers_have_no_derivative(dag, x):
    assert (Dual(x, dag.zero) * 2.0 + 1.0).d is dag.zero
    assert Dual(x, dag.zero).dag is dag
