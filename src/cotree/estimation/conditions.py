"""Conditions (runs of a model) and measured values of an estimation problem."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.arguments import check_choice
from cotree.errors import ParameterError, check_known, nearest
from cotree.estimation.estimated import SCALES

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.compiled import Model
    from cotree.estimation.estimated import Array


#: Distributions of residuals; ``noise`` is the standard deviation or the Laplace scale.
DISTRIBUTIONS = ("normal", "laplace")


@dataclass(frozen=True, eq=False)
class Condition:
    """Conditions of a run in which values were measured.

    Attributes
    ----------
    name : str
        Name in messages and results.
    model : Model
        Model, compiled with sensitivities to all estimated parameters and initial values.
    parameters : mapping of str to str or float
        Values of model parameters: numbers or names of estimated parameters. Other parameters keep
        the model's values.
    initial : mapping of str to str or float
        Initial values of states, in the same form.
    inputs : mapping of str to object
        Inputs that replace those of the scene: numbers and tables, as in ``simulate``.
    t_start : float
        Start of the run, [s].
    columns : mapping of str to str
        State or output measured by each data column.
    before : Condition or None
        Previous run, whose steady state is the initial state of this one. It has the same model and
        may also start from a steady state. Values in ``initial`` take precedence over the steady
        state.
    """

    name: str
    model: Model
    parameters: Mapping[str, str | float] = field(default_factory=dict)
    initial: Mapping[str, str | float] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    t_start: float = 0.0
    columns: Mapping[str, str] = field(default_factory=dict)
    before: Condition | None = None

    def quantity(self, name: str) -> str:
        """Return the state or output that a column measures, or ``name`` if it is one itself."""
        # Columns are looked up first: a column named like a state may measure an added output.
        if name in self.columns:
            return self.columns[name]
        known = {*self.model.states, *self.model.outputs}
        if name in known:
            return name
        raise ParameterError(
            f"the model has no state or output '{name}'{nearest(name, {*known, *self.columns})}"
        )

    def column(self, quantity: str) -> str:
        """Return the column that measures a state or output; without one, return the argument."""
        return next((name for name, own in self.columns.items() if own == quantity), quantity)

    @property
    def chain(self) -> tuple[Condition, ...]:
        """The condition itself and all previous ones, from the last run to the first."""
        return (self, *(self.before.chain if self.before else ()))


@dataclass(frozen=True, eq=False)
class Measured:
    """Measured values, each with condition, time, observable and noise, in any order.

    Attributes
    ----------
    condition : ndarray of int, shape (n,)
        Index of the condition of each value.
    t : ndarray, shape (n,)
        Times, [s], not before the start of the condition.
    observable : sequence of str, n
        State or output that was measured.
    value : ndarray, shape (n,)
        Measured values, finite and not transformed.
    noise : sequence of str or float, n
        Standard deviations of the transformed values (scales of Laplace distributions): a positive
        number, a state or output of the model, or an estimated parameter, which need not be a
        parameter of the model.
    transformation : sequence of str, n
        One of ``SCALES`` for each value, or one for all.
    distribution : sequence of str, n
        One of ``DISTRIBUTIONS`` for each value, or one for all.
    """

    condition: npt.NDArray[np.intp]
    t: Array
    observable: Sequence[str]
    value: Array
    noise: Sequence[str | float]
    transformation: Sequence[str] | str = "lin"
    distribution: Sequence[str] | str = "normal"

    def __post_init__(self) -> None:
        for name in ("transformation", "distribution"):
            given = getattr(self, name)
            if isinstance(given, str):
                object.__setattr__(self, name, [given] * len(self))

    def __len__(self) -> int:
        return len(self.value)


def check_condition(condition: Condition, estimated: Sequence[str]) -> None:
    """Raise an error if a condition contains unknown names."""
    model, what = condition.model, f"condition '{condition.name}'"
    for kind, given, known in (
        ("parameter", condition.parameters, model.parameters),
        ("state", condition.initial, model.states),
    ):
        after = f", but the model has no such {kind}"
        check_known(given, known, f"{what} sets", after, ParameterError)
        for name, value in given.items():
            if not isinstance(value, str):
                continue
            after = ", which is not an estimated parameter"
            check_known([value], estimated, f"{what} sets '{name}' to", after, ParameterError)
            if name not in model.sensitivities:
                raise ParameterError(
                    f"{what} estimates '{name}', but the model was compiled without sensitivities "
                    "to it"
                )


def check_measured(
    measured: Measured, conditions: Sequence[Condition], estimated: Sequence[str]
) -> None:
    """Raise an error if a measured value has invalid data or an unknown name."""
    n = len(measured)
    for name, values in vars(measured).items():
        if len(values) != n:
            raise ParameterError(f"there are {n} values, but '{name}' has {len(values)} rows")
    for name, allowed in (("transformation", SCALES), ("distribution", DISTRIBUTIONS)):
        for value in getattr(measured, name):
            check_choice(value, f"the {name} of a measured value", allowed)
    for i in range(n):
        condition, t = conditions[int(measured.condition[i])], float(measured.t[i])
        where = f"value {i} of '{measured.observable[i]}' in condition '{condition.name}'"
        if not np.isfinite(measured.value[i]):
            raise ParameterError(f"{where} is {measured.value[i]}: remove the row")
        if measured.transformation[i] != "lin" and not measured.value[i] > 0.0:
            raise ParameterError(f"{where} is {measured.value[i]:g}, which has no logarithm")
        if not (np.isfinite(t) and t >= condition.t_start):
            raise ParameterError(
                f"{where} is at t = {t:g}, but the run begins at t = {condition.t_start:g}"
            )
        noise, known = measured.noise[i], (*condition.model.states, *condition.model.outputs)
        is_own = isinstance(noise, str) and noise not in estimated
        needed = [measured.observable[i], *([str(noise)] if is_own else [])]
        after = ", but the model has no such state or output"
        check_known(needed, known, f"{where} needs", after, ParameterError)
        if not isinstance(noise, str) and not (np.isfinite(noise) and noise > 0.0):
            raise ParameterError(f"{where} has the standard deviation {noise}: give a positive one")


class Columns:
    """Names and values of the parameters and initial values that one condition sets in a run.

    ``through``, (n_sensitivities, n_estimated), is one if the sensitivity parameter is tied to the
    estimated parameter, and zero otherwise.
    """

    def __init__(self, condition: Condition, columns: Sequence[str], names: Sequence[str]) -> None:
        model = condition.model
        defaults = dict(zip(model.parameters, model.default_parameters.tolist(), strict=True))
        given = {**defaults, **condition.parameters, **condition.initial}
        values = [given[name] for name in columns]
        self._numbers = np.array([0.0 if isinstance(v, str) else v for v in values], dtype=float)
        self._places = [(j, names.index(v)) for j, v in enumerate(values) if isinstance(v, str)]
        self.through = np.zeros((len(model.sensitivities), len(names)))
        for name, value in {**condition.parameters, **condition.initial}.items():
            if isinstance(value, str):
                self.through[model.sensitivities.index(name), names.index(value)] = 1.0

    def row(self, values: Array) -> Array:
        """Return a member's row for values of the estimated parameters."""
        row = self._numbers.copy()
        for j, k in self._places:
            row[j] = values[k]
        return row
