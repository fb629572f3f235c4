"""The start of a run: states and sensitivities that satisfy all equations, step by step.

In: a model, parameters, inputs, and initial values of a run. Out: a ``Start``. The steps, of which
each leaves alone what those before it found:

1. Values as they are given: the scene's or those of its operating point, then those of the run.
2. The constraints of mechanisms (:mod:`cotree.model.consistent`).
3. Algebraic unknowns, and what storages hold from what follows from it; then the modes of jumps
   inside expressions, and the unknowns again (:mod:`cotree.model.unknowns`).
4. A check of what was given twice (:mod:`cotree.model.contents`, :mod:`cotree.model.redundant`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from cotree.errors import ParameterError, nearest
from cotree.model.consistent import Start, consistent_start
from cotree.model.contents import check_followers, held_followers
from cotree.model.redundant import check_redundant
from cotree.model.unknowns import settle_jumps, solve_start
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.model.model import CompiledModel

Array = npt.NDArray[np.float64]


def find_start(
    model: CompiledModel, t: float, p: Array, u: Array | None, initial: Mapping[str, float]
) -> Start:
    """Find initial states and sensitivities; see :meth:`cotree.Model.start`.

    Parameters
    ----------
    model : CompiledModel
        The model.
    t : float
        Start time, [s].
    p : ndarray, shape (n_parameters,)
        Parameters.
    u : ndarray, shape (n_inputs,), optional
        Inputs at that time; the scene's where absent.
    initial : mapping of str to float
        Initial values of states in place of the scene's.
    """
    held = held_followers(model, initial)
    start = constrained_start(model, t, p, u, initial)
    y, s = start.y, start.s
    if start.is_chosen and model.sensitivities:
        s = _by_differences(model, t, p, initial, start)
    y, s = solve_start(model, t, p, u, y, s, held)
    y, s = settle_jumps(model, t, p, u, y, s, held)
    check_followers(model, initial, y)
    check_redundant(model, t, p, u, Start(y, s), set(initial))
    return Start(y, s, start.is_chosen)


def constrained_start(
    model: CompiledModel,
    t: float,
    p: Array,
    u: Array | None,
    initial: Mapping[str, float],
    *,
    is_probe: bool = False,
) -> Start:
    """Take the values that are given, and move what is not onto the constraints."""
    names, wanted = model.states, model.sensitivities
    y, s = model.initial_values(t, p, u)
    for name, value in initial.items():
        if name not in names:
            raise ParameterError(f"the model has no state '{name}'{nearest(name, names)}")
        i = names.index(name)
        y[i] = check_number(value, f"initial value of '{name}'")
        s[i] = [float(other == name) for other in wanted]
    anew = {names.index(name) for name in initial}
    kept = {i for i, is_given in enumerate(model.layout.given) if is_given} | anew
    # An initial value that may change is an initial value.
    kept |= {names.index(name) for name in wanted if name in names}
    return consistent_start(model, t, p, y, s, kept, is_probe=is_probe, anew=anew)


def _by_differences(
    model: CompiledModel, t: float, p: Array, initial: Mapping[str, float], start: Start
) -> Array:
    """Differentiate a start that was chosen as the least move, shape (n_states, n_parameters).

    The choice depends on the parameters through the constraints' gradients, whose derivatives no
    kernel has: five points give it to ten digits.
    """
    s = start.s.copy()
    for j, name in enumerate(model.sensitivities):
        if name in model.states:
            size = max(1.0, abs(start.y[model.states.index(name)]))
        else:
            size = max(abs(p[model.parameters.index(name)]), 1e-3)
        step, total = 1e-3 * size, np.zeros(len(model.states))
        for place, weight in ((-2, 1.0), (-1, -8.0), (1, 8.0), (2, -1.0)):
            moved, given = p.copy(), dict(initial)
            if name in model.states:
                own = start.y[model.states.index(name)]
                given[name] = float(own + place * step)
            else:
                moved[model.parameters.index(name)] += place * step
            total += weight * constrained_start(model, t, moved, None, given, is_probe=True).y
        s[:, j] = total / (12.0 * step)
    return np.where(model.sensitivity_pattern, s, 0.0)  # of what does not depend, rounding is left
