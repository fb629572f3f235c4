"""Mapping from estimated parameters to the parameters and initial values of ensemble members."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.estimation.conditions import Condition

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Accuracy:
    """Method, tolerances and budget of the runs; see :meth:`cotree.Model.simulate`."""

    method: str = "auto"
    rtol: float = 1e-8
    atol: float = 1e-10
    # Far from the estimates a run may become stiff: it then fails early, and the step is rejected.
    max_steps: float = 100_000.0


class Columns:
    """The parameters and initial values that a member sets for one condition.

    Parameters
    ----------
    condition : Condition
        The condition.
    columns : sequence of str
        Parameters and states that members set; those that this condition does not name keep the
        model's values.
    names : sequence of str
        Names of the estimated parameters.

    Attributes
    ----------
    through : ndarray, shape (n_sensitivities, n_estimated)
        Incidence matrix: one where a sensitivity parameter of the model is tied to an estimated
        parameter.
    """

    def __init__(self, condition: Condition, columns: Sequence[str], names: Sequence[str]) -> None:
        model = condition.model
        defaults = dict(zip(model.parameters, model.default_parameters.tolist(), strict=True))
        given = {**defaults, **condition.parameters, **condition.initial}
        values = [given[name] for name in columns]
        self._numbers = np.array([0.0 if isinstance(v, str) else v for v in values], dtype=float)
        self._places = [(j, names.index(v)) for j, v in enumerate(values) if isinstance(v, str)]
        self.through = np.zeros((len(model.sensitivities), len(names)))
        for name, value in {**condition.parameters, **condition.initial}.items():
            if isinstance(value, str):
                self.through[model.sensitivities.index(name), names.index(value)] = 1.0

    def row(self, values: Array) -> Array:
        """Return the column values of one member for values of the estimated parameters."""
        row = self._numbers.copy()
        for j, k in self._places:
            row[j] = values[k]
        return row
