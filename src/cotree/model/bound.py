"""A model at the parameters and inputs of one run, or at one point."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ModelError, SolveError
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Callable

    from scipy.sparse import csc_matrix

    from cotree.equations import EventRow
    from cotree.model.arrays import Array
    from cotree.model.model import CompiledModel

    Kernel = Callable[[float, Array, Array, Array | None], Array]

# A contact counts as jammed if friction increases its normal force by more than this factor.
_JAMMED = 100.0

# Minimum weight in a dependent combination of constraints for which a message names an edge.
_INVOLVED = 0.1


@dataclass(frozen=True, eq=False)
class BoundModel:
    """A model with the time, parameters and inputs at which it is evaluated.

    A run has inputs at all times; its methods take a time, and ``t`` is its start.
    """

    model: CompiledModel
    t: float  # time of the evaluation, [s]
    p: Array  # parameter values, which are never changed in place
    #: Input values, or a function of time that returns them; None for the scene's inputs.
    given: Array | Callable[[float], Array | None] | None = None
    _kernels: dict[str, Kernel] = field(default_factory=dict, init=False, repr=False)

    def __reduce__(self) -> tuple[Any, ...]:
        # Kernels are pointers, which are not valid in another process.
        return BoundModel, (self.model, self.t, self.p, self.given)

    @cached_property
    def inputs_at(self) -> Callable[[float], Array | None]:
        """The inputs as a function of time that returns None for the scene's inputs."""
        given = self.given
        return given if callable(given) else lambda t: given

    @cached_property
    def u(self) -> Array | None:
        """The input values at time t; None for the scene's inputs."""
        return self.inputs_at(self.t)

    @property
    def inputs(self) -> Array:
        """The given inputs, or those of the scene, shape (n_inputs,)."""
        return self.model.input_values(self.t, self.p) if self.u is None else self.u

    @property
    def k(self) -> Array:
        """The values that the kernel ``prepare`` computes from the parameters, in a new array."""
        return self.model.prepared(self.p)

    @property
    def event_rows(self) -> tuple[EventRow, ...]:
        """The events of the model."""
        return self.model.layout.events

    def call(self, kernel: str, y: Array, s: Array | None = None) -> Array:
        """Evaluate a kernel; in its result, sensitivities to each parameter are consecutive."""
        along = np.zeros(0) if s is None else np.ascontiguousarray(s.T).ravel()
        return self._kernel(kernel)(self.t, y, along, self.u).copy()

    def event_values(self, y: Array, s: Array | None = None) -> Array:
        """Evaluate the event functions, without switching functions of laws, shape (n_events,)."""
        return self.call("events", y, s)[: len(self.event_rows)]

    def augmented_rates(self, t: float, z: Array) -> Array:
        """Return the rates of states and sensitivities; the next call overwrites the array."""
        return self._call("augmented_rhs", t, z)

    def rates(self, t: float, z: Array) -> Array:
        """Return the rates of the states; the next call overwrites the array."""
        return self._call("rhs", t, z)

    def jacobian(self, t: float, y: Array) -> Array:
        """Return the state Jacobian as a dense matrix."""
        return self.model.structure.full(self._call("jacobian", t, y))

    def sparse_jacobian(self, t: float, y: Array) -> csc_matrix:
        """Return the state Jacobian in SciPy's CSC form."""
        return self.model.jacobian_sparse(t, y, self.p, self.inputs_at(t))

    def undefined(self, t: float, y: Array) -> str:
        """Return the reason why the rates are undefined at a point, or an empty string."""
        return self.model.why_undefined(t, y, self.p, self.inputs_at(t))

    def constraint_residuals(self, t: float, z: Array) -> Array:
        """Return the residuals of the constraints in a new array, shape (n_constraints,)."""
        return np.array(self._call("constraints", t, z))

    def singular(self, t: float, z: Array) -> tuple[str, ...]:
        """Return the edges whose constraints are dependent, or nearly dependent, at a point."""
        rows, weakest = self._gradients(t, z)
        # Eigenvalues of C C^T are squared singular values of C; eigenvectors combine rows of C.
        squares, directions = np.linalg.eigh(rows @ rows.T)
        weak = directions[:, squares <= weakest**2]
        involved = np.flatnonzero(np.max(np.abs(weak), axis=1, initial=0.0) > _INVOLVED)
        return tuple(dict.fromkeys(self.model.layout.constraint_edges[i] for i in involved))

    def redundant(self, t: float, z: Array) -> int:
        """Count the constraints that follow from the others at a point."""
        if not self.model.layout.constraint_edges:
            return 0
        rows, _ = self._gradients(t, z)
        return len(rows) - int(np.linalg.matrix_rank(rows, tol=RANK))

    def parts(self, z: Array) -> tuple[Array, Array]:
        """Return the states and sensitivities of a vector of both."""
        n, m = len(self.model.states), len(self.model.sensitivities)
        return z[:n], z[n:].reshape(m, n).T

    def jammed(self, z: Array) -> str:
        """Return a message on the contacts that jam at the end of a failed run, or an empty string.

        Friction increases the normal force without bound if it cancels the inertia at the contact.
        """
        from cotree.model.unknowns import solve_states

        (y, s), found = self.parts(z), []
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
                other = solve_states(self, other)
            except (ModelError, SolveError):
                continue
            with_friction, without = (self.event_values(point, s)[force] for point in (y, other))
            if with_friction > _JAMMED * without > 0.0:
                found.append(f"'{self.event_rows[force].name.removesuffix(' lifts')}'")
        if not found:
            return ""
        return (
            f"Sliding at {', '.join(found)} jams: with such strong friction the normal force grows "
            "without bound (Painleve's paradox): reduce the friction."
        )

    def _kernel(self, name: str) -> Kernel:
        kernel = self._kernels.get(name)
        if kernel is None:
            kernel = self._kernels[name] = self.model.bound(name, self.p)
        return kernel

    def _call(self, name: str, t: float, z: Array) -> Array:
        n = len(self.model.states)
        return self._kernel(name)(t, z[:n], z[n:], self.inputs_at(t))

    def _gradients(self, t: float, z: Array) -> tuple[Array, float]:
        """Return the constraint gradients, and the limit for singular values that count as zero."""
        starts = self.model.start_in_c
        assert starts is not None  # this method is only called for compiled models
        return starts.gradients(replace(self, t=t), z[: len(self.model.states)])
