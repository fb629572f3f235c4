"""Functions of Python that a job in C calls: inputs, samples, and searches for lost points.

The integrators are those of a library that :mod:`cotree.solvers.engine` finds. Their
nonlinear systems are solved by C of our own: the Newton matrix of the states is factorised once for
them and for all their sensitivities.

CVODE and IDA take states and sensitivities as one vector; in CVODES and IDAS each parameter's has
its own, so that the error test and the iteration take the worst of them, not their mean. Two
correctors (W. F. Feehery, J. E. Tolsma and P. I. Barton, Applied Numerical Mathematics 25, 1997,
for the first; T. Maly and L. R. Petzold, ibid. 20, 1996, for the second):

- staggered: the states are solved for and tested; then their sensitivities, which costs nothing
  where the states' step is refused;
- simultaneous: one iteration has all of them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.methods import Method
    from cotree.solvers.engine import Engine
    from cotree.solvers.problem import Problem
    from cotree.solvers.result import FloatArray


class Callbacks:
    """The functions of one job, which keeps this as long as C may call them.

    ``errors`` holds the exceptions that calls have raised.
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

        helper = ffi.new("cotree_helper *")
        helper.find_unknowns = self._callback("cotree_find_unknowns", find_unknowns)
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


class Rescue:
    """Search for points of one integration that the iterations in C do not find.

    ``complaint`` is the reason why the last point was not found, without a capital and a full stop.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.complaint = ""

    def find_unknowns(self, t: float, y: FloatArray) -> bool:
        """Solve for the algebraic unknowns, in place; keep the reason where none are found."""
        from cotree.model.algebraic import Algebraic

        problem = self.problem
        assert problem.state_rhs is not None  # of a compiled model
        assert problem.jacobian is not None
        unknowns = Algebraic(
            problem.state_rhs, problem.jacobian, problem.names, problem.n_algebraic
        )

        try:
            # The search works on a copy: where it fails, C keeps the point that it had.
            found = y.copy()
            unknowns.solve(t, found)
        except Error as error:
            self.complaint = str(error).rstrip(".")
            return False
        y[:], self.complaint = found, ""
        return True


# Multiplications of a factorisation beyond which a sparse one with an order of its own is better.
_MOST_MULTIPLICATIONS = 3e7


class SundialsAid:
    """The ``cotree_sundials_aid`` of a job, with all that it points to.

    ``is_wide``: a sparse factorisation would be much cheaper than the banded one.
    """

    def __init__(self, engine: Engine, row: Method, problem: Problem, model: Any) -> None:
        ffi, n = engine.library.ffi, problem.n_states
        c = self.address = ffi.new("cotree_sundials_aid *")
        c.sundials, c.corrector = engine.functions, row.corrector
        # What is left of the sensitivities' equations changes with the states. Where no test sees
        # it, the iteration takes at least a given number of corrections.
        c.are_followed = (
            problem.n_sensitivities > 0 and not problem.settings.error_test_sensitivities
        )
        if problem.n_algebraic and not row.keeps_algebraic:
            # What is left after an elimination has no pattern.
            c.lower = c.upper = n - problem.n_algebraic - 1
        else:
            # Where no rate depends on a state, there are no arrays.
            n_nonzeros = model.n_nonzeros
            starts = ffi.unpack(model.column_starts, n + 1) if n_nonzeros else [0] * (n + 1)
            rows = ffi.unpack(model.row_indices, n_nonzeros) if n_nonzeros else []
            from cotree.linear.plan import narrow_band

            c.lower, c.upper, order = narrow_band(n, starts, rows)
            if order is not None:
                self._order = c.places = ffi.new("int[]", order.tolist())
        # A banded factorisation multiplies about n l (l + u) times.
        self.is_wide = bool(n * c.lower * (c.lower + c.upper) > _MOST_MULTIPLICATIONS)
