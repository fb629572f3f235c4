"""A model as functions of one run's parameters and inputs: what Python asks of it during the run.

In: a model, parameters, inputs. Out: functions of time and states. Runs in C ask little: each
function is bound at its first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.model.consistent import consistent_start
from cotree.model.model import Moment

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from scipy.sparse import csc_matrix

    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray

    Bound = Callable[[float, FloatArray, FloatArray, FloatArray | None], FloatArray]

_NONE = np.zeros(0)


class Functions:
    """The functions of one run.

    Parameters
    ----------
    model : CompiledModel
        The model.
    p : ndarray, shape (n_parameters,)
        Parameters.
    u : callable
        ``u(t)`` gives the inputs, shape (n_inputs,), or None for the model's own.
    """

    def __init__(
        self, model: CompiledModel, p: FloatArray, u: Callable[[float], FloatArray | None]
    ) -> None:
        self._model, self._p, self._u, self._n = model, p, u, len(model.states)
        self._bound: dict[str, Bound] = {}

    def augmented_rates(self, t: float, z: FloatArray) -> FloatArray:
        """Return the rates of states and sensitivities, a buffer of the kernel."""
        return self._kernel("augmented_rhs")(t, z[: self._n], z[self._n :], self._u(t))

    def rates(self, t: float, z: FloatArray) -> FloatArray:
        """Return the rates of the states alone, a buffer of the kernel."""
        return self._kernel("rhs")(t, z[: self._n], z[self._n :], self._u(t))

    def jacobian(self, t: float, y: FloatArray) -> FloatArray:
        """Return the derivatives of the states' rates, dense."""
        return self._model.structure.full(self._kernel("jacobian")(t, y, _NONE, self._u(t)))

    def sparse_jacobian(self, t: float, y: FloatArray) -> csc_matrix:
        """Return the same in SciPy's CSC form."""
        return self._model.jacobian_sparse(t, y, self._p, self._u(t))

    def undefined(self, t: float, y: FloatArray) -> str:
        """Describe why the states' rates have no value at a point; empty where they have one."""
        return self._model.why_undefined(t, y, self._p, self._u(t))

    def settle(self, t: float, y: FloatArray, kept: Sequence[int]) -> FloatArray:
        """Move states set by an event onto the constraints."""
        # Only states are wanted: C goes on from them with the sensitivities.
        none, at = (
            np.zeros((self._n, len(self._model.sensitivities))),
            Moment(self._model, t, self._p),
        )
        return consistent_start(at, y, none, kept, is_initial=False, is_probe=True).y

    def _kernel(self, name: str) -> Bound:
        found = self._bound.get(name)
        if found is None:
            found = self._bound[name] = self._model.bound(name, self._p)
        return found
