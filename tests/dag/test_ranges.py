"""Ranges of values: all values within, and no wider than their arguments' ranges ask for."""

from __future__ import annotations

import numpy as np
import pytest

from cotree.dag.evaluate import evaluate
from cotree.dag.lookup import LinearTable
from cotree.dag.multi_output import table
from cotree.dag.nodes import Dag, Node
from cotree.dag.ranges import ENDLESS, is_ranged, ranges

UNARY = ("sin", "cos", "tan", "exp", "tanh", "atan", "erf", "abs", "sign", "floor", "cosh", "sinh")
SAW = LinearTable((0.0, 1.0, 1.5, 3.0), (0.0, 2.0, -1.0, 0.5))
RISE = LinearTable((0.0, 1.0, 1.5), (0.0, 2.0, 2.5))


def drawn(rng: np.random.Generator, x: Node, y: Node, depth: int) -> Node:
    """Draw an expression of two quantities."""
    dag = x.dag
    if depth == 0:
        return (x, y, dag.constant(float(rng.uniform(-2, 2))))[rng.integers(3)]
    a, b, c = (drawn(rng, x, y, depth - 1) for _ in range(3))
    kind = int(rng.integers(10))
    if kind < 4:
        return (a + b, a - b, a * b, a * a)[kind]
    if kind == 4:
        return a / (b * b + 0.5)
    if kind == 5:
        return dag.select(a, b, c)
    if kind == 6:
        return dag.function("sqrt", dag.function("abs", a)) + table(dag, SAW, b)[0]
    if kind == 7:
        return dag.function("atan2", a, b * b + 0.1)
    return dag.function(UNARY[rng.integers(len(UNARY))], a)


def extent(root: Node, x: Node, y: Node, box: np.ndarray) -> tuple[float, float]:
    """Evaluate the range of a value over a box."""
    dag = root.dag
    ends = {q: (dag.symbol("lo", i), dag.symbol("hi", i)) for i, q in enumerate((x, y))}
    ((low, high),) = ranges([root], ends)
    values = {end: float(box[i, k]) for i, q in enumerate((x, y)) for k, end in enumerate(ends[q])}
    with np.errstate(all="ignore"):
        return tuple(float(value) for value in evaluate([low, high], values))


@pytest.mark.parametrize("seed", range(150))
def test_values_lie_in_their_ranges(seed: int) -> None:
    """No value of a random expression in a box is outside its range."""
    rng, dag = np.random.default_rng(seed), Dag()
    x, y = dag.symbol("x", 0), dag.symbol("x", 1)
    try:
        root = drawn(rng, x, y, int(rng.integers(1, 4)))
    except (ArithmeticError, ValueError):
        pytest.skip("constants fold to no number")
    middle, half = rng.uniform(-3, 3, size=2), 10 ** rng.uniform(-3, 0.5, size=2)
    box = np.stack([middle - half, middle + half], axis=1)
    low, high = extent(root, x, y, box)
    points = rng.uniform(box[:, 0], box[:, 1], size=(300, 2))
    points = np.vstack([points, box[:, 0], box[:, 1]])
    with np.errstate(all="ignore"):
        found = [float(evaluate([root], {x: a, y: b})[0]) for a, b in points.tolist()]
    size = 1e-12 * max(1.0, np.nanmax(np.abs(found)))  # roundings of a few operations
    # Where nothing is known no comparison holds.
    outside = [value for value in found if value < low - size or value > high + size]
    assert not outside


@pytest.mark.parametrize(
    ("form", "box", "expected"),
    [
        (lambda x: x * x, (-1.0, 2.0), (0.0, 4.0)),
        (lambda x: x.dag.function("sin", x), (0.0, 3.0), (0.0, 1.0)),
        (lambda x: x.dag.function("sin", x), (0.0, 5.0), (-1.0, 1.0)),
        (lambda x: x.dag.function("cos", 100.0 * x), (0.01, 0.02), (np.cos(2.0), np.cos(1.0))),
        (lambda x: x.dag.function("abs", x), (-3.0, 1.0), (0.0, 3.0)),
        (lambda x: x.dag.function("tan", x), (1.0, 2.0), (-ENDLESS, ENDLESS)),
        (lambda x: 1.0 / x, (-1.0, 2.0), (-ENDLESS, ENDLESS)),
        (lambda x: 1.0 / x, (1.0, 2.0), (0.5, 1.0)),
        (lambda x: table(x.dag, RISE, x)[0], (0.5, 3.0), (1.0, 2.5)),
        (lambda x: x.dag.select(x - 1.0, x, x.dag.zero), (0.5, 3.0), (0.0, 3.0)),
    ],
)
def test_ranges_of_one_quantity_are_exact(form, box, expected) -> None:
    """A quantity that occurs once gives the range itself."""
    dag = Dag()
    x, y = dag.symbol("x", 0), dag.symbol("x", 1)
    found = extent(form(x), x, y, np.array([box, (0.0, 1.0)]))
    assert found == pytest.approx(expected, rel=1e-14, abs=1e-14)


def test_results_of_linear_systems_have_no_ranges() -> None:
    """They are quantities of their own."""
    dag = Dag()
    x = dag.symbol("x", 0)
    assert is_ranged(dag.function("sin", x))
    assert not is_ranged(x)
    assert not is_ranged(dag.several("solve", [x, x, x], None, 3)[0])
