from __future__ import annotations

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest
from cartesian_pendulum import (
    AMPLITUDE,
    LENGTH,
    PERIOD,
    CartesianPendulum,
    P,
    pendulum,
    pendulum_exact,
)
from ivp_cases import oscillator, scalar

from cotree.equations import Quantity
from cotree.errors import SingularSystemError, SolveError
from cotree.solvers import (
    METHODS,
    Drift,
    Projection,
    RunRecord,
    Statistics,
    check_problem,
    integrate,
)

# Those that take Python functions.
ALL = [name for name, row in METHODS.items() if row.family == "scipy"]
BOTH = ("g", "L")

# Rows are sums of squares of about 2 and 30; their rounding is a few times eps = 2.2e-16 of that.
ROUNDING = 1e-14


def _projection(model: CartesianPendulum) -> Projection:
    return Projection(model, P, lambda t: None)  # type: ignore[arg-type]


def _error(trajectory, sensitivities=()) -> float:
    exact = pendulum_exact(trajectory.t, sensitivities)
    scale = np.max(np.abs(exact), axis=1, keepdims=True)
    return float(np.max(np.abs(trajectory.z - exact) / scale))


def _differentiated(z):
    """The constraint and its rate, differentiated by g and L; a rod of length L pulls at both."""
    (x, y, vx, vy), rows = z[:4], []
    for (sx, sy, sa, sb), by in zip(z[4:].reshape(2, 4, -1), (0.0, LENGTH), strict=True):
        rows += [x * sx + y * sy - by, vx * sx + vy * sy + x * sa + y * sb]
    return np.array(rows)


def test_closed_form_satisfies_the_hand_written_kernels():
    t = np.linspace(0.1, 5, 7)
    exact = pendulum_exact(t, BOTH)
    rhs = pendulum(sensitivities=BOTH).rhs
    step = 1e-4
    ahead, behind = pendulum_exact(t + step, BOTH), pendulum_exact(t - step, BOTH)
    # Central differences: step**2 times third derivatives of a few hundred.
    for i, at in enumerate(t):
        slope = (ahead[:, i] - behind[:, i]) / (2 * step)
        np.testing.assert_allclose(rhs(at, exact[:, i]), slope, atol=1e-5)
    assert np.max(np.abs(_differentiated(exact))) < 10 * ROUNDING


def test_states_move_to_the_nearest_point_in_few_steps():
    model = CartesianPendulum()
    z = np.array([0.9, -1.1, 2.0, 1.0])
    projected = _projection(model)(0.0, z)
    unit = z[:2] / np.linalg.norm(z[:2])
    np.testing.assert_allclose(projected[:2], LENGTH * unit, rtol=1e-15)
    np.testing.assert_allclose(projected[2:], z[2:] - unit * (unit @ z[2:]), rtol=1e-15)
    assert z.tolist() == [0.9, -1.1, 2.0, 1.0]
    # 9 % off: Newton's method squares the error to rounding in 4 steps, the speeds take one more,
    # and the last one only finds rounding.
    assert model.calls["projection"] <= 6


def test_a_state_on_the_constraints_costs_one_step():
    model = CartesianPendulum()
    z = pendulum_exact(np.array([0.3]))[:, 0]
    np.testing.assert_allclose(_projection(model)(0.0, z), z, rtol=1e-15, atol=1e-15)
    assert model.calls == {"projection": 1, "constraints": 1}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ALL)
def test_held_at_rounding_and_more_accurate(method):
    rtol = 1e-4 if method == "RK23" else 1e-6
    periods = 10 if method == "DOP853" else 4
    times = np.linspace(0, periods * PERIOD, 61)
    held, free = (
        integrate(pendulum(times, is_projected=on, rtol=rtol, atol=rtol / 100), method)
        for on in (True, False)
    )
    assert held.status == 0, held.message
    assert free.drift is None
    assert held.drift.names == ("rod", "rod_dot")
    assert held.drift.residual.shape == (2, 61)
    assert held.drift.worst < ROUNDING
    assert 0 < held.drift.correction < 100 * rtol
    # Left alone, the constraint's error grows with the square of time; held, it is none.
    assert _error(held) < _error(free)


@pytest.mark.slow
@pytest.mark.parametrize("method", ALL)
def test_held_for_many_periods(method):
    """Three hundred periods by the method whose phase is compared, fifty by each other one."""
    tight = method == "DOP853"
    times = np.linspace(0, (300.3 if tight else 50.3) * PERIOD, 21)
    rtol = 1e-9 if tight else 1e-4
    result = integrate(pendulum(times, rtol=rtol, atol=rtol / 100), method)
    assert result.status == 0, result.message
    assert result.drift.worst < ROUNDING
    # What is corrected is what a hundred steps at most have left, however long the run.
    assert result.drift.correction < 100 * rtol
    if tight:
        error = np.max(np.abs(result.z - pendulum_exact(times)), axis=0)
        # The energy that each step loses shifts the phase by the square of time, and nothing
        # worse happens: left to drift, the error is 600 times as large and of a higher power.
        assert error[-1] < 1.5 * 10**2 * error[2]
        # 3e4 steps of up to rtol each, with a factor of 30 for the phase.
        assert error[-1] < 1e-3


