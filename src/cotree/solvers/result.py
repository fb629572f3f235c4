"""Results of a simulation by name, and the trajectory that every solver returns.

:mod:`cotree.results` adds figures.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from cotree.errors import ModelError, nearest
from cotree.files import write_csv
from cotree.report import Report, Reported, Values, counted, frame
from cotree.units import quotient

if TYPE_CHECKING:
    import os
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from cotree.equations import PositionRow


class UnknownNameError(ModelError, KeyError):
    """Raised if a result does not contain a name."""

    def __str__(self) -> str:
        """Return the message without the quotes that KeyError would add."""
        return str(self.args[0]) if self.args else ""


@dataclass(frozen=True, eq=False)
class EventTimes:
    """The times of an event in a simulation, and the states before and after each occurrence.

    Attributes
    ----------
    t : ndarray, shape (n_events,)
        Times, [s].
    y_before, y_after : ndarray, shape (n_states, n_events)
        States, including modes.
    s : ndarray, shape (n_parameters, n_events)
        Sensitivities of the times, [s / parameter unit].
    """

    t: FloatArray
    y_before: FloatArray
    y_after: FloatArray
    s: FloatArray


# Key of a record's ``__dict__`` under which the functions of deferred fields are stored.
_PENDING = "_pending"


def deferred(**makes: Callable[[], Mapping[str, Any]]) -> dict[str, Any]:
    """Return an item for a record's ``__dict__`` that defers the computation of fields.

    ``makes`` contains one function per field, which returns the field and all fields that are
    computed together. Several threads may call it at the same time.
    """
    return {_PENDING: makes}


@dataclass(frozen=True, eq=False, repr=False)
class RunRecord(Reported):
    """The numerical results of one simulation.

    Outputs, inputs, events and parameter values are evaluated when they are first read. An output
    that is undetermined at a stored time then raises ``SingularSystemError``.

    Attributes
    ----------
    t : ndarray, shape (n_t,)
        Times, [s].
    y : ndarray, shape (n_states, n_t)
        States.
    s : ndarray, shape (n_states, n_parameters, n_t)
        Sensitivities of the states, [state unit / parameter unit].
    states, outputs, inputs : tuple of str
        Names along the first axes of ``y``, ``output_values`` and ``input_values``.
    output_values, input_values : ndarray, shape (n_outputs, n_t) and (n_inputs, n_t)
        Outputs and inputs.
    output_sensitivities : ndarray, shape (n_outputs, n_parameters, n_t)
        Sensitivities of the outputs.
    parameters_of_sensitivity : tuple of str
        Names along the second axis of ``s``.
    units : mapping of str to str
        Unit of each name that has one.
    status : int
        0 if the integration succeeded, negative if it stopped early.
    message : str
        The solver's report.
    statistics : Statistics
        Work done by the solver.
    times : mapping of str to float
        Time of each stage, [s]: formulate, generate, compile, start (operating point or initial
        values), integrate.
    drift : Drift or None
        Residuals of the constraints along the run; None if the model has no constraints.
    redundant : int
        The largest number of constraints that follow from the others during the run.
    events : mapping of str to EventTimes
        Times and states of each event of the scene.
    parameter_values : mapping of str to float
        Values of the tunable and derived parameters.
    positions : tuple of PositionRow
        Positions in networks that are sums of states; ``result["k.s"]`` also returns them.
    """

    t: FloatArray
    y: FloatArray
    s: FloatArray
    states: tuple[str, ...]
    outputs: tuple[str, ...]
    output_values: FloatArray
    output_sensitivities: FloatArray
    inputs: tuple[str, ...]
    input_values: FloatArray
    parameters_of_sensitivity: tuple[str, ...]
    units: Mapping[str, str]
    status: int
    message: str
    statistics: Statistics
    times: Mapping[str, float] = field(default_factory=dict)
    drift: Drift | None = None
    redundant: int = 0
    events: Mapping[str, EventTimes] = field(default_factory=dict)
    parameter_values: Mapping[str, float] = field(default_factory=dict)
    positions: tuple[PositionRow, ...] = ()

    # Type checkers do not see this method, so they report unknown attributes.
    if not TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any:
            """Compute a deferred field, and the fields that the same function returns."""
            own = vars(self)
            pending = own.get(_PENDING, {})
            make = pending.get(name)
            if make is not None:
                made = make()
                for key, value in made.items():
                    own.setdefault(key, value)  # if two threads compute it, the first value is kept
                # A new dict is stored, because records copied by `changed` share the old one.
                own[_PENDING] = {key: row for key, row in pending.items() if key not in made}
            if name in own:  # another thread may have computed it in the meantime
                return own[name]
            raise AttributeError(f"'{type(self).__name__}' object has no attribute '{name}'")

    def __getstate__(self) -> dict[str, Any]:
        """Return all values, because the functions of deferred fields cannot be pickled."""
        own = vars(self)
        for name in own.get(_PENDING, ()):
            getattr(self, name)
        return {name: value for name, value in own.items() if name != _PENDING}

    def __repr__(self) -> str:
        return f"<Result of {len(self.states)} states at {len(self.t)} times: {self.message}>"

    @property
    def success(self) -> bool:
        """Whether the integration reached its end."""
        return self.status == 0

    def __contains__(self, name: object) -> bool:
        """Return whether a name is "t" or the name of a state, position, output or input."""
        return name == "t" or name in (*self._known, *self.inputs)

    @property
    def _known(self) -> tuple[str, ...]:
        """Names of the states, positions and outputs, which have sensitivities."""
        return (*self.states, *(row.name for row in self.positions), *self.outputs)

    def __getitem__(self, name: str) -> FloatArray:
        """Return a state, position, output or input over time, shape (n_t,); "t" is the time.

        Raises UnknownNameError, which is also a KeyError, if the name is unknown.
        """
        if name == "t":
            return self.t
        for names, values in self._groups():
            if name in names:
                row: FloatArray = values[names.index(name)]
                return row
        known = [*self._known, *self.inputs]
        raise UnknownNameError(f"There is no state, output or input '{name}'{_hint(name, known)}")

    def sensitivity(self, name: str, parameter: str) -> FloatArray:
        """Return the derivative of a state, position or output with respect to a parameter.

        It has shape (n_t,), in [unit of name / unit of parameter]. Raises UnknownNameError if there
        is no such variable, or the sensitivities to this parameter were not requested.
        """
        column = self._column(parameter)
        # Inputs are not in the groups, because they have no sensitivities.
        for names, values in self._groups(("s", "output_sensitivities")):
            if name in names:
                row: FloatArray = values[names.index(name), column]
                return row
        raise UnknownNameError(f"There is no state or output '{name}'{_hint(name, self._known)}")

    def event_sensitivity(self, event: str, parameter: str) -> FloatArray:
        """Return the derivatives of an event's times with respect to a parameter.

        They have shape (n_events,), in [s / unit of parameter]. Raises UnknownNameError if the
        event is unknown, or the model has no sensitivities to this parameter.
        """
        column = self._column(parameter)
        if event not in self.events:
            raise UnknownNameError(f"There is no event '{event}'{_hint(event, self.events)}")
        row: FloatArray = self.events[event].s[column]
        return row

    def _column(self, parameter: str) -> int:
        if parameter not in self.parameters_of_sensitivity:
            raise UnknownNameError(
                f"Sensitivities to '{parameter}' were not requested"
                f"{_hint(parameter, self.parameters_of_sensitivity)}"
            )
        return self.parameters_of_sensitivity.index(parameter)

    def unit(self, name: str) -> str:
        """Return the unit of a state, output, input or parameter, or "" if it is unknown."""
        if name == "t":
            return "s"
        known = {*self._known, *self.inputs, *self.parameters_of_sensitivity}
        if name not in self.units and name not in known:
            raise UnknownNameError(
                f"There is no quantity '{name}'{_hint(name, {*known, *self.units})}"
            )
        return self.units.get(name, "")

    def columns(self) -> dict[str, FloatArray]:
        """Return all columns of a table by their titles.

        The columns are t, states, positions, outputs and inputs, then sensitivities with titles
        "d(name)/d(parameter)". Each has shape (n_t,).
        """
        table = {"t": self.t}
        for names, values in self._groups():
            table.update(zip(names, values, strict=True))
        for name in self._known:
            for parameter in self.parameters_of_sensitivity:
                table[f"d({name})/d({parameter})"] = self.sensitivity(name, parameter)
        return table

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with the columns of ``columns()``, units in ``attrs["units"]``.

        Raises Error if pandas is not installed.
        """
        table = frame(self.columns())
        own = {"t": "s", **self.units}
        table.attrs["units"] = {name: own[name] for name in table.columns if own.get(name)}
        return table

    def to_csv(self, path: str | os.PathLike[str]) -> None:
        """Write the columns of ``columns()`` to a CSV file, with all digits of each number.

        If the call is interrupted, an older file remains unchanged. Raises SceneError if the file
        cannot be written.
        """
        table = self.columns()
        write_csv(path, itertools.chain([table], zip(*table.values(), strict=True)))

    def report(self) -> Report:
        """Build the report: message, last point with 10 digits, events, and work of the solver.

        In notebooks it also contains initial, least and largest values.
        """
        size = f"{counted(len(self.states), 'state')} at {counted(len(self.t), 'time')}"
        tables, span = [], ""
        if self.t.size:
            span = f", t = {self.t[0]:.6g} to {self.t[-1]:.6g} s"
            end = f"{'end' if self.success else 'last good point'}: t = {self.t[-1]:.10g} s"
            followers = [row.name for row in self.positions]
            groups = {end: (*self.states, *followers), "outputs": self.outputs}
            for caption, names in (groups | {"inputs": self.inputs}).items():
                rows = [_row(name, self.unit(name), self[name]) for name in names]
                tables.append(_values(caption, rows))
            for to in self.parameters_of_sensitivity:
                rows = [
                    _row(
                        f"d({name})/d({to})",
                        quotient(self.unit(name), self.unit(to)),
                        self.sensitivity(name, to),
                    )
                    for name in self._known
                ]
                tables.append(_values(f"sensitivities to {to}", rows))
        events = [
            f"Event '{name}' occurred {counted(len(row.t), 'time')}"
            + (f", last at t = {row.t[-1]:.10g} s." if row.t.size else ".")
            for name, row in self.events.items()
        ]
        work, drift = self.statistics, self.drift
        lines = [
            f"{work.method}: {work.n_steps} steps, {work.nfev} evaluations, {work.njev} Jacobians."
        ]
        if drift is not None:
            held = f"Constraints held to {drift.worst:.1g}"
            lines.append(f"{held}, largest correction {drift.correction:.1g}.")
        if self.redundant:
            lines.append(f"Redundant constraints: {self.redundant}; reactions are not unique.")
        if self.times:
            stages = ", ".join(f"{stage} {seconds:.3g} s" for stage, seconds in self.times.items())
            lines.append(f"Time: {stages}.")
        return Report(f"Result of {size}{span}", self.message, *tables, *events, *lines)

    def _groups(
        self, fields: Sequence[str] = ("y", "output_values", "input_values")
    ) -> Iterator[tuple[tuple[str, ...], FloatArray]]:
        """Yield names and values, or sensitivities, of states, positions, outputs and inputs."""
        # A generator evaluates outputs only when they are needed.
        of_states = getattr(self, fields[0])
        yield self.states, of_states
        if self.positions:
            sums = [row.sum_of(of_states.T).T for row in self.positions]
            yield tuple(row.name for row in self.positions), np.array(sums)
        for names, name in zip((self.outputs, self.inputs), fields[1:], strict=False):
            yield names, getattr(self, name)


