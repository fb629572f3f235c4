from __future__ import annotations

import math

import pytest

from cotree.dag.derivative import adjoints, tangent
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag, reachable
from cotree.scene.expressions import parse

#: Expressions of x, constant for x <= 1, with their slope beyond.
CLIPPED = {
    "sqrt(max(x - 1, 0))": lambda x: 0.5 / math.sqrt(x - 1),
    "max(x - 1, 0)**0.7": lambda x: 0.7 * (x - 1) ** -0.3,
    "max(x - 1, 0)**(0.7*h)": lambda x: 0.7 * (x - 1) ** -0.3,
    "sqrt(x - 1 + abs(x - 1))": lambda x: 1.0 / math.sqrt(2 * (x - 1)),
    "sqrt(0.5*x - 0.5 + 0.5*abs(1 - x))": lambda x: 0.5 / math.sqrt(x - 1),
    "sqrt((x - 1)*(1 + sign(x - 1)))": lambda x: 1.0 / math.sqrt(2 * (x - 1)),
    "sqrt(where(x > 1, x - 1, 0))": lambda x: 0.5 / math.sqrt(x - 1),
    "sqrt(max(h**2*(x - 1), 0) + max(1 - x, 0) - max(1 - x, 0))": lambda x: 0.5 / math.sqrt(x - 1),
    "exp(0.5*log(max(x - 1, 0)))": lambda x: 0.5 / math.sqrt(x - 1),
    "acos(min(2 - x, 1))": lambda x: 1.0 / math.sqrt(1 - (2 - x) ** 2),
    "asin(max(1 - x, -1) - max(1 - x, 0))": lambda x: -1.0 / math.sqrt(1 - (1 - x) ** 2),
    "where(x > 1, sqrt(x - 1), 0)": lambda x: 0.5 / math.sqrt(x - 1),
}


def _lowered(text):
    dag = Dag()
    symbols = {"x": dag.symbol("x", 0), "h": dag.symbol("p", 0)}
    return dag, symbols, parse(text, "test").lower(dag, symbols.__getitem__)


@pytest.mark.parametrize("text", CLIPPED)
def test_a_constant_branch_has_derivative_zero_by_both_ways(text):
    dag, symbols, node = _lowered(text)
    forward = tangent(node, {symbols["x"]: dag.one})
    (reverse,) = adjoints([node], [dag.one], [symbols["x"]])
    for d in (forward, reverse):
        # The end of the constant branch belongs to it.
        for x in (0.5, 1.0):
            assert evaluate([d], {symbols["x"]: x, symbols["h"]: 1.0})[0] == 0.0
        at = {symbols["x"]: 1.6, symbols["h"]: 1.0}
        # A few roundings.
        assert evaluate([d], at)[0] == pytest.approx(CLIPPED[text](1.6), rel=1e-14)


def test_second_derivatives_of_a_clipped_power():
    dag, symbols, node = _lowered("max(x, 0)**1.5")
    x = symbols["x"]
    second = tangent(tangent(node, {x: dag.one}), {x: dag.one})
    assert evaluate([second], {x: -0.3})[0] == 0.0
    # d2(x**1.5) = 0.75 / sqrt(x), a few roundings.
    assert evaluate([second], {x: 0.25})[0] == pytest.approx(1.5, rel=1e-14)


def test_a_bound_by_a_parameter_that_is_zero():
    dag, symbols, node = _lowered("sqrt(max(x, h))")
    at = {symbols["x"]: -1.0, symbols["h"]: 0.0}
    assert evaluate([tangent(node, {symbols["x"]: dag.one})], at)[0] == 0.0
    # By the bound itself the root has no finite derivative there.
    assert evaluate([tangent(node, {symbols["h"]: dag.one})], at)[0] == math.inf


def test_cusps_stay_without_a_derivative():
    dag, symbols, node = _lowered("sqrt(abs(x))")
    d = tangent(node, {symbols["x"]: dag.one})
    assert not math.isfinite(evaluate([d], {symbols["x"]: 0.0})[0])


@pytest.mark.parametrize(
    "text", ["sqrt(x)", "sqrt(max(x, 1e-3))", "max(x, 0)**1.5", "sqrt(x*x + h)"]
)
def test_nothing_is_chosen_where_nothing_is_singular(text):
    dag, symbols, node = _lowered(text)
    d = tangent(node, {symbols["x"]: dag.one})
    own = [item for item in reachable([node]) if item.op == "select"]
    # The derivative of a selection is the only new one.
    assert len([item for item in reachable([d]) if item.op == "select"]) <= 2 * len(own)


@pytest.mark.parametrize(
    ("text", "at_zero"),
    [
        ("where(x < 0, 0, x*sqrt(x))", 0.0),
        ("where(x <= 0, 2*x, x*sqrt(x))", 2.0),
        ("where(x > 0, h*x*sqrt(x), 3*x)", 3.0),
        ("where(-h*x > 0, sqrt(-x)*x, x)", 1.0),
    ],
)
def test_a_selection_has_the_slope_of_the_side_without_an_end(text, at_zero):
    dag, symbols, node = _lowered(text)
    forward = tangent(node, {symbols["x"]: dag.one})
    (reverse,) = adjoints([node], [dag.one], [symbols["x"]])
    for d in (forward, reverse):
        assert evaluate([d], {symbols["x"]: 0.0, symbols["h"]: 1.0})[0] == at_zero
        # A few roundings, on the side of the root.
        x = -0.36 if text.startswith("where(-h") else 0.36
        at = {symbols["x"]: x, symbols["h"]: 1.0}
        assert evaluate([d], at)[0] == pytest.approx(1.5 * 0.6, rel=1e-14)
