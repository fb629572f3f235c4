"""Sensitivities against finite differences over a range of step sizes.

In: a model compiled with sensitivities. Out: a report with the deviation over the step size for
each of them, and whether it is as small as rounding and integration errors allow.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from cotree.errors import Error, ParameterError, check_known
from cotree.report import Report, Reported, Table

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from typing import Unpack

    from cotree.model.model import CompiledModel
    from cotree.results import Result
    from cotree.scene.settings import SettingsDict


Array = npt.NDArray[np.float64]


class Model(Protocol):
    """A model that can be simulated: :class:`cotree.Model`."""

    states: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    sensitivities: tuple[str, ...]
    kernels: CompiledModel

    @property
    def simulate(self) -> Callable[..., Result]:
        """Its runs."""
        ...


@dataclass(frozen=True, eq=False)
class Experiment:
    """A run that is repeated with one value changed.

    Attributes
    ----------
    model : Model
        The model that runs.
    t_eval : ndarray, shape (n_t,)
        Times to report, [s]; the run goes from the first to the last.
    settings : mapping of str to object
        Further arguments of :meth:`cotree.Model.simulate`: method, tolerances, parameters, ...
    """

    model: Model
    t_eval: Array
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities: states, then outputs."""
        return (*self.model.states, *self.model.outputs)

    def run(self, changed: Mapping[str, float] | None = None) -> Result:
        """Integrate with some parameters or initial values changed.

        Raises
        ------
        ModelError
            If a value is refused.
        SolveError
            If the integration fails.
        """
        parameters, initial = self._values("parameters"), self._values("initial")
        for name, value in (changed or {}).items():
            # A state stands for its initial value, as among sensitivities.
            (initial if name in self.model.states else parameters)[name] = value
        return self.model.simulate(
            (float(self.t_eval[0]), float(self.t_eval[-1])),
            self.t_eval,
            # A run that stops early has not all the points.
            throw=True,
            **{**self.settings, "parameters": parameters, "initial": initial},
        )

    def value(self, name: str) -> float:
        """Return the parameter's value, or the initial value of a state."""
        p = self.model.kernels.parameter_array(self._values("parameters"))
        if name in self.model.states:
            # The scene's own value, before constraints may have moved it.
            own = self.model.kernels.initial(p)[self.model.states.index(name)]
            return float(self._values("initial").get(name, own))
        return float(p[self.model.parameters.index(name)])

    def size(self, name: str, result: Result) -> float:
        """Return the size that steps of a parameter or initial value are relative to.

        It is the parameter's own size. An initial value is often zero or small by chance, so its
        size is the largest value of the state in ``result``. Where that is zero too, it is 1 in
        the unit at hand, since nothing better is known.
        """
        if name in self.model.states:
            size = float(np.max(np.abs(result[name])))
        else:
            size = abs(self.value(name))
        return size or 1.0

    def central_difference(self, name: str, step: float) -> Array:
        """Differentiate states and outputs by a central difference.

        Parameters
        ----------
        name : str
            A parameter, or a state whose initial value is meant.
        step : float
            Half the distance between the two runs, in the unit of ``name``.

        Returns
        -------
        ndarray, shape (n_states + n_outputs, n_t)

        Raises
        ------
        ModelError
            If the model refuses one of the two values.
        SolveError
            If one of the two integrations fails.
        """
        value = self.value(name)
        above, below = value + step, value - step
        difference = quantities(self.run({name: above})) - quantities(self.run({name: below}))
        # The distance as rounded, not 2 * step: at small steps the two differ.
        return difference / (above - below)

    def _values(self, key: str) -> dict[str, float]:
        if key != "parameters":
            return dict(self.settings.get(key) or {})
        p = self.model.kernels.parameter_array(self.settings.get(key))
        return dict(zip(self.model.parameters, p.tolist(), strict=True))


def quantities(result: Result) -> Array:
    """Stack states and outputs, shape (n_states + n_outputs, n_t)."""
    return np.vstack([result.y, result.output_values])


def sensitivities(result: Result, name: str) -> Array:
    """Stack the sensitivities of states and outputs, shape (n_states + n_outputs, n_t)."""
    j = result.parameters_of_sensitivity.index(name)
    return np.vstack([result.s[:, j], result.output_sensitivities[:, j]])


