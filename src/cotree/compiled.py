"""The compiled model of a scene: a thin layer over the stages of the compiler."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.arguments import by_name
from cotree.build.cache import pickled
from cotree.ensemble.of_model import run_members
from cotree.files import target_path
from cotree.methods import METHODS
from cotree.model.arrays import one_point
from cotree.model.bound import BoundModel
from cotree.model.start import find_start, scene_start
from cotree.records import changed, filled
from cotree.report import Report, Reported
from cotree.results import Result
from cotree.scene.expressions import check_number
from cotree.scene.settings import Simulation, documented, settings_from
from cotree.sharing import RecentCache, locked_cached_property
from cotree.solvers.prepare import Preparation, cached_for
from cotree.solvers.simulate import run_values
from cotree.spec import BuildSpec, open_spec

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from typing import Unpack

    from cotree.check import CheckReport
    from cotree.choice import Operations
    from cotree.export.c_project import CProject
    from cotree.export.fmi.fmu import Fmu
    from cotree.gradient.run import Gradient
    from cotree.model.arrays import Array
    from cotree.model.linearization import Linearization
    from cotree.model.linearize import Linearizer
    from cotree.model.model import CompiledModel
    from cotree.model.start import Start
    from cotree.model.trim import TrimPoint
    from cotree.scene.settings import OtherSettings, Settings, SettingsDict

#: Public methods, in the order of a typical session.
_CALLS = "simulate() trim() linearize() start() rhs() jacobian() output_values() write() summary()"

# Maximum numbers of cached variants with other input expressions (all remain in the cache on disk),
# and of cached preparations, one for each set of settings.
_MOST_VARIANTS, _MOST_KEPT = 32, 8


class Model(Reported):
    """A compiled scene.

    Every method takes parameters ``p`` and inputs ``u`` as arrays in the order of
    :attr:`parameters` and :attr:`inputs`; None selects the scene's values. Parameters may also be a
    mapping of names to values; the others keep the scene's. Results are new arrays. Several threads
    may call the same model at the same time, each with its own parameters.

    Attributes
    ----------
    states, parameters, inputs, outputs : tuple of str
        Names of the states, the tunable parameters, the inputs and the outputs.
    sensitivities : tuple of str
        Parameters and states with respect to which sensitivities are taken.
    kernels : CompiledModel
        The kernels in C, with names, units and sparsity patterns of arguments and results.
    times : dict of str to float
        Seconds spent in each stage: formulate, generate, compile, start.
    """

    def __init__(
        self,
        kernels: CompiledModel,
        spec: BuildSpec | bytes,
        times: Mapping[str, float],
        defaults: Simulation | None = None,
    ) -> None:
        self.kernels, self._spec, self.times = kernels, spec, dict(times)
        own = spec.scene.defaults if isinstance(spec, BuildSpec) else defaults
        self._defaults = own or Simulation()
        self.states, self.parameters = kernels.states, kernels.parameters
        self.inputs, self.outputs = kernels.inputs, kernels.outputs
        self.sensitivities = kernels.sensitivities
        self._kept: RecentCache[tuple[Model, Preparation]] = RecentCache(_MOST_KEPT)
        self._variants: RecentCache[Model] = RecentCache(_MOST_VARIANTS)

    @property
    def spec(self) -> BuildSpec:
        """The specification that the model was compiled from.

        Raises ModelError if the model was unpickled and its scene cannot be read in this process.
        """
        # Components of another process must be registered here before the specification is read.
        if isinstance(self._spec, bytes):
            self._spec = open_spec(self._spec)
        return self._spec

    def __reduce__(self) -> tuple[Any, ...]:
        spec = self._spec if isinstance(self._spec, bytes) else pickled(self._spec) or b""
        return type(self), (self.kernels, spec, {}, self._defaults)

    def report(self) -> Report:
        """Build the report: names, calls, methods, compiler and, in notebooks, parameters."""
        methods, compiler = " ".join(("auto", *METHODS)), self.kernels.compiler
        facts = ("calls", _CALLS), ("methods", methods), ("compiler", compiler)
        return self.kernels.layout.report(type(self).__name__, facts)

    @property
    def operations(self) -> Operations:
        """Operation counts by kernel; ``alternatives`` are the formulations that were compared."""
        from cotree.choice import Operations

        return Operations(self.kernels.program.operations, self.spec.formed.alternatives)

    def summary(self) -> str:
        """Return a description of the kernels, the compared formulations and the passes."""
        passes = (report.summary() for report in self.spec.formed.reports)
        return Report(self.kernels.program.summary(), self.operations.tried(), *passes).text()

    @property
    def default_parameters(self) -> Array:
        """The scene's parameter values, shape (n_parameters,)."""
        return self.kernels.default_parameters

    @property
    def initial_state(self) -> Array:
        """The consistent initial states at the scene's parameter values, shape (n_states,)."""
        return scene_start(self.kernels).y

    def start(
        self,
        t: float = 0.0,
        p: Any = None,
        initial: Mapping[str, float] | None = None,
        u: Any = None,
    ) -> Start:
        """Find initial states and sensitivities that satisfy constraints and algebraic equations.

        Parameters
        ----------
        t : float
            Start time, [s].
        p : array_like, shape (n_parameters,), or mapping of str to float, optional
            Parameters.
        initial : mapping of str to float, optional
            Initial values of states that replace the scene's; they depend on no parameter. Values
            of algebraic unknowns are guesses, except for storages by content. If all coordinates or
            speeds are given, the scene's values of joints that are not states are ignored.
        u : array_like, shape (n_inputs,), optional
            Inputs at that time, on which algebraic unknowns depend.

        Returns
        -------
        Start
            ``y``, shape (n_states,), and ``s``, shape (n_states, n_parameters).

        Raises
        ------
        ParameterError
            If a name is unknown, or given values violate a constraint.
        SolveError
            If no values of the algebraic unknowns are found.
        SingularSystemError
            If the algebraic equations do not determine them.
        """
        # Kernels check the guards on parameters at every call.
        return find_start(self._point_at(t, p, u), initial or {})

    def _point_at(self, t: Any, p: Any, u: Any) -> BoundModel:
        u = None if u is None else one_point(u, self.inputs, "input")
        return BoundModel(self.kernels, check_number(t, "t"), self.kernels.parameter_array(p), u)

    def rhs(self, t: Any, y: Any, p: Any = None, u: Any = None) -> Array:
        """Evaluate the rates of the states.

        Parameters
        ----------
        t : float, or array_like of shape (m,)
            Time, [s].
        y : array_like, shape (n_states,) or (n_states, m)
            States; with two axes those of m points. Labels of pandas, if any, must be their names.
        p : array_like, shape (n_parameters,), or mapping of str to float, optional
            Parameters; shape (n_parameters, m) is allowed for m points.
        u : array_like, shape (n_inputs,), optional
            Inputs; shape (n_inputs, m) is allowed for m points. The scene's own inputs may depend
            on parameters, which sensitivities include.

        Returns
        -------
        ndarray, shape (n_states,) or (n_states, m)
            Rates, in the states' units per second; residuals at the indices of algebraic unknowns.

        Raises
        ------
        ParameterError
            If an array has the wrong shape, or the parameters are refused by the model.
        SingularSystemError
            If the mass matrix is singular. For m points the message names the column.
        """
        return self.kernels.rhs(t, y, p, u)

    def jacobian(self, t: Any, y: Any, p: Any = None, u: Any = None) -> Array:
        """Evaluate the derivatives of the rates with respect to the states, (n_states, n_states).

        Parameters and errors as for :meth:`rhs`; for m points the shape is (n_states, n_states, m).
        """
        return self.kernels.jacobian(t, y, p, u)

    def sensitivity_rhs(self, t: Any, y: Any, s: Any, p: Any = None, u: Any = None) -> Array:
        """Evaluate the rates of the sensitivities, in the shape of ``s``.

        Parameters
        ----------
        t, y, p, u
            As for :meth:`rhs`.
        s : array_like, shape (n_states, n_parameters) or (n_states, n_parameters, m)
            Sensitivities of the states, in the order of :attr:`sensitivities`.
        """
        return self.kernels.sensitivity_rhs(t, y, s, p, u)

    def output_values(self, t: Any, y: Any, p: Any = None, u: Any = None) -> Array:
        """Evaluate the outputs, shape (n_outputs,) or (n_outputs, m).

        Parameters and errors as for :meth:`rhs`.
        """
        return self.kernels.output_values(t, y, p, u)

    def output_sensitivity(self, t: Any, y: Any, s: Any, p: Any = None, u: Any = None) -> Array:
        """Evaluate the sensitivities of the outputs, shape (n_outputs, n_parameters).

        Parameters and errors as for :meth:`sensitivity_rhs`; with m points the last axis is theirs.
        """
        return self.kernels.output_sensitivity(t, y, s, p, u)

    @documented
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
        throw: bool = False,
        **settings: Unpack[OtherSettings],
    ) -> Result:
        """Integrate states and sensitivities together.

        Data that depend only on the settings are prepared once for all runs with equal settings, if
        these have at most 10,000 times; Python functions are compared by identity.

        Parameters
        ----------
        t_span, t_eval, method, rtol, atol, parameters, initial, inputs, throw, **settings
            See :class:`cotree.Settings`.

        Returns
        -------
        Result
            ``t``, ``y`` (n_states, n_t), ``s`` (n_states, n_parameters, n_t), and values by name.

        Raises
        ------
        ModelError
            If a parameter, initial value or input is not accepted.
        SolveError
            If the method is unknown or its settings are invalid.
        TypeError
            If a setting is unknown.

        Examples
        --------
        >>> from cotree import load
        >>> result = load("slider-pendulum").compile(["L"]).simulate((0, 10), rtol=1e-10)
        >>> round(float(result["j1.s"][-1]), 6)
        0.526045
        """
        parameters, initial, inputs = map(by_name, (parameters, initial, inputs))
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
        model, preparation = self._prepared(given, parameters, initial)
        values = run_values(preparation, parameters, initial or {})
        # The library is already compiled, but the first run of a method compiles its engine.
        own = values["times"]
        own["compile"] += model.times.get("compile", 0.0)
        values["times"] = {**model.times, **own}
        values["model"] = model
        values["settings"] = changed(
            preparation.settings, parameters=parameters, initial=initial or {}
        )
        return filled(Result, values)

    def _prepared(
        self, given: Mapping[str, Any], parameters: Any, initial: Any
    ) -> tuple[Model, Preparation]:
        """Prepare runs with the given settings; the scene supplies the others."""
        # If the call sets their values, unknown names in input expressions are parameters.
        names = tuple(parameters) if given["inputs"] and isinstance(parameters, Mapping) else ()

        def prepare() -> tuple[Model, Preparation]:
            whole = {**given, "parameters": parameters, "initial": initial}
            model, settings = self._variant(settings_from(self._defaults, whole))
            return model, Preparation(model.kernels, settings)

        return cached_for(self._kept, {**given, "gains": names} if names else given, prepare)

    ensemble = run_members

    def gradient(
        self,
        objective: str | Mapping[str, Any],
        t_span: tuple[float, float] | None = None,
        by: Sequence[str] | None = None,
        method: str | None = None,
        parameters: Any = None,
        initial: Mapping[str, float] | None = None,
        inputs: Mapping[str, Any] | None = None,
        **settings: Unpack[SettingsDict],
    ) -> Gradient:
        """Compute an objective of a run and its gradient in reverse mode.

        The time is a few times that of a run without sensitivities, whatever the length of ``by``.
        The gradient is the exact derivative of the computed objective at constant step sizes.

        Parameters
        ----------
        objective : str or mapping of str to (times, values) or (times, values, deviations)
            An expression as in :func:`cotree.optimise`, without extremes and times of events. Or
            values to be met by expressions x: the sum of ((x - value) / deviation)**2.
        by : sequence of str, optional
            Parameters, and states for their initial values; by default all parameters. The model
            need not be compiled with these sensitivities.
        t_span, method, parameters, initial, inputs, **settings
            See :class:`cotree.Settings`; the method is explicit, by default ``dop853``.

        Returns
        -------
        Gradient
            ``value``, ``gradient``, shape (n_by,), and ``names``; ``result[name]`` is an entry.

        Raises
        ------
        ModelError, SolveError
            If a name is unknown, the run fails, or model or method have no reverse mode.
        """
        from cotree.gradient.run import gradient_of

        parameters, initial, inputs = map(by_name, (parameters, initial, inputs))
        given = {"t_span": t_span, "method": method, "inputs": inputs, **settings}
        model, preparation = self._prepared(given, parameters, initial)
        own = changed(preparation.settings, parameters=parameters, initial=initial or {})
        return gradient_of(model.kernels, model.spec, objective, by, own)

    def linearize(
        self,
        t: float = 0.0,
        y: Any = None,
        p: Any = None,
        u: Any = None,
        *,
        reduced: bool = False,
        sensitivities: Sequence[str] | str = (),
        total: bool = False,
    ) -> Linearization:
        """Linearise about the motion through a state: z' = A z + B u, y = C z + D u.

        Parameters
        ----------
        t : float
            Time, [s].
        y : array_like, shape (n_states,), optional
            States, with guesses for algebraic unknowns; by default the initial states.
        p, u : array_like, shapes (n_parameters,) and (n_inputs,), optional
            Parameters, or a mapping of names to values, and inputs; by default the scene's.
        reduced : bool
            Whether to linearise in independent deviations, two for each degree of freedom, as
            eigenvalues require if there are constraints or quaternions. Otherwise all states are
            used.
        sensitivities : sequence of str
            Parameters, inputs or states to differentiate A, B, C and D by; see
            :meth:`~cotree.model.linearization.Linearization.sensitivity`. The model need not be
            compiled with these.
        total : bool
            Whether derivatives include the dependence of the initial states on the parameters, for
            which the model must be compiled with these sensitivities. The dependence of algebraic
            unknowns and of the scene's inputs is always included. ``model.trim().linearize``
            differentiates along equilibria.

        Returns
        -------
        Linearization
            ``A``, ``B``, ``C``, ``D`` with names, ``basis`` and ``is_steady``. Deviations continue
            to satisfy the constraints to first order: G A N + G' N = 0 with the Jacobian G of the
            constraints, the basis N of its null space, and the time derivative G'.

        Raises
        ------
        ParameterError
            If an array has the wrong shape, or a name is unknown.
        SingularSystemError
            If the mass matrix is singular there.
        SolveError
            If a mode of dry friction contradicts speeds or forces: at rest the mode is 0 before a
            run, even if forces exceed their limits.
        """
        from cotree.model.linearize import linearize

        at = self._point_at(t, p, u)
        return linearize(
            self._linearizer, at, y, reduced=reduced, sensitivities=sensitivities, total=total
        )

    def trim(
        self,
        solve: Sequence[str] | str = (),
        *,
        fixed: Mapping[str, float] | None = None,
        rates: Mapping[str, float | None] | None = None,
        outputs: Mapping[str, float] | None = None,
        guess: Mapping[str, float] | None = None,
        t: float = 0.0,
        p: Any = None,
        u: Any = None,
    ) -> TrimPoint:
        """Find an equilibrium or a steady motion by Newton's method with the exact Jacobian.

        All states are unknown, except those in ``fixed``. All rates are zero, except those in
        ``rates``. Constraints and algebraic equations are satisfied.

        Parameters
        ----------
        solve : sequence of str
            Inputs and parameters that are unknown in addition to the states, one for each
            prescribed state or output.
        fixed : mapping of str to float, optional
            Prescribed values of states, inputs and parameters, in SI. The rate of a coordinate
            whose speed is prescribed is that speed.
        rates : mapping of str to float or None, optional
            Nonzero rates of states, in SI; None leaves a rate free.
        outputs : mapping of str to float, optional
            Prescribed values of outputs, in SI.
        guess : mapping of str to float, optional
            Initial guesses; by default the model's initial states and the scene's values. If there
            are several equilibria, one near the guess is found.
        t : float
            Time, [s].
        p, u : array_like, shapes (n_parameters,) and (n_inputs,), optional
            Parameters, or a mapping of names to values, and inputs; by default the scene's.

        Returns
        -------
        TrimPoint
            ``y``, ``p``, ``u`` and values by name, ``is_unique`` and ``undetermined``,
            ``linearize()``, and ``settings`` for :meth:`cotree.Model.simulate`.

        Raises
        ------
        ParameterError
            If a name is unknown, or arguments contradict each other.
        SolveError
            If no such point is found; the message names the equations that are not satisfied.

        Examples
        --------
        >>> import cotree
        >>> scene = cotree.Scene("pendulum", gravity=[0, -9.81, 0])
        >>> scene.input("M", 0.0, unit="N m")
        >>> scene.edge("j", "revolute", "ground", "A", axis=[0, 0, 1], torque="M")
        >>> scene.edge("rod", "arm", "A", "B", vector=[0, -2.0, 0])
        >>> scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
        >>> held = scene.compile().trim(["M"], fixed={"j.theta": 0.5})
        >>> round(held["M"], 6)
        9.406329
        """
        from cotree.model.trim import find_trim

        at = self._point_at(t, p, u)
        return find_trim(self._linearizer, at, solve, fixed, rates, outputs, guess)

    @locked_cached_property
    def _linearizer(self) -> Linearizer:
        from cotree.model.linearize import Linearizer
        from cotree.pipeline import equations_of_deviations

        return Linearizer(*equations_of_deviations(self.spec.formed.first))

    def check(
        self,
        sensitivities: Sequence[str] = (),
        t_end: float | None = None,
        *,
        parameters: Mapping[str, float] | None = None,
        method: str | None = None,
        report: Callable[[str], None] | None = None,
        **settings: Unpack[SettingsDict],
    ) -> CheckReport:
        """Compare sensitivities with central finite differences over a range of step sizes.

        Parameters
        ----------
        sensitivities : sequence of str
            Parameters and states to check; by default those of the model, or else all parameters.
        t_end : float, optional
            End of the runs, [s]; by default the scene's.
        report : callable, optional
            Called with each part of the report's summary as soon as it is available.
        parameters, method, **settings
            Settings of all runs, see :class:`cotree.Settings`; by default ``rtol`` is 1e-12 and
            ``atol`` a hundredth of it.

        Returns
        -------
        CheckReport
            ``passed``, ``summary()``, and a row for each sensitivity.
        """
        from cotree.check import check_sensitivities

        names = tuple(sensitivities) or self.sensitivities or self.parameters
        model = self if set(names) <= set(self.sensitivities) else self._with(names)
        # Runs without sensitivities take a fraction of the time and suffice for differences.
        plain = self._with(()) if self.sensitivities else self
        own: dict[str, Any] = {"parameters": parameters, "method": method, "report": report}
        return check_sensitivities(model, names, t_end, plain, **own, **settings)

    def _with(self, sensitivities: tuple[str, ...]) -> Model:
        spec = replace(self.spec, sensitivities=sensitivities)
        return self._variants.of(sensitivities, lambda: compile_spec(spec))

    def as_casadi(self, t: float | None = None) -> Any:
        """Return the rates as an external function of CasADi, with their exact Jacobian.

        Parameters
        ----------
        t : float, optional
            Time of the evaluation, [s]; required if the rates depend on it.

        Returns
        -------
        casadi.Callback
            The function (x, u, p) -> dx of states, inputs, and the parameters that the model was
            compiled with sensitivities to. Keep a reference as long as expressions use it.

        Raises
        ------
        ParameterError
            If the model has algebraic unknowns or constraints, or the time or package is missing.
        """
        from cotree.model.bridges import casadi_function, rates_of

        return casadi_function(rates_of(self.kernels, lambda: self._linearizer, t, "as_casadi"))

    def as_jax(self, t: float | None = None) -> Any:
        """Return the rates as a function of JAX, (x, u, p) -> dx, with exact first derivatives.

        Under ``vmap``, and with further leading axes of the arguments, points are evaluated
        together. Parameters and errors as for :meth:`as_casadi`; JAX must compute in double
        precision.
        """
        from cotree.model.bridges import jax_function, rates_of

        return jax_function(rates_of(self.kernels, lambda: self._linearizer, t, "as_jax"))

    def as_torch(self, t: float | None = None) -> Any:
        """Return the rates as a function of PyTorch, (x, u, p) -> dx, with first derivatives.

        Arguments are tensors of doubles with any leading axes, which are broadcast. All points are
        evaluated in one call, also under ``torch.func.vmap``. Parameters and errors as for
        :meth:`as_casadi`.
        """
        from cotree.model.bridges import rates_of, torch_function

        return torch_function(rates_of(self.kernels, lambda: self._linearizer, t, "as_torch"))

    def _variant(self, settings: Settings) -> tuple[Model, Settings]:
        """Compile input expressions into the model; return it with the other settings."""
        if not settings.inputs:
            return self, settings
        from cotree.scene.variants import input_expressions

        found = input_expressions(self.spec.scene, settings.inputs, settings.parameters)
        if found is None:
            return self, settings
        model = self._variants.of(found.key, lambda: compile_spec(self.spec.of(found.scene())))
        return model, replace(settings, inputs=found.others)

    def write(
        self,
        directory: str | Path,
        integrator: str = "dopri5",
        step: float | None = None,
        *,
        real: str = "double",
        prefix: str = "",
        cpp: bool = False,
        single_file: bool = False,
    ) -> CProject:
        """Write a C project: model, header, integrators, main program and build files.

        Parameters
        ----------
        directory : str or Path
            The target folder; created if it does not exist.
        integrator : str
            ``dopri5``, ``rkf45``, ``dop853``; for stiff models ``rodas5``, ``rodas4``; with a fixed
            step ``rk4``, or ``euler`` for stiff models. Several, separated by commas, are all
            compiled, for the option ``--method`` of the main program; the first is the default.
        step : float, optional
            Step size of ``rk4`` and ``euler``, [s].
        real : str
            Type of all numbers, ``double`` or ``float``.
        prefix : str
            Prefix of names in C and of files; by default the scene's name.
        cpp : bool
            Whether to write a header for C++, too.
        single_file : bool
            Whether to write one header and one source, in which all names have the prefix.

        Returns
        -------
        CProject
            The files and the command that builds them.

        Raises
        ------
        CodegenError
            If the directory cannot be written, integrator, scene and step are incompatible, or the
            prefix or the type of numbers is invalid.
        """
        from cotree.export.c_project import Kit, write_project_of

        kit = Kit(integrator, real, prefix, cpp, single_file)
        return write_project_of(self, Path(directory), kit, step, self._defaults)

    def export_fmu(
        self,
        path: str | Path,
        version: int = 3,
        kinds: Sequence[str] = ("ModelExchange", "CoSimulation"),
        integrator: str | None = None,
        *,
        inputs: Sequence[str] | None = None,
        platforms: Sequence[str] | None = None,
    ) -> Fmu:
        """Write the model as a functional mock-up unit (FMU) for other simulators.

        The file contains its C sources, which need only libm. In an FMU for Co-Simulation only, the
        sensitivities that the model was compiled with are variables.

        Parameters
        ----------
        path : str or Path
            The file, ``x.fmu``.
        version : int
            3 or 2, the version of the Functional Mock-up Interface.
        kinds : sequence of str
            ``ModelExchange``, ``CoSimulation`` or both.
        integrator : str, optional
            Integrator of Co-Simulation: ``dopri5``, ``rkf45``, ``dop853``, ``rodas5`` or
            ``rodas4``. By default ``rodas5`` for models with algebraic unknowns, else ``dopri5``.
        inputs : sequence of str, optional
            Inputs that the importer sets, by default those that are constant in the scene.
        platforms : sequence of str, optional
            Platforms of its libraries: ``x86_64-linux``, ``aarch64-linux``, ``x86_64-windows``,
            ``x86_64-darwin``, ``aarch64-darwin``. By default this machine; others need the extra
            ``zig``. An FMU with an empty list contains sources only.

        Raises
        ------
        CodegenError
            If an argument is unknown, or the scene does not support it.
        SceneError
            If the file cannot be written.
        BuildError
            If there is no compiler, or it fails.
        """
        from cotree.export.fmi.fmu import choose, write_fmu_of

        choice = choose(version, kinds, integrator, inputs, platforms)
        return write_fmu_of(self, target_path(path, "the FMU"), choice, self._defaults)


def compile_spec(spec: BuildSpec) -> Model:
    """Form the equations, generate C, compile and load it; see :meth:`cotree.Scene.compile`."""
    kernels, times = spec.compile()
    return Model(kernels, spec, times)
