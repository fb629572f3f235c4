"""Lookup tables: piecewise linear or cubic along one axis, bilinear along two axes.

Each piece of a cubic or bilinear table is a polynomial; the outermost pieces extrapolate. The
results of a node are the value and its derivatives, so differentiating a result selects another
result of the same node.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Dag, Node


@dataclass(frozen=True)
class LinearTable:
    """A piecewise linear function that is constant outside its range."""

    x: tuple[float, ...]  # ascending arguments, at least two
    y: tuple[float, ...]  # table values at ``x``

    function = "cotree_table"

    @property
    def arrays(self) -> dict[str, tuple[float, ...]]:
        """Return the arrays that C reads, by name."""
        return {"x": self.x, "y": self.y}


@dataclass(frozen=True)
class CubicTable:
    """A piecewise cubic Hermite function. Results: value, first to third derivatives."""

    x: tuple[float, ...]  # ascending arguments, at least two
    #: Values and first derivatives at ``x``.
    y: tuple[float, ...]
    slopes: tuple[float, ...]

    #: Name of the C function, and a name for each result.
    function = "cotree_cubic"
    results = ("", "slope", "curvature", "third")
    #: For each result, by index of the argument: index of the result that is its derivative.
    partials: ClassVar[tuple[dict[int, int], ...]] = ({0: 1}, {0: 2}, {0: 3}, {})

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Return the points at which pieces join, along each axis."""
        return (self.x,)

    @property
    def arrays(self) -> dict[str, tuple[float, ...]]:
        """Return the arrays that C reads, by name, the axes first."""
        return {"x": self.x, "y": self.y, "slopes": self.slopes}

    @np.errstate(all="ignore")
    def evaluate(self, values: Sequence[Any]) -> Sequence[Any]:
        """Evaluate the table at a number, real or complex, or at an array of numbers."""
        x, y, slopes = map(np.array, (self.x, self.y, self.slopes))
        k = _piece(x, values[0])
        h, s = x[k + 1] - x[k], values[0] - x[k]
        secant = (y[k + 1] - y[k]) / h
        b = (3.0 * secant - 2.0 * slopes[k] - slopes[k + 1]) / h
        c = (slopes[k] + slopes[k + 1] - 2.0 * secant) / (h * h)
        return [
            y[k] + s * (slopes[k] + s * (b + s * c)),
            slopes[k] + s * (2.0 * b + 3.0 * s * c),
            2.0 * b + 6.0 * s * c,
            6.0 * c,
        ]


