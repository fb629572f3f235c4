"""A model at the parameters and inputs of one run: its rates, events and constraints."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ModelError, SolveError
from cotree.model.model import CompiledModel, EvaluationPoint
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Callable

    from scipy.sparse import csc_matrix

    from cotree.solvers.result import FloatArray

    Kernel = Callable[[float, FloatArray, FloatArray, FloatArray | None], FloatArray]

_NONE = np.zeros(0)

# A contact counts as jammed if friction increases its normal force by more than this factor.
_JAMMED = 100.0

# Minimum weight in a dependent combination of constraints for which a message names an edge.
_INVOLVED = 0.1


class BoundModel:
    """The functions of a model for the parameters p and the inputs u of one run.

    ``u(t)`` returns the inputs, shape (n_inputs,), or None to use the inputs of the model.
    """

    def __init__(
        self, model: CompiledModel, p: FloatArray, u: Callable[[float], FloatArray | None]
    ) -> None:
        self.event_rows = model.layout.events
        self._model, self._p, self._u, self._n = model, p, u, len(model.states)
        self._edges = model.layout.constraint_edges
        self._kernels: dict[str, Kernel] = {}

    def augmented_rates(self, t: float, z: FloatArray) -> FloatArray:
        """Return the rates of states and sensitivities; the next call overwrites the array."""
        return self._call("augmented_rhs", t, z)

    def rates(self, t: float, z: FloatArray) -> FloatArray:
        """Return the rates of the states; the next call overwrites the array."""
        return self._call("rhs", t, z)

    def jacobian(self, t: float, y: FloatArray) -> FloatArray:
        """Return the state Jacobian as a dense matrix."""
        return self._model.structure.full(self._call("jacobian", t, y))

    def sparse_jacobian(self, t: float, y: FloatArray) -> csc_matrix:
        """Return the state Jacobian in SciPy's CSC form."""
        return self._model.jacobian_sparse(t, y, self._p, self._u(t))

    def undefined(self, t: float, y: FloatArray) -> str:
        """Return the reason why the rates are undefined at a point, or an empty string."""
        return self._model.why_undefined(t, y, self._p, self._u(t))

    def constraint_residuals(self, t: float, z: FloatArray) -> FloatArray:
        """Return the residuals of the constraints in a new array, shape (n_constraints,)."""
        return np.array(self._call("constraints", t, z))

    def singular(self, t: float, z: FloatArray) -> tuple[str, ...]:
        """Return the edges whose constraints are dependent, or nearly dependent, at a point."""
        rows, weakest = self._gradients(t, z)
        # Eigenvalues of C C^T are squared singular values of C; eigenvectors combine rows of C.
        squares, directions = np.linalg.eigh(rows @ rows.T)
        weak = directions[:, squares <= weakest**2]
        involved = np.flatnonzero(np.max(np.abs(weak), axis=1, initial=0.0) > _INVOLVED)
        return tuple(dict.fromkeys(self._edges[i] for i in involved))

    def redundant(self, t: float, z: FloatArray) -> int:
        """Count the constraints that follow from the others at a point."""
        if not self._edges:
            return 0
        rows, _ = self._gradients(t, z)
        return len(rows) - int(np.linalg.matrix_rank(rows, tol=RANK))

    def event_values(self, t: float, z: FloatArray) -> FloatArray:
        """Return the values of the event functions in a new array, shape (n_events,)."""
        return self._at(t).event_values(*self._parts(z))

    def jammed(self, t: float, z: FloatArray) -> str:
        """Return a message on the contacts that jam at the end of a failed run, or an empty string.

        Friction increases the normal force without bound if it cancels the inertia at the contact.
        """
        from cotree.model.unknowns import solve_states

        y, s = self._parts(z)
        at, found = self._at(t), []
        for row in self.event_rows:
            # The targets of a friction event are the mode of the friction and the mode of its stop.
            if not row.is_pressed or round(abs(y[row.targets[0]])) != 1:
                continue
            force = next(
                i
                for i, other in enumerate(self.event_rows)
                if other.is_lift and other.targets[0] == row.targets[1]
            )
            other = y.copy()
            other[row.targets[0]] = 2.0
            try:
                other = solve_states(at, other)
            except (ModelError, SolveError):
                continue
            with_friction, without = (at.event_values(point, s)[force] for point in (y, other))
            if with_friction > _JAMMED * without > 0.0:
                found.append(f"'{self.event_rows[force].name.removesuffix(' lifts')}'")
        if not found:
            return ""
        return (
            f"Sliding at {', '.join(found)} jams: with such strong friction the normal force grows "
            "without bound (Painleve's paradox): reduce the friction."
        )

    def _call(self, name: str, t: float, z: FloatArray) -> FloatArray:
        kernel = self._kernels.get(name)
        if kernel is None:
            kernel = self._kernels[name] = self._model.bound(name, self._p)
        return kernel(t, z[: self._n], z[self._n :], self._u(t))

    def _at(self, t: float) -> EvaluationPoint:
        return EvaluationPoint(self._model, t, self._p, self._u(t))

    def _parts(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        return z[: self._n], z[self._n :].reshape(len(self._model.sensitivities), self._n).T

    def _gradients(self, t: float, z: FloatArray) -> tuple[FloatArray, float]:
        """Return the constraint gradients, and the limit for singular values that count as zero."""
        starts = self._model.start_in_c
        assert starts is not None  # this method is only called for compiled models
        return starts.gradients(self._at(t), z[: self._n])