def _hint(name: str, known: Iterable[str]) -> str:
    """Return the end of a message, which suggests the most similar known name."""
    hint = nearest(name, known)
    return hint if hint.endswith("?") else f"{hint}."


FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Statistics:
    """Work done by one integration.

    Attributes
    ----------
    method : str
        Name of the method, never "auto".
    nfev, njev : int
        Numbers of right-hand side calls, including those for differences, and of state Jacobians.
    nlu : int
        Number of factorisations, 0 if the solver does not report it.
    n_steps : int
        Number of accepted steps.
    seconds : float
        Wall-clock time of the integration, [s].
    compile_seconds : float
        Wall-clock time in which the method's C code was compiled, once on a machine, [s].
    began_with : str
        The method that ran until the problem became stiff, or empty. The numbers above include its
        work.
    """

    method: str
    nfev: int
    njev: int
    nlu: int
    n_steps: int
    seconds: float
    compile_seconds: float = 0.0
    began_with: str = ""


@dataclass(frozen=True, eq=False)
class Drift:
    """Violation of the constraints along a motion.

    Attributes
    ----------
    names : tuple of str
        Names of the constraints, constraint rates and quaternion norms.
    residual : ndarray, shape (n_rows, n_t)
        Residuals at the stored points, in the units of the constraints. The last point of a failed
        integration may not be projected.
    correction : float
        The largest change of a state in a projection, divided by max(abs(state), 1). It includes
        the error of the step, so it increases with the tolerances.
    """

    names: tuple[str, ...]
    residual: FloatArray
    correction: float

    @property
    def worst(self) -> float:
        """The largest magnitude of all residuals."""
        return float(np.max(np.abs(self.residual), initial=0.0))


