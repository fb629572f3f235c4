"""Arrays as users give them: checked, copied, contiguous; and objects that C reads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.arguments import by_name, doubles
from cotree.errors import ParameterError, nearest
from cotree.scene.expressions import check_number

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.equations import DerivedParameter
    from cotree.quantities import Quantity

Array = npt.NDArray[np.float64]


def as_array(value: Any, shape: Sequence[int], what: str) -> Array:
    """Return a contiguous copy as doubles; ParameterError if the shape is wrong."""
    array = doubles(value)  # a copy, since callers may change their array
    if array is None:
        raise ParameterError(f"{what} must be an array of numbers of shape {tuple(shape)}")
    if array.shape != tuple(shape):
        raise ParameterError(
            f"{what} must be an array of shape {tuple(shape)}, not of shape {array.shape}"
        )
    return array


def as_parameters(
    values: Any,
    places: Mapping[str, int],
    defaults: Array,
    derived: Sequence[DerivedParameter] = (),
) -> Array:
    """Return the array of parameters from values by name or from an array of all.

    Raises ParameterError if a name is unknown, a value is not a finite number, or an array has
    another shape. ``derived`` parameters follow from these, for messages.
    """
    values = by_name(values)
    if not isinstance(values, Mapping):
        return as_array(values, (len(places),), "the parameters")
    p = defaults.copy()
    for name, value in values.items():
        if name not in places:
            followers = [row for row in derived if row.name == name]
            if followers:
                raise ParameterError(f"{followers[0].dependence}: give those, and it follows")
            raise ParameterError(
                f"the model has no tunable parameter '{name}'{nearest(name, places)}"
            )
        p[places[name]] = check_number(value, f"parameter '{name}'")
    return p


def derived_values(derived: Sequence[DerivedParameter], p: Array) -> dict[str, float]:
    """Return the values of derived parameters, by name."""
    if not derived:
        return {}
    from cotree.dag.evaluate import evaluate
    from cotree.dag.nodes import PARAMETER

    dag = derived[0].node.dag
    symbols = {dag.symbol(PARAMETER, i): value for i, value in enumerate(p.tolist())}
    with np.errstate(all="ignore"):
        found = evaluate([row.node for row in derived], symbols)
    return {row.name: float(value) for row, value in zip(derived, found, strict=True)}


def is_many(y: Any) -> bool:
    """Return whether there is a column of states for each of several points."""
    try:
        return np.ndim(y) == 2
    except ValueError:  # ragged
        return False


def pointer_to(ffi: Any, array: Array) -> Any:
    """Return a pointer to an array that keeps it alive; NULL if it is empty."""
    # The collector may clear a view made by array.data before the pointer that was made of it.
    return ffi.from_buffer("double[]", array) if array.size else ffi.NULL


class CObjects:
    """C objects of cffi that live as long as this object.

    Attributes
    ----------
    errors : list of BaseException
        What functions of Python have raised that C has called.
    """

    def __init__(self, ffi: Any, *kept: Any) -> None:
        self._ffi, self._kept = ffi, list(kept)
        self.errors: list[BaseException] = []

    def new(self, *what: Any) -> Any:
        """Return a new object of ``ffi.new``."""
        self._kept.append(self._ffi.new(*what))
        return self._kept[-1]

    def ints(self, values: Sequence[int]) -> Any:
        """Return a new array of integers, of one zero at least."""
        return self.new("int[]", list(values) or [0])

    def quantities(self, rows: Sequence[Quantity]) -> Any:
        """Return rows as an array of ``cotree_quantity``."""
        found = self.new("cotree_quantity[]", max(1, len(rows)))
        for row, own in zip(rows, found, strict=False):
            own.name, own.unit = (
                self.new("char[]", text.encode()) for text in (row.name, row.unit)
            )
        return found

    def pointer(self, array: npt.NDArray[Any], kind: str = "double") -> Any:
        """Return a pointer to an array, which C does not read if it is empty."""
        array = np.ascontiguousarray(array) if array.size else np.zeros(1, dtype=array.dtype)
        self._kept.append(self._ffi.from_buffer(f"{kind}[]", array))
        return self._kept[-1]

    def callback(self, kind: str, function: Callable[..., int]) -> Any:
        """Return a C function that calls Python; exceptions are stored, and the result is -1."""

        def remember(kind: Any, error: BaseException, traceback: Any) -> None:
            self.errors.append(error)

        self._kept.append(self._ffi.callback(kind, function, error=-1, onerror=remember))
        return self._kept[-1]
