"""Steps whose error seems small by chance, because they pass over a kink."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import Scene
from cotree.codegen.tableaus import TABLEAUS

pytestmark = pytest.mark.compiler

RTOL, ATOL, END, SLOPE = 1e-8, 1e-8, 4.0, 20.0


def kinked():
    """x = t, which C shows as a state, and y' = cos x + SLOPE max(0, x - c)."""
    scene = Scene("kinked")
    scene.parameter("c", 10.0)
    scene.parameter("slope", SLOPE)
    scene.edge("x", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("one", "current_source", "ground", "a", current=1.0)
    scene.edge("y", "capacitor", "b", "ground", capacitance=1.0)
    scene.edge("I", "current_source", "ground", "b", current="cos(x.v) + slope*max(0, x.v - c)")
    return scene


def ratio(text):
    return float(np.divide(*map(float, f"{text}/1".split("/")[:2])))


def estimates(t, h, c):
    """The two estimates of a step of dop853, and the change of y that it takes."""
    row = TABLEAUS["dop853"]
    nodes = np.array([0.0, *map(ratio, row.nodes), 1.0])
    rates = np.cos(t + h * nodes) + SLOPE * np.maximum(0.0, t + h * nodes - c)
    sums = (*row.errors, row.solution)
    return [h * sum(ratio(w) * rates[i] for i, w in weights.items()) for weights in sums]


def exact(t, c):
    return np.sin(t) + 0.5 * SLOPE * np.maximum(0.0, t - c) ** 2


def bad_place(t, h):
    """The kink within a step from t where the first estimate changes its sign, by bisection."""
    places = t + h * np.linspace(0.02, 0.98, 97)
    signs = np.sign([estimates(t, h, c)[0] for c in places])
    at = int(np.flatnonzero(signs[1:] != signs[:-1])[0])
    low, high = places[at], places[at + 1]
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if np.sign(estimates(t, h, middle)[0]) == signs[at] else (low, middle)
        )
    return low


def test_a_kink_where_the_error_estimate_vanishes():
    model = kinked().compile(locate_kinks=False)
    smooth = model.simulate((0.0, END), None, "dop853", RTOL, ATOL)
    tried = 0
    for t, after in zip(smooth.t[5:-2], smooth.t[6:-1], strict=True):
        h = after - t
        c = bad_place(t, h)
        fifth, third, change = estimates(t, h, c)
        tolerance = ATOL + RTOL * max(abs(exact(t, c)), abs(exact(after, c)))
        by_itself = fifth**2 / np.sqrt(fifth**2 + 0.01 * third**2) / tolerance
        wrong = abs(change - (exact(after, c) - exact(t, c)))
        # The estimate believes a step that errs by far more than is allowed.
        assert by_itself < 1e-3
        assert wrong > 1e3 * tolerance
        found = model.simulate((0.0, END), None, "dop853", RTOL, ATOL, parameters={"c": c})
        assert not np.any(found.t == after)  # another length was taken
        error = np.abs(found["y.v"] - exact(found.t, c)).max()
        # Tens of steps, each of which may err by the tolerance where y is 30 at most.
        assert error < 50.0 * (ATOL + 30.0 * RTOL), (t, h, error)
        tried += 1
    assert tried == 8  # the first steps are too short for much to happen in them
