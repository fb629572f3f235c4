"""A pendulum in Cartesian coordinates, as a compiled model offers it, and its closed form."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ellipj, ellipk

from cotree.equations import Quantity
from cotree.solvers.problem import Problem
from cotree.solvers.project import Projection

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray

GRAVITY, LENGTH, AMPLITUDE = 9.81, 1.3, 1.0
P = np.array([GRAVITY, LENGTH])
PERIOD = 4 * float(ellipk(math.sin(AMPLITUDE / 2) ** 2)) * math.sqrt(LENGTH / GRAVITY)


class CartesianPendulum:
    """Kernels written by hand; like compiled ones they return the same buffer at every call."""

    states = ("x", "y", "x_dot", "y_dot")
    layout = SimpleNamespace(
        constraint_edges=(),
        constraints=(Quantity("rod", "m^2"), Quantity("rod_dot", "m^2/s")),
    )

    def __init__(self, sensitivities: tuple[str, ...] = ()) -> None:
        self.sensitivities = sensitivities
        self.calls: dict[str, int] = {}

    def bound(self, name: str, p: FloatArray):
        kernel = getattr(self, name)
        buffer: list[FloatArray] = []

        def call(t: float, x: FloatArray, s: FloatArray, u: FloatArray | None) -> FloatArray:
            self.calls[name] = self.calls.get(name, 0) + 1
            result = kernel(x.tolist(), s.reshape(-1, 4).tolist(), *p.tolist())
            buffer[:] = buffer or [np.empty(len(result))]
            buffer[0][:] = result
            return buffer[0]

        return call

    def constraints(self, state, s, g, length):
        x, y, vx, vy = state
        return [(x * x + y * y - length * length) / 2, x * vx + y * vy]

    def projection(self, state, s, g, length):
        x, y, _, _ = state
        square = x * x + y * y
        position, speed = (-c / square for c in self.constraints(state, s, g, length))
        return [x * position, y * position, x * speed, y * speed]

    def sensitivity_projection(self, state, s, g, length):
        x, y, vx, vy = state
        square = x * x + y * y
        result = []
        for name, (sx, sy, sa, sb) in zip(self.sensitivities, s, strict=True):
            position = -(x * sx + y * sy - length * (name == "L")) / square
            speed = -(sx * vx + sy * vy + x * sa + y * sb) / square
            result += [x * position, y * position, x * speed, y * speed]
        return result

    def augmented_rhs(self, state, s, g, length):
        """Equations of index 1: the rod's force keeps the acceleration on the constraint."""
        x, y, vx, vy = state
        square = x * x + y * y
        pull = (vx * vx + vy * vy - g * y) / square
        result = [vx, vy, -pull * x, -g - pull * y]
        for name, (sx, sy, sa, sb) in zip(self.sensitivities, s, strict=True):
            by_g = float(name == "g")
            pull_dot = 2 * (vx * sa + vy * sb - pull * (x * sx + y * sy)) - g * sy - by_g * y
            pull_dot /= square
            result += [sa, sb, -pull_dot * x - pull * sx, -by_g - pull_dot * y - pull * sy]
        return result

    def jacobian(self, t: float, y: FloatArray) -> FloatArray:
        x, y, vx, vy = y.tolist()
        square = x * x + y * y
        pull = (vx * vx + vy * vy - GRAVITY * y) / square
        by = np.array([-2 * x * pull, -GRAVITY - 2 * y * pull, 2 * vx, 2 * vy]) / square
        matrix = np.zeros((4, 4))
        matrix[0, 2] = matrix[1, 3] = 1.0
        matrix[2], matrix[3] = -x * by, -y * by
        matrix[2, 0] -= pull
        matrix[3, 1] -= pull
        return matrix


def pendulum(
    t_eval: FloatArray | None = None,
    sensitivities: tuple[str, ...] = (),
    is_projected: bool = True,
    **changes: object,
) -> Problem:
    """Release the pendulum at rest."""
    model = CartesianPendulum(sensitivities)
    projection = Projection(model, P, lambda t: None)  # type: ignore[arg-type]
    rhs = model.bound("augmented_rhs", P)
    fields: dict[str, object] = {
        "rhs": lambda t, z: rhs(t, z[:4], z[4:], None),
        "jacobian": model.jacobian,
        "n_states": 4,
        "n_sensitivities": len(sensitivities),
        "z0": pendulum_exact(np.zeros(1), sensitivities)[:, 0],
        "t_span": (0.0, PERIOD if t_eval is None else float(t_eval[-1])),
        "t_eval": t_eval,
        "names": model.states,
        "parameters": sensitivities,
    }
    if is_projected:
        fields |= {
            "project": projection,
            "residual": projection.residual,
            "constraints": projection.names,
        }
    return Problem(**(fields | changes))  # type: ignore[arg-type]


def pendulum_exact(t: FloatArray, sensitivities: tuple[str, ...] = ()) -> FloatArray:
    """The closed form: the angle depends on time only through ``sqrt(g / L) t``."""
    k = math.sin(AMPLITUDE / 2)
    omega = math.sqrt(GRAVITY / LENGTH)
    sn, cn, dn, _ = ellipj(np.remainder(t, PERIOD) * omega, k * k)
    angle = 2 * np.arcsin(k * cn / dn)
    rate = -2 * k * omega * (1 - k * k) * sn / (dn * dn) / np.cos(angle / 2)
    bend = -omega * omega * np.sin(angle)
    unit, across = (
        np.array([np.sin(angle), -np.cos(angle)]),
        np.array([np.cos(angle), np.sin(angle)]),
    )
    state = [LENGTH * unit, LENGTH * rate * across]
    for name in sensitivities:
        # d(omega) / omega is dg / 2g - dL / 2L; the angle takes t times it along its rate.
        stretch = 0.5 / GRAVITY if name == "g" else -0.5 / LENGTH
        angle_s, rate_s = stretch * t * rate, stretch * (rate + t * bend)
        grows = float(name == "L")
        state += [
            grows * unit + LENGTH * angle_s * across,
            grows * rate * across + LENGTH * (rate_s * across - rate * angle_s * unit),
        ]
    return np.concatenate(state)
