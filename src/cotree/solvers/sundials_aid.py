"""Needs of SUNDIALS' steppers besides a job: functions, and the order of a banded Jacobian.

The integrators are those of a library that :mod:`cotree.solvers.sundials_library` finds. Their
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

from cotree.linear.plan import narrow_band

if TYPE_CHECKING:
    from cotree.solvers.engine import Engine
    from cotree.solvers.methods import Method
    from cotree.solvers.problem import Problem

# Multiplications of a factorisation beyond which a sparse one with an order of its own is better.
_MOST_MULTIPLICATIONS = 3e7


class SundialsAid:
    """The ``cotree_sundials_aid`` of a job, with all that it points to.

    Parameters
    ----------
    engine : Engine
        That of the job.
    row : Method
        The method.
    problem : Problem
        The problem.
    model : cotree_model
        Its model, as the engine sees it.

    Attributes
    ----------
    address : object
        Pointer to the structure.
    is_wide : bool
        Whether a sparse factorisation would be much cheaper than the banded one.
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
            c.lower, c.upper, order = narrow_band(n, starts, rows)
            if order is not None:
                self._order = c.places = ffi.new("int[]", order.tolist())
        # A banded factorisation multiplies about n l (l + u) times.
        self.is_wide = bool(n * c.lower * (c.lower + c.upper) > _MOST_MULTIPLICATIONS)
