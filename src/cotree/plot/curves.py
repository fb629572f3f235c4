"""Choice of the curves that a picture of a result shows, by the names that results have."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import SceneError, brief, nearest

if TYPE_CHECKING:
    from collections.abc import Sequence

# Parameters to which sensitivities come along unnamed: each has a panel of its own.
_MOST_UNNAMED = 4

_TITLE = re.compile(r"d\((.*)\)/d\((.*)\)\Z")

#: Name that a user gives: a state, output, input or title of a column, or (name, parameter).
Name = str | tuple[str, str]


@dataclass(frozen=True)
class Curves:
    """Curves to draw.

    Attributes
    ----------
    values : tuple of str
        States, outputs and inputs.
    sensitivities : tuple of (str, str)
        States and outputs with the parameters that their sensitivities are to.
    """

    values: tuple[str, ...]
    sensitivities: tuple[tuple[str, str], ...]


def choose_curves(
    names: str | Sequence[Name] | None,
    states: Sequence[str],
    outputs: Sequence[str],
    inputs: Sequence[str],
    parameters: Sequence[str],
    *,
    is_alone: bool = False,
) -> Curves:
    """Choose the curves that some names stand for.

    Parameters
    ----------
    names : str, sequence of str or of (str, str), or None
        States, outputs, inputs, and sensitivities as ``d(name)/d(parameter)`` or
        ``(name, parameter)``. Where no sensitivity is named, those of the states and outputs that
        are, to the first four parameters, come with them. None means the coordinates, the states
        that are no rates.
    states, outputs, inputs, parameters : sequence of str
        The names that the result has; parameters are those of its sensitivities.
    is_alone : bool
        Whether no sensitivity comes along that is not named.

    Raises
    ------
    SceneError
        If the result has nothing by a given name.
    """
    known = (*states, *outputs)
    # Rates are told by their names alone: a result does not know its equations.
    if names is None:
        names = [name for name in states if not name.endswith("_dot")] or known
        if not names:
            raise SceneError("the result has neither states nor outputs to plot")
    # Dicts serve as sets that keep the order in which the curves were named.
    values: dict[str, None] = {}
    pairs: dict[tuple[str, str], None] = {}
    for name in [names] if isinstance(names, str) else names:
        pair = sensitivity_pair(name)
        if pair is not None:
            _check_pair(pair, known, parameters)
            pairs[pair] = None
        elif name in known or name in inputs:
            values[str(name)] = None
        else:
            hint = nearest(name, (*known, *inputs))
            raise SceneError(f"cannot plot '{brief(name)}', no state, output or input{hint}")
    if not values and not pairs:
        raise SceneError("nothing is named that could be plotted")
    if not pairs and not is_alone:
        unnamed = parameters[:_MOST_UNNAMED]
        pairs = {(name, to): None for name in values if name in known for to in unnamed}
    return Curves(tuple(values), tuple(pairs))


def sensitivity_pair(name: object) -> tuple[str, str] | None:
    """Give name and parameter of a sensitivity; None for what names none."""
    if isinstance(name, str):
        found = _TITLE.match(name)
        return (found[1], found[2]) if found else None
    if isinstance(name, (tuple, list)) and len(name) == 2:
        return str(name[0]), str(name[1])
    return None


def _check_pair(pair: tuple[str, str], known: Sequence[str], parameters: Sequence[str]) -> None:
    name, parameter = map(brief, pair)
    if pair[0] not in known:
        hint = nearest(name, known)
        raise SceneError(f"cannot plot a sensitivity of '{name}', no state or output{hint}")
    if pair[1] not in parameters:
        hint = nearest(parameter, parameters)
        raise SceneError(
            f"cannot plot sensitivities to '{parameter}', which were not asked for{hint}"
        )
