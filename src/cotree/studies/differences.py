"""Sensitivities by finite differences: runs with one parameter or initial value changed.

In: a model, times and settings. Out: states and outputs, or their central differences, as arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.api import Model
    from cotree.results import Result

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Experiment:
    """A run that is repeated with one value changed.

    Attributes
    ----------
    model : Model
        The model that runs.
    t_eval : ndarray, shape (n_t,)
        Times to report, [s]; the run goes from the first to the last.
    settings : mapping of str to object
        Further arguments of :meth:`cotree.Model.simulate`: method, tolerances, parameters, ...
    """

    model: Model
    t_eval: Array
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities: states, then outputs."""
        return (*self.model.states, *self.model.outputs)

    def run(self, changed: Mapping[str, float] | None = None) -> Result:
        """Integrate with some parameters or initial values changed.

        Raises
        ------
        ModelError
            If a value is refused.
        SolveError
            If the integration fails.
        """
        parameters, initial = self._values("parameters"), self._values("initial")
        for name, value in (changed or {}).items():
            # A state stands for its initial value, as among sensitivities.
            (initial if name in self.model.states else parameters)[name] = value
        return self.model.simulate(
            (float(self.t_eval[0]), float(self.t_eval[-1])),
            self.t_eval,
            # A run that stops early has not all the points.
            throw=True,
            **{**self.settings, "parameters": parameters, "initial": initial},
        )

    def value(self, name: str) -> float:
        """Give the parameter's value, or the initial value of a state."""
        p = self.model.parameter_array(self._values("parameters"))
        if name in self.model.states:
            # The scene's own value, before constraints may have moved it.
            own = self.model.initial(p)[self.model.states.index(name)]
            return float(self._values("initial").get(name, own))
        return float(p[self.model.parameters.index(name)])

    def size(self, name: str, result: Result) -> float:
        """Give the size that steps of a parameter or initial value are relative to.

        It is the parameter's own size. An initial value is often zero or small by chance, so its
        size is the largest value of the state in ``result``. Where that is zero too, it is 1 in
        the unit at hand, since nothing better is known.
        """
        if name in self.model.states:
            size = float(np.max(np.abs(result[name])))
        else:
            size = abs(self.value(name))
        return size or 1.0

    def central_difference(self, name: str, step: float) -> Array:
        """Differentiate states and outputs by a central difference.

        Parameters
        ----------
        name : str
            A parameter, or a state whose initial value is meant.
        step : float
            Half the distance between the two runs, in the unit of ``name``.

        Returns
        -------
        ndarray, shape (n_states + n_outputs, n_t)

        Raises
        ------
        ModelError
            If the model refuses one of the two values.
        SolveError
            If one of the two integrations fails.
        """
        value = self.value(name)
        above, below = value + step, value - step
        difference = quantities(self.run({name: above})) - quantities(self.run({name: below}))
        # The distance as rounded, not 2 * step: at small steps the two differ.
        return difference / (above - below)

    def _values(self, key: str) -> dict[str, float]:
        if key != "parameters":
            return dict(self.settings.get(key) or {})
        p = self.model.parameter_array(self.settings.get(key))
        return dict(zip(self.model.parameters, p.tolist(), strict=True))


def quantities(result: Result) -> Array:
    """Stack states and outputs, shape (n_states + n_outputs, n_t)."""
    return np.vstack([result.y, result.output_values])


def sensitivities(result: Result, name: str) -> Array:
    """Stack the sensitivities of states and outputs, shape (n_states + n_outputs, n_t)."""
    j = result.parameters_of_sensitivity.index(name)
    return np.vstack([result.s[:, j], result.output_sensitivities[:, j]])
