"""Times of jumps and kinks, found from nodes."""

from __future__ import annotations

import math

import pytest

from cotree.dag.nodes import Dag
from cotree.dag.switching_times import (
    acts_in_part,
    find_longest_steps,
    find_time_events,
    longest_step,
)
from cotree.dag.time_events import find_restart_times, time_events_along
from cotree.scene.expressions import parse


def stop_times(stops, values, low, high):
    """List the times strictly within a span."""
    return [
        t for t in find_restart_times(stops, values, low, high).times.tolist() if low < t < high
    ]


def _times(text, low=0.0, high=10.0, **parameters):
    dag = Dag()
    symbols = {name: dag.symbol("p", i) for i, name in enumerate(parameters)}
    known = {"t": dag.symbol("t", 0), "x": dag.symbol("x", 0), **symbols}
    stops = find_time_events(dag, [parse(text, "a test").lower(dag, known.__getitem__)])
    values = {symbols[name]: value for name, value in parameters.items()}
    return stop_times(stops, values, low, high)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("sin(t)*x + t**2", []),
        ("sign(t - 3)", [3.0]),
        ("abs(1 - 2*t)", [0.5]),
        ("max(t, 4)*x", [4.0]),
        ("sign(x - t)", []),  # depends on a state: the error test sees to it
        ("sign(t**2 - 9)", []),  # not linear in time
        ("sign(11 - t)", []),  # after the end
        ("floor((t - 1)/4)", [1.0, 5.0, 9.0]),
        ("mod(t, 3)", [3.0, 6.0, 9.0]),
        ("sign(mod(t - 1, 4) - 1.5)", [1.0, 2.5, 5.0, 6.5, 9.0]),
        ("sin(sign(t - 1)) + sign(t - 1)", [1.0]),
        ("max(0, 1 - abs(t - 2)/0.5)", [1.5, 2.0, 2.5]),
        ("max(0, min(t - 1, 4 - t))", [1.0, 2.5, 4.0]),
        ("x*sign(sign(t - 1) + t - 3)", [1.0, 2.0, 3.0, 4.0]),
    ],
)
def test_times_of_expressions(text, expected):
    assert _times(text) == pytest.approx(expected, rel=1e-15)


def test_times_follow_the_parameters():
    text = "sign(mod(t - delay, period) - width)"
    found = _times(text, high=2.0, delay=0.5, period=1.0, width=0.25)
    assert found == [0.5, 0.75, 1.5, 1.75]
    assert _times(text, high=1.0, delay=0.5, period=2.0, width=math.nan) == [0.5]


def test_what_starts_has_no_times_before():
    dag = Dag()
    t = dag.symbol("t", 0)
    passed = (t - 2.0) / 3.0
    count = dag.function("floor", dag.select(passed, passed, dag.zero))
    phase = t - 2.0 - 3.0 * count
    stops = find_time_events(dag, [dag.function("abs", phase - 1.0)])
    assert stop_times(stops, {}, -10.0, 10.0) == [2.0, 3.0, 5.0, 6.0, 8.0, 9.0]


def test_times_that_differ_by_roundings_are_one():
    assert len(_times("sign(t - 0.3) + sign(t - 0.1*3) + sign(10*t - 3)")) == 1


def test_tables_of_time_stop_at_their_points():
    from cotree.dag.lookup import LinearTable
    from cotree.dag.multi_output import table

    dag = Dag()
    t = dag.symbol("t", 0)
    value, _ = table(dag, LinearTable((0.0, 1.0, 4.0), (0.0, 2.0, 1.0)), 2.0 * t - 1.0)
    assert stop_times(find_time_events(dag, [value]), {}, 0.0, 10.0) == [0.5, 1.0, 2.5]


def test_a_period_far_too_short_is_refused():
    with pytest.raises(ValueError, match=r"period of 1e-12 s occurs"):
        _times("mod(t, 1e-12)")


@pytest.mark.parametrize(
    ("text", "period"),
    [
        ("sin(3*t + 1)*x", 2 * math.pi / 3),
        ("cos(-w*(t - 2))", 2 * math.pi / 5),
        ("sin(w*t) + sin(7*t)", 2 * math.pi / 7),
        ("sin(x) + t", math.inf),
        ("sin(t**2)", math.inf),
        ("sin(w)", math.inf),
    ],
)
def test_steps_are_a_share_of_the_shortest_period(text, period):
    dag = Dag()
    known = {"t": dag.symbol("t", 0), "x": dag.symbol("x", 0), "w": dag.symbol("p", 0)}
    limits = find_longest_steps(dag, [parse(text, "a test").lower(dag, known.__getitem__)])
    assert longest_step(limits, {known["w"]: 5.0}) == pytest.approx(period / 32, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("exp(x/2)", True),
        ("exp(t)*x", False),
        ("sin(t)*x**2", False),
        ("max(0, x - t)", True),
        ("tanh(sqrt(x))", True),
    ],
)
def test_laws_that_may_be_nearly_zero_most_of_the_time(text, expected):
    dag = Dag()
    known = {"t": dag.symbol("t", 0), "x": dag.symbol("x", 0)}
    assert acts_in_part([parse(text, "a test").lower(dag, known.__getitem__)]) is expected


@pytest.mark.parametrize("n_along", [0, 3])
def test_the_list_of_times_is_limited(n_along):
    dag = Dag()
    t, p = dag.symbol("t", 0), dag.symbol("p", 0)
    text = "floor(9e6*t) + floor(8e6*t) + floor(7e6*t + p)"
    known = {"t": t, "p": p}
    stops = find_time_events(dag, [parse(text, "a test").lower(dag, known.__getitem__)])
    stops = time_events_along(stops, [{p: dag.one}] * n_along)
    # 24 million times, although each term alone has fewer than the maximum.
    remedy = "or compile with fewer sensitivities" if n_along else "or shorten the span"
    with pytest.raises(ValueError, match=rf"contains 2400000\d time events.*{remedy}"):
        find_restart_times(stops, {p: 0.0}, 0.0, 1.0)
    with pytest.raises(
        ValueError, match=r"limit of 1e-09 s was exceeded by the search for 24000\d time"
    ):
        find_restart_times(stops, {p: 0.0}, 0.0, 1e-2, time_limit=1e-9)
    # Each whole microsecond is in all three series.
    for limit in (None, 60.0):
        found = find_restart_times(stops, {p: 0.0}, 0.0, 1e-2, time_limit=limit)
        assert len(found) == 220001
