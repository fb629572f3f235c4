"""The constraints that hold a motion: their residuals, and where they depend on each other.

In: a compiled model whose layout names constraints. Out: ``HeldConstraints``, which choose methods
and judge results. C projects on the constraints during a run.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.model.finder import gradient_groups, scene_length, turned, turning_speeds
from cotree.tolerances import RANK

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.model.model import CompiledModel
    from cotree.solvers.result import FloatArray


# Gradients below this share of the largest, or of 1, are rounding.
_ROUNDING_ROW = 1e-12

# Constraints whose gradients shrink along some direction below this share of what they are along
# their weakest one in a few other positions, or below the second number, are nearly dependent. Many
# loops side by side have weak directions everywhere.
_NEAR, _LEAST, _POSITIONS = 0.1, 1e-6, 3

# Edges with more than this share in a direction that the constraints no longer see are named.
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
        ``u(t)`` gives the inputs, shape (n_inputs,), or None for the model's own.
    """

    def __init__(
        self, model: CompiledModel, p: FloatArray, u: Callable[[float], FloatArray | None]
    ) -> None:
        self.names = tuple(row.name for row in model.layout.constraints)
        self._n_states = len(model.states)
        self._u = u
        self._edges = model.layout.constraint_edges
        self._layout, self._reach, self._gap = model.layout, 0.0, 0.0
        self._gradient = model.bound("gradient", p) if self._edges else None
        self._residual = model.bound("constraints", p)

    def _rows(self, t: float, z: FloatArray) -> FloatArray:
        """Return the gradients of the constraints by velocities, the longest of each edge as one.

        They are those of a scene of any size, so that what is decided by them is, too. A joint one
        of whose gradients is short, since links are in one line, is about to lose it.
        """
        rows = self._gradients(t, z)
        seen = np.linalg.norm(rows, axis=1) > _ROUNDING_ROW * np.max(np.abs(rows), initial=1.0)
        rows[~seen] = 0.0
        # A derivative by an angle becomes one by the distance that the angle moves.
        rows[:, self._turns] /= self._length(t, z)
        groups, sizes = gradient_groups(self._layout), np.linalg.norm(rows, axis=1)
        longest: dict[tuple[str, str], float] = {}
        for group, size in zip(groups, sizes.tolist(), strict=True):
            longest[group] = max(size, longest.get(group, 0.0))
        rows /= np.array([longest[group] or 1.0 for group in groups])[:, None]
        return rows

    def _weakest(self, t: float, z: FloatArray) -> float:
        """Return the singular value of the gradients below which a direction is nearly lost."""
        if not self._gap:
            n = self._n_states
            others = [turned(self._layout, z[:n], i) for i in range(_POSITIONS)]
            # The norm of order -2 is the smallest singular value.
            gaps = [np.linalg.norm(self._rows(t, np.concatenate([y, z[n:]])), -2) for y in others]
            self._gap = max(_NEAR * float(max(gaps)), _LEAST)
        return self._gap

    def _gradients(self, t: float, z: FloatArray) -> FloatArray:
        """Return the gradients of the constraints by the speeds, shape (n_rows, n_speeds)."""
        assert self._gradient is not None
        x, s = z[: self._n_states], z[self._n_states :]
        return np.array(self._gradient(t, x, s, self._u(t))).reshape(len(self._edges), -1)

    def _length(self, t: float, z: FloatArray) -> float:
        """Return the length by which a turn counts as a shift, [m], found at the first call."""
        if not self._reach:
            n, groups = self._n_states, gradient_groups(self._layout)

            def gradients(y: FloatArray) -> FloatArray:
                return self._gradients(t, np.concatenate([y, z[n:]]))

            self._reach = scene_length(self._layout, gradients, groups, z[:n])
        return self._reach

    @property
    def _turns(self) -> npt.NDArray[np.bool_]:
        return turning_speeds(self._layout)

    @property
    def has_rows(self) -> bool:
        """Whether there are constraints, and not only norms of quaternions."""
        return bool(self._edges)

    def singular(self, t: float, z: FloatArray) -> tuple[str, ...]:
        """Name the edges whose constraints are dependent, or nearly so, at a point."""
        rows = self._rows(t, z)
        # Eigenvalues of C C^T are squared singular values of C; eigenvectors combine constraints.
        squares, directions = np.linalg.eigh(rows @ rows.T)
        weak = directions[:, squares <= self._weakest(t, z) ** 2]
        involved = np.flatnonzero(np.max(np.abs(weak), axis=1, initial=0.0) > _INVOLVED)
        return tuple(dict.fromkeys(self._edges[i] for i in involved))

    def redundant(self, t: float, z: FloatArray) -> int:
        """Count the constraints that follow from the others at a point."""
        if not self._edges:
            return 0
        rows = self._rows(t, z)
        return len(rows) - int(np.linalg.matrix_rank(rows, tol=RANK))

    def residual(self, t: float, z: FloatArray) -> FloatArray:
        """Return the residuals of the constraints, a fresh array of the shape of ``names``."""
        x, s = z[: self._n_states], z[self._n_states :]
        return np.array(self._residual(t, x, s, self._u(t)))
