"""Grids: members that are the product of some axes."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.values import column_values
from cotree.errors import ParameterError, brief

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray

# A bound on what a slip may ask for: the rows alone of so many members take gigabytes.
_MOST = 100_000_000


@dataclass(frozen=True, eq=False)
class Grid:
    """The product of some axes; see :func:`grid`.

    Attributes
    ----------
    axes : mapping of str to ndarray
        Values of each, in the order of the dimensions of results.
    """

    axes: Mapping[str, FloatArray]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the axes."""
        return tuple(self.axes)

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes."""
        return tuple(len(values) for values in self.axes.values())

    def __len__(self) -> int:
        return math.prod(self.shape)

    def __repr__(self) -> str:
        shown = " x ".join(f"{name} ({len(values)})" for name, values in self.axes.items())
        return f"<Grid of {len(self)} members: {shown}>"

    def rows(self) -> FloatArray:
        """Give the values of each member, shape (n_members, n_axes); the last axis goes fastest."""
        meshed = np.meshgrid(*self.axes.values(), indexing="ij")
        return np.stack([values.ravel() for values in meshed], axis=1)


def grid(axes: Mapping[str, Any] | None = None, /, **more: Any) -> Grid:
    """Make members of all combinations of some values.

    Parameters
    ----------
    axes : mapping of str to array_like of shape (n,), optional
        Values of parameters, and initial values of states, whose names have dots.
    **more : array_like of shape (n,)
        Further ones.

    Returns
    -------
    Grid
        For ``members`` of :meth:`cotree.Model.ensemble`. Results have a dimension for each axis.

    Raises
    ------
    ParameterError
        If an axis is empty, has a value twice or one that is no finite number, or is given twice.

    Examples
    --------
    >>> import cotree
    >>> cotree.grid({"j1.s": [0.4, 0.5]}, L=[0.8, 1.0, 1.2])
    <Grid of 6 members: j1.s (2) x L (3)>
    """
    if axes is not None and not isinstance(axes, Mapping):
        raise ParameterError(f"grid takes a mapping of names to values, not {brief(repr(axes))}")
    first = dict(axes or {})
    for name in more:
        if name in first:
            raise ParameterError(f"the grid has two axes '{brief(name)}': give one")
    read = {}
    for name, values in {**first, **more}.items():
        if not isinstance(name, str):
            raise ParameterError(
                f"the grid has the axis {brief(repr(name))}: give its name as text"
            )
        what = f"axis '{brief(name)}' of the grid"
        read[name] = np.atleast_1d(column_values(values, what))
        if not read[name].size:
            raise ParameterError(f"{what} is empty: give at least one value")
        found, counts = np.unique(read[name], return_counts=True)
        if len(found) < len(read[name]):
            raise ParameterError(f"{what} has {found[counts > 1][0]:.17g} twice: give it once")
    if not read:
        raise ParameterError("the grid has no axes: give grid(L=[0.9, 1.0, 1.1])")
    made = Grid(read)
    if len(made) > _MOST:
        raise ParameterError(
            f"the grid has {len(made)} members, more than {_MOST}: take fewer values"
        )
    return made
