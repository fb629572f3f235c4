"""The two shipped scenes written by hand in SymPy: the paper's Eq. (8), and Fig. 1 with its force.

They are the independent route: nothing here comes from a graph.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy


@dataclass(frozen=True)
class HandWritten:
    """Residuals R(t, q, v, a, p) = 0, linear in the accelerations a."""

    q: tuple[Any, ...]
    v: tuple[Any, ...]
    a: tuple[Any, ...]
    p: tuple[Any, ...]
    residuals: tuple[Any, ...]

    def functions(self):
        """Return accelerations and their derivatives by q, v and p as functions of (t, y, p)."""
        arguments = [T, *self.q, *self.v, *self.p]
        residual = sympy.Matrix(self.residuals)
        matrix = residual.jacobian(self.a)
        still = residual.subs(dict.fromkeys(self.a, 0))
        by = residual.jacobian([*self.q, *self.v, *self.p])
        first = sympy.lambdify(arguments, [matrix, still], "numpy")
        second = sympy.lambdify([*arguments, *self.a], by, "numpy")

        def rates(t, y, p):
            m, rest = first(t, *y, *p)
            return np.linalg.solve(m, -rest).ravel()

        def derivatives(t, y, p):
            """Return d a / d (q, v, p), shape (n, 2 n + n_parameters)."""
            m, _ = first(t, *y, *p)
            return np.linalg.solve(m, -np.array(second(t, *y, *p, *rates(t, y, p)), dtype=float))

        return rates, derivatives


T = sympy.Symbol("t", real=True)


def _slider_pendulum() -> HandWritten:
    s, theta, vs, w, a_s, a_theta = sympy.symbols("s theta vs w a_s a_theta", real=True)
    p = m1, m2, L, r, zeta, k, s0, g = sympy.symbols("m1 m2 L r zeta k s0 g", positive=True)
    sin, cos, half = sympy.sin(theta), sympy.cos(theta), L / 2
    first = (
        m2 * (r**2 / 4 + L**2 / 3) * a_theta
        + m2 * half * cos * a_s
        + m2 * g * half * sin
        + zeta * w
    )
    second = m2 * half * cos * a_theta + (m1 + m2) * a_s - m2 * half * sin * w**2 + k * (s - s0)
    return HandWritten((s, theta), (vs, w), (a_s, a_theta), p, (first, second))


def _spring_mass_damper() -> HandWritten:
    x, v, a = sympy.symbols("x v a", real=True)
    p = m, k, c, l0, F0, w, _, _ = sympy.symbols("m k c l0 F0 w x0 v0", positive=True)
    return HandWritten((x,), (v,), (a,), p, (m * a + c * v + k * (x - l0) - F0 * sympy.sin(w * T),))


HAND_WRITTEN = {
    "slider-pendulum": _slider_pendulum(),
    "spring-mass-damper": _spring_mass_damper(),
}
