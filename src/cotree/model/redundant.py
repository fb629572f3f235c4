"""Redundant initial values: those of network variables that follow from states and sources.

They change nothing where they agree with what they follow from, their sensitivities included; all
that do not are refused together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ParameterError

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

    from cotree.equations import RedundantRow
    from cotree.model.arrays import Array
    from cotree.model.consistent import Start
    from cotree.model.model import Moment

#: Values agree when they differ by less than this share of the largest value that they follow from:
#: the error of a step at the default tolerance.
_AGREE = 1e-8

#: They also agree when they differ by less than this, which rounding of larger terms leaves.
_ROUNDING = 1e-12

#: The least size of a parameter where derivatives by it are compared: with zero all would agree.
_SMALLEST = 1e-3


def check_redundant(
    at: Moment,
    start: Start,
    replaced: Container[str],
) -> None:
    """Refuse initial values that contradict those of states, or sources.

    Parameters
    ----------
    at : Moment
        The model at the start.
    start : Start
        The start that follows from the initial values of states.
    replaced : container of str
        States whose initial value is not the scene's: what follows from them is free.

    Raises
    ------
    ParameterError
        If some do, or if their sensitivities do; all of them are named.
    """
    model, t = at.model, at.t
    rows, names = model.layout.redundant, model.states
    if not rows:
        return
    held = [
        (i, [names.index(name) for name in row.states])
        for i, row in enumerate(rows)
        # A run that replaces a state contradicts nothing: what followed from it moves along.
        if not any(name in replaced for name in row.states)
    ]
    # The kernel ends with these two rows: values as they follow, and as they are given.
    follows, given = at.call("start", start.y)[-2 * len(rows) :].reshape(2, -1)
    apart = {
        f"'{rows[i].name}' is given as {given[i]:.6g} but is {follows[i]:.6g} by "
        f"{_origin(rows[i].states, t)}": rows[i]
        for i, states in held
        if not _agree(follows[i], given[i], start.y[states])
    }
    if apart:
        raise ParameterError(
            f"initial values contradict each other: {'; '.join(apart)}. Give values that agree, or "
            f"leave these out{_hint(apart.values())}"
        )
    if model.sensitivities:
        _check_sensitivities(at, start, held)


def _check_sensitivities(at: Moment, start: Start, held: Sequence[tuple[int, list[int]]]) -> None:
    """Refuse redundant values whose derivatives by a parameter contradict those of states."""
    model, s = at.model, start.s.T
    rows, m = model.layout.redundant, len(model.sensitivities)
    found = at.call("start_sensitivity", start.y, start.s).reshape(m, -1)
    # For each parameter, the same two rows of derivatives come last.
    follows, given = np.moveaxis(found[:, -2 * len(rows) :].reshape(m, 2, -1), 1, 0)
    apart: dict[str, RedundantRow] = {}
    for j, name in enumerate(model.sensitivities):
        if name not in model.parameters:  # a state's own initial value: others follow it
            continue
        size = max(abs(at.p[model.parameters.index(name)]), _SMALLEST)
        apart |= {
            f"d({rows[i].name})/d({name}) is {given[j, i]:.6g} as given but {follows[j, i]:.6g} by "
            f"{_origin(rows[i].states, at.t)}": rows[i]
            for i, states in held
            # As changes of the values for a change of the parameter by its own size.
            if not _agree(size * follows[j, i], size * given[j, i], size * s[j, states])
        }
    if apart:
        raise ParameterError(
            "initial values agree for these parameters, but not as they change: "
            f"{'; '.join(apart)}. Give them by expressions that agree for all values of the "
            f"parameters, or leave these out{_hint(apart.values())}"
        )


def _hint(rows: Iterable[RedundantRow]) -> str:
    """Name what an edge has of its own, where its position is that of its nodes."""
    if not any(row.is_position for row in rows):
        return ""
    return (
        "; positions between the same nodes are one, and along a circuit they add up to zero: what "
        "stretches a spring at the start is its free_length or free_angle"
    )


def _agree(follows: float, given: float, terms: Array) -> bool:
    size = max(abs(follows), abs(given), float(np.max(np.abs(terms), initial=0.0)))
    return bool(abs(follows - given) <= _AGREE * size + _ROUNDING)


def _origin(states: Sequence[str], t: float) -> str:
    """Name the states, or sources, that a value follows from."""
    if not states:
        return f"the sources at t = {t:g}"
    return ", ".join(f"'{name}'" for name in states)
