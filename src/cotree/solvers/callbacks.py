"""Functions of Python that a job in C calls: inputs, samples, and solutions for unknowns.

The Newton matrix of SUNDIALS' methods is factorised by cotree's own C, once for the states and all
their sensitivities.

CVODE and IDA integrate states and sensitivities as one vector. In CVODES and IDAS each parameter
has a vector, so that the error test and the iteration use the largest norm, not the mean. Two
correctors (W. F. Feehery, J. E. Tolsma and P. I. Barton, Applied Numerical Mathematics 25, 1997,
for the first; T. Maly and L. R. Petzold, ibid. 20, 1996, for the second):

- staggered: the states are solved for and tested, then their sensitivities;
- simultaneous: one iteration solves for all.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error
from cotree.model.arrays import CObjects

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.methods import Method
    from cotree.solvers.engine import Engine
    from cotree.solvers.problem import Problem
    from cotree.solvers.result import FloatArray


class Callbacks(CObjects):
    """The functions and other objects of one job, which stay alive with it."""

    def __init__(self, ffi: Any, rescue: Rescue, *kept: Any) -> None:
        super().__init__(ffi, *kept)
        self._rescue = rescue

    def input_function(self, functions: Mapping[int, Callable[[float], float]]) -> Any:
        """Return a C function that evaluates inputs in Python."""
        errors = self.errors

        def evaluate(t: float, u: Any, context: Any) -> int:
            if errors:  # C may first try a shorter step
                return -1
            for place, function in functions.items():
                u[place] = function(t)
            return 0

        return self.callback("cotree_input_function", evaluate)

    def reach(self, reach: Callable[[float, FloatArray], None], size: int) -> Any:
        """Return a C function that is called at the start of each segment."""
        ffi = self._ffi

        def call(t: float, z: Any, context: Any) -> int:
            reach(t, np.frombuffer(ffi.buffer(z, 8 * size)))
            return 0

        return self.callback("cotree_reach", call)

    def helper(self, n_states: int) -> Any:
        """Return C functions that search for points if the iterations in C fail."""
        rescue, ffi = self._rescue, self._ffi

        def find_unknowns(t: float, x: Any, context: Any) -> int:
            point = np.frombuffer(ffi.buffer(x, 8 * n_states))
            return int(not rescue.find_unknowns(t, point))

        helper = self.new("cotree_helper *")
        helper.find_unknowns = self.callback("cotree_find_unknowns", find_unknowns)
        return helper


class Rescue:
    """Search for points of one integration that the iterations in C do not find.

    ``reason`` states why the last point was not found, without a capital and a full stop.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.reason = ""

    def find_unknowns(self, t: float, y: FloatArray) -> bool:
        """Solve for the algebraic unknowns in place; store the reason of a failure."""
        from cotree.model.algebraic import Algebraic

        problem = self.problem
        assert problem.state_rhs is not None  # a compiled model has both
        assert problem.jacobian is not None
        unknowns = Algebraic(
            problem.state_rhs, problem.jacobian, problem.names, problem.n_algebraic
        )

        try:
            # A copy, since C continues with the old point after a failure.
            found = y.copy()
            unknowns.solve(t, found)
        except Error as error:
            self.reason = str(error).rstrip(".")
            return False
        y[:], self.reason = found, ""
        return True


# Number of multiplications of a banded factorisation above which a sparse one is better.
_MOST_MULTIPLICATIONS = 3e7


class SundialsAid:
    """The ``cotree_sundials_aid`` of a job, with the arrays that it points to.

    ``is_wide``: a sparse factorisation would be much cheaper than the banded one.
    """

    def __init__(self, engine: Engine, row: Method, problem: Problem, model: Any) -> None:
        ffi, n = engine.library.ffi, problem.n_states
        c = self.address = ffi.new("cotree_sundials_aid *")
        c.sundials, c.corrector = engine.functions, row.corrector
        # Residuals of sensitivities change with the states. Without an error test of sensitivities,
        # the iteration makes at least a given number of corrections.
        c.are_followed = (
            problem.n_sensitivities > 0 and not problem.settings.error_test_sensitivities
        )
        if problem.n_algebraic and not row.keeps_algebraic:
            # The reduced Jacobian is dense.
            c.lower = c.upper = n - problem.n_algebraic - 1
        else:
            # If no rate depends on a state, there are no arrays.
            n_nonzeros = model.n_nonzeros
            starts = ffi.unpack(model.column_starts, n + 1) if n_nonzeros else [0] * (n + 1)
            rows = ffi.unpack(model.row_indices, n_nonzeros) if n_nonzeros else []
            from cotree.linear.elimination import narrow_band

            c.lower, c.upper, order = narrow_band(n, starts, rows)
            if order is not None:
                self._order = c.places = ffi.new("int[]", order.tolist())
        # A banded factorisation takes about n l (l + u) multiplications.
        self.is_wide = bool(n * c.lower * (c.lower + c.upper) > _MOST_MULTIPLICATIONS)
