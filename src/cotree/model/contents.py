"""Contents of storages as states, and the variables that follow from them, at the start of runs.

A scene gives a voltage where the state is a charge: the start finds the charge from the voltage.
Absolute tolerances, too, are given for voltages; those of charges follow from them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.model.arrays import Array
    from cotree.model.model import CompiledModel, Moment

#: A state and the algebraic unknown that follows from it, by their places.
Pair = tuple[int, int]

#: Both may be given where they agree to this share.
_AGREE = 1e-6


def held_followers(model: CompiledModel, initial: Mapping[str, float]) -> list[Pair]:
    """List the states that a start finds from the variables that follow from them.

    Parameters
    ----------
    model : CompiledModel
        The model.
    initial : mapping of str to float
        Initial values of a run in place of the scene's. Where both are given, the state counts.
    """
    layout, names = model.layout, model.states
    if not layout.followers:
        return []
    # At an operating point all contents follow from voltages; else those that are not given.
    is_found = [model.begins_at_rest or not is_given for is_given in layout.given]
    return [
        (total, follower)
        for total, follower in layout.followers
        if names[total] not in initial and (names[follower] in initial or is_found[total])
    ]


def held_along(model: CompiledModel, held: Sequence[Pair], name: str) -> list[Pair]:
    """List the same for the sensitivity to an initial value: the named variable is given.

    Parameters
    ----------
    model : CompiledModel
        The model.
    held : sequence of (int, int)
        The pairs of the start itself; see :func:`held_followers`.
    name : str
        The parameter or state of the sensitivity.
    """
    names = model.states
    return [
        pair
        for pair in model.layout.followers
        if names[pair[1]] == name or (pair in held and names[pair[0]] != name)
    ]


def check_followers(model: CompiledModel, initial: Mapping[str, float], y: Array) -> None:
    """Refuse initial values of a run that contradict each other.

    Parameters
    ----------
    model : CompiledModel
        The model.
    initial : mapping of str to float
        Initial values of the run in place of the scene's.
    y : ndarray, shape (n_states,)
        The start that was found.

    Raises
    ------
    ParameterError
        If a run gives both the content of a storage and the variable that follows from it, and
        they do not agree.
    """
    names = model.states
    for total, follower in model.layout.followers:
        if names[total] in initial and names[follower] in initial:
            given, found = initial[names[follower]], float(y[follower])
            # Written so that nan is refused, too.
            if not abs(given - found) <= _AGREE * max(abs(given), abs(found)):
                raise ParameterError(
                    f"initial values contradict each other: '{names[follower]}' is given as "
                    f"{given:.6g} but is {found:.6g} by '{names[total]}'; leave one out"
                )


def content_sizes(at: Moment, y: Array) -> Array | None:
    """Return the factors of the absolute tolerances of states, shape (n_states,); None for one.

    For the content of a storage, the factor is the change of the content per unit of the variable
    that follows from it: a capacitance. It is one for all other states.
    """
    followers = at.model.layout.followers
    if not followers:
        return None
    sizes, jacobian = np.ones(len(y)), np.abs(at.model.jacobian(at.t, y, at.p, at.u))
    for total, follower in followers:
        # This row holds the derivatives of the storage's law. Where the law has none by its own
        # variable at this point, the largest by another one stands in for the capacitance.
        own = jacobian[follower, follower] or np.max(np.delete(jacobian[follower], total))
        if own > 0.0 and np.isfinite(own):
            sizes[total] = own
    return sizes
