from __future__ import annotations

import math
import time

import numpy as np
import pytest
from ivp_cases import oscillator, scalar

import cotree
from cotree.errors import ModelError, ParameterError, SolveError
from cotree.methods import METHODS
from cotree.solvers import check_problem, integrate

# Those that take Python functions.
ALL = [name for name, row in METHODS.items() if row.family == "scipy"]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ALL)
def test_past_a_pole(method):
    times = np.array([0.0, 0.25, 1.5])
    result = integrate(scalar(lambda t, x: x * x, lambda t, x: 2 * x, t_eval=times), method)
    assert result.status == -1
    assert not result.message.startswith(f"{method} reached")
    # The last column is the last good point. The pole lies at t = 1; at rtol = 1e-6 the methods
    # place it within 1e-4 of that.
    assert result.t[:2].tolist() == [0.0, 0.25]
    assert result.t[2] == pytest.approx(1, abs=1e-4)
    assert np.all(np.isfinite(result.z))
    assert result.z[0, 1] == pytest.approx(4 / 3, rel=1e-4)


@pytest.mark.parametrize("method", ALL)
def test_derivative_becomes_nan(method):
    result = integrate(scalar(lambda t, x: math.nan if t > 0.5 else 1.0, lambda t, x: 0.0), method)
    assert result.status == -1
    assert "the derivative of 'x' is nan at t = " in result.message
    assert result.t[-1] <= 0.5
    np.testing.assert_allclose(result.z[0], 1 + result.t, rtol=1e-12)


@pytest.mark.parametrize("method", ALL)
def test_derivative_is_infinite_at_the_start(method):
    result = integrate(scalar(lambda t, x: math.inf, lambda t, x: 0.0), method)
    assert result.status == -1
    assert "cannot start; the derivative of 'x' is inf at t = 0" in result.message
    assert result.t.tolist() == [0.0]


@pytest.mark.parametrize("method", ["Radau", "BDF", "LSODA"])
def test_jacobian_that_is_not_finite_at_first(method):
    result = integrate(scalar(lambda t, x: -1000 * x, lambda t, x: math.nan), method)
    # LSODA begins with Adams' formulas and may never ask.
    assert result.status == -1 or (method == "LSODA" and result.statistics.njev == 0)
    if result.statistics.njev:
        assert "'x' and 'x' is nan" in result.message


@pytest.mark.parametrize("method", ["rodas5", "cvode", "ida", "Radau"])
def test_jacobian_of_a_model_that_is_not_a_number(method):
    """A root of a square that vanishes everywhere has a value and no derivative."""
    scene = cotree.Scene("decay")
    scene.parameter("h", 0.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("I", "current_source", "ground", "a", current="1 - sqrt((h*C.v)**2)")
    # CVODE once shortened its first step for ever, within a single call.
    with pytest.warns(RuntimeWarning, match="is not finite|is nan"):
        result = scene.compile().simulate((0, 3), method=method, time_limit=60)
    assert result.status == -1
    assert "'C.v' and 'C.v'" in result.message


@pytest.mark.parametrize("method", ["Radau", "BDF", "LSODA"])
def test_trial_steps_may_leave_the_domain(method):
    def root(t: float, x: float) -> float:
        return -math.sqrt(x) if x >= 0 else math.nan

    # x = (1 - t/2)^2 comes near to the edge of the domain, where trial steps overshoot.
    result = integrate(scalar(root, None, t_span=(0.0, 1.99)), method)
    assert result.status == 0, result.message
    # atol = 1e-8, and the error of 1e-6 in the motion before, divided by the closing distance.
    assert result.z[0, -1] == pytest.approx(0.005**2, abs=2e-6)


@pytest.mark.parametrize("error", [KeyboardInterrupt, ModelError, ValueError])
@pytest.mark.parametrize("method", ALL)
def test_errors_of_the_right_hand_side_propagate(method, error):
    def broken(t: float, x: float) -> float:
        if t > 0.5:
            raise error("from inside")
        return -x

    with pytest.raises(error, match="from inside"):
        integrate(scalar(broken, lambda t, x: -1.0), method)


@pytest.mark.parametrize("method", ALL)
def test_step_budget(method):
    result = integrate(oscillator(max_steps=7), method)
    assert result.status == -2
    assert "limit of 7 steps" in result.message
    assert result.statistics.n_steps == 7
    assert result.t.size == 8


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ALL)
def test_longest_step(method):
    result = integrate(oscillator(max_step=0.01), method)
    assert result.status == 0
    # Times are sums of steps, each rounded.
    assert np.diff(result.t).max() <= 0.01 * (1 + 1e-9)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ALL)
