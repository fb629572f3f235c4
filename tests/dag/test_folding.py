from __future__ import annotations

import math
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag


def test_neutral_and_absorbing_constants(dag, x):
    assert x * 0.0 is dag.zero
    assert 0.0 * x is dag.zero
    assert x + 0.0 is x
    assert 0.0 + x is x
    assert x - 0.0 is x
    assert 1.0 * x is x
    assert x * 1.0 is x
    assert x / 1.0 is x
    assert 0.0 / x is dag.zero
    assert x - x is dag.zero
    assert x / x is dag.one
    assert 0.0 - x is -x


def test_constants_fold(dag):
    two, three = dag.constant(2.0), dag.constant(3)
    assert (two + three).value == 5.0
    assert (two - three).value == -1.0
    assert (two * three).value == 6.0
    assert (three / two).value == 1.5
    assert (two**three).value == 8.0
    assert dag.function("cos", dag.zero) is dag.one
    assert dag.function("atan2", dag.zero, dag.one) is dag.zero


def test_there_is_one_zero(dag, x):
    assert dag.constant(-0.0) is dag.zero
    assert math.copysign(1.0, dag.constant(-0.0).value) == 1.0
    assert x * -0.0 is dag.zero


def test_sums_and_products_commute(dag, x, y):
    assert x + y is y + x
    assert x * y is y * x
    assert x + x is 2.0 * x
    assert 2.0 * (3.0 * x) is 6.0 * x


def test_negations_sink_towards_the_result(dag, x, y):
    negative = -x
    assert -negative is x
    assert x + -y is x - y
    assert -x + y is y - x
    assert x - -y is x + y
    assert -(x - y) is y - x
    assert -x - y is -(x + y)
    assert (-x) * y is -(x * y)
    assert x * -y is -(x * y)
    assert (-x) * (-y) is x * y
    assert (-x) / y is -(x / y)
    assert x / -y is -(x / y)
    assert -2.0 * x is -(2.0 * x)
    assert x + -3.0 is x + dag.constant(-3.0)


@pytest.mark.parametrize("name", ["sin", "tan", "asin", "atan", "sinh", "tanh", "sign"])
def test_odd_functions_give_the_sign_back(dag, x, name):
    assert dag.function(name, -x) is -dag.function(name, x)


@pytest.mark.parametrize("name", ["cos", "cosh", "abs"])
def test_even_functions_drop_the_sign(dag, x, name):
    assert dag.function(name, -x) is dag.function(name, x)


def test_functions_without_symmetry_keep_the_sign(dag, x):
    for name in ("exp", "log", "sqrt", "acos"):
        assert dag.function(name, -x).args[0] is -x


def test_what_only_looks_alike_is_kept_apart(dag, x, y):
    assert x - y is not y - x
    assert x / y is not y / x
    assert x**y is not y**x
    assert dag.function("atan2", x, y) is not dag.function("atan2", y, x)
    assert dag.select(x, y, dag.one) is not dag.select(x, dag.one, y)
    assert dag.symbol("x", 0) is not dag.symbol("p", 0)
    assert dag.symbol("t", 0) is not dag.symbol("u", 0)


def test_select_folds(dag, x, y):
    assert dag.select(x, y, y) is y
    assert dag.select(dag.zero, x, y) is x
    assert dag.select(dag.constant(-1.0), x, y) is y


def test_arguments_precede_the_nodes_that_use_them(dag, x, y):
    dag.function("sin", x * y + 2.0) / (x - y) ** 3
    assert all(arg.index < node.index for node in dag.nodes for arg in node.args)
    assert [node.index for node in dag.nodes] == list(range(len(dag)))


def test_constants_must_be_finite(dag, x):
    for value in (math.inf, math.nan):
        with pytest.raises(ArithmeticError, match="not finite"):
            dag.constant(value)
    with pytest.raises(ArithmeticError):
        dag.constant(1e308) * 10.0
    with pytest.raises(ZeroDivisionError):
        x / 0.0
    with pytest.raises(ValueError, match="math domain error"):
        dag.function("log", dag.constant(-1.0))


@pytest.mark.parametrize("power", range(-6, 17))
def test_integer_powers_are_products(dag, x, power):
    node = x ** float(power)
    assert not any(made.op == "pow" for made in dag.nodes)
    # Up to five products, each rounding once.
    value = evaluate([node], {x: 1.7})[0]
    assert value == pytest.approx(1.7**power, rel=6 * 2.0**-52)


def test_powers_share_their_squares(dag, x):
    x**8.0
    assert sum(node.op == "mul" for node in dag.nodes) == 3
    assert x**2 is x * x


def test_other_powers(dag, x, y):
    assert (x**0.5).op == "sqrt"
    assert (x**0.3).op == "pow"
    assert (x**65.0).op == "pow"
    assert (x**y).op == "pow"
    assert x**0.0 is dag.one


