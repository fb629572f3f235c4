"""Hand-written initial value problems with closed forms, for the tests of the solvers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.scene.settings import Settings
from cotree.solvers.problem import RunProblem

if TYPE_CHECKING:
    from cotree.solvers.result import FloatArray

STIFFNESS, DAMPING = 40.0, 1.0
X0, V0 = 0.3, -1.0


#: Fields of a problem that are settings of a run.
OF_SETTINGS = {"t_span", "t_eval", "rtol", "atol", "error_test_sensitivities"}
OF_SETTINGS |= {"max_steps", "max_events", "time_limit"}


def problem_of(fields: dict[str, Any]) -> RunProblem:
    """Build a problem of its fields and settings."""
    settings = Settings(**{name: fields[name] for name in fields if name in OF_SETTINGS})
    return RunProblem(
        settings=settings, **{name: fields[name] for name in fields if name not in OF_SETTINGS}
    )


def oscillator_rhs(t: float, z: FloatArray) -> FloatArray:
    """x'' = -k x - c x', with the sensitivities to k and c."""
    x, v = z[:2]
    jacobian = np.array([[0.0, 1.0], [-STIFFNESS, -DAMPING]])
    by_k = jacobian @ z[2:4] + [0.0, -x]
    by_c = jacobian @ z[4:6] + [0.0, -v]
    return np.concatenate([jacobian @ z[:2], by_k, by_c])


def oscillator_jacobian(t: float, y: FloatArray) -> FloatArray:
    return np.array([[0.0, 1.0], [-STIFFNESS, -DAMPING]])


def oscillator(t_eval: FloatArray | None = None, **changes: object) -> RunProblem:
    fields: dict[str, object] = {
        "rhs": oscillator_rhs,
        "jacobian": oscillator_jacobian,
        "n_states": 2,
        "n_sensitivities": 2,
        "z0": np.array([X0, V0, 0.0, 0.0, 0.0, 0.0]),
        "t_span": (0.0, 5.0),
        "t_eval": t_eval,
        "names": ("x", "v"),
    }
    return problem_of(fields | changes)


def _motion(t: FloatArray, k: complex, c: complex) -> np.ndarray:
    decay = c / 2
    omega = np.sqrt(k - decay**2)
    cosine, sine = np.cos(omega * t), np.sin(omega * t)
    amplitude = (V0 + decay * X0) / omega
    x = X0 * cosine + amplitude * sine
    v = -X0 * omega * sine + amplitude * omega * cosine - decay * x
    return np.exp(-decay * t) * np.array([x, v])


def oscillator_exact(t: FloatArray) -> FloatArray:
    """The closed form; its derivatives by complex step are exact to rounding."""
    step = 1e-30
    state = _motion(t, STIFFNESS, DAMPING).real
    by_k = _motion(t, STIFFNESS + 1j * step, DAMPING).imag / step
    by_c = _motion(t, STIFFNESS, DAMPING + 1j * step).imag / step
    return np.concatenate([state, by_k, by_c])


def scalar(f, jacobian=None, z0=1.0, **changes: object) -> RunProblem:
    """One state 'x' with x' = f(t, x)."""
    fields: dict[str, object] = {
        "rhs": lambda t, z: np.array([f(t, z[0])]),
        "jacobian": None if jacobian is None else lambda t, y: np.array([[jacobian(t, y[0])]]),
        "n_states": 1,
        "n_sensitivities": 0,
        "z0": np.array([z0]),
        "t_span": (0.0, 2.0),
        "rtol": 1e-6,
        "atol": 1e-8,
        "names": ("x",),
    }
    return problem_of(fields | changes)


def robertson_rhs(t: float, z: FloatArray) -> FloatArray:
    """Robertson's three reactions with the sensitivities to k1."""
    a, b, c = z[:3]
    slow, fast = 0.04 * a - 1e4 * b * c, 3e7 * b * b
    by_k1 = robertson_jacobian(t, z[:3]) @ z[3:] + [-a, a, 0.0]
    return np.concatenate([[-slow, slow - fast, fast], by_k1])


def robertson_jacobian(t: float, y: FloatArray) -> FloatArray:
    _, b, c = y
    first = np.array([-0.04, 1e4 * c, 1e4 * b])
    last = np.array([0.0, 6e7 * b, 0.0])
    return np.array([first, -first - last, last])


def robertson(t_end: float, **changes: object) -> RunProblem:
    fields: dict[str, object] = {
        "rhs": robertson_rhs,
        "jacobian": robertson_jacobian,
        "n_states": 3,
        "n_sensitivities": 1,
        "z0": np.array([1.0, 0.0, 0.0, 0.0, 0.0, 0.0]),
        "t_span": (0.0, t_end),
        "t_eval": np.array([t_end]),
        "rtol": 1e-6,
        "atol": 1e-13,
        "names": ("A", "B", "C"),
    }
    return problem_of(fields | changes)


def shared_buffer(problem: RunProblem):
    """The problem's right-hand side as a compiled model offers it: one buffer for all calls."""
    buffer = np.empty(problem.size)

    def rhs(t: float, z: FloatArray) -> FloatArray:
        assert z.flags.c_contiguous
        assert z.dtype == np.float64
        buffer[:] = problem.rhs(t, z)
        return buffer

    return rhs
