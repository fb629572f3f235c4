"""Comparison of sensitivities with finite differences over a range of step sizes."""

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


class CheckedModel(Protocol):
    """A model that can be simulated: :class:`cotree.Model`."""

    states: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    sensitivities: tuple[str, ...]
    kernels: CompiledModel

    @property
    def simulate(self) -> Callable[..., Result]:
        """Simulate; see :meth:`cotree.Model.simulate`."""
        ...


@dataclass(frozen=True, eq=False)
class RepeatedRun:
    """A run from the first to the last of ``t_eval`` that is repeated with one value changed."""

    model: CheckedModel
    t_eval: Array
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the quantities: states, then outputs."""
        return (*self.model.states, *self.model.outputs)

    def run(self, changed: Mapping[str, float] | None = None) -> Result:
        """Simulate with changed parameters or initial values."""
        parameters, initial = self._values("parameters"), self._values("initial")
        for name, value in (changed or {}).items():
            # The name of a state represents its initial value, as for sensitivities.
            (initial if name in self.model.states else parameters)[name] = value
        return self.model.simulate(
            (float(self.t_eval[0]), float(self.t_eval[-1])),
            self.t_eval,
            # raises an error if the run ends early
            throw=True,
            **{**self.settings, "parameters": parameters, "initial": initial},
        )

    def value(self, name: str) -> float:
        """Return the value of a parameter, or the initial value of a state."""
        p = self.model.kernels.parameter_array(self._values("parameters"))
        if name in self.model.states:
            # Use the value stated in the scene, not the value adapted to the constraints.
            own = self.model.kernels.initial(p)[self.model.states.index(name)]
            return float(self._values("initial").get(name, own))
        return float(p[self.model.parameters.index(name)])

    def size(self, name: str, result: Result) -> float:
        """Return the scale of the finite-difference steps of a parameter or initial value.

        It is the magnitude of the parameter. An initial value is often zero or small by chance; its
        scale is the largest magnitude of the state in ``result`` or, if this is zero, 1.
        """
        if name in self.model.states:
            size = float(np.max(np.abs(result[name])))
        else:
            size = abs(self.value(name))
        return size or 1.0

    def central_difference(self, name: str, step: float) -> Array:
        """Approximate the derivatives of states and outputs, (n_states + n_outputs, n_t).

        ``step`` is half the distance between the two runs, in the unit of ``name``.
        """
        value = self.value(name)
        above, below = value + step, value - step
        difference = quantities(self.run({name: above})) - quantities(self.run({name: below}))
        # Divide by the rounded distance, which differs from 2 * step if steps are small.
        return difference / (above - below)

    def _values(self, key: str) -> dict[str, float]:
        if key != "parameters":
            return dict(self.settings.get(key) or {})
        p = self.model.kernels.parameter_array(self.settings.get(key))
        return dict(zip(self.model.parameters, p.tolist(), strict=True))


def quantities(result: Result) -> Array:
    """Return states and outputs in one array, shape (n_states + n_outputs, n_t)."""
    return np.vstack([result.y, result.output_values])


def sensitivities(result: Result, name: str) -> Array:
    """Return the sensitivities of states and outputs, shape (n_states + n_outputs, n_t)."""
    j = result.parameters_of_sensitivity.index(name)
    return np.vstack([result.s[:, j], result.output_sensitivities[:, j]])


# Relative steps in half decades. Truncation errors dominate the first, rounding the last.
_RELATIVE_STEPS = tuple(10.0 ** (-1 - k / 2) for k in range(17))
_N_TIMES = 21
_RTOL = 1e-12
# Absolute tolerance divided by relative tolerance.
_ATOL_SHARE = 1e-2
# Tolerance factor of a second run, whose difference from the first run is its integration error.
_LOOSER = 10.0
# Error of a central difference at the best step, see `check_sensitivities`.
_ROUNDING = 10.0 * float(np.finfo(float).eps) ** (2.0 / 3.0)


@dataclass(frozen=True)
class ParameterCheck(Reported):
    """Comparison of one sensitivity with finite differences.

    Attributes
    ----------
    name : str
        The parameter, or the state, which represents its initial value.
    value : float
        Its value, in its own unit.
    steps : tuple of float
        Decreasing step sizes h, in the same unit.
    deviations : tuple of float
        V(h) = max abs(S - FD(h)) over states, outputs and times; nan if a run failed.
    quantities : tuple of str
        The state or output with this maximum, by step; "" if a run failed.
    closest : str
        The state or output whose smallest deviation is closest to its tolerance.
    deviation, tolerance : float
        Its smallest deviation over all steps, and the tolerance.
    step : float
        The step of this deviation; nan without one.
    note : str
        A remark: the parameter has no effect, or could not be checked.
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
        """Return whether the deviation is known and within the tolerance."""
        # If a deviation is unknown (nan), the comparison is false.
        return self.deviation <= self.tolerance

    def report(self) -> Report:
        """Build the report: the verdict, and the deviation as a function of the step size."""
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
    """Comparison of a model's sensitivities with finite differences.

    Attributes
    ----------
    rows : tuple of ParameterCheck
        The comparison for each parameter.
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
        """Return a sentence that describes the comparison."""
        return (
            f"sensitivities S against central differences FD(h) at {_N_TIMES} times to "
            f"t = {self.t_end:g} s, {self.method}, rtol {self.rtol:g}"
        )

    @property
    def verdict(self) -> str:
        """Return a sentence with the number of passed parameters and the names of the others."""
        failed = [row.name for row in self.rows if not row.passed]
        if not failed:
            return f"all sensitivities passed: {len(self.rows)}"
        return f"{len(failed)} of {len(self.rows)} sensitivities failed: {', '.join(failed)}"

    def report(self) -> Report:
        """Build the report: the deviations of each parameter as text, the verdict in HTML."""
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
    model: CheckedModel,
    sensitivities: Sequence[str] | None = None,
    t_end: float | None = None,
    plain: CheckedModel | None = None,
    *,
    parameters: Mapping[str, float] | None = None,
    method: str | None = None,
    report: Callable[[str], None] | None = None,
    **settings: Unpack[SettingsDict],
) -> CheckReport:
    """Compare sensitivities with central finite differences over a range of step sizes.

    See :meth:`cotree.Model.check`. ``plain`` is the same scene compiled without sensitivities, for
    the differences: most of the runs then take a fraction of the time. If a run at changed values
    fails, its step is left out.

    Notes
    -----
    All runs have the same method and tolerances. The steps h are 1e-1 to 1e-9 in half decades,
    relative to the scale P of the changed value: the magnitude of a parameter, or the largest
    magnitude of a state for its initial value, or 1 if that is zero.

    For each state and output, V(h) is the largest absolute deviation of the sensitivity S from the
    central difference FD(h) over the times. V has a truncation error proportional to h**2, rounding
    and integration errors proportional to 1/h, and does not fall below the error of S. With a step
    of eps**(1/3) P, a central difference of a smooth quantity y has an error of eps**(2/3) times

        scale = max(max|S|, max|y| / P),

    if y is exact up to rounding. Since y has an integration error, the smallest V over all steps
    must be below

        10 eps**(2/3) scale + e_S + e_y / h*,

    where e_S and e_y are the changes of S and y in a run with ten times the tolerances, and at
    least the requested accuracy, atol + rtol max|S| and atol + rtol max|y|. The step h* is that of
    the most accurate FD: the smaller of the two neighbours whose differences agree best. It does
    not depend on S, so that a wrong S cannot select a favourable step.
    """
    names = _checked_names(model, sensitivities)
    # A short run determines the method that "auto" selects and the scene's end time.
    rtol, given = settings.pop("rtol", None) or _RTOL, settings
    common: dict[str, Any] = {"parameters": dict(parameters or {}), **given}
    span = None if t_end is None else (0.0, t_end)
    probe = model.simulate(span, method=method, throw=True, **common)
    found = CheckReport((), float(probe.t[-1]), probe.statistics.method, rtol)
    tell = report or (lambda text: None)
    tell(found.heading)
    runs = _reference_runs(model, plain, found, common)
    for name in names:
        row = _check(runs, name)
        found = replace(found, rows=(*found.rows, row))
        tell(f"\n{row.summary()}")
    tell(f"\n{found.verdict}")
    return found


@dataclass(frozen=True, eq=False)
class _ReferenceRuns:
    experiment: RepeatedRun  # experiment whose runs form the differences
    #: Runs with sensitivities, at the given tolerances and at larger ones.
    with_s: Result
    with_s_loose: Result
    #: The corresponding runs without sensitivities, if the experiment has none.
    tight: Result
    loose: Result

    def asked(self, array: Array) -> Array:
        """Return the requested accuracy: atol + rtol times the largest magnitude over time."""
        rtol = float(self.experiment.settings["rtol"])
        # atol = _ATOL_SHARE * rtol, so rtol is a common factor.
        return rtol * (_ATOL_SHARE + _largest(array))


def _reference_runs(
    model: CheckedModel, plain: CheckedModel | None, report: CheckReport, common: Mapping[str, Any]
) -> _ReferenceRuns:
    """Simulate with unchanged values, at the given tolerances and at larger ones."""
    times = np.linspace(0.0, report.t_end, _N_TIMES)
    settings = [
        {"method": report.method, "rtol": rtol, "atol": rtol * _ATOL_SHARE, **common}
        for rtol in (report.rtol, _LOOSER * report.rtol)
    ]
    own, differenced = (
        [RepeatedRun(each, times, given) for given in settings] for each in (model, plain or model)
    )
    tight, loose = (run.run() for run in own)
    runs = _ReferenceRuns(differenced[0], tight, loose, tight, loose)
    # FD(h) is computed with ``plain`` if given; e_y is the integration error of that model.
    if plain is None:
        return runs
    return replace(runs, tight=differenced[0].run(), loose=differenced[1].run())


def _checked_names(model: CheckedModel, wanted: Sequence[str] | None) -> tuple[str, ...]:
    names = model.sensitivities if wanted is None else tuple(wanted)
    if not names:
        raise ParameterError(
            "there is no sensitivity to check: name the parameters when the scene is compiled"
        )
    what = "the model has no sensitivity to"
    check_known(names, model.sensitivities, what, error=ParameterError)
    return names


def _check(runs: _ReferenceRuns, name: str) -> ParameterCheck:
    """Compare one sensitivity with differences; array axes are step, quantity and time."""
    experiment = runs.experiment
    s, y = sensitivities(runs.with_s, name), quantities(runs.tight)
    size = experiment.size(name, runs.tight)
    steps = np.array([size * relative for relative in _RELATIVE_STEPS])
    differences, refusal = _differences(experiment, name, steps, y.shape)
    # Maximum over time; nan if a run at a step failed.
    deviations = np.max(np.abs(s - differences), axis=2)
    # `scale`, e_S, e_y and h* for each quantity, as defined in the notes of `check_sensitivities`.
    scale = np.maximum(_largest(s), _largest(y) / size)
    s_error = np.maximum(_largest(s - sensitivities(runs.with_s_loose, name)), runs.asked(s))
    y_error = np.maximum(_largest(y - quantities(runs.loose)), runs.asked(y))
    tolerance = _ROUNDING * scale + s_error + y_error / _best_steps(differences, steps)
    least = _least(deviations)
    # Find the largest ratio of deviation to tolerance; a quantity without differences comes first.
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
    experiment: RepeatedRun, name: str, steps: Array, shape: tuple[int, ...]
) -> tuple[Array, str]:
    """Compute the central differences at all steps; if a run fails, they are nan, with a reason."""
    # If runs at a step fail, its differences remain nan and the others are compared.
    found = np.full((len(steps), *shape), np.nan)
    refusal = ""
    for k, step in enumerate(steps.tolist()):
        try:
            found[k] = experiment.central_difference(name, step)
        except Error as error:
            # The model may reject a value, such as a negative mass, or be singular.
            refusal = str(error)
    return found, refusal


def _largest(values: Array) -> Array:
    largest: Array = np.max(np.abs(values), axis=-1)
    return largest


def _least(deviations: Array) -> Array:
    """Return the smallest deviation over the steps, without nan; nan if all are nan."""
    least = np.min(np.where(np.isnan(deviations), np.inf, deviations), axis=0)
    return np.where(np.isfinite(least), least, np.nan)


def _best_steps(differences: Array, steps: Array) -> Array:
    """Return, for each quantity, the smaller of the adjacent steps whose differences agree best."""
    # Adjacent differences deviate by truncation at long steps and by rounding at short steps.
    spread = np.max(np.abs(np.diff(differences, axis=0)), axis=2)
    best = np.argmin(np.where(np.isnan(spread), np.inf, spread), axis=0)
    # Steps decrease, so the second of two adjacent steps is the smaller one.
    found: Array = steps[best + 1]
    return found
