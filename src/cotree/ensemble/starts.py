"""Parameters, initial values and tolerances of the members of a block, a row for each.

In: a ``Pattern``, and the rows of a block. Out: parameters, initial values and tolerances.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.model.start import is_slope
from cotree.solvers.corners import turn_tolerances
from cotree.solvers.tested import tested

if TYPE_CHECKING:
    from cotree.ensemble.pattern import Pattern
    from cotree.solvers.base import FloatArray


@dataclass(frozen=True, eq=False)
class Own:
    """Values that members have of their own.

    Attributes
    ----------
    p : ndarray, shape (n_members, n_parameters)
        Parameters.
    states : ndarray of int, shape (n_set,)
        States whose initial values are set.
    values : ndarray, shape (n_members, n_set)
        These values.
    is_refused : ndarray of bool, shape (n_members,)
        Members with values that are not finite.
    """

    p: FloatArray
    states: npt.NDArray[np.intc]
    values: FloatArray
    is_refused: npt.NDArray[np.bool_]


def own_values(pattern: Pattern, rows: FloatArray) -> Own:
    """Give what members set."""
    plan, model = pattern.plan, pattern.plan.model
    shared = model.parameter_array(plan.settings.parameters)
    p = np.empty((len(rows), len(shared)))
    p[:] = shared
    initial = {
        name: np.full(len(rows), float(value))
        for name, value in plan.settings.initial.items()
        if not is_slope(name)
    }
    columns, places = [], []
    for j, name in enumerate(plan.columns):
        if name in model.states:
            initial[name] = rows[:, j]
        elif not is_slope(name):  # whose starts are made in Python
            columns.append(j)
            places.append(model.parameters.index(name))
    p[:, places] = rows[:, columns]
    return Own(
        p,
        np.array([model.states.index(name) for name in initial], dtype=np.intc),
        np.array(list(initial.values())).reshape(len(initial), len(rows)).T.copy(),
        np.logical_not(np.isfinite(rows).all(axis=1)),
    )


def tolerances(pattern: Pattern, p: FloatArray) -> tuple[FloatArray | None, FloatArray | None]:
    """Give the absolute tolerances of members, of what is integrated and of turns, if they differ.

    Those of sensitivities are divided by the sizes of the parameters; see
    :class:`cotree.solvers.augmented.Tolerances`.
    """
    problem, model, settings = pattern.problem, pattern.plan.model, pattern.plan.settings
    names = model.sensitivities[: problem.n_sensitivities]
    moved = [
        j
        for j, name in enumerate(names)
        if name in pattern.plan.columns and name in model.parameters and name not in settings.scales
    ]
    if not moved:
        return None, None
    scales = np.tile(np.asarray(problem.scales), (len(p), 1))
    for j in moved:
        size = np.abs(p[:, model.parameters.index(names[j])])
        scales[:, j] = np.where(size == 0.0, 1.0, size)
    own = replace(problem, scales=scales)
    _, atols = tested(pattern.row, own, is_extended=bool(pattern.job.job.is_extended))
    # Where sensitivities are not tested, their sizes change nothing.
    return (atols if atols.ndim > 1 else None), turn_tolerances(own)
