"""Lookup tables of one and two arguments, made of piecewise linear ones.

A piecewise linear table finds the cell that an argument is in, and how far within it; the
coefficients of each cell are read at its number. So all that holds of piecewise linear tables and
of floors, in every language that nodes are written in, holds of these.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.dag.multi_output import Table, table

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.dag.nodes import Dag, Node

    Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Grid:
    """Values on a grid of arguments.

    Attributes
    ----------
    axes : tuple of tuple of float
        Ascending arguments along each axis, one or two of them; at least two each.
    values : tuple of float
        Those of the last argument follow one another.
    is_smooth : bool
        Whether cubics between the points keep their monotony (F. N. Fritsch, R. E. Carlson, SIAM
        J. Numer. Anal. 17 (1980) 238), along each axis; linear otherwise.
    extends : bool
        Whether values go on along straight lines outside of the grid; they are constant otherwise.
    """

    axes: tuple[tuple[float, ...], ...]
    values: tuple[float, ...]
    is_smooth: bool = False
    extends: bool = False


def look_up(dag: Dag, grid: Grid, places: Sequence[Node]) -> Node:
    """Form the value of a grid.

    Parameters
    ----------
    dag : Dag
        The arena.
    grid : Grid
        The points and the interpolation between them.
    places : sequence of Node
        The arguments, one for each axis.
    """
    if len(grid.axes) == 1 and not grid.is_smooth and not grid.extends:
        return table(dag, Table(grid.axes[0], grid.values), places[0])[0]
    value = _inside(dag, grid, places)
    if not grid.extends:
        return value
    # Beyond the last points the value changes by the slope there, times the way.
    for axis, (knots, place) in enumerate(zip(grid.axes, places, strict=True)):
        for end, bound in enumerate((knots[0], knots[-1])):
            beyond = place - bound if end else bound - place
            way = dag.select(beyond, beyond, dag.zero)
            slope = _inside(dag, _edge(grid, axis, end), _others(places, axis))
            value = value + (way * slope if end else -way * slope)
    return value


def _others(places: Sequence[Node], axis: int) -> list[Node]:
    return [place for i, place in enumerate(places) if i != axis]


def _edge(grid: Grid, axis: int, end: int) -> Grid:
    """Give the slopes along one axis at one of its ends, on the grid of the other axes."""
    slopes = _slopes(grid, axis)
    own = np.take(slopes, -1 if end else 0, axis=axis)
    others = tuple(knots for i, knots in enumerate(grid.axes) if i != axis)
    return Grid(others, tuple(own.ravel().tolist()), grid.is_smooth)


def _inside(dag: Dag, grid: Grid, places: Sequence[Node]) -> Node:
    """Form the value, which is constant outside of the grid."""
    if not grid.axes:
        return dag.constant(grid.values[0])
    coefficients = _coefficients(grid)
    cells = [_cell(dag, knots, place) for knots, place in zip(grid.axes, places, strict=True)]
    number, total = cells[0][0], len(grid.axes[0]) - 1
    for (own, _), knots in zip(cells[1:], grid.axes[1:], strict=True):
        number, total = number * (len(knots) - 1) + own, total * (len(knots) - 1)
    degree = 3 if grid.is_smooth else 1
    flat = np.moveaxis(coefficients.reshape((total, *[degree + 1] * len(cells))), 0, -1)

    def along(axis: int, powers: tuple[int, ...]) -> Node:
        """Sum the powers of a local coordinate by Horner's rule."""
        if axis == len(cells):
            return _read(dag, flat[powers], number)
        sums = along(axis + 1, (*powers, degree))
        for power in range(degree - 1, -1, -1):
            sums = sums * cells[axis][1] + along(axis + 1, (*powers, power))
        return sums

    return along(0, ())


def _cell(dag: Dag, knots: tuple[float, ...], place: Node) -> tuple[Node, Node]:
    """Give the number of the cell that an argument is in, and how far it is within, 0 to 1."""
    numbers = tuple(float(i) for i in range(len(knots)))
    counted = table(dag, Table(knots, numbers), place)[0]
    last = dag.constant(numbers[-2])
    floor = dag.function("floor", counted)
    cell = dag.select(last - floor, floor, last)
    return cell, counted - cell


def _read(dag: Dag, values: Array, number: Node) -> Node:
    """Read one of some values by its number; at whole numbers a linear table gives them exactly."""
    first = float(values[0])
    if np.all(values == first):
        return dag.constant(first)
    numbers = tuple(float(i) for i in range(len(values)))
    return table(dag, Table(numbers, tuple(values.tolist())), number)[0]


@lru_cache(maxsize=256)
def _coefficients(grid: Grid) -> Array:
    """Give the coefficients of each cell's polynomial in its local coordinates.

    The shape is that of the cells, then one more axis for the powers of each coordinate.
    """
    shape = tuple(len(knots) for knots in grid.axes)
    n = len(shape)
    rows = [np.array(grid.values, dtype=float).reshape(shape)]
    if grid.is_smooth:
        # Values and slopes along each axis, and of two the slopes of slopes: all that a product
        # of cubics takes at a point. The axis that comes last counts first.
        for axis in reversed(range(n)):
            rows = [*rows, *(_monotone(np.asarray(grid.axes[axis]), row, axis) for row in rows)]
    kinds = 2 if grid.is_smooth else 1
    own = np.stack(rows, axis=-1).reshape((*shape, *[kinds] * n))
    for axis, knots in enumerate(grid.axes):
        own = _of_cells(own, axis, n + axis, np.diff(knots))
    return own


#: From values at both ends, and slopes there times the width, to coefficients of powers.
_LINE = np.array([[1.0, 0.0], [-1.0, 1.0]])
_CUBIC = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [-3.0, 3.0, -2.0, -1.0], [2.0, -2.0, 1.0, 1.0]]
)


def _of_cells(own: Array, axis: int, kind: int, widths: Array) -> Array:
    """Turn what is known at points along an axis into coefficients of the cells between them."""
    low = np.take(own, range(len(widths)), axis=axis)
    high = np.take(own, range(1, len(widths) + 1), axis=axis)
    ends = [np.take(side, 0, axis=kind) for side in (low, high)]
    if own.shape[kind] == 2:
        scale = widths.reshape([-1 if i == axis else 1 for i in range(own.ndim - 1)])
        ends += [scale * np.take(side, 1, axis=kind) for side in (low, high)]
    matrix = _CUBIC if own.shape[kind] == 2 else _LINE
    return np.moveaxis(np.tensordot(matrix, np.stack(ends), axes=1), 0, kind)


def _monotone(knots: Array, values: Array, axis: int) -> Array:
    """Give the slopes at the points that keep cubics monotone, along an axis."""
    from scipy.interpolate import PchipInterpolator

    found: Array = PchipInterpolator(knots, values, axis=axis).derivative()(knots)
    return found


def _slopes(grid: Grid, axis: int) -> Array:
    """Give the slopes along an axis at its points; of straight lines those of the end cells."""
    shape = tuple(len(knots) for knots in grid.axes)
    values = np.array(grid.values, dtype=float).reshape(shape)
    knots = np.asarray(grid.axes[axis])
    if grid.is_smooth:
        return _monotone(knots, values, axis)
    scale: Any = [1] * len(shape)
    scale[axis] = -1
    found: Array = np.diff(values, axis=axis) / np.diff(knots).reshape(scale)
    return found
