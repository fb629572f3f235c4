"""Algebraic unknowns of a model: those of a start, with their sensitivities, and of a point.

Of a start, the modes of jumps inside expressions are found with them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import SolveError
from cotree.model.algebraic import Algebraic
from cotree.model.contents import held_along
from cotree.model.linear import is_sparse, linearise

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.model.arrays import Array
    from cotree.model.contents import Pair
    from cotree.model.model import Moment

#: The most rounds in which jumps that decide each other may settle, and contents with unknowns that
#: they depend on. Contents have settled when they change by less than this share of the terms of
#: their equations.
_MOST_ROUNDS, _SAME = 50, 1e-12


def solve_start(at: Moment, y: Array, s: Array, held: Sequence[Pair] = ()) -> tuple[Array, Array]:
    """Solve for the algebraic unknowns of a start and for their sensitivities.

    Parameters
    ----------
    at : Moment
        The model at the start.
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        States, with guesses of the algebraic unknowns, and sensitivities.
    held : sequence of (int, int)
        States to be found with the algebraic unknowns, and which of these is given in its place:
        what storages hold, and the voltages that it follows from. No others depend on it.

    Returns
    -------
    ndarray, shape (n_states,), and ndarray, shape (n_states, n_parameters)
    """
    if not at.model.layout.n_algebraic:
        return y, s
    algebraic = of_model(at)
    y, s = y.copy(), s.copy()
    if held:
        _solve_held(at, algebraic, y, held)
    else:
        algebraic.solve(at.t, y)
    # Newton's method may also end at a solution that leaves unknowns free.
    algebraic.check_index(at.t, y)
    if at.model.sensitivities:
        s = _sensitivities(at, algebraic, y, s, held)
    return y, s


def _sensitivities(
    at: Moment, algebraic: Algebraic, y: Array, s: Array, held: Sequence[Pair]
) -> Array:
    """Solve for the sensitivities of what :func:`solve_start` finds."""
    model, cut, s = at.model, algebraic.cut, s.copy()
    columns: dict[tuple[Pair, ...], list[int]] = {}
    for j, name in enumerate(model.sensitivities):
        # Parameters with the same unknowns share one factorisation.
        columns.setdefault(tuple(held_along(model, held, name)), []).append(j)
    places = {pairs: _unknowns(range(cut, len(y)), pairs) for pairs in columns}
    for pairs, own in columns.items():
        for j in own:
            s[places[pairs], j] = 0.0
    # With the sought sensitivities set to zero, the algebraic rows hold g_x S_x + g_p.
    residual = at.call("sensitivity_rhs", y, s).reshape(s.shape[::-1])[:, cut:].T
    matrix, linear = algebraic.linearised(at.t, y)
    for pairs, own in columns.items():
        solve = linear.solve
        if pairs:  # what is found comes last
            order = [i for i in range(len(y)) if i not in set(places[pairs])] + places[pairs]
            solve = linearise(matrix[cut:, order], y[order]).solve
        block = s[places[pairs]]
        block[:, own] = -solve(residual[:, own])
        s[places[pairs]] = block
    return s


def _unknowns(algebraic: range, pairs: Iterable[Pair]) -> list[int]:
    """List the unknowns of the equations, with contents in place of given unknowns."""
    # The equation of a content then gives the content, and its voltage is known.
    instead = {follower: total for total, follower in pairs}
    return [instead.get(i, i) for i in algebraic]


def _solve_held(at: Moment, algebraic: Algebraic, y: Array, held: Sequence[Pair]) -> None:
    """Solve, in place, for algebraic unknowns and for the states that given unknowns determine.

    Each of these states stands in one equation only, c(v) - q = 0, v being given. Its value follows
    from that equation, and then all equations are solved as at any other time. This is repeated
    where c depends on other unknowns, too.
    """
    t, jacobian = at.t, at.model.bound_jacobian(at.p)
    totals, followers = (np.array(places) for places in zip(*held, strict=True))
    rows, given = followers - algebraic.cut, y[followers].copy()
    # The equation of a content is c(v) - q = 0: adding its residual to q satisfies it.
    y[totals] += algebraic.residual(t, y)[rows]
    for _ in range(_MOST_ROUNDS):
        algebraic.solve(t, y)
        y[followers] = given
        left = algebraic.residual(t, y)[rows]
        y[totals] += left
        # What is left is compared with the sizes of the terms that the equations sum.
        terms = np.abs(jacobian(t, y, at.u)[followers]) @ np.abs(y)
        if np.all(np.abs(left) <= _SAME * terms):
            return
    names = ", ".join(f"'{at.model.states[i]}'" for i in totals.tolist())
    raise SolveError(
        f"{names} cannot be found at t = {t:.10g} from initial values of what follows from it: it "
        "depends on unknowns of nonlinear equations besides; give its own initial value"
    )


def settle_jumps(at: Moment, y: Array, s: Array, held: Sequence[Pair] = ()) -> tuple[Array, Array]:
    """Set the modes that stand for jumps inside expressions to what these are at a point.

    Parameters
    ----------
    at, held
        As for :func:`solve_start`.
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        States that satisfy all equations with the modes that they hold, and sensitivities.

    Returns
    -------
    ndarray, shape (n_states,), and ndarray, shape (n_states, n_parameters)

    Raises
    ------
    SolveError
        If there are no values that agree with the states that they lead to.
    """
    rows = at.model.layout.events
    if not any(row.is_jump for row in rows):
        return y, s
    y = y.copy()
    for _ in range(_MOST_ROUNDS * len(rows)):
        # `jumps` gives what each event sets. An event whose value is beyond zero in its direction
        # has the point on its side.
        values, wanted = at.event_values(y), at.call("jumps", y)
        changed = False
        for row, value in zip(rows, values, strict=True):
            # One jump at a time, since the others may look at what this one changes.
            if row.is_jump and row.direction * value > 0.0 and not changed:
                (target,) = row.targets
                changed = bool(y[target] != wanted[row.results.start])
                y[target] = wanted[row.results.start]
        if not changed:
            return y, s
        y, s = solve_start(at, y, s, held)
    modes = dict.fromkeys(at.model.states[row.targets[0]] for row in rows if row.is_jump)
    names = ", ".join(f"'{name}'" for name in modes)
    raise SolveError(
        f"no values of {names} agree with the states that they lead to at t = {at.t:g}: the jump "
        "turns back what it looks at"
    )


def solve_states(at: Moment, y: Array) -> Array:
    """Solve for the algebraic unknowns of a point; see :func:`solve_start`."""
    if at.model.layout.n_algebraic:
        y = y.copy()
        of_model(at).solve(at.t, y)
    return y


def of_model(at: Moment) -> Algebraic:
    """Give the algebraic unknowns of a model, at fixed parameters and inputs but any time."""
    none, model, p, u = np.zeros(0), at.model, at.p, at.u
    rhs, layout = model.bound("rhs", p), model.layout
    n_algebraic, cut = layout.n_algebraic, len(layout.states) - layout.n_algebraic
    # Rows of the algebraic equations alone are factorised.
    n_own = sum(row >= cut for row in layout.row_indices)
    jacobian = model.bound_jacobian(p, is_sparse=is_sparse(n_algebraic, n_own))

    # Asked for only after Newton's method has failed from the guess itself.
    def improve(t: float, y: Array) -> Array | None:
        return model.junctions.at(t, y, p, replace(at, t=t).inputs).search(y[cut:])

    return Algebraic(
        lambda t, y: rhs(t, y, none, u),
        lambda t, y: jacobian(t, y, u),
        model.states,
        n_algebraic,
        improve,
    )