@pytest.mark.parametrize("method", ALL)
def test_own_steps_are_projected_too(method):
    result = integrate(pendulum(rtol=1e-5, atol=1e-7), method)
    assert result.status == 0, result.message
    assert result.statistics.n_steps == result.t.size - 1
    assert result.drift.residual.shape == (2, result.t.size)
    assert result.drift.worst < ROUNDING
    assert _error(result) < 1e-2


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ["BDF", "LSODA"])
def test_outputs_decide_nothing_about_a_method_with_a_memory(method):
    end = 5 * PERIOD
    few = integrate(pendulum(np.array([end]), rtol=1e-6, atol=1e-8), method)
    many = integrate(pendulum(np.linspace(0, end, 501), rtol=1e-6, atol=1e-8), method)
    # SUNDIALS and LSODA round differently where they were asked for values between steps.
    assert many.statistics.n_steps == pytest.approx(few.statistics.n_steps, rel=0.1)
    # 600 to 1300 steps; starting anew at each coarse output took CVODE many times as many.
    assert many.statistics.n_steps < 2000


@pytest.mark.sampled(2)
@pytest.mark.parametrize("is_tested", [True, False])
@pytest.mark.parametrize("method", ALL)
def test_sensitivities_obey_the_differentiated_constraint(method, is_tested):
    rtol = 1e-5 if method == "RK23" else 1e-7
    times = np.linspace(0, 2 * PERIOD, 11)
    problem = pendulum(times, BOTH, rtol=rtol, atol=rtol / 100, error_test_sensitivities=is_tested)
    result = integrate(problem, method)
    assert result.status == 0, result.message
    assert result.drift.worst < ROUNDING
    # As for the states, with sensitivities of up to 10 in the place of some.
    assert np.max(np.abs(_differentiated(result.z))) < 10 * ROUNDING
    # Hundreds of steps with an error of up to rtol each.
    assert _error(result, BOTH) < 300 * rtol


@pytest.mark.parametrize("method", ["DOP853", "RK23", "BDF"])
def test_backwards_in_time(method):
    times = np.linspace(PERIOD, 0, 9)
    problem = pendulum(times, z0=pendulum_exact(times[:1])[:, 0], t_span=(PERIOD, 0.0))
    result = integrate(dataclasses.replace(problem, rtol=1e-6), method)
    assert result.drift.worst < ROUNDING
    # Hundreds of steps with an error of up to rtol each.
    assert _error(result) < 3e-4


@pytest.mark.parametrize("method", ALL)
def test_the_start_is_projected(method):
    z0 = np.array([LENGTH * math.sin(AMPLITUDE), -LENGTH * math.cos(AMPLITUDE), 0.0, 0.0])
    result = integrate(pendulum(np.array([0.0, 0.5]), z0=1.001 * z0), method)
    np.testing.assert_allclose(result.z[:, 0], z0, rtol=1e-15, atol=1e-15)
    # Relative to what was given, where that is more than 1.
    assert result.drift.correction == pytest.approx(0.001 / 1.001, rel=1e-9)


@pytest.mark.parametrize("method", ALL)
def test_a_driven_speed_jumps_at_a_breakpoint(method):
    def driven(t: float) -> float:
        return 1.0 if t < 1 else 2.0

    problem = dataclasses.replace(
        oscillator(np.array([0.0, 0.5, 1.0, 1.5, 2.0])),
        rhs=lambda t, z: np.array([z[1], 0.0]),
        jacobian=lambda t, y: np.array([[0.0, 1.0], [0.0, 0.0]]),
        n_sensitivities=0,
        z0=np.array([0.0, 1.0]),
        t_span=(0.0, 2.0),
        breakpoints=(1.0,),
        project=lambda t, z: np.array([z[0], driven(t)]),
        residual=lambda t, z: z[1:] - driven(t),
        constraints=("drive",),
    )
    result = integrate(problem, method)
    assert result.status == 0, result.message
    # Every method integrates a constant exactly; the corner's value is that of the segment before.
    np.testing.assert_allclose(result.z[0], [0.0, 0.5, 1.0, 2.0, 3.0], atol=1e-13)
    assert result.z[1].tolist() == [1.0, 1.0, 1.0, 2.0, 2.0]
    assert result.drift.worst == 0.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ALL)
def test_a_projection_that_changes_nothing_changes_no_result(method):
    for times in (None, np.linspace(0, 5, 41)):
        plain = oscillator(times, breakpoints=(1.0,), rtol=1e-4, atol=1e-6)
        same = dataclasses.replace(plain, project=lambda t, z: z, residual=lambda t, z: np.zeros(0))
        free, held = integrate(plain, method), integrate(same, method)
        assert free.drift is None
        assert held.drift.correction == 0.0
        assert np.array_equal(free.t, held.t)
        # Bit by bit: a problem without constraints goes the same way.
        assert np.array_equal(free.z, held.z)
        assert free.statistics.nfev == held.statistics.nfev


