"""Arrays as users give them: checked, copied, contiguous."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.dag.evaluate import evaluate
from cotree.dag.symbols import PARAMETER
from cotree.errors import ParameterError, nearest
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.equations import DerivedParameter

Array = npt.NDArray[np.float64]


def as_array(value: Any, shape: Sequence[int], what: str) -> Array:
    """Make a contiguous array of doubles of a given shape, always a copy.

    Parameters
    ----------
    value : array_like
        The user's value.
    shape : sequence of int
        The shape that it has to have.
    what : str
        Its name in a message.

    Raises
    ------
    ParameterError
        If it is no array of numbers, or of another shape.
    """
    try:
        array = np.array(value, dtype=float, order="C")  # always a copy: callers change theirs
    except (TypeError, ValueError):
        raise ParameterError(
            f"{what} must be an array of numbers of shape {tuple(shape)}"
        ) from None
    if array.shape != tuple(shape):
        raise ParameterError(
            f"{what} must be an array of shape {tuple(shape)}, not of shape {array.shape}"
        )
    return array


def as_parameters(
    values: Any, names: Sequence[str], defaults: Array, derived: Sequence[DerivedParameter] = ()
) -> Array:
    """Make the array of parameters of some by name, of an array of all, or of nothing.

    Parameters
    ----------
    values : mapping of str to float, array_like of shape (n_parameters,), or None
        The user's value.
    names : sequence of str
        Of all parameters.
    defaults : ndarray, shape (n_parameters,)
        The scene's values, for those that are not given.
    derived : sequence of DerivedParameter
        Parameters that follow from these, for messages.

    Raises
    ------
    ParameterError
        If a name is unknown, a value is not a finite number, or an array has another shape.
    """
    if values is not None and not isinstance(values, Mapping):
        return as_array(values, (len(names),), "the parameters")
    p = defaults.copy()
    places = {name: i for i, name in enumerate(names)} if values else {}
    for name, value in (values or {}).items():
        followers = [row for row in derived if row.name == name]
        if followers:
            raise ParameterError(f"{followers[0].told}: give those, and it follows")
        if name not in places:
            raise ParameterError(
                f"the model has no tunable parameter '{name}'{nearest(name, names)}"
            )
        p[places[name]] = check_number(value, f"parameter '{name}'")
    return p


def derived_values(derived: Sequence[DerivedParameter], p: Array) -> dict[str, float]:
    """Give the values of derived parameters, by name.

    Parameters
    ----------
    derived : sequence of DerivedParameter
        The parameters.
    p : ndarray, shape (n_parameters,)
        What they follow from.
    """
    if not derived:
        return {}
    dag = derived[0].node.dag
    symbols = {dag.symbol(PARAMETER, i): value for i, value in enumerate(p.tolist())}
    with np.errstate(all="ignore"):
        found = evaluate([row.node for row in derived], symbols)
    return {row.name: float(value) for row, value in zip(derived, found, strict=True)}
