"""The modes of jumps inside expressions at a start: what these are there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import SolveError
from cotree.model.unknowns import solve_start

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.model.contents import Pair
    from cotree.model.model import CompiledModel

    Array = npt.NDArray[np.float64]

#: Jumps may decide each other, each a few times.
_MOST_ROUNDS = 50


def settle_jumps(
    model: CompiledModel,
    t: float,
    p: Array,
    u: Array | None,
    y: Array,
    s: Array,
    held: Sequence[Pair] = (),
) -> tuple[Array, Array]:
    """Set the modes that stand for jumps inside expressions to what these are at a point.

    Parameters
    ----------
    model : CompiledModel
        The model.
    t : float
        When, [s].
    p, u : ndarray
        Parameters and inputs; None takes the scene's inputs.
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        States that satisfy all equations with the modes that they hold, and sensitivities.
    held : sequence of (int, int)
        See :func:`cotree.model.unknowns.solve_start`.

    Returns
    -------
    ndarray, shape (n_states,), and ndarray, shape (n_states, n_parameters)

    Raises
    ------
    SolveError
        If there are no values that agree with the states that they lead to.
    """
    rows = model.layout.events
    if not any(row.is_jump for row in rows):
        return y, s
    looked_at, new, y = model.bound("events", p), model.bound("jumps", p), y.copy()
    nothing = np.zeros(0)
    for _ in range(_MOST_ROUNDS * len(rows)):
        values = looked_at(t, y, nothing, u).copy()
        wanted = new(t, y, nothing, u)
        changed = False
        for row, value in zip(rows, values, strict=True):
            if row.is_jump and row.direction * value > 0.0 and not changed:
                (target,) = row.targets
                changed = bool(y[target] != wanted[row.results.start])
                y[target] = wanted[row.results.start]
        if not changed:
            return y, s
        y, s = solve_start(model, t, p, u, y, s, held)
    names = ", ".join(f"'{model.states[row.targets[0]]}'" for row in rows if row.is_jump)
    raise SolveError(
        f"no values of {names} agree with the states that they lead to at t = {t:g}: the jump "
        "turns back what it looks at"
    )
