"""Runs of a model.

In: a model and what a call of ``simulate`` gives. Out: the ``Result`` of one run. What depends on
settings alone is prepared at the first of several runs with the same ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from cotree.model.model import CompiledModel
from cotree.records import changed, filled
from cotree.results import Result
from cotree.scene.settings import documented, settings_from
from cotree.solvers.prepare import Preparation, kept_for
from cotree.solvers.simulate import run_values

if TYPE_CHECKING:
    from typing import Unpack

    from cotree.scene.settings import OtherSettings, Settings


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

    def _preparation(self, given: Mapping[str, Any]) -> Preparation:
        """Prepare runs with some settings; the scene gives those that are left open."""
        return Preparation(*self._variant(settings_from(self._recipe.defaults, given)))

    @documented
    def simulate(
        self,
        t_span: tuple[float, float] | None = None,
        t_eval: Any = None,
        method: str | None = None,
        rtol: float | None = None,
        atol: float | None = None,
        *,
        parameters: Any = None,
        initial: Mapping[str, float] | None = None,
        inputs: Mapping[str, Any] | None = None,
        sensitivities: bool = True,
        throw: bool = False,
        **settings: Unpack[OtherSettings],
    ) -> Result:
        """Integrate states and sensitivities together.

        What depends on settings alone is prepared at the first of several runs with the same ones.
        Arrays, lists and numbers are compared by their values, functions of Python by identity;
        settings with more than 10,000 times are prepared at each run. Several threads may call it
        at the same time; a result depends on the values of its own call alone.

        Parameters
        ----------
        t_span, t_eval, method, rtol, atol, parameters, initial, inputs, throw, **settings
            See :class:`cotree.Settings`.

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
        TypeError
            If there is no such setting.

        Examples
        --------
        >>> from cotree import load
        >>> result = load("slider-pendulum").compile(["L"]).simulate((0, 10), rtol=1e-10)
        >>> round(float(result["j1.s"][-1]), 6)
        0.526045
        """
        given: dict[str, Any] = {
            "t_span": t_span,
            "t_eval": t_eval,
            "method": method,
            "rtol": rtol,
            "atol": atol,
            "inputs": inputs,
            "sensitivities": sensitivities,
            "throw": throw,
            **settings,
        }

        # Names in expressions of inputs are parameters if the call gives them values.
        names = tuple(parameters) if inputs and isinstance(parameters, Mapping) else ()
        preparation = kept_for(
            self,
            {**given, "gains": names} if inputs else given,
            lambda: self._preparation({**given, "parameters": parameters, "initial": initial}),
        )
        values = run_values(preparation, parameters, initial or {})
        # The library was compiled before; the first run of a method compiles its engine.
        model: Any = preparation.whole_model
        own = values["times"]
        own["compile"] += model.times.get("compile", 0.0)
        return filled(
            Result,
            {
                **values,
                "times": {**model.times, **own},
                "model": model,
                "settings": changed(
                    preparation.settings, parameters=parameters, initial=initial or {}
                ),
            },
        )
