"""Lookup tables against SciPy's interpolators, in fields, outputs and parts."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import PchipInterpolator, RegularGridInterpolator

import cotree
from cotree.dag.derivative import tangents
from cotree.dag.evaluate import evaluate
from cotree.dag.lookup import Grid, look_up
from cotree.dag.nodes import Dag

RANDOM = np.random.default_rng(7)
KNOTS = np.sort(RANDOM.uniform(0, 5, 7))
OTHERS = np.sort(RANDOM.uniform(-1, 3, 5))
VALUES = np.cumsum(RANDOM.normal(size=7))
SURFACE = RANDOM.normal(size=(7, 5))
# Inside, outside and at the points themselves.
PLACES = np.concatenate([RANDOM.uniform(-1, 6, 60), KNOTS])


def formed(grid, n):
    """Form a grid's value, and its derivatives by each argument."""
    dag = Dag()
    places = [dag.symbol("p", i) for i in range(n)]
    value = look_up(dag, grid, places)
    return places, [value, *(tangents([value], {place: dag.one})[0] for place in places)]


def along(knots, values, smooth, extends):
    """Evaluate SciPy's interpolation, held or extended outside."""
    spline = PchipInterpolator(knots, values)
    ends = [spline(knots[0], 1), spline(knots[-1], 1)]
    if not smooth:
        slopes = np.diff(values) / np.diff(knots)
        ends = [slopes[0], slopes[-1]]

    def value(x):
        inside = np.clip(x, knots[0], knots[-1])
        found = spline(inside) if smooth else np.interp(inside, knots, values)
        return found + extends * (
            ends[0] * np.minimum(x - knots[0], 0) + ends[1] * np.maximum(x - knots[-1], 0)
        )

    return value


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("extends", [False, True])
def test_one_argument_is_interpolated_as_by_scipy(smooth, extends):
    (place,), roots = formed(Grid((tuple(KNOTS),), tuple(VALUES), smooth, extends), 1)
    found = np.array([evaluate(roots, {place: float(x)}) for x in PLACES])
    expected = along(KNOTS, VALUES, smooth, extends)
    np.testing.assert_allclose(found[:, 0], expected(PLACES), atol=1e-13)
    # Off the points; half the difference of a step of 1e-6, whose rounding is 1e-10.
    off = [i for i, x in enumerate(PLACES) if np.min(np.abs(KNOTS - x)) > 1e-5]
    slopes = (expected(PLACES + 1e-6) - expected(PLACES - 1e-6)) / 2e-6
    np.testing.assert_allclose(found[off, 1], slopes[off], atol=1e-8)


def test_two_arguments_are_interpolated_as_by_scipy():
    places, roots = formed(Grid((tuple(KNOTS), tuple(OTHERS)), tuple(SURFACE.ravel())), 2)
    x = RANDOM.uniform(KNOTS[0], KNOTS[-1], 80)
    y = RANDOM.uniform(OTHERS[0], OTHERS[-1], 80)
    found = [
        evaluate(roots[:1], dict(zip(places, p, strict=True)))[0]
        for p in zip(x.tolist(), y.tolist(), strict=True)
    ]
    expected = RegularGridInterpolator((KNOTS, OTHERS), SURFACE)(np.column_stack([x, y]))
    np.testing.assert_allclose(found, expected, atol=1e-13)


def test_a_smooth_surface_is_monotone_along_its_grid_lines_and_has_continuous_slopes():
    places, roots = formed(Grid((tuple(KNOTS), tuple(OTHERS)), tuple(SURFACE.ravel()), True), 2)

    def at(x, y):
        return evaluate(roots, {places[0]: float(x), places[1]: float(y)})

    y = RANDOM.uniform(OTHERS[0], OTHERS[-1], 20)
    for i, knot in enumerate(KNOTS):
        found = [at(knot, other)[0] for other in y]
        np.testing.assert_allclose(found, PchipInterpolator(OTHERS, SURFACE[i])(y), atol=1e-13)
    for x, other in zip(RANDOM.uniform(KNOTS[1], KNOTS[-2], 20), y, strict=True):
        # Differences over 1e-6 have an error of rounding of 1e-9.
        ahead, behind = at(x + 1e-6, other)[0], at(x - 1e-6, other)[0]
        assert at(x, other)[1] == pytest.approx((ahead - behind) / 2e-6, abs=1e-7)
    for knot in KNOTS[1:-1]:
        left, right = at(knot - 1e-12, y[0]), at(knot + 1e-12, y[0])
        np.testing.assert_allclose(left, right, atol=1e-9)


def motor(**table):
    scene = cotree.Scene("motor")
    scene.parameter("J", 0.4)
    scene.edge("J1", "rotational_inertia", "ground", "a", inertia="J")
    scene.edge("T", "torque_source", "ground", "a", torque={"of": "J1.w"} | table)
    return scene


