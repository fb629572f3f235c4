"""Whether values of time jump, from their limits on both sides."""

from __future__ import annotations

import pytest

from cotree.dag.continuity import have_time_events, margins, may_jump
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag
from cotree.scene.expressions import parse


def _made(text):
    dag = Dag()
    symbols = {"t": dag.symbol("t", 0), "x": dag.symbol("x", 0)}
    symbols |= {name: dag.symbol("p", i) for i, name in enumerate("abcd")}
    return dag, symbols, parse(text, "a test").lower(dag, symbols.__getitem__)


@pytest.mark.parametrize(
    ("text", "jumps"),
    [
        ("abs(t - 1)", False),
        ("sign(t - 1)", True),
        ("(t - 1)*sign(t - 1)", False),
        ("max(0, t - 1)**0.5", False),  # an infinite slope is no jump
        ("floor(t)", True),
        ("mod(t, 2)", True),
        ("abs(mod(t, 2) - 1)", False),
        ("1e-3*sign(t - 1) + t", True),
        ("min(t, 1e-6)", False),
        ("exp(-max(0, t)*1e9)", False),  # steep, but no jump
    ],
)
def test_at_stops(text, jumps):
    dag, symbols, value = _made(text)
    assert have_time_events(dag, value, [symbols["t"]])
    found = evaluate(margins(dag, value, symbols["t"]), {})
    assert found
    assert (min(found) < 0.0) == jumps


def test_parameters_decide():
    dag, symbols, value = _made("abs(t - a)*sign(t - b)")
    nodes = margins(dag, value, symbols["t"])
    for b, jumps in ((1e-3, False), (1.1e-3, True)):
        values = {symbols["a"]: 1e-3, symbols["b"]: b}
        assert (min(evaluate(nodes, values)) < 0.0) == jumps


@pytest.mark.parametrize(
    ("text", "jumps"),
    [
        ("max(sin(1e3*t), 0)", False),
        ("max(sin(a*t + b), 0)", False),
        ("sign(sin(1e3*t))", True),
        ("sign(t**2 - a)*(t**2 - a)", False),
        ("floor(exp(t))", True),
        ("x*sign(x)", False),
        ("sign(x - 1)", True),
        ("max(x, t)", False),
        ("sign(2 + sin(t))", True),  # never met: it is not seen to be continuous
    ],
)
def test_along_motions(text, jumps):
    _, symbols, value = _made(text)
    moving = [symbols["t"], symbols["x"]]
    assert may_jump(value, moving, symbols["t"]) == jumps