def test_rebuilding_folds_again(dag, x, y):
    node = dag.function("sin", x) * y
    assert dag.rebuild(node, (dag.zero, y)) is dag.zero
    assert dag.rebuild(dag.function("sin", x), (dag.zero,)) is dag.zero
    assert dag.rebuild(x - y, (y, y)) is dag.zero


def test_sections_label_what_is_made_inside(dag, x, y):
    with dag.labelled("outer"):
        a = x + y
        with dag.labelled("inner"):
            b = x * y
        c = x / y
    assert (a.section, b.section, c.section, (x - y).section) == ("outer", "inner", "outer", "")


# Trees of plain tuples, so that the same tree can be evaluated without a Dag.
_SYMBOLS = [("symbol", i) for i in range(3)]
_INTEGERS = st.integers(-3, 3)


def _exact_trees():
    leaves = st.one_of(st.sampled_from(_SYMBOLS), _INTEGERS.map(lambda n: ("constant", n)))
    return st.recursive(
        leaves,
        lambda children: st.one_of(
            st.tuples(st.sampled_from(["add", "sub", "mul"]), children, children),
            st.tuples(st.sampled_from(["neg", "abs", "sign"]), children),
            st.tuples(st.just("select"), children, children, children),
        ),
        max_leaves=20,
    )


def _positive_trees():
    """Trees of positive values only: nothing cancels, so that rounding stays small."""
    numbers = st.floats(0.1, 10.0).map(lambda value: ("constant", value))
    return st.recursive(
        st.one_of(st.sampled_from(_SYMBOLS), numbers),
        lambda children: st.one_of(
            st.tuples(st.sampled_from(["add", "mul", "div"]), children, children),
            st.tuples(st.sampled_from(["sqrt", "atan", "tanh"]), children),
        ),
        max_leaves=15,
    )


_PLAIN = {
    "add": lambda a, b: a + b,
    "sub": lambda a, b: a - b,
    "mul": lambda a, b: a * b,
    "div": lambda a, b: a / b,
    "neg": lambda a: -a,
    "abs": abs,
    "sign": lambda a: (a > 0) - (a < 0),
    "select": lambda c, a, b: a if c >= 0 else b,
    "sqrt": math.sqrt,
    "atan": math.atan,
    "tanh": math.tanh,
}


def _plain(tree, values):
    """Evaluate a tree as it stands: no node, no interning, no folding."""
    op, *args = tree
    if op == "symbol":
        return values[args[0]]
    if op == "constant":
        return args[0]
    return _PLAIN[op](*[_plain(arg, values) for arg in args])


def _node(tree, dag):
    op, *args = tree
    if op == "symbol":
        return dag.symbol("x", args[0])
    if op == "constant":
        return dag.constant(float(args[0]))
    nodes = [_node(arg, dag) for arg in args]
    if op in ("abs", "sign", "sqrt", "atan", "tanh"):
        return dag.function(op, *nodes)
    return getattr(dag, op)(*nodes)


@given(_exact_trees(), st.tuples(_INTEGERS, _INTEGERS, _INTEGERS))
def test_folding_keeps_the_value_of_integer_trees_exactly(tree, values):
    dag = Dag()
    node = _node(tree, dag)
    assert _node(tree, dag) is node  # interned
    known = {dag.symbol("x", i): float(value) for i, value in enumerate(values)}
    exact = _plain(tree, [Fraction(value) for value in values])
    # At most 20 factors of size 3 stay far below 2**53: every step is exact.
    assert evaluate([node], known)[0] == exact


@given(_positive_trees(), st.tuples(*[st.floats(0.1, 10.0)] * 3))
def test_folding_keeps_the_value_of_positive_trees(tree, values):
    dag = Dag()
    node = _node(tree, dag)
    known = {dag.symbol("x", i): value for i, value in enumerate(values)}
    # At most 30 operations of condition 1, each rounding by 2**-53, on both sides.
    expected = _plain(tree, values)
    assert evaluate([node], known)[0] == pytest.approx(expected, rel=1e-13)


@given(_exact_trees(), st.tuples(_INTEGERS, _INTEGERS, _INTEGERS))
def test_signs_and_neutral_elements_at_random(tree, values):
    dag = Dag()
    node = _node(tree, dag)
    assert node - node is dag.zero
    assert node * dag.one is node
    assert node + dag.zero is node
    known = {dag.symbol("x", i): float(value) for i, value in enumerate(values)}
    negative = -node
    value, back, twice = evaluate([node, -negative, node + node], known)
    assert (back, twice) == (value, 2.0 * value)


def test_what_is_added_and_taken_away_again_vanishes():
    dag = Dag()
    x, y = dag.symbol("x", 0), dag.symbol("x", 1)
    for a, b in ((x, y), (y, x)):
        assert a + (b - a) is b
        assert (b - a) + a is b
        assert (a + b) - a is b
        assert (b - a) - b is -a
        assert a - (a - b) is b
        assert a - (a + b) is -b


def test_a_product_with_the_reciprocal_is_one():
    dag = Dag()
    x = dag.symbol("x", 0)
    assert x * (1.0 / x) is dag.one
    assert (1.0 / x) * -x is dag.constant(-1.0)