CURVE = {"x": [0, 1, 2, 4, 6], "y": [5, 4.5, 3, 2.5, 0.2], "interpolation": "monotone"}


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_a_motor_follows_its_curve(method):
    model = motor(**CURVE).compile(["J"], optimize="-O0")
    t = np.linspace(0, 1.5, 7)
    settings = {"rtol": 1e-11, "atol": 1e-13, "method": method}
    result = model.simulate((0, 1.5), t, **settings)
    torque = PchipInterpolator(CURVE["x"], CURVE["y"])
    exact = solve_ivp(
        lambda _, w: torque(np.clip(w, 0, 6)) / 0.4,
        (0, 1.5),
        [0.0],
        "DOP853",
        t,
        rtol=1e-12,
        atol=1e-13,
    )
    # Slopes of the curve are continuous, and their kinks are met by error control.
    np.testing.assert_allclose(result["J1.w"], exact.y[0], atol=1e-8)
    ends = [
        model.simulate((0, 1.5), parameters={"J": 0.4 + h}, sensitivities=False, **settings)
        for h in (1e-3, -1e-3)
    ]
    slope = (ends[0]["J1.w"][-1] - ends[1]["J1.w"][-1]) / 2e-3
    # The error of a difference of this step, squared.
    assert result.sensitivity("J1.w", "J")[-1] == pytest.approx(slope, rel=1e-4)


def test_an_output_may_be_a_table_that_fields_name():
    scene = cotree.Scene("scheduled")
    scene.edge("m", "translational_mass", "ground", "a", mass=1.0, initial={"v": 1.0})
    scene.edge("F", "force_source", "ground", "a", force="-gain*m.v")
    rows = [[1.0, 2.0], [1.0, 2.0]]
    scene.output("gain", {"of": ["m.v", "t"], "x": [0, 2], "y": [0, 1], "values": rows})
    result = scene.compile().simulate((0, 1), rtol=1e-11, method="dop853")
    assert result["gain"][-1] == pytest.approx(2.0, rel=1e-14)
    # v' = -(1 + t) v.
    assert result["m.v"][-1] == pytest.approx(np.exp(-1.5), rel=1e-9)


def test_a_jump_within_the_argument_is_an_event():
    scene = motor(of="where(J1.w > 1, 5, 0) + J1.w", x=[0, 10], y=[1, 2])
    result = scene.compile().simulate((0, 2), parameters={"J": 1.0}, rtol=1e-10, method="dop853")
    # w' = 1 + w/10 up to w = 1, which takes 10 log 1.1; then w' = 3/2 + w/10.
    late = 2 - 10 * np.log(1.1)
    assert result["J1.w"][-1] == pytest.approx(16 * np.exp(0.1 * late) - 15, rel=1e-9)


def test_tables_are_saved_and_become_those_of_parts(tmp_path):
    scene = motor(**CURVE)
    rows = [[1, 2], [3, 4], [5, 9]]
    surface = {"of": ["J1.w", "t"], "x": [0, 3, 6], "y": [0, 1], "values": rows}
    scene.output("gain", surface | {"beyond": "extend", "interpolation": "monotone"})
    end = scene.compile().simulate((0, 1), rtol=1e-9)["gain"][-1]
    scene.save(tmp_path / "motor.toml")
    again = cotree.load(tmp_path / "motor.toml")
    assert again.compile().simulate((0, 1), rtol=1e-9)["gain"][-1] == end
    outer = cotree.Scene("outer")
    outer.add("p", again)
    assert outer.compile().simulate((0, 1), rtol=1e-9)["p.gain"][-1] == end


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"y": [1, 2, 3]}, "needs as many values as x"),
        ({"x": [1, 0]}, "needs x that increase"),
        ({"x": [0, float("nan")]}, "not finite"),
        ({"of": ["J1.w"], "values": [[1, 2], [3, 4]]}, "needs an expression, or two in a list"),
        ({"of": ["J1.w", "t"], "values": [[1, 2], [3]]}, "must be 2 rows of 2 numbers"),
        ({"of": ["J1.w", "t"], "values": [[1, 2], [3, float("inf")]]}, "not finite"),
        ({"of": ["J1.w", "t"]}, "is a table: give 'of'"),
        ({"interpolation": "cubic"}, "must be 'linear' or 'monotone'"),
        ({"beyond": 1}, "must be 'hold' or 'extend'"),
        ({"of": "lookup(J1.w)"}, "'lookup', which is not a known function"),
        ({"more": 1}, "is a table: give 'of'"),
    ],
)
def test_wrong_tables_are_refused_by_name(table, message):
    with pytest.raises(cotree.Error, match=f"torque of edge 'T'.*{message}"):
        motor(**{"x": [0, 1], "y": [1, 2]} | table)
