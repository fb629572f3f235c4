"""The consistent start, and messages on given values that violate the constraints.

Given values are kept, and the others follow from the constraints. If the given values are nearly
consistent, the last of them are changed as little as possible, with a warning; otherwise an error
lists the residual of each joint. Values of the run have priority over those of the scene, which are
used in the scene's order. ``templates/runtime/start/cotree_assembly.c`` computes the start; a
``Report`` writes the messages.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, NoReturn

import numpy as np

from cotree.codegen.start_tables import start_tables
from cotree.errors import ParameterError, listed
from cotree.quiet import level_of_user

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    import numpy.typing as npt

    from cotree.equations import RedundantRow
    from cotree.model.arrays import Array
    from cotree.model.model import EvaluationPoint
    from cotree.model.start_in_c import StartCall

#: Relative changes of prescribed values above the first number are named in messages; residuals
#: below the second number count as zero.
_NOTICED, _MET = 1e-4, 1e-10

#: Largest number of residuals, and of changes, in a message.
_MOST_NAMED = 6

_LEVELS = ("positions", "velocities")


class Report:
    """Messages on a start whose given values violate the constraints, from results of C.

    Parameters
    ----------
    at : EvaluationPoint
        The model at the start.
    places : ndarray of int
        Indices of the states whose values the run gives, in its order.
    call : StartCall
        The call; its report arrays are set here.
    """

    def __init__(self, at: EvaluationPoint, places: npt.NDArray[np.intc], call: StartCall) -> None:
        layout = at.model.layout
        self._model, self._call = at.model, call
        rows = start_tables(layout).rows
        self._names = [row.name for row in rows]
        self._is_length = np.array([row.unit.startswith("m") for row in rows], dtype=bool)
        n, m = len(layout.states), len(layout.sensitivities)
        self._values = [*at.model.states, *layout.start_rows]
        self._c = c = call.c.report = call.new("cotree_start_report *")
        self._before, self._after, self._changes, self._left = (
            np.zeros(size) for size in (n, n, n + len(rows), len(rows))
        )
        for name in ("before", "after", "changes", "left"):
            setattr(c, name, call.pointer(getattr(self, f"_{name}")))
        # A run's own values come first, then the scene's in its order.
        names = [*(at.model.states[i] for i in places), *layout.given_names, *at.model.states]
        order = {name: i for i, name in enumerate(dict.fromkeys(names))}
        c.ranks = call.new("int[]", [order.get(name, 0) for name in self._values])
        self._follows = np.zeros((m, len(self._values)), dtype=np.intc)
        c.follows = call.pointer(self._follows, "int")

    @property
    def is_mended(self) -> bool:
        """Whether given values had to change."""
        return bool(np.any(self._changes))

    def _moved(self) -> list[str]:
        """List the given values that have changed, and the residuals of relaxed conditions."""
        n, size = len(self._before), np.abs(self._changes)
        states = self._model.states
        found = [
            f"'{states[i]}' from {self._before[i]:.6g} to {self._after[i]:.6g}"
            for i in np.flatnonzero(size[:n] > _NOTICED)
        ]
        own = self._changes[n:] * self._units
        found += [
            f"'{self._names[i]}' by {own[i]:.3g}" for i in np.flatnonzero(size[n:] > _NOTICED)
        ]
        return found[:_MOST_NAMED]

    @property
    def _units(self) -> Array:
        """Return the scale of each residual in its own unit."""
        return np.where(self._is_length, self._c.length, 1.0)

    def warn(self) -> None:
        """Warn of given values that had to change."""
        moved = self._moved()
        if moved:
            warnings.warn(
                f"initial values were changed to satisfy the constraints: {', '.join(moved)}",
                RuntimeWarning,
                stacklevel=level_of_user(),
            )

    def note(self, *, is_warning: bool) -> str:
        """Name the given values that change with parameters; empty if none does."""
        following: dict[str, list[str]] = {}
        for value, name in self._following():
            following.setdefault(value, []).append(name)
        if not following:
            return ""
        shown = listed(
            f"'{value}' with {listed(map(repr, names))}" for value, names in following.items()
        )
        message = (
            f"initial values change with parameters, so that those given before them are kept: "
            f"{shown}. Give them as expressions of these parameters, or leave them out"
        )
        if is_warning:
            warnings.warn(message, RuntimeWarning, stacklevel=level_of_user())
        return f"{message[0].upper()}{message[1:]}."

    def _following(self) -> Iterator[tuple[str, str]]:
        for j, i in np.argwhere(self._follows).tolist():
            yield self._values[i], self._model.sensitivities[j]

    def refuse(self, y: Array, *, is_of_derivatives: bool) -> NoReturn:
        """Raise the error of a start near y that does not exist, or has no derivative."""
        for first in self._model.layout.quaternions:
            if not np.any(y[first : first + 4]):
                raise ParameterError(
                    f"the initial quaternion from '{self._model.states[first]}' on is zero: give "
                    "it a length, or angles"
                )
        if is_of_derivatives:
            self._refuse_derivative()
        size = np.nan_to_num(np.abs(self._left), nan=np.inf)
        order = [i for i in np.argsort(-size * self._units)[:_MOST_NAMED] if size[i] > _MET]
        own = self._left * self._units
        shown = ", ".join(f"{self._names[i]} = {own[i]:.3g}" for i in order)
        moved = self._moved()
        nearest = f". The nearest valid ones would change {', '.join(moved)}" if moved else ""
        raise ParameterError(
            f"the initial {_LEVELS[self._c.level]} violate the constraints, and the given values "
            f"cannot be adjusted; residuals: {shown}{nearest}. Change initial values or "
            "lengths of these joints, or give fewer initial values"
        )

    def _refuse_derivative(self) -> NoReturn:
        size = np.abs(self._left)
        order = [i for i in np.argsort(-size)[:4] if size[i] > 0.1 * np.max(size)]
        named = ", ".join(f"'{self._names[i]}'" for i in order)
        raise ParameterError(
            f"the start has no derivative by '{self._model.sensitivities[self._c.column]}': it "
            f"changes the {_LEVELS[self._c.level]} that the constraints require, and no change of "
            f"the states follows to first order: {named} would be violated. The constraints are "
            "dependent there: start elsewhere, let all affected values depend on that parameter, "
            "or compile without this sensitivity"
        )


def contradiction(
    at: EvaluationPoint, y: Array, s: Array, is_apart: npt.NDArray[np.bool_]
) -> ParameterError:
    """Return the error of initial values that contradict those of states or sources.

    Parameters
    ----------
    at : EvaluationPoint
        The model at the start.
    y, s : ndarray, shapes (n_states,) and (n_states, n_parameters)
        The start.
    is_apart : ndarray of bool, shape (1 + n_parameters, n_redundant)
        Which redundant values, and which of their derivatives, contradict it.
    """
    rows, m, n = at.model.layout.redundant, len(at.model.sensitivities), is_apart.shape[1]
    if is_apart[0].any():
        # The kernel ends with these two rows: derived values, then given values.
        follows, given = at.call("start", y)[-2 * n :].reshape(2, n)
        apart = {
            f"'{rows[i].name}' is given as {given[i]:.6g} but is {follows[i]:.6g} by "
            f"{_origin(rows[i].states, at.t)}": rows[i]
            for i in np.flatnonzero(is_apart[0])
        }
        return ParameterError(
            f"initial values contradict each other: {'; '.join(apart)}. Give values that agree, or "
            f"leave these out{_hint(apart.values())}"
        )
    # For each parameter, the same two rows of derivatives are last.
    found = at.call("start_sensitivity", y, s).reshape(m, -1)[:, -2 * n :].reshape(m, 2, n)
    apart = {
        f"d({rows[i].name})/d({at.model.sensitivities[j]}) is {found[j, 1, i]:.6g} as given but "
        f"{found[j, 0, i]:.6g} by {_origin(rows[i].states, at.t)}": rows[i]
        for j, i in np.argwhere(is_apart[1:])
    }
    return ParameterError(
        "initial values agree for these parameters, but not as they change: "
        f"{'; '.join(apart)}. Give them by expressions that agree for all values of the "
        f"parameters, or leave these out{_hint(apart.values())}"
    )


def _hint(rows: Iterable[RedundantRow]) -> str:
    """Return advice for positions that follow from those of nodes."""
    if not any(row.is_position for row in rows):
        return ""
    return (
        "; edges between the same nodes have one position, and positions along a circuit add up to "
        "zero: set the initial stretch of a spring by its free_length or free_angle"
    )


def _origin(states: Sequence[str], t: float) -> str:
    """Name the states or sources that determine a value."""
    if not states:
        return f"the sources at t = {t:g}"
    return ", ".join(f"'{name}'" for name in states)
