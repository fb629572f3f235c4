"""A model at one time, at which values that satisfy its equations are sought."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from cotree.model.arrays import Array
    from cotree.model.model import CompiledModel


@dataclass(frozen=True, eq=False)
class Moment:
    """A model at one time, with its parameters and inputs.

    Attributes
    ----------
    model : CompiledModel
        The model.
    t : float
        Time, [s].
    p : ndarray, shape (n_parameters,)
        Parameters.
    u : ndarray, shape (n_inputs,), or None
        Inputs in place of the scene's.
    """

    model: CompiledModel
    t: float
    p: Array
    u: Array | None = None

    @property
    def inputs(self) -> Array:
        """The inputs, those of the scene where no others are given, shape (n_inputs,)."""
        return self.model.input_values(self.t, self.p) if self.u is None else self.u

    def call(self, kernel: str, y: Array, s: Array | None = None) -> Array:
        """Evaluate a kernel.

        Parameters
        ----------
        kernel : str
            A name in ``KERNELS``.
        y : ndarray, shape (n_states,)
            States.
        s : ndarray, shape (n_states, n_parameters), optional
            Sensitivities, where the kernel takes them.

        Returns
        -------
        ndarray
            A fresh array. Of sensitivities it has a row for each parameter, then flattened.
        """
        along = np.zeros(0) if s is None else np.ascontiguousarray(s.T).ravel()
        return self.model.bound(kernel, self.p)(self.t, y, along, self.u).copy()

    def event_values(self, y: Array, s: Array | None = None) -> Array:
        """Return what the events of the model watch, shape (n_events,), without its corners."""
        return self.call("events", y, s)[: len(self.model.layout.events)]