# Relative steps from 1e-1 to 1e-9 in half decades: from where truncation shows in any nonlinear
# system to where rounding hides everything.
_RELATIVE_STEPS = tuple(10.0 ** (-1 - k / 2) for k in range(17))
_N_TIMES = 21
_RTOL = 1e-12
# The absolute tolerance is this much less.
_ATOL_SHARE = 1e-2
# The second run is this much looser; what changes is the integration error of the looser one.
_LOOSER = 10.0
# A central difference at its best step has an error of about eps**(2/3), see `check_sensitivities`.
_ROUNDING = 10.0 * float(np.finfo(float).eps) ** (2.0 / 3.0)


@dataclass(frozen=True)
class ParameterCheck(Reported):
    """One sensitivity against finite differences.

    Attributes
    ----------
    name : str
        The parameter, or the state whose initial value is meant.
    value : float
        Its value, in its own unit.
    steps : tuple of float
        Step sizes h, in the same unit, falling.
    deviations : tuple of float
        V(h) = max abs(S - FD(h)) over states, outputs and times; nan where a run failed.
    quantities : tuple of str
        The state or output where that maximum is found, "" where a run failed.
    closest : str
        The state or output whose least deviation comes closest to what is allowed.
    deviation, tolerance : float
        Its least deviation over all steps, and what is allowed.
    step : float
        The step of this deviation; nan without one.
    note : str
        A remark for the reader: the parameter reaches nothing, or it could not be checked.
    """

    name: str
    value: float
    steps: tuple[float, ...]
    deviations: tuple[float, ...]
    quantities: tuple[str, ...]
    closest: str
    deviation: float
    tolerance: float
    step: float
    note: str = ""

    @property
    def passed(self) -> bool:
        """Return whether the deviation is as small as it should be; False where it is not known."""
        # A deviation that is not known is nan, which no comparison accepts.
        return self.deviation <= self.tolerance

    def report(self) -> Report:
        """Build the report: the verdict, and the deviation over the step size."""
        found = f"{'PASS' if self.passed else 'FAIL'}  {self.name} = {self.value:.10g}"
        if not math.isnan(self.deviation):
            found += (
                f": closest is {self.closest}, {self.deviation:.2e} at h = {self.step:.2e}, "
                f"allowed {self.tolerance:.2e}"
            )
        steps = zip(self.steps, self.deviations, self.quantities, strict=True)
        rows = [
            (f"{h:.2e}", "not available" if math.isnan(v) else f"{v:.3e}", name)
            for h, v, name in steps
        ]
        caption = f"{found}; {self.note}" if self.note else found
        return Report("", Table(("h", "max |S - FD(h)|", "of"), rows, caption, "rrl", most=0))


@dataclass(frozen=True, repr=False)
class CheckReport(Reported):
    """Sensitivities of a model against finite differences.

    Attributes
    ----------
    rows : tuple of ParameterCheck
        One for each parameter.
    t_end : float
        End of the runs, [s].
    method : str
        The method of all runs.
    rtol : float
        Their relative tolerance.
    """

    rows: tuple[ParameterCheck, ...]
    t_end: float
    method: str
    rtol: float

    def __repr__(self) -> str:
        return f"<CheckReport: {self.verdict}>"

    @property
    def passed(self) -> bool:
        """Return whether every parameter passed."""
        return all(row.passed for row in self.rows)

    @property
    def heading(self) -> str:
        """Describe the comparison."""
        return (
            f"sensitivities S against central differences FD(h) at {_N_TIMES} times to "
            f"t = {self.t_end:g} s, {self.method}, rtol {self.rtol:g}"
        )

    @property
    def verdict(self) -> str:
        """Describe how many parameters passed, and which did not."""
        failed = [row.name for row in self.rows if not row.passed]
        if not failed:
            return f"all sensitivities passed: {len(self.rows)}"
        return f"{len(failed)} of {len(self.rows)} sensitivities failed: {', '.join(failed)}"

    def report(self) -> Report:
        """Build the report: of each parameter the deviations in text, and the verdict in HTML."""
        head = ("parameter", "value", "closest", "deviation", "allowed", "verdict")
        rows = [
            (
                *(row.name, row.value, row.closest, row.deviation, row.tolerance),
                "PASS" if row.passed else f"FAIL {row.note}".strip(),
            )
            for row in self.rows
        ]
        steps = (part for row in self.rows for part in row.report().parts)
        return Report(self.heading, *steps, Table(head, rows, in_text=0), self.verdict)


