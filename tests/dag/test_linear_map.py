"""Maps of many columns against the same statements written out."""

from __future__ import annotations

import random

import numpy as np
import pytest

import cotree
from cotree.dag.derivative import adjoints, tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import apply_map, form_map
from cotree.dag.nodes import Dag, symbols_in

COLUMNS = 3


def _made(dag: Dag):
    """Two results of two inputs, as a map of three columns and written out."""
    x = [dag.symbol("x", i) for i in range(3)]

    def results(a, b):
        return [dag.function("sin", x[0]) * a - b / x[1], dag.select(x[2], 2.0 * a, -b) + a]

    inputs = [dag.symbol("a", 0), dag.symbol("a", 1)]
    columns = [[dag.symbol("c", 2 * j), dag.symbol("c", 2 * j + 1) * x[0]] for j in range(COLUMNS)]
    linear, shared = form_map(dag, results(*inputs), inputs, columns)
    mapped = [node for row in apply_map(dag, linear, shared, columns) for node in row]
    return linear, mapped, [node for column in columns for node in results(*column)]


def _point(nodes, seed=0):
    rng = random.Random(seed)
    return {node: rng.uniform(0.5, 1.5) for node in symbols_in(nodes)}


def test_a_map_gives_what_written_out_statements_give():
    dag = Dag()
    linear, mapped, written_out = _made(dag)
    # x2 decides between two values: both sides of it.
    for sign in (1.0, -1.0):
        point = _point([*mapped, *written_out])
        point[dag.symbol("x", 2)] *= sign
        # A division became a product with a reciprocal: two roundings in place of one.
        np.testing.assert_allclose(
            evaluate(mapped, point), evaluate(written_out, point), rtol=1e-14
        )
    assert linear.n_columns == COLUMNS
    assert linear.counts.keys() <= {"add", "sub", "mul", "neg"}


def test_derivatives_of_a_map_are_those_of_written_out_statements():
    dag = Dag()
    _, mapped, written_out = _made(dag)
    symbols = symbols_in(mapped)
    seed = {node: dag.symbol("d", i) for i, node in enumerate(symbols)}
    found, expected = tangents(mapped, seed), tangents(written_out, seed)
    point = _point([*found, *expected, *mapped, *seed.values()])
    np.testing.assert_allclose(evaluate(found, point), evaluate(expected, point), rtol=1e-13)

    # A reverse sweep and a forward one agree: <w, J d> = <J^T w, d>.
    weights = [dag.constant(0.3 + i) for i in range(len(mapped))]
    back = evaluate(adjoints(mapped, weights, symbols), point)
    ahead = evaluate(found, point)
    assert np.dot([w.value for w in weights], ahead) == pytest.approx(
        np.dot(back, [point[d] for d in seed.values()]), rel=1e-13
    )


def test_what_is_not_linear_has_no_map():
    dag = Dag()
    a, x = dag.symbol("a", 0), dag.symbol("x", 0)
    column = [[dag.symbol("c", 0)]]
    assert form_map(dag, [a * a], [a], column) is None
    assert form_map(dag, [dag.function("exp", a)], [a], column) is None
    assert form_map(dag, [x + 0.0 * a], [a], column) is None  # does not vanish with a


@pytest.mark.parametrize(
    ("value", "is_map"), [("sin", True), ("sqrt", False), ("log", False), ("exp", False)]
)
def test_a_choice_that_keeps_out_what_has_no_value_is_no_product(value, is_map):
    """A weight of zero times infinity or nan is nan: such a choice remains a choice."""
    dag = Dag()
    x, a, c = dag.symbol("x", 0), dag.symbol("a", 0), dag.symbol("c", 0)
    guarded = dag.select(x, dag.function(value, x) * a, dag.zero)
    assert (form_map(dag, [guarded], [a], [[c]]) is not None) == is_map


def test_sensitivities_pass_by_a_law_that_has_no_value_where_it_does_not_act():
    """Rods that do not reach the length where a force begins move as they do without it."""
    rates = []
    for has_force in (True, False):
        scene = cotree.Scene("chain", gravity=[0, -9.81, 0])
        node, names = "ground", [f"L{i}" for i in range(3)]
        for i, name in enumerate(names):
            scene.parameter(name, 0.5)
            scene.edge(f"h{i}", "revolute", node, f"A{i}", axis=[0, 0, 1], initial={"theta": -0.5})
            scene.edge(f"r{i}", "arm", f"A{i}", node := f"B{i}", vector=[0, f"-{name}", 0])
            scene.edge(f"b{i}", "rigid_body", "ground", node, mass=1.0, inertia=0.1)
        if has_force:
            law = "where(length > 100, sqrt(length - 100), 0)"
            scene.edge("stop", "line_force", "ground", node, force=law)
        model = scene.compile(names, optimize="-O0")
        s = np.ones((len(model.states), len(names)))
        rates.append(model.sensitivity_rhs(0.0, model.initial_state, s))
        rates.append(model.jacobian(0.0, model.initial_state))
    # Both give the same sums in another order.
    np.testing.assert_allclose(rates[0], rates[2], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(rates[1], rates[3], rtol=1e-12, atol=1e-12)
