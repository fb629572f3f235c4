"""A problem with one parameter fixed, for optimisation over the others."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.estimation.estimated import Scaled

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.estimation.likelihood import Predictions
    from cotree.estimation.problem import Problem
    from cotree.estimation.rendezvous import Rendezvous

Array = npt.NDArray[np.float64]


class FixedProblem:
    """A problem with one of its parameters fixed.

    Parameters
    ----------
    problem : Problem
        The full problem.
    index : int
        Number of the parameter that is fixed.
    value : float
        Its value, on its scale.
    meeting : Rendezvous
        Computes predictions of the full problem.
    more_rows : callable, optional
        Prior residuals of the full problem.

    Attributes
    ----------
    scaled, measured, likelihood
        As of the problem, for the other parameters.
    more_rows : callable or None
        Prior residuals as a function of the other parameters.
    """

    def __init__(
        self,
        problem: Problem,
        index: int,
        value: float,
        meeting: Rendezvous,
        more_rows: Callable[[Array], tuple[Array, Array]] | None,
    ) -> None:
        self._index, self._value, self._meeting, self._more = index, value, meeting, more_rows
        self.scaled = Scaled([*problem.estimated[:index], *problem.estimated[index + 1 :]])
        self.measured, self.likelihood = problem.measured, problem.likelihood
        self.more_rows = None if more_rows is None else self._more_rows

    def free(self, theta: Array) -> Array:
        """Remove the fixed parameter."""
        return np.delete(theta, self._index)

    def whole(self, theta: Array) -> Array:
        """Insert the fixed parameter."""
        return np.insert(theta, self._index, self._value)

    def ask(self, number: int, theta: Any) -> Predictions:
        """Return predictions, like :meth:`Rendezvous.ask`."""
        found = self._meeting.ask(number, self.whole(theta))
        return replace(
            found,
            slopes=np.delete(found.slopes, self._index, axis=1),
            sigma_slopes=np.delete(found.sigma_slopes, self._index, axis=1),
        )

    def objective(self, number: int) -> float:
        """Evaluate the objective if no other parameter is left."""
        found = self._meeting.ask(number, self.whole(np.zeros(0)))
        value = -self.likelihood.log_likelihood(found)
        if self._more is not None:
            value += 0.5 * float(np.sum(self._more(self.whole(np.zeros(0)))[0] ** 2))
        return value if not found.message else np.inf

    def _more_rows(self, theta: Array) -> tuple[Array, Array]:
        assert self._more is not None
        rows, slopes = self._more(self.whole(theta))
        return rows, np.delete(slopes, self._index, axis=1)