def check_sensitivities(
    model: Model,
    sensitivities: Sequence[str] | None = None,
    t_end: float | None = None,
    plain: Model | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    method: str | None = None,
    report: Callable[[str], None] | None = None,
    **settings: Unpack[SettingsDict],
) -> CheckReport:
    """Compare sensitivities with central finite differences over a range of step sizes.

    Parameters
    ----------
    model : Model
        Compiled with sensitivities.
    sensitivities : sequence of str, optional
        The sensitivities to check; all of them where absent.
    t_end : float, optional
        End of the runs, [s]; the scene's where absent.
    plain : Model, optional
        The same scene compiled without sensitivities, for the differences: most of the runs, which
        then take a fraction of the time.
    parameters : mapping of str to float, optional
        Parameter values in place of the scene's.
    method : str, optional
        The method of all runs; what ``auto`` takes where absent.
    report : callable, optional
        Gets the parts of :meth:`CheckReport.summary` one by one, each as soon as it is known.
    **settings
        Of all runs, as of :meth:`cotree.Model.simulate`; by default ``rtol`` is 1e-12 and ``atol``
        a hundredth of it.

    Returns
    -------
    CheckReport
        A row for each parameter.

    Raises
    ------
    ParameterError
        If a sensitivity was not compiled in, or there is none.
    ModelError
        If a value or a setting is refused.
    SolveError
        If the run at the values themselves fails. A failed run at changed values is no error: its
        step is left out.

    Notes
    -----
    Every run takes the same method and the same tolerances. The steps h are 1e-1 to 1e-9
    in half decades, relative to the size P of what is changed: that of the parameter, or the
    largest value that a state takes where its initial value is meant, or 1 if that is zero.

    For each state and output, V(h) is the largest absolute deviation of the sensitivity S from the
    central difference FD(h) over the times. V falls as h**2 with truncation, rises as 1/h with
    rounding and integration errors, and has a floor where S itself is wrong. With a step
    of eps**(1/3) P a central difference of a smooth quantity y is good to about eps**(2/3) times

        scale = max(max|S|, max|y| / P),

    if y is known to rounding. It is known to its integration error only, so that the
    least V over all steps is to stay below

        10 eps**(2/3) scale + e_S + e_y / h*,

    where e_S and e_y are the changes of S and y in a run at ten times the tolerances, and at
    least what the solver was asked for, atol + rtol max|S| and atol + rtol max|y|. The step h* is
    the one where FD itself is best: the smaller of the two neighbours whose differences agree best.
    It is found without S, so that a wrong S cannot choose the step that excuses it.

    A parameter passes if this holds for every state and output.
    """
    names = _checked_names(model, sensitivities)
    # A short way to learn what "auto" chooses and where the scene ends.
    rtol, given = settings.pop("rtol", None) or _RTOL, settings
    common: dict[str, Any] = {"parameters": dict(parameters or {}), **given}
    span = None if t_end is None else (0.0, t_end)
    probe = model.simulate(span, method=method, throw=True, **common)
    found = CheckReport((), float(probe.t[-1]), probe.statistics.method, rtol)
    tell = report or _say_nothing
    tell(found.heading)
    runs = _reference_runs(model, plain, found, common)
    for name in names:
        row = _check(runs, name)
        found = replace(found, rows=(*found.rows, row))
        tell(f"\n{row.summary()}")
    tell(f"\n{found.verdict}")
    return found


def _say_nothing(text: str) -> None:
    pass


@dataclass(frozen=True, eq=False)
class _Runs:
    """The runs that are made before differences are formed."""

    experiment: Experiment  # the experiment from which differences are formed
    #: Runs with sensitivities, at the tolerances and at looser ones.
    with_s: Result
    with_s_loose: Result
    #: The same runs of the experiment.
    tight: Result
    loose: Result

    def asked(self, array: Array) -> Array:
        """Return the accuracy asked for: atol + rtol times the largest size over time."""
        rtol = float(self.experiment.settings["rtol"])
        # atol is a share of rtol, hence the common factor.
        return rtol * (_ATOL_SHARE + _largest(array))


def _reference_runs(
    model: Model, plain: Model | None, report: CheckReport, common: Mapping[str, Any]
) -> _Runs:
    """Run at the values themselves, at the tolerances and at looser ones."""
    times = np.linspace(0.0, report.t_end, _N_TIMES)
    # For each model two experiments: at the tolerances, and at looser ones.
    own, differenced = (
        tuple(
            _experiment(each, times, report.method, common, factor * report.rtol)
            for factor in (1.0, _LOOSER)
        )
        for each in (model, plain or model)
    )
    tight, loose = (run.run() for run in own)
    runs = _Runs(differenced[0], tight, loose, tight, loose)
    # Integration errors e_y are those of the model that is differenced, not of the one with S.
    if plain is None:
        return runs
    return replace(runs, tight=differenced[0].run(), loose=differenced[1].run())


