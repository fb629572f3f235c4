"""Members in lanes hold the pieces of their start, and leave at the first corner of their rates."""

import math

import numpy as np
import pytest
from lane_runs import TIMES, assert_same, plan_of, rows_of, runs_in_lanes

from cotree import Scene
from cotree.build import find_toolchain
from cotree.ensemble.batch import run_block

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(find_toolchain() is None, reason="needs a C compiler"),
]

METHODS = ("dop853", "dopri5", "rkf45", "rodas5", "rodas4")
NAMES = ("k", "a")
#: Corners beyond the motion, of each kind: it stays within 0.6 m and 0.8 m/s.
LAWS = {
    "max": "-k*m.s - 3*max(m.s - 5*a, 0)",
    "abs": "-k*m.s + a - abs(m.s_dot + 9*a)/9",
    "where": "-where(m.s > -4, k*m.s, a*(m.s + 4) - 4*k)",
    "nested": "-k*m.s - max(abs(m.s + 6*a) - 12, 0)",
    "sign": "-k*m.s - a*(m.s + 4)*sign(m.s + 4) + 4*a",
    "power": "-k*m.s - a*max(m.s - 5*a, 0)**1.5",
    "table": "-k*f(m.s)*a",
    "plane": "-k*m.s + a*g(m.s, m.s_dot)",
}


def mass(force, **initial):
    """Build a mass of 1 kg on a rail."""
    scene = Scene("mass")
    scene.parameter("k", 2.0)
    scene.parameter("a", 1.0)
    scene.table("f", [-6, -5, -4, 4, 5], [-8, -7, -4, 4, 7])
    rows = [[0.0, 1.0, 0.0], [0.0, 2.0, 1.0], [3.0, 1.0, 0.0]]
    scene.table("g", [-6.0, -5.0, 5.0], [-8.0, -7.0, 7.0], rows)
    initial = initial or {"s": 0.5, "s_dot": 0.3}
    scene.edge("m", "prismatic", "ground", "A", axis=[1, 0, 0], force=force, initial=initial)
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
    scene.output("power", "m.s_dot*m.s")
    return scene


@pytest.fixture(scope="module", params=LAWS)
def model(request):
    made = mass(LAWS[request.param]).compile(["k", "a"])
    assert made.kernels.layout.kinks
    return made


def in_lanes(found, single):
    """Return for each member whether lanes ran it to its end; last digits differ then."""
    return (found.z != single.z).any(axis=(1, 2))


@pytest.mark.parametrize("method", METHODS)
def test_members_that_pass_no_corner_stay_in_their_lanes(model, method):
    rows = rows_of(model, NAMES, 19)
    plan = plan_of(model, NAMES, method=method)
    assert runs_in_lanes(plan)
    found, single = run_block(plan, rows), run_block(plan_of(model, NAMES, 1, method=method), rows)
    np.testing.assert_array_equal(found.status, 0)
    assert in_lanes(found, single).all()
    # The very steps of the scalar engine.
    np.testing.assert_array_equal(found.steps, single.steps)
    np.testing.assert_allclose(found.z, single.z, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.outputs, single.outputs, rtol=1e-9, atol=1e-10)
    slopes = found.output_sensitivities, single.output_sensitivities
    np.testing.assert_allclose(*slopes, rtol=1e-9, atol=1e-10)


@pytest.mark.parametrize("method", METHODS)
def test_members_that_pass_one_have_the_bits_of_the_scalar_engine(method):
    """A swing of sqrt(0.5^2 + 0.3^2 / k) to a corner at 2a - 1.6."""
    model = mass("-k*m.s - 3*max(m.s - (2*a - 1.6), 0)").compile(["k", "a"])
    rows = np.stack([np.full(41, 2.0), np.linspace(1.0, 2.0, 41)], axis=1)
    passes = 2.0 * rows[:, 1] - 1.6 < math.sqrt(0.25 + 0.045)
    blocks = {n: run_block(plan_of(model, NAMES, n, method=method), rows) for n in (1, 2, 4, 8)}
    found, single = blocks[2], blocks[1]
    stay = in_lanes(found, single)
    assert stay.any()
    assert not stay[passes].any()
    np.testing.assert_array_equal(found.steps, single.steps)
    np.testing.assert_allclose(found.z, single.z, rtol=1e-9, atol=1e-10)
    # Who else leaves changes no bit of the others.
    for n in (4, 8):
        assert_same(blocks[n], found)
    plan = plan_of(model, NAMES, method=method)
    assert_same(run_block(plan, rows, threads=2), found)
    np.testing.assert_array_equal(run_block(plan, rows[::-1].copy()).z[::-1], found.z)
    for i in (0, 20, 40):
        np.testing.assert_array_equal(run_block(plan, rows[i : i + 1]).z[0], found.z[i])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("law", "initial", "end"),
    [
        ("-k*m.s - a*abs(m.s_dot)*m.s_dot", {"s": 0.5, "s_dot": 0.0}, 3.0),  # begins on a corner
        ("0.5*sin(5*m.s) - k*max(m.s - a, 0)", {"s": 0.0, "s_dot": 1.0}, 1.12),  # near the end
        # Less wide than a step.
        ("0.5*sin(5*m.s) - k*max(0, 1 - 100*abs(m.s - a))", {"s": 0.0, "s_dot": 1.0}, 3.0),
    ],
)
def test_no_corner_is_passed_in_a_lane(law, initial, end, method):
    model = mass(law, **initial).compile(["k", "a"])
    rows = np.stack([np.full(61, 2.0), np.linspace(0.9, 1.4, 61)], axis=1)
    times = np.linspace(0.0, end, 9)
    found, single = (
        run_block(plan_of(model, NAMES, n, method=method, times=times), rows) for n in (None, 1)
    )
    np.testing.assert_array_equal(found.status, 0)
    # Lanes read points between steps from five of them.
    assert (single.steps > 5).all()
    np.testing.assert_array_equal(found.steps, single.steps)
    passes = single.z[:, :, 0].max(axis=1) > rows[:, 1] if "sin" in law else np.ones(61, bool)
    assert passes.sum() > 10
    assert not in_lanes(found, single)[passes].any()
    np.testing.assert_allclose(found.z, single.z, rtol=1e-9, atol=1e-10)


def test_backwards_the_error_test_finds_corners_in_lanes_too():
    model = mass("-k*m.s - 3*max(m.s - 0.3*a, 0)").compile(["k", "a"])
    rows, times = rows_of(model, NAMES, 5), -TIMES
    plans = [plan_of(model, NAMES, n, times=times) for n in (None, 1)]
    found, single = (run_block(plan, rows) for plan in plans)
    assert in_lanes(found, single).all()
    np.testing.assert_allclose(found.z, single.z, rtol=1e-5, atol=1e-5)
