"""The constraints of a motion: their residuals, and positions at which they are dependent.

In: a compiled model whose layout names constraints. Out: ``HeldConstraints``, which choose methods
and judge results. C projects on the constraints during a run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.model.model import EvaluationPoint
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.model.model import CompiledModel
    from cotree.solvers.result import FloatArray


# Edges with more than this share of a dependent combination of constraints are named.
_INVOLVED = 0.1


class HeldConstraints:
    """Residuals and gradients of a model's constraints.

    Parameters
    ----------
    model : CompiledModel
        A model with constraints.
    p : ndarray, shape (n_parameters,)
        Its parameters.
    u : callable
        ``u(t)`` returns the inputs, shape (n_inputs,), or None for the model's own.
    """

    def __init__(
        self, model: CompiledModel, p: FloatArray, u: Callable[[float], FloatArray | None]
    ) -> None:
        self.names = tuple(row.name for row in model.layout.constraints)
        self._model, self._p, self._u = model, p, u
        self._edges = model.layout.constraint_edges
        self._residual = model.bound("constraints", p)

    def _gradients(self, t: float, z: FloatArray) -> tuple[FloatArray, float]:
        """Return gradients, and the singular value below which they are nearly dependent."""
        starts, n = self._model.start_in_c, len(self._model.states)
        assert starts is not None  # there is a compiler
        return starts.gradients(EvaluationPoint(self._model, t, self._p, self._u(t)), z[:n])

    @property
    def has_rows(self) -> bool:
        """Whether there are constraints, and not only norms of quaternions."""
        return bool(self._edges)

    def singular(self, t: float, z: FloatArray) -> tuple[str, ...]:
        """Name the edges whose constraints are dependent, or nearly so, at a point."""
        rows, weakest = self._gradients(t, z)
        # Eigenvalues of C C^T are squared singular values of C; eigenvectors combine constraints.
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

    def residual(self, t: float, z: FloatArray) -> FloatArray:
        """Return the residuals of the constraints, a fresh array of the shape of ``names``."""
        n = len(self._model.states)
        return np.array(self._residual(t, z[:n], z[n:], self._u(t)))