def _experiment(
    model: Model, times: Array, method: str, common: Mapping[str, Any], rtol: float
) -> Experiment:
    settings = {"method": method, "rtol": rtol, "atol": rtol * _ATOL_SHARE, **common}
    return Experiment(model, times, settings)


def _checked_names(model: Model, wanted: Sequence[str] | None) -> tuple[str, ...]:
    names = model.sensitivities if wanted is None else tuple(wanted)
    if not names:
        raise ParameterError(
            "there is no sensitivity to check: name the parameters when the scene is compiled"
        )
    what = "the model has no sensitivity to"
    check_known(names, model.sensitivities, what, error=ParameterError)
    return names


def _check(runs: _Runs, name: str) -> ParameterCheck:
    """Check one sensitivity; arrays have the axes step, quantity, time."""
    experiment = runs.experiment
    s, y = sensitivities(runs.with_s, name), quantities(runs.tight)
    size = experiment.size(name, runs.tight)
    steps = np.array([size * relative for relative in _RELATIVE_STEPS])
    differences, refusal = _differences(experiment, name, steps, y.shape)
    # Over time; nan where a run at a step failed.
    deviations = np.max(np.abs(s - differences), axis=2)
    # `scale`, e_S, e_y and h* of the notes of `check_sensitivities`, each by quantity.
    scale = np.maximum(_largest(s), _largest(y) / size)
    s_error = np.maximum(_largest(s - sensitivities(runs.with_s_loose, name)), runs.asked(s))
    y_error = np.maximum(_largest(y - quantities(runs.loose)), runs.asked(y))
    tolerance = _ROUNDING * scale + s_error + y_error / _best_steps(differences, steps)
    least = _least(deviations)
    # The largest share of what is allowed; a quantity without any difference comes before all.
    closest = int(np.argmax(np.nan_to_num(least / tolerance, nan=np.inf)))
    is_known = math.isfinite(least[closest])
    note = ""
    if not is_known:
        note = f"no finite differences could be formed: {refusal}"
    elif not np.any(s) and not np.any(np.nan_to_num(differences)):
        note = f"'{name}' reaches no state and no output"
    largest = np.argmax(deviations, axis=1)
    found = np.max(deviations, axis=1)
    return ParameterCheck(
        name=name,
        value=experiment.value(name),
        steps=tuple(steps.tolist()),
        deviations=tuple(found.tolist()),
        quantities=tuple(
            "" if math.isnan(v) else experiment.quantities[i]
            for i, v in zip(largest, found, strict=True)
        ),
        closest=experiment.quantities[closest],
        deviation=float(least[closest]),
        tolerance=float(tolerance[closest]),
        step=float(steps[np.nanargmin(deviations[:, closest])]) if is_known else math.nan,
        note=note,
    )


def _differences(
    experiment: Experiment, name: str, steps: Array, shape: tuple[int, ...]
) -> tuple[Array, str]:
    """Form the central differences at all steps, nan and the reason where a run fails."""
    # Steps that fail stay nan, and the others are compared.
    found = np.full((len(steps), *shape), np.nan)
    refusal = ""
    for k, step in enumerate(steps.tolist()):
        try:
            found[k] = experiment.central_difference(name, step)
        except Error as error:
            # A mass below zero, or a configuration that the solver cannot leave.
            refusal = str(error)
    return found, refusal


def _largest(values: Array) -> Array:
    """Return the largest size over time, shape (n_quantities,)."""
    largest: Array = np.max(np.abs(values), axis=-1)
    return largest


def _least(deviations: Array) -> Array:
    """Return the least deviation over the steps that are known, nan where none is."""
    least = np.min(np.where(np.isnan(deviations), np.inf, deviations), axis=0)
    return np.where(np.isfinite(least), least, np.nan)


def _best_steps(differences: Array, steps: Array) -> Array:
    """Give, for each quantity, the smaller of the two neighbouring steps that agree best."""
    # Neighbours differ by truncation where steps are long and by rounding where they are short; in
    # between they agree best.
    spread = np.max(np.abs(np.diff(differences, axis=0)), axis=2)
    best = np.argmin(np.where(np.isnan(spread), np.inf, spread), axis=0)
    # Steps fall, so the second of two neighbours is the smaller one.
    found: Array = steps[best + 1]
    return found
