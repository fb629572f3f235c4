"""Rates of a model as one function of states, inputs and parameters with its exact Jacobian.

In: a model. Out: what bridges to other packages call: values, and derivatives by each argument.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.dag.nodes import TIME, kinds_in
from cotree.errors import ParameterError

if TYPE_CHECKING:
    from cotree.model.arrays import Array
    from cotree.model.points import PointMethods


@dataclass(frozen=True)
class Rates:
    """The function (x, u, p) -> dx/dt at one time.

    Attributes
    ----------
    model : PointMethods
        The model.
    t : float
        The time, [s].
    names : tuple of str
        The parameters among its arguments, those that the model was compiled with sensitivities
        to; the others keep the values of the scene.
    """

    model: PointMethods
    t: float
    names: tuple[str, ...]

    @property
    def sizes(self) -> tuple[int, int, int]:
        """Numbers of states, of inputs and of these parameters."""
        return len(self.model.states), len(self.model.inputs), len(self.names)

    @property
    def values(self) -> Array:
        """The scene's values of the parameters, shape (n_parameters,)."""
        own = dict(zip(self.model.parameters, self.model.default_parameters, strict=True))
        return np.array([own[name] for name in self.names])

    def __call__(self, x: Array, u: Array, p: Array) -> Array:
        """Evaluate the rates, shape (n_states,)."""
        return self.model.rhs(self.t, x, self._given(p), u)

    def derivatives(self, x: Array, u: Array, p: Array) -> tuple[Array, Array, Array]:
        """Evaluate the derivatives by x, u and p, shapes (n_states, n) for each of the three."""
        model, given = self.model, self._given(p)
        n, n_inputs, n_parameters = self.sizes
        by_state = model.jacobian(self.t, x, given, u)
        by_input = np.zeros((n, 0))
        if n_inputs:
            # Of a model without algebraic unknowns nothing has to be eliminated.
            own = model.parameter_array(given), np.asarray(u, dtype=float)
            by_input = model._linearizer.whole(self.t, x, *own)[1][:n, n:]
        by_parameter = np.zeros((n, 0))
        if n_parameters:
            # Rates of sensitivities that are zero are what a parameter adds to rates by itself.
            at_rest = np.zeros((n, len(model.sensitivities)))
            rates = model.sensitivity_rhs(self.t, x, at_rest, given, u)
            by_parameter = rates[:, [model.sensitivities.index(name) for name in self.names]]
        return by_state, by_input, by_parameter

    def _given(self, p: Array) -> dict[str, float]:
        return dict(zip(self.names, map(float, p), strict=True))


def rates_of(model: PointMethods, t: float | None, bridge: str) -> Rates:
    """Make the function of a model.

    Parameters
    ----------
    model : PointMethods
        The model.
    t : float or None
        The time, [s]; None where rates do not depend on it.
    bridge : str
        Name of the method that asks, for messages.

    Raises
    ------
    ParameterError
        If the model has algebraic unknowns or constraints, or its rates depend on time and none is
        given.
    """
    layout = model.layout
    if layout.n_algebraic or layout.constraints:
        what = "algebraic unknowns" if layout.n_algebraic else "constraints"
        raise ParameterError(
            f"{bridge}() needs a model whose rates follow from its states alone, and "
            f"'{layout.name}' has {what}: export an FMU, or call simulate"
        )
    if t is None and TIME in kinds_in(model._program.kernels["rhs"].results):
        raise ParameterError(
            f"rates of '{layout.name}' depend on time: say at which, such as {bridge}(t=0.0)"
        )
    names = tuple(name for name in model.sensitivities if name in model.parameters)
    return Rates(model, 0.0 if t is None else t, names)
