"""Functions of Python that a job in C calls: inputs, samples, and searches for lost points.

In: an ``ffi`` and what is to be called. Out: pointers to functions. An exception waits until C is
back: C knows only that the call failed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.solvers.base import FloatArray
    from cotree.solvers.rescue import Rescue


class Callbacks:
    """The functions of one job, which keeps this as long as C may call them.

    Parameters
    ----------
    ffi : object
        Of the engine.
    rescue : Rescue
        Looks for points that the iterations in C do not find.

    Attributes
    ----------
    errors : list of BaseException
        What calls have raised.
    """

    def __init__(self, ffi: Any, rescue: Rescue) -> None:
        self._ffi, self._rescue = ffi, rescue
        self._kept: list[Any] = []
        self.errors: list[BaseException] = []

    def ask_for_inputs(self, functions: Mapping[int, Callable[[float], float]]) -> Any:
        """Return C a function that asks Python for inputs."""
        errors = self.errors

        def ask(t: float, u: Any, context: Any) -> int:
            if errors:  # C may try a shorter step before it gives up
                return -1
            for place, function in functions.items():
                u[place] = function(t)
            return 0

        return self._callback("cotree_input_function", ask)

    def reach(self, reach: Callable[[float, FloatArray], None], size: int) -> Any:
        """Return C the function that is told where a segment begins."""
        ffi = self._ffi

        def tell(t: float, z: Any, context: Any) -> int:
            reach(t, np.frombuffer(ffi.buffer(z, 8 * size)))
            return 0

        return self._callback("cotree_reach", tell)

    def helper(self, n_states: int) -> Any:
        """Return C the functions that look for points where its own iterations fail."""
        rescue, ffi = self._rescue, self._ffi

        def find_unknowns(t: float, x: Any, context: Any) -> int:
            point = np.frombuffer(ffi.buffer(x, 8 * n_states))
            return int(not rescue.find_unknowns(t, point))

        def find_states(t: float, x: Any, kept: Any, n_kept: int, context: Any) -> int:
            point = np.frombuffer(ffi.buffer(x, 8 * n_states))
            return int(not rescue.find_states(t, point, [kept[i] for i in range(n_kept)]))

        helper = ffi.new("cotree_helper *")
        helper.find_unknowns = self._callback("cotree_find_unknowns", find_unknowns)
        helper.find_states = self._callback("cotree_find_states", find_states)
        self._kept.append(helper)
        return helper

    def _callback(self, kind: str, function: Callable[..., int]) -> Any:
        """Return C a function of Python; exceptions, Ctrl-C among them, wait until C is back."""
        errors = self.errors

        def remember(kind: Any, error: BaseException, traceback: Any) -> None:
            errors.append(error)

        callback = self._ffi.callback(kind, function, error=-1, onerror=remember)
        self._kept.append(callback)
        return callback