# Values of ``Trajectory.status`` for failures and reached limits.
FAILED, BUDGET_SPENT = -1, -2


@dataclass(frozen=True, eq=False)
class Trajectory:
    """The result of an integration, which may have stopped early."""

    #: Times, [s]. After a failure, the last one belongs to the last valid point.
    t: FloatArray
    z: FloatArray  # states and sensitivities at these times
    status: int  # 0: success, -1: the integration failed, -2: a limit was reached
    message: str  # message on the end of the run
    statistics: Statistics  # numbers of steps, evaluations and factorisations
    #: Residuals of the constraints along the run; None without constraints.
    drift: Drift | None = None
    #: One row for each event that occurred: time, [s], index of the event, derivatives of the time
    #: with respect to the parameters, states before, and states after.
    events: FloatArray = field(default_factory=lambda: np.zeros((0, 2)))
    #: Whether the run failed because the equations could not be solved with any step size.
    is_unsolved: bool = False


def _row(title: str, unit: str, values: FloatArray) -> tuple[object, ...]:
    # Sensitivities of outputs that are not unique are nan at all times.
    is_known = bool(np.any(np.isfinite(values)))
    low, high = (np.nanmin(values), np.nanmax(values)) if is_known else (np.nan, np.nan)
    return (title, float(values[-1]), unit, *map(float, (values[0], low, high)))


def _values(caption: str, rows: Sequence[Sequence[object]]) -> Values:
    head = ("", "end", "unit", "start", "least", "largest")
    return Values(head, rows, caption, digits=10, in_text=3)