def test_start_at_rest_that_ends_soon(method):
    # x' = -1e9 (x - sin t): nothing moves at t = 0, and a first step of a share of the span is
    # ten million time constants. x = sin t up to 1e-9.
    problem = scalar(
        lambda t, x: -1e9 * (x - math.sin(t)),
        lambda t, x: -1e9,
        z0=0.0,
        t_span=(0.0, 1e-5 if method in ("RK45", "RK23", "DOP853") else 1.0),
        rtol=1e-6,
        atol=1e-8,
    )
    result = integrate(problem, method)
    assert result.status == 0, result.message
    # The error test allows 1e-6 a step; what it leaves decays at once.
    assert result.z[0, -1] == pytest.approx(math.sin(result.t[-1]), abs=3e-6)


@pytest.mark.parametrize("method", ALL)
def test_time_budget(method):
    def slow(t: float, x: float) -> float:
        time.sleep(0.001)
        return -1e3 * (x - math.cos(1e3 * t))

    begin = time.perf_counter()
    span = (0.0, 1e3)
    problem = scalar(slow, lambda t, x: -1e3, z0=0.0, t_span=span, time_limit=0.05)
    result = integrate(problem, method)
    assert result.status == -2
    assert "time limit of 0.05 s" in result.message
    # One evaluation may overrun; the rest is room for a busy machine.
    assert time.perf_counter() - begin < 10.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"t_span": (1.0, 1.0)}, "empty"),
        ({"t_span": (0.0, math.inf)}, "end of t_span is inf"),
        ({"t_eval": np.array([])}, "at least one"),
        ({"t_eval": np.array([0.0, math.nan])}, "not finite"),
        ({"t_eval": np.array([0.0, 6.0])}, "outside"),
        ({"t_eval": np.array([1.0, 1.0])}, "strictly increase"),
        ({"t_eval": np.array([0.0, 1.0]), "t_span": (5.0, 0.0)}, "strictly decrease"),
        ({"max_step": 0.0}, "max_step is 0"),
        ({"max_step": math.nan}, "max_step is nan"),
        ({"rtol": 0.0}, "rtol is 0"),
        ({"rtol": math.nan}, "rtol is nan"),
        ({"atol": -1.0}, "atol is -1"),
        ({"atol": math.inf}, "atol is inf"),
        ({"atol": np.ones(3)}, "atol is"),
        ({"z0": np.array([0.0, math.nan, 0, 0, 0, 0])}, "initial value of 'v' is nan"),
        (
            {"z0": np.array([0.0, 0, 0, 0, math.inf, 0])},
            "the sensitivity of 'x' to parameter 1 is inf",
        ),
        ({"z0": np.zeros(5)}, "shape"),
        ({"names": ("x",)}, "1 names are given for 2 states"),
        ({"breakpoints": (math.nan,)}, "breakpoint"),
        ({"max_steps": 0}, "max_steps is 0"),
        ({"time_limit": -1.0}, "time_limit is -1"),
    ],
)
def test_wrong_problems_are_named(changes, words):
    with pytest.raises((SolveError, ParameterError), match=words):
        check_problem(oscillator(**changes))


def test_shapes_of_callables_are_checked():
    with pytest.raises(SolveError, match=r"right-hand side returned shape \(2,\)"):
        integrate(oscillator(rhs=lambda t, z: z[:2]), "RK45")
    with pytest.raises(SolveError, match=r"Jacobian has shape \(3, 3\)"):
        integrate(oscillator(jacobian=lambda t, y: np.eye(3)), "BDF")


def test_a_body_whose_mass_is_rounding_is_named():
    """Its accelerations are the constraint forces' rounding errors, divided by its mass."""
    scene = cotree.Scene("ladder", gravity=[0, -9.81, 0])
    scene.edge("b", "planar", "ground", "P", normal=[0, 0, 1])
    scene.edge("rod", "rigid_body", "ground", "P", mass=1.0, inertia=0.1)
    scene.edge("u", "prismatic", "ground", "U", axis=[1, 0, 0], initial={"s": 0.8})
    scene.edge("dust", "rigid_body", "ground", "U", mass=1e-12)
    for name, expression in {
        "cx": "P.x - u.s + 0.25*u.s/sqrt(1 + u.s**2)",
        "cy": "P.y - u.s**2/2 - 0.25/sqrt(1 + u.s**2)",
        "ct": "b.theta + sin(u.s)",
    }.items():
        scene.edge(name, "constraint", "ground", "P", expression=expression)
    model = scene.compile()
    with pytest.warns(RuntimeWarning, match=r"[Mm]ass of edge 'dust' is 1e-12"):
        result = model.simulate((0, 3), rtol=1e-9, method="dop853")
    assert result.status < 0
