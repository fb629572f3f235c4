"""Runs of a model: one, or many that differ in values alone.

In: a model and settings. Out: a ``Runner``, which is called with values of parameters and initial
values, or at once the ``Result`` of one run.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cotree.model.model import CompiledModel
from cotree.records import changed, filled
from cotree.results import Result
from cotree.solvers.budgets import LONGEST_TIME, MOST_EVENTS, MOST_STEPS
from cotree.solvers.prepare import prepared
from cotree.solvers.settings import Settings
from cotree.solvers.simulate import run_values

# Settings that the scene gives where a call does not.
_OF_SCENE = ("method", "rtol", "atol")


class Runner:
    """Runs of a model with the same settings, prepared for values of parameters and starts.

    Several threads may call it at the same time. A result depends on the values of its own call
    alone, and is the one that :meth:`cotree.Model.simulate` gives, to the last bit.

    Attributes
    ----------
    model : cotree.Model
        The model.
    settings : Settings
        Settings of all runs.
    """

    def __init__(self, model: RunnableModel, settings: Settings) -> None:
        self.model, self.settings = model, settings
        self._preparation = prepared(model, settings)

    def __call__(
        self, parameters: Any = None, initial: Mapping[str, float] | None = None
    ) -> Result:
        """Run once.

        Parameters
        ----------
        parameters : mapping of str to float, or array_like of shape (n_parameters,), optional
            Values in place of those of the settings, or of the scene.
        initial : mapping of str to float, optional
            Initial values of states, likewise.

        Returns
        -------
        Result
            As of ``simulate``.

        Raises
        ------
        ModelError
            If a value is not accepted.
        SolveError
            If the method cannot take the problem.
        """
        model, settings = self.model, self.settings
        if parameters is not None or initial:
            settings = changed(
                settings,
                parameters=_merged(model, settings.parameters, parameters),
                initial=_started(settings.initial, initial),
            )
        run = run_values(self._preparation, settings.parameters, settings.initial)
        # The model's library was compiled before; the first run of a method compiles its engine.
        built = model.times.get("compile", 0.0) + run["times"]["compile"]
        run["times"] = {**model.times, **run["times"], "compile": built}
        # What runs belongs to a room below, which knows neither pictures nor this model.
        return filled(Result, {**run, "model": model, "settings": settings})

    def __repr__(self) -> str:
        start, end = self.settings.t_span
        name, method = self.model.layout.name, self.settings.method
        return f"<Runner of '{name}' from t = {start:g} to {end:g} by {method}>"


def _merged(model: RunnableModel, known: Any, given: Any) -> Any:
    """Put values of a call in place of those of the settings."""
    if known is None or given is None:
        return known if given is None else given
    if not isinstance(given, Mapping):
        return given
    if isinstance(known, Mapping):
        return {**known, **given}
    return model.parameter_array(given, known)


def _started(known: Mapping[str, float], given: Any) -> Any:
    """Do the same for initial values."""
    return {**known, **given} if known and isinstance(given, Mapping) else given or known


class RunnableModel(CompiledModel):
    """A model with runs.

    Attributes
    ----------
    times : dict of str to float
        Seconds spent in each stage before any run.
    """

    times: dict[str, float]
    _recipe: Any

    def _variant(self, settings: Settings) -> tuple[RunnableModel, Settings]:
        """Give the model with expressions among the inputs compiled in, and what is left to set."""
        raise NotImplementedError

    def simulate(
        self,
        t_span: tuple[float, float] | None = None,
        t_eval: Any = None,
        method: str | None = None,
        rtol: float | None = None,
        atol: float | None = None,
        parameters: Any = None,
        initial: Mapping[str, float] | None = None,
        inputs: Mapping[str, Any] | None = None,
        *,
        sensitivities: bool = True,
        error_test_sensitivities: bool = True,
        scales: Mapping[str, float] | None = None,
        max_step: float | None = None,
        max_steps: float | None = MOST_STEPS,
        max_events: float | None = MOST_EVENTS,
        time_limit: float | None = LONGEST_TIME,
        throw: bool = False,
        project: bool = True,
    ) -> Result:
        """Integrate states and sensitivities together.

        What depends on settings alone is prepared at the first of several runs with the same ones;
        see :meth:`runner`.

        Parameters
        ----------
        t_span : (float, float), optional
            Start and end, [s]; the scene's ``t_end`` where absent.
        t_eval : array_like, shape (n_t,), optional
            Times to report; the solver's own steps where absent, of which every second, fourth, ...
            is stored where all of them would take more than 256 MiB.
        method : str, optional
            ``dopri5``, ``rkf45``, ``dop853``, ``rodas4``, ``rodas5`` (in C), ``RK45``, ``RK23``,
            ``DOP853``, ``Radau``, ``BDF``, ``LSODA`` (SciPy), ``cvode``, ``ida``, and as an extra
            ``cvodes``, ``cvodes-simultaneous`` and ``idas`` (SUNDIALS), or ``auto``.
        rtol, atol : float, optional
            Relative and absolute tolerance.
        parameters : mapping of str to float, or array_like of shape (n_parameters,), optional
            Values in place of the scene's.
        initial : mapping of str to float, optional
            Initial values of states in place of the scene's; they depend on no parameter, unless
            their sensitivities are given, too, as ``"d(STATE)/d(PARAMETER)"``: a run can go on from
            the end of another one.
        inputs : mapping, optional
            Inputs in place of the scene's: a number, (times, values), a Python function of t, or
            an expression of t, parameters, states, outputs and whatever fields may name.
            Expressions are compiled into the model at their first use. Parameters that the model
            does not have, such as gains, get their values by ``parameters``; for sensitivities to
            them compile ``scene.with_inputs(...)``.
        sensitivities : bool
            Whether the sensitivities that the model was compiled with are integrated; the result
            has none where false, and the run takes as long as that of a model without them.
        error_test_sensitivities : bool
            Whether sensitivities take part in the error test.
        scales : mapping of str to float, optional
            Sizes of parameters in place of their values: ``atol`` divided by them is that of their
            sensitivities. One where a value is zero, and for initial values.
        max_step : float, optional
            Longest step, [s]; infinity for no limit. The default is a 32nd of the shortest period
            where sines of time drive laws that act for a part of it, as diodes do; else none.
        max_steps, max_events, time_limit : int, int and float
            Budgets of steps, of events that happen, and of seconds of computing time: a million, a
            hundred thousand and 3600 s. None, or infinity, for no limit. A run that spends one
            stops with what is there, and the message names the state that grows without bound, if
            one does.
        throw : bool
            Raise SolveError where the integration fails; else it warns, and the result says so.
        project : bool
            Hold states and sensitivities to the constraints by projection; where false, drift
            is left to the tolerances, or to ``baumgarte``.

        Returns
        -------
        Result
            ``t``, ``y`` (n_states, n_t), ``s`` (n_states, n_parameters, n_t), and all by name.

        Raises
        ------
        ModelError
            If a parameter, initial value or input is not accepted.
        SolveError
            If the method is unknown or its settings make no sense.

        Examples
        --------
        >>> from cotree import load
        >>> result = load("slider-pendulum").compile(["L"]).simulate((0, 10), rtol=1e-10)
        >>> round(float(result["j1.s"][-1]), 6)
        0.526045
        """
        given = {
            "t_span": t_span,
            "t_eval": t_eval,
            "method": method,
            "rtol": rtol,
            "atol": atol,
            "parameters": parameters,
            "initial": initial,
            "inputs": inputs,
            "sensitivities": sensitivities,
            "error_test_sensitivities": error_test_sensitivities,
            "scales": scales,
            "max_step": max_step,
            "max_steps": max_steps,
            "max_events": max_events,
            "time_limit": time_limit,
            "throw": throw,
            "project": project,
        }
        settings = filled(Settings, _completed(self, given))
        return Runner(*self._variant(settings))()

    def runner(
        self, t_span: tuple[float, float] | None = None, t_eval: Any = None, **settings: Any
    ) -> Runner:
        """Prepare runs that differ in values of parameters and initial values alone.

        A loop over ``simulate`` with the same settings does the same work once, too. A runner has
        it done where it is made, checks settings there, and keeps settings that cannot be compared:
        functions of Python, tables, and more than 10,000 times.

        Parameters
        ----------
        t_span, t_eval, **settings
            As of :meth:`simulate`. Parameters and initial values among them hold for all runs that
            do not give others.

        Returns
        -------
        Runner
            ``runner(parameters=None, initial=None)`` gives a ``Result``.

        Raises
        ------
        ModelError
            If an input is not accepted.
        SolveError
            If settings make no sense.
        TypeError
            If there is no such setting.

        Examples
        --------
        >>> from cotree import load
        >>> run = load("slider-pendulum").compile(["L"]).runner((0, 10), [10.0], rtol=1e-10)
        >>> [round(float(run({"L": length})["j1.s"][-1]), 6) for length in (1.0, 1.1)]
        [0.526045, 0.51608]
        """
        given = _completed(self, {"t_span": t_span, "t_eval": t_eval, **settings})
        return Runner(*self._variant(Settings(**given)))


def _completed(model: RunnableModel, given: dict[str, Any]) -> dict[str, Any]:
    """Take from the scene, in place, what the caller leaves open."""
    defaults = model._recipe.defaults
    if given["t_span"] is None:
        given["t_span"] = (0.0, defaults.t_end)
    for name in _OF_SCENE:
        if given.get(name) is None:
            given[name] = getattr(defaults, name)
    for name in ("initial", "inputs", "scales"):
        given[name] = given.get(name) or {}
    return given
