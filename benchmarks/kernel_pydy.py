"""The chain of rods by PyDy: Kane's equations by SymPy, matrices as C by PyDy, solution in C.

PyDy solves the linear system by LAPACK through NumPy. This script uses a Cholesky factorisation in
C instead, which is faster for these sizes.
"""

from __future__ import annotations

import ctypes
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from timing import Contender, compile_c, loop, within

_SOLVE = """
void peer(double *in, double *out)
{{
    enum {{ N = {n} }};
    double m[N * N];
    int i, j, k;
    evaluate(in, in + N, in + 2 * N, m, out + N);
    for (j = 0; j < N; ++j) {{
        for (k = 0; k < j; ++k) {{
            for (i = j; i < N; ++i) m[i * N + j] -= m[i * N + k] * m[j * N + k];
        }}
        m[j * N + j] = sqrt(m[j * N + j]);
        for (i = j + 1; i < N; ++i) m[i * N + j] /= m[j * N + j];
    }}
    for (i = 0; i < N; ++i) {{
        out[i] = in[N + i];
        for (k = 0; k < i; ++k) out[N + i] -= m[i * N + k] * out[N + k];
        out[N + i] /= m[i * N + i];
    }}
    for (i = N - 1; i >= 0; --i) {{
        for (k = i + 1; k < N; ++k) out[N + i] -= m[k * N + i] * out[N + k];
        out[N + i] /= m[i * N + i];
    }}
}}
"""


def kanes_matrices(n: int, names: tuple[str, ...]) -> tuple[list[Any], list[Any]]:
    """Return mass matrix and forcing of a chain of n rods, and the symbols in them."""
    import sympy
    from sympy.physics import mechanics

    q, u = mechanics.dynamicsymbols(f"q:{n}"), mechanics.dynamicsymbols(f"u:{n}")
    p = {name: sympy.Symbol(name) for name in names}
    ground, origin = mechanics.ReferenceFrame("N"), mechanics.Point("O")
    origin.set_vel(ground, 0)
    frame, pin, bodies, loads = ground, origin, [], []
    for i in range(n):
        turned = frame.orientnew(f"A{i}", "Axis", [q[i], ground.z])
        turned.set_ang_vel(frame, u[i] * ground.z)
        mass, length = p[f"m{i}"], p[f"L{i}"]
        middle = pin.locatenew(f"C{i}", length / 2 * turned.x)
        middle.v2pt_theory(pin, ground, turned)
        end = pin.locatenew(f"P{i}", length * turned.x)
        end.v2pt_theory(pin, ground, turned)
        inertia = mechanics.inertia(turned, 0, 0, mass * length**2 / 12)
        bodies.append(mechanics.RigidBody(f"B{i}", middle, turned, mass, (inertia, middle)))
        loads.append((middle, -mass * p["g"] * ground.y))
        frame, pin = turned, end
    time_rates = [rate - angle.diff() for angle, rate in zip(q, u, strict=True)]
    kane = mechanics.KanesMethod(ground, q, u, time_rates)
    kane.kanes_equations(bodies, loads)
    return [q, u, list(p.values())], [kane.mass_matrix, kane.forcing]


def _write(n: int, names: tuple[str, ...], folder: Path) -> None:
    from pydy.codegen.c_code import CMatrixGenerator

    arguments, matrices = kanes_matrices(n, names)
    writer = CMatrixGenerator(arguments, matrices)
    (folder / "count").write_text(str(sum(value.count_ops() for _, value in writer.subexprs)))
    (folder / "part").write_text(writer.doprint()[1] + _SOLVE.format(n=n))
    (folder / "part").rename(folder / "text")


def pydy(model: Any, kernel: str, x: Any, s: Any, limit: float = 100.0) -> Contender:
    """Generate the rates of a chain of rods by PyDy, in a process that can be terminated."""
    import pydy  # noqa: F401 - missing, it is left out

    folder, began = Path(tempfile.mkdtemp(prefix="peer")), time.perf_counter()
    n, names = len(model.states) // 2, tuple(model.parameters)
    within(limit, _write, (n, names, folder))
    took = time.perf_counter() - began
    found = Contender(None, None, took, 0.0, f"stopped after {limit:.0f} s")
    if not (folder / "text").exists():
        return found
    text = (folder / "text").read_text()
    found.c_bytes = len(text)
    best = [("gcc", "-O3", "-march=native", "-fno-math-errno")]
    path, found.compilation, found.note = compile_c(text, best, limit)
    if path is None:
        return found
    library = ctypes.CDLL(str(path))
    address = ctypes.cast(library.peer, ctypes.c_void_p).value or 0
    out = np.zeros(2 * n)
    found.call = loop("plain", address, np.concatenate([x, model.default_parameters]), [out])
    found.call.keeps += (library,)  # type: ignore[attr-defined]
    found.value = lambda: out
    return found