@pytest.mark.sampled(3)
@pytest.mark.parametrize("wants_outputs", [True, False])
@pytest.mark.parametrize("error", [SolveError, SingularSystemError])
@pytest.mark.parametrize("method", ALL)
def test_a_failing_projection_ends_the_run(method, error, wants_outputs):
    plain = pendulum(np.linspace(0, PERIOD, 2001) if wants_outputs else None)

    def project(t, z):
        if t > 0.5:
            raise error("the rod is torn.")
        return plain.project(t, z)

    result = integrate(dataclasses.replace(plain, project=project, rtol=1e-5), method)
    assert result.status == -1
    assert result.message.startswith(f"{method} stopped at t = 0.")
    assert result.message.endswith(": the rod is torn.")
    assert np.all(np.diff(result.t) > 0)
    assert result.t[-1] <= 0.5
    assert result.drift.residual.shape == (2, result.t.size)
    assert result.drift.worst < ROUNDING


@pytest.mark.parametrize("method", ALL)
def test_a_failing_projection_of_the_start(method):
    problem = pendulum(
        np.array([0.5, 1.0]),
        project=lambda t, z: np.full(4, math.nan),
        z0=np.array([1.0, 0.0, 0.0, 0.0]),
    )
    result = integrate(problem, method)
    assert result.status == -1
    assert "the projection onto the constraints is not finite" in result.message
    assert result.t.tolist() == [0.0]
    # The point is stored as it was given, and the report says how far off it is.
    assert result.z[:, 0].tolist() == [1.0, 0.0, 0.0, 0.0]
    assert result.drift.residual[:, 0] == pytest.approx([(1 - LENGTH**2) / 2, 0.0])


@pytest.mark.parametrize("method", ["RK45", "Radau", "BDF"])
def test_no_derivative_on_the_constraints(method):
    problem = scalar(
        lambda t, x: math.nan if x > t + 1e-10 else 1.0,
        lambda t, x: 0.0,
        project=lambda t, z: z + 1e-9 * (t > 0.5),  # less than a step may be moved
        residual=lambda t, z: np.zeros(1),
        constraints=("c",),
    )
    result = integrate(problem, method)
    assert result.status == -1
    assert "the derivative of 'x' is nan" in result.message


class _Gap(CartesianPendulum):
    """A pendulum with a third row, of which no projection takes anything away."""

    layout = SimpleNamespace(
        constraint_edges=(),
        constraints=(*CartesianPendulum.layout.constraints, Quantity("gap", "m")),
    )

    def bound(self, name, p):
        call = super().bound(name, p)
        if name != "constraints":
            return call
        return lambda t, x, s, u: np.append(call(t, x, s, u), 0.25)


def test_rows_that_stay_are_named():
    z = pendulum_exact(np.zeros(1))[:, 0]
    with pytest.raises(SolveError, match=r"at t = 2: 'gap' stays 0.25 m\. Check") as caught:
        _projection(_Gap())(2.0, z)
    assert "rod" not in str(caught.value)


class _Restless(CartesianPendulum):
    """A pendulum whose step leads ever further away, with a gap that no step closes."""

    def constraints(self, state, s, g, length):
        return [1e-5, 0.0]

    def projection(self, state, s, g, length):
        return [1e-5, 0.0, 0.0, 0.0]


def test_steps_that_do_not_come_to_rest_are_refused():
    with pytest.raises(SolveError, match="'rod' stays"):
        _projection(_Restless())(0.0, np.array([1.0, 0.0, 0.0, 1.0]))


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_states_that_are_not_finite_are_refused(value):
    with np.errstate(invalid="ignore"), pytest.raises(SolveError, match="'rod' stays"):
        _projection(CartesianPendulum())(0.0, np.array([value, 1.0, 0.0, 0.0]))


def test_half_a_constrained_problem_is_refused():
    with pytest.raises(SolveError, match="residual is missing"):
        check_problem(pendulum(residual=None))
    with pytest.raises(SolveError, match="project is missing"):
        check_problem(pendulum(project=None))
    with pytest.raises(SolveError, match=r"projection returned shape \(2,\)"):
        integrate(pendulum(project=lambda t, z: z[:2]), "RK45")


def test_the_result_says_how_constraints_are_held():
    t = np.array([0.0, 1.0])
    result = RunRecord(
        t=t,
        y=np.array([t]),
        s=np.zeros((1, 0, 2)),
        states=("x",),
        outputs=(),
        output_values=np.zeros((0, 2)),
        output_sensitivities=np.zeros((0, 0, 2)),
        inputs=(),
        input_values=np.zeros((0, 2)),
        parameters_of_sensitivity=(),
        units={},
        status=0,
        message="DOP853 reached t = 1.",
        statistics=Statistics("DOP853", 10, 0, 0, 2, 0.5),
    )
    assert "onstraint" not in result.summary()
    residual = np.array([[1e-16, 0.0], [0.0, -2e-15]])
    held = dataclasses.replace(result, drift=Drift(("rod", "rod_dot"), residual, 3e-9))
    assert "\nConstraints held to 2e-15, largest correction 3e-09." in held.summary()
    assert list(held.columns()) == ["t", "x"]
