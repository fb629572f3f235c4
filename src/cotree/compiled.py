"""The compiled model of a scene, as users see it: thin over the stages that do the work."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.carried import carry, digest
from cotree.ensemble.of_model import EnsembleMethods
from cotree.errors import Error, SolveError
from cotree.files import target_path
from cotree.model.arrays import as_array, derived_values
from cotree.model.model import Moment
from cotree.model.points import PointMethods
from cotree.model.start import find_start, scene_start
from cotree.naming import c_identifier
from cotree.operating import OperatingPoint, program_at_rest
from cotree.quiet import level_of_user
from cotree.runner import RunnableModel
from cotree.scene.settings import OPERATING_POINT
from cotree.scene.variants import expressions_among
from cotree.sharing import forming, locked_cached_property
from cotree.solvers.methods import METHODS
from cotree.variants import Variants

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.choice import Operations
    from cotree.compilation import Compiled
    from cotree.export.c_project import CProject
    from cotree.export.fmi.fmu import Fmu, FmuChoice
    from cotree.formulation.first_graph import FirstGraph
    from cotree.model.arrays import Array
    from cotree.model.consistent import Start
    from cotree.model.linearize import Linearizer
    from cotree.program import Program
    from cotree.recipe import CarriedRecipe, Recipe
    from cotree.scene.description import SceneDescription
    from cotree.scene.settings import Settings


class Model(RunnableModel, EnsembleMethods, PointMethods):
    """A compiled scene.

    Attributes
    ----------
    times : dict of str to float
        Seconds spent in each stage: formulate, generate, compile, start.
    """

    _recipe: Recipe | CarriedRecipe

    def __init__(
        self, compiled: Compiled, recipe: Recipe | CarriedRecipe, at_rest: Program | None = None
    ) -> None:
        begins_at_rest = recipe.defaults.start == OPERATING_POINT
        # Only bound here: the network at rest is formed when a start is first asked for.
        rest = OperatingPoint(self, lambda: at_rest or program_at_rest(self, recipe.scene))
        super().__init__(compiled.text.program, compiled.kernels, rest if begins_at_rest else None)
        self._compiled, self._recipe = compiled, recipe
        self.times: dict[str, float] = dict(compiled.times)

    def __reduce__(self) -> tuple[Any, ...]:
        # Libraries belong to a process; another one compiles the text, or finds it in its cache.
        return carry(self._compiled.text, self._recipe, self._program_at_rest)

    @property
    def _scene(self) -> SceneDescription:
        # Of a model from another process, its bytes are opened here.
        return self._recipe.scene

    @property
    def _program_at_rest(self) -> Program | None:
        return self._rest.program if isinstance(self._rest, OperatingPoint) else None

    @property
    def digest(self) -> str:
        """Hash of its C text, names and default values: equal for models that compute the same."""
        return digest(self._compiled.text, self._program_at_rest)

    @locked_cached_property
    def _variants(self) -> Variants[Model]:
        recipe = self._recipe
        return Variants(recipe.scene, lambda other: recipe.of(other, self.first_graph).made())

    def __repr__(self) -> str:
        from cotree.model.display import model_text

        return model_text(self, ("auto", *METHODS))

    def _repr_html_(self) -> str:
        """Show names, parameters, methods and compiler in a notebook."""
        from cotree.model.display import model_html

        return model_html(self, ("auto", *METHODS))

    def slow_causes(self) -> str:
        """Return sentences on bodies that are so light that rounding errors move them."""
        from cotree.scene.checks import tiny_masses

        try:
            found = [sentence for _, sentence in tiny_masses(self._scene)]
        except Error:  # of values that a run replaced
            return ""
        return " ".join(f"{sentence[0].upper()}{sentence[1:]}." for sentence in found[:2])

    @property
    def source(self) -> str:
        """The C text of the model."""
        text = self._compiled.text
        return text.files[f"{text.prefix}.c"]

    @property
    def first_graph(self) -> FirstGraph:
        """The first graph, from which its equations were formed."""
        return self._compiled.formed.first

    @property
    def cached(self) -> bool:
        """Whether the library was compiled before."""
        return self._compiled.cached

    @property
    def operations(self) -> Operations:
        """Operation counts by kernel; ``alternatives`` are the formulations that were tried."""
        from cotree.choice import Operations

        return Operations(super().operations, self._compiled.formed.alternatives)

    def summary(self) -> str:
        """Describe the kernels, the formulations tried and what each pass did."""
        lines = [self._program.summary(), *self.operations.tried()]
        for report in self._compiled.formed.reports:
            lines.append(f"pass {report.name}: operations of each kernel alone, before -> after")
            counts = [(name, n, report.after[name]) for name, n in report.before.items()]
            rows = [f"  {name:20} {n} -> {m}" for name, n, m in counts if n != m]
            # Kernels that a pass leaves as they are have no row.
            lines += rows or ["  none changed"]
        return "\n".join(lines)

    def derived(self, p: Any = None) -> dict[str, float]:
        """Give the values of the parameters that are derived from others, by name.

        Parameters
        ----------
        p : array_like, shape (n_parameters,), or mapping of str to float, optional
            What they follow from; the scene's values where absent.

        Raises
        ------
        ParameterError
            If a value is not accepted.
        """
        return derived_values(self.layout.derived, self.parameter_array(p))

    @property
    def initial_state(self) -> Array:
        """The consistent initial states at the scene's parameter values, shape (n_states,)."""
        return scene_start(self).y

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
            Initial values of states in place of the scene's; they depend on no parameter. Those of
            algebraic unknowns are guesses, but for storages by content. Where they are all
            coordinates, or all speeds, the scene's of joints that are no states give way to them.
        u : array_like, shape (n_inputs,), optional
            Inputs at that time, which algebraic unknowns depend on.

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
        u = None if u is None else as_array(u, (len(self.inputs),), "inputs")
        # Guards look at the parameters as soon as a kernel is called.
        return find_start(Moment(self, t, self.parameter_array(p), u), initial or {})

    @locked_cached_property
    def _linearizer(self) -> Linearizer:
        from cotree.model.linearize import Linearizer
        from cotree.pipeline import equations_of_deviations

        return Linearizer(*equations_of_deviations(self.first_graph))

    def _variant(self, settings: Settings) -> tuple[Model, Settings]:
        """Give the model with expressions among the inputs compiled in, and what is left to set."""
        given = settings.inputs
        if not given:
            return self, settings
        expressions = expressions_among(given) if isinstance(given, Mapping) else {}
        if not expressions:
            return self, settings
        rest = {name: value for name, value in given.items() if name not in expressions}
        model = self._variants.of(expressions, settings.parameters)
        return model, replace(settings, inputs=rest)

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
        """Write model, header, integrators, a main program and build files that need no Python.

        Parameters
        ----------
        directory : str or Path
            The target folder; made if it does not exist.
        integrator : str
            ``dopri5``, ``rkf45``, ``dop853``; if stiff ``rodas5``, ``rodas4``; of one step length
            ``rk4``, if stiff ``euler``. Several, separated by commas, are all compiled in, for the
            option ``--method`` of the main program; the first one runs by default.
        step : float, optional
            Length of the steps of ``rk4`` and ``euler``, [s].
        real : str
            Type of all numbers, ``double`` or ``float``.
        prefix : str
            What names in C and files begin with, in place of the scene's name.
        cpp : bool
            Whether to write a header for C++, too.
        single_file : bool
            Whether to write one header and one source, whose names all begin with the prefix, in
            place of a file for each part and of build files.

        Returns
        -------
        CProject
            The files and the command that builds them.

        Raises
        ------
        CodegenError
            If the directory cannot be written; if integrator, scene and step do not go together;
            or if the prefix or the type of numbers is not accepted.
        """
        from cotree.export.c_project import Kit, write_c_project

        d, to = self._recipe.defaults, Path(directory)
        kit = Kit(integrator, real, prefix, cpp, single_file)
        numbers = {"t_end": d.t_end, "rtol": d.rtol, "atol": d.atol}
        # A C project has no search for operating points: it begins with the numbers found here.
        start = self.start() if self.begins_at_rest else None
        # Kernels of the project alone are new nodes of the program's arena, which threads share.
        with forming:
            return write_c_project(self._program, to, kit, **numbers, step=step, start=start)

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
            Inputs that the importer sets. By default these are the inputs that are constant in the
            scene; the others remain functions of time.
        platforms : sequence of str, optional
            Platforms of its libraries: ``x86_64-linux``, ``aarch64-linux``, ``x86_64-windows``,
            ``x86_64-darwin``, ``aarch64-darwin``. By default this machine; others need the extra
            ``zig``. An FMU with an empty list contains sources only.

        Returns
        -------
        Fmu
            What was written.

        Raises
        ------
        CodegenError
            If an argument is unknown, or the scene does not allow what it asks for.
        SceneError
            If the file cannot be written.
        BuildError
            If there is no compiler, or it fails.
        """
        from cotree.export.c_checks import Evaluated
        from cotree.export.fmi.fmu import choose, write_fmu

        choice = choose(version, kinds, integrator, inputs, platforms)
        d = self._recipe.defaults
        rest = self.start() if self.begins_at_rest else None
        to, extra = target_path(path, "the FMU"), self._fmu_extras(choice)
        # Further kernels are new nodes of the program's arena, which threads share.
        with forming:
            own = Evaluated(self._program)
            numbers = d.t_end, d.rtol, d.atol
            return write_fmu(self._program, to, choice, own, numbers, rest=rest, extra=extra)

    def _fmu_extras(self, choice: FmuChoice) -> dict[str, bytes]:
        """Give the expected results and the icon of an FMU."""
        from cotree.export.fmi.fmu import icon_files, interval_of, reference_files, reference_times
        from cotree.pipeline import draw_graphs
        from cotree.plot import draw_graphs as picture

        t_end = self._recipe.defaults.t_end
        graphs, trees = draw_graphs(self._scene, None)
        drawn = picture((graph, trees.get(domain)) for domain, graph in graphs.items())
        files = icon_files(drawn, choice.version)
        # Inputs from outside stay where they begin.
        begin = self.input_values(0.0)
        wanted = choice.inputs or ()
        held = {name: u for name, u in zip(self.inputs, begin, strict=True) if name in wanted}
        try:
            result = self.simulate(
                (0.0, t_end), reference_times(t_end, interval_of(t_end)), inputs=held, throw=True
            )
        except SolveError as error:
            warnings.warn(
                f"the FMU holds no expected results, since the scene's default run fails: {error}",
                RuntimeWarning,
                stacklevel=level_of_user(),
            )
            return files
        columns = {name: result[name] for name in self.outputs}
        return files | reference_files(c_identifier(self.layout.name), result.t, columns)
