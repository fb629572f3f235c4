"""Points that iterations in C do not find: Python looks farther, and C goes on from there.

In: a ``Problem``, and a point that C is stuck at. Out: the point with its algebraic unknowns, or
on its constraints; or the sentence that says why there is none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.errors import Error
from cotree.model.algebraic import Algebraic

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.solvers.base import FloatArray
    from cotree.solvers.problem import Problem


class Rescue:
    """Looks farther for points of one integration.

    Parameters
    ----------
    problem : Problem
        A problem of a compiled model.

    Attributes
    ----------
    problem : Problem
        The same, or another one of the same kind.
    complaint : str
        The reason why the last point was not found, without a capital and a full stop; empty where
        it was, or nothing was asked.
    """

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        self.complaint = ""

    @property
    def is_needed(self) -> bool:
        """Return whether there may be anything to look for."""
        problem = self.problem
        # C asks for states after events that set them, and for algebraic unknowns anywhere.
        is_set = problem.events is not None and problem.settle is not None
        return is_set or problem.n_algebraic > 0

    def find_unknowns(self, t: float, y: FloatArray) -> bool:
        """Solve for the algebraic unknowns of all states, in place, from any guess."""
        problem = self.problem
        assert problem.state_rhs is not None  # of a compiled model
        assert problem.jacobian is not None
        unknowns = Algebraic(
            problem.state_rhs, problem.jacobian, problem.names, problem.n_algebraic
        )

        def find(point: FloatArray) -> FloatArray:
            unknowns.solve(t, point)
            return point

        return self._find(find, y)

    def find_states(self, t: float, y: FloatArray, kept: Sequence[int]) -> bool:
        """Move states onto the constraints, in place; tell whether that was possible.

        Parameters
        ----------
        t : float
            Time, [s].
        y : ndarray, shape (n_states,)
            States as an event set them.
        kept : sequence of int
            Places of those that stay as they are.
        """
        settle = self.problem.settle
        return settle is not None and self._find(lambda point: settle(t, point, kept), y)

    def _find(self, find: Callable[[FloatArray], FloatArray], y: FloatArray) -> bool:
        """Replace y by the point found from it; return False, and keep the reason, if none is."""
        try:
            # The search works on a copy: where it fails, C keeps the point that it had.
            y[:] = find(y.copy())
        except Error as error:
            self.complaint = str(error).rstrip(".")
            return False
        self.complaint = ""
        return True
