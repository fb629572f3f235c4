"""Evaluation of a kernel at many points, one per column, in one C call."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error, ParameterError
from cotree.model.arrays import Array, as_array, is_many
from cotree.model.kernels import Rows, call_columns, load_columns
from cotree.program.kernels import KERNELS
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from cotree.model.model import CompiledModel


def in_columns(
    model: CompiledModel, name: str, t: Any, y: Any, p: Any, u: Any, s: Any = None
) -> Array:
    """Evaluate a kernel at m points; the result has shape (n_results, m).

    Shapes: t () or (m,), y (n_states, m), s (n_states, n_sensitivities, m); p and u may have m
    columns. Raise ParameterError if a shape is wrong or a guard rejects a parameter. Errors at a
    point name its column.
    """
    points = _Points(model, t, y, p, u, s)
    library = load_columns() if model.backend == "C" else None
    results = np.zeros((points.n, model.traits.n_results.get(name, 0)))
    done = 0
    if library is not None and points.n and model.address(name) is not None:
        inputs = np.zeros((points.n, len(model.inputs))) if points.u is None else points.u
        done = call_columns(
            library, model, name, points.rows(name), inputs, results, has_inputs=u is not None
        )
    if KERNELS[name].is_packed:
        whole = np.zeros((points.n, points.s.shape[1]))
        whole[:, points.places] = results
        results = whole
    # Without a compiler, or after a failure in C, Python evaluates the remaining points.
    for j in range(done, points.n):
        results[j] = _at(model, name, points, j)
    return results.T.copy()


class _Points:
    """Arguments of a kernel in the C layout: one row for each point."""

    def __init__(self, model: CompiledModel, t: Any, y: Any, p: Any, u: Any, s: Any) -> None:
        n, n_s, self.n = len(model.states), len(model.sensitivities), np.shape(y)[1]
        self.places = np.array(model.layout.sensitivity_places, dtype=np.intp)
        self.u: Array | None = None
        self.s = np.zeros((self.n, 0))
        self.x = _rows(y, (n,), self.n, "the states")
        self.t = (
            np.full(self.n, check_number(t, "t"))
            if np.ndim(t) == 0
            else _rows(t, (), self.n, "the times")
        )
        for j in np.flatnonzero(~np.isfinite(self.t))[:1].tolist():
            raise ParameterError(f"column {j}: t is {self.t[j]}: give a finite number")
        # Parameters have one row per point, or one row for all points.
        self.has_own = is_many(p)
        if self.has_own:
            self.p = _rows(p, (len(model.parameters),), self.n, "the parameters")
            for j in np.flatnonzero(~np.isfinite(self.p).all(axis=1))[:1].tolist():
                _at(model, "rhs", self, j)  # C returns nan here; Python raises the error
        else:
            self.p = model.parameter_array(p)[None, :]
            model.set_parameters(self.p[0])
        if u is not None and is_many(u):
            self.u = _rows(u, (len(model.inputs),), self.n, "inputs")
        elif u is not None:
            self.u = np.tile(as_array(u, (len(model.inputs),), "inputs"), (self.n, 1))
        # In C, the sensitivities to one parameter are consecutive.
        if s is not None:
            whole = as_array(s, (n, n_s, self.n), "the sensitivities")
            self.s = np.ascontiguousarray(whole.transpose(2, 1, 0)).reshape(self.n, n * n_s)

    def rows(self, name: str) -> Rows:
        """Return the arguments of a kernel."""
        s = np.ascontiguousarray(self.s[:, self.places]) if KERNELS[name].is_packed else self.s
        return Rows(self.t, self.x, s, self.p, self.has_own)


def _rows(values: Any, shape: tuple[int, ...], n: int, what: str) -> Array:
    """Return a checked array with one row per point, from one with one column per point."""
    return np.ascontiguousarray(as_array(values, (*shape, n), what).T)


def _at(model: CompiledModel, name: str, points: _Points, j: int) -> Array:
    try:
        p = points.p[j if points.has_own else 0]
        u = None if points.u is None else points.u[j]
        return model.bound(name, p)(float(points.t[j]), points.x[j], points.s[j], u)
    except Error as error:
        raise type(error)(f"column {j}: {error}") from None