@dataclass(frozen=True)
class PlaneTable:
    """A bilinear function of two arguments. Results: value, d/dx, d/dy and d2/dxdy."""

    #: Ascending arguments of both axes, at least two each.
    x: tuple[float, ...]
    y: tuple[float, ...]
    z: tuple[float, ...]  # table values, one row for each ``x``

    function = "cotree_plane"
    results: ClassVar[tuple[str, ...]] = ("", "slope_x", "slope_y", "twist")
    partials: ClassVar[tuple[dict[int, int], ...]] = ({0: 1, 1: 2}, {1: 3}, {0: 3}, {})

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Return the points at which pieces join, along each axis."""
        return (self.x, self.y)

    @property
    def arrays(self) -> dict[str, tuple[float, ...]]:
        """Return the arrays that C reads, by name, the axes first."""
        return {"x": self.x, "y": self.y, "z": self.z}

    @np.errstate(all="ignore")
    def evaluate(self, values: Sequence[Any]) -> Sequence[Any]:
        """Evaluate the table at two numbers, real or complex, or at two arrays of numbers."""
        given = []
        for axis, at in zip(map(np.array, self.axes), values, strict=True):
            k = _piece(axis, at)
            given.append((axis, k, at - axis[k]))
        return _bilinear(given, np.array(self.z))


@dataclass(frozen=True)
class HeldTable(LinearTable):
    """A piecewise linear function whose interval can be frozen during a step.

    Arguments: the argument of the table, and the number of the frozen interval; zero means that the
    argument selects the interval. The first interval is below all points, the last one above all
    points. Results: value, slope, both ends of the interval, and its number. An infinite end is
    replaced by the argument minus or plus one.
    """

    function = "cotree_held_table"
    results = ("", "slope", "low", "high", "piece")
    # An end at argument plus or minus one moves with the argument, so it is never crossed.
    partials: ClassVar[tuple[dict[int, int], ...]] = ({0: 1}, {}, {}, {}, {})

    @property
    def axes(self) -> tuple[tuple[float, ...], ...]:
        """Return the points at which pieces join, along each axis."""
        return (self.x,)

    def ends(self, _: int) -> tuple[int, int, int]:
        """Return the indices of three results: both ends of the interval, and its number."""
        return 2, 3, 4

    def evaluate(self, values: Sequence[Any]) -> Sequence[Any]:
        """Evaluate the table at a number, real or complex, or at an array of numbers."""
        x, y, at = np.array(self.x), np.array(self.y), values[0]
        n, place = len(x), np.real(at)
        inside = np.clip(np.searchsorted(x, place, side="right"), 1, n - 1)
        own = np.where(place <= x[0], 0, np.where(place >= x[-1], n, inside))
        k = _held(values[1], own)
        low, high = np.clip(k - 1, 0, n - 1), np.clip(k, 0, n - 1)
        width = np.where(high > low, x[high] - x[low], 1.0)
        slope = (y[high] - y[low]) / width
        return [
            y[low] + slope * (at - x[low]),
            slope,
            np.where(k == 0, place - 1.0, x[low]),
            np.where(k == n, place + 1.0, x[high]),
            k + 1.0,
        ]


@dataclass(frozen=True)
class HeldPlane(PlaneTable):
    """A bilinear function whose interval along each axis can be frozen during a step.

    Arguments: those of the table, then the numbers of the frozen intervals; zero means that the
    argument selects the interval. Results: those of :class:`PlaneTable`, then the ends and the
    number of the interval along each axis.
    """

    function = "cotree_held_plane"
    results = (*PlaneTable.results, *("low_x", "high_x", "piece_x", "low_y", "high_y", "piece_y"))
    partials: ClassVar[tuple[dict[int, int], ...]] = (*PlaneTable.partials, *({},) * 6)

    def ends(self, axis: int) -> tuple[int, int, int]:
        """Return the indices of three results: both ends of an axis's interval, and its number."""
        first = 4 + 3 * axis
        return first, first + 1, first + 2

    def evaluate(self, values: Sequence[Any]) -> Sequence[Any]:
        """Evaluate the table at two numbers, real or complex, or at two arrays of numbers."""
        given, further = [], []
        for axis, at, held in zip(map(np.array, self.axes), values[:2], values[2:], strict=True):
            n, place = len(axis), np.real(at)
            own = _piece(axis, at)
            k = _held(held, own)
            given.append((axis, k, at - axis[k]))
            further += [
                np.where(k == 0, place - 1.0, axis[k]),
                np.where(k == n - 2, place + 1.0, axis[k + 1]),
                k + 1.0,
            ]
        return [*_bilinear(given, np.array(self.z)), *further]


LookupData = CubicTable | PlaneTable | HeldTable | HeldPlane


def _bilinear(given: Sequence[tuple[Any, Any, Any]], numbers: Any) -> list[Any]:
    """Evaluate a bilinear piece; ``given`` has points, interval and argument along each axis."""
    (x, i, s), (y, j, u) = given
    z = numbers.reshape(len(x), len(y))
    width, height = x[i + 1] - x[i], y[j + 1] - y[j]
    by_x = (z[i + 1, j] - z[i, j]) / width
    by_y = (z[i, j + 1] - z[i, j]) / height
    twist = ((z[i + 1, j + 1] - z[i, j + 1]) / width - by_x) / height
    return [z[i, j] + s * by_x + u * (by_y + s * twist), by_x + u * twist, by_y + s * twist, twist]


def _held(number: Any, own: Any) -> Any:
    """Return the index of the frozen interval, or of the argument's interval if none is frozen."""
    held = np.asarray(np.real(number))  # also turns a single number into an array
    return np.where(held == 0.0, own, held.astype(int) - 1)


def _piece(x: Any, at: Any) -> Any:
    """Return the index of the interval that contains an argument; the outermost are unbounded."""
    # The real part selects the interval, so that complex steps do not leave it.
    place = np.real(at)
    piece = np.clip(np.searchsorted(x, place, side="right") - 1, 0, len(x) - 2)
    return np.where(np.isnan(place), 0, piece)  # nan arguments return nan, as in C


def look_up(dag: Dag, data: LookupData, args: Sequence[Node]) -> Node:
    """Form the value of a table from one node per axis."""
    numbers = [arg.value for arg in args]
    if None not in numbers:  # a table with constant arguments is a constant
        return dag.constant(float(data.evaluate(numbers)[0]))
    return dag.several("lookup", args, data, len(data.results))[0]
