"""The public face: Scene and Model, thin over the stages that do the work."""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.build import BuildOptions
from cotree.errors import ParameterError
from cotree.operating import OperatingModel
from cotree.readers import load_source
from cotree.results import Result
from cotree.scene.description import SceneDescription, check_number
from cotree.scene.tunable import keep_tunable, listed_names
from cotree.sharing import forming
from cotree.solvers.simulate import Settings, simulate

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.choice import Operations
    from cotree.export.c_project import CProject
    from cotree.export.equations import SymbolicEquations
    from cotree.export.graph_report import GraphReport
    from cotree.pipeline import Compiled
    from cotree.scene.graphs import TreeChoice


class Scene(SceneDescription):
    """A system drawn as edges between named nodes.

    Parameters
    ----------
    name : str
        Its name: letters, digits, underscores, dashes.
    gravity : sequence of three float or str, [m/s^2]
        Acceleration of free fall in ground axes; expressions of parameters are allowed.

    Examples
    --------
    >>> scene = Scene("pendulum", gravity=[0, "-g", 0])
    >>> scene.parameter("g", 9.81, unit="m/s^2")
    >>> scene.parameter("L", 2.0, unit="m")
    >>> scene.edge("hinge", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 0.1})
    >>> scene.edge("rod", "arm", "A", "B", vector=[0, "-L", 0])
    >>> scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
    >>> scene.compile(sensitivities=["L"]).states
    ('hinge.theta', 'hinge.theta_dot')
    """

    def compile(
        self,
        sensitivities: Sequence[str] = (),
        tree: TreeChoice = None,
        *,
        optimize: str = "auto",
        native: bool = False,
        baumgarte: float = 0.0,
        tunable: Sequence[str] | None = None,
    ) -> Model:
        """Form the equations, generate C, compile and load it.

        Parameters
        ----------
        sensitivities : sequence of str
            Parameters, or states whose initial value is meant, to take sensitivities to.
        tree : None, sequence of str, or mapping of domain to sequence of str
            The branches of both graphs, or of ``translation`` and ``rotation`` each; None takes
            those that add least to the equations.
        optimize : str
            Compiler level, ``-O0`` to ``-O3``, or ``-Og``; ``auto`` goes by the size of the code.
        native : bool
            Use every instruction of this machine; the library then runs on no other.
        baumgarte : float
            Rate, [1/s], at which violated constraints decay. Zero, the default, leaves them to
            projection, which holds them to rounding.
        tunable : sequence of str, optional
            Parameters that runs may change, with those of sensitivities; others become numbers in
            the code. As the scene says where absent.

        Returns
        -------
        Model
            The compiled model.

        Raises
        ------
        ModelError
            If the scene is wrong: an unknown name, a floating node, a bad value.
        FormulationError
            If its equations cannot be formed.
        BuildError
            If the C text cannot be compiled.
        """
        begun = time.perf_counter()
        from cotree.pipeline import compile_scene

        names = listed_names(sensitivities, "sensitivities")
        described = keep_tunable(self, tunable, names)
        rate = check_number(baumgarte, "baumgarte")
        if rate < 0.0:
            raise ParameterError(f"baumgarte is {rate}: it must not be negative")
        options = BuildOptions(optimize=optimize, native=native)
        prepared = time.perf_counter() - begun
        model = Model(compile_scene(described, names, tree, options, rate), described)
        model.times["formulate"] += prepared
        model.check_start()
        for name in model.unreached:
            warnings.warn(
                f"no state or output depends on parameter '{name}': its sensitivities are all zero",
                RuntimeWarning,
                stacklevel=2,
            )
        model.times["start"] = time.perf_counter() - begun - sum(model.times.values())
        return model

    def graph(self, tree: TreeChoice = None) -> GraphReport:
        """Draw the linear graphs, with trees and topology matrices.

        Raises
        ------
        TopologyError
            If a node is floating or the named edges are not a tree.
        """
        from cotree.export.graph_report import graph_report
        from cotree.pipeline import count_trees, draw_graphs

        costs = count_trees(self)
        if tree is None and costs:
            tree = list(costs[0].trees.branches)
        return graph_report(*draw_graphs(self, tree), costs)

    def equations(
        self, sensitivities: Sequence[str] = (), tree: TreeChoice = None
    ) -> SymbolicEquations:
        """Form governing and sensitivity equations as SymPy expressions, to read.

        Raises
        ------
        ModelError, FormulationError
            As for :meth:`compile`.
        """
        from cotree.export.equations import symbolic_equations
        from cotree.pipeline import formulate

        names = listed_names(sensitivities, "sensitivities")
        return symbolic_equations(formulate(self, names, tree)[1])

    def save(self, path: str | Path) -> None:
        """Write the scene to a TOML file, whole or not at all.

        It loads to the same scene, whatever this one was read from. Types of
        :func:`cotree.register_component` are named in it, and must be registered where it is read.

        Parameters
        ----------
        path : str or Path
            The file; its name ends in .toml.

        Raises
        ------
        SceneError
            If the file cannot be written, or parts of the scene were changed by other means than
            its methods.
        """
        from cotree.scene.toml_text import save_scene

        save_scene(self, Path(path))


def load(source: str | Path) -> Scene:
    """Read a scene.

    Parameters
    ----------
    source : str or Path
        Name of a shipped scene, or path of a TOML, URDF or SPICE file.

    Raises
    ------
    ModelError
        If there is no such scene, the file is none of these, or the scene is wrong.

    Examples
    --------
    >>> load("slider-pendulum").nodes
    ('ground', 'A', 'C', 'D', 'B')
    """
    return load_source(source, Scene)


class Model(OperatingModel):
    """A compiled scene."""

    def __init__(self, compiled: Compiled, scene: SceneDescription) -> None:
        super().__init__(compiled.program, compiled.kernels, scene, compiled.first)
        self._compiled = compiled
        #: Seconds spent in each stage: formulate, generate, compile, start.
        self.times: dict[str, float] = dict(compiled.times)

    @property
    def source(self) -> str:
        """The C text of the model."""
        return self._compiled.files[f"{self._compiled.context.prefix}.c"]

    @property
    def cached(self) -> bool:
        """Whether the library was compiled before."""
        return self._compiled.cached

    @property
    def operations(self) -> Operations:
        """Operation counts by kernel; ``alternatives`` are the formulations that were tried."""
        from cotree.choice import Operations

        return Operations(super().operations, self._compiled.alternatives)

    def summary(self) -> str:
        """Describe the kernels, the formulations tried and what each pass did."""
        lines = [self._program.summary(), *self.operations.tried()]
        for report in self._compiled.reports:
            lines.append(f"pass {report.name}: operations of each kernel alone, before -> after")
            counts = [(name, n, report.after[name]) for name, n in report.before.items()]
            rows = [f"  {name:20} {n} -> {m}" for name, n, m in counts if n != m]
            lines += rows or ["  none changed"]
        return "\n".join(lines)

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
        error_test_sensitivities: bool = True,
        scales: Mapping[str, float] | None = None,
        max_step: float | None = None,
        max_steps: int | None = None,
        max_events: int | None = None,
        time_limit: float | None = None,
        throw: bool = False,
        project: bool = True,
    ) -> Result:
        """Integrate states and sensitivities together.

        Parameters
        ----------
        t_span : (float, float), optional
            Start and end, [s]; the scene's ``t_end`` where absent.
        t_eval : array_like, shape (n_t,), optional
            Times to report; the solver's own steps where absent.
        method : str, optional
            ``dopri5``, ``rkf45``, ``dop853``, ``rodas4``, ``rodas5`` (in C), ``RK45``, ``RK23``,
            ``DOP853``, ``Radau``, ``BDF``, ``LSODA`` (SciPy), ``cvode``, ``ida``, and as an extra
            ``cvodes``, ``cvodes-simultaneous`` and ``idas`` (SUNDIALS), or ``auto``.
        rtol, atol : float, optional
            Relative and absolute tolerance.
        parameters : mapping of str to float, or array_like of shape (n_parameters,), optional
            Values in place of the scene's.
        initial : mapping of str to float, optional
            Initial values of states in place of the scene's; they depend on no parameter.
        inputs : mapping, optional
            Inputs in place of the scene's: a number, an expression of t and parameters,
            (times, values), or a Python function of t.
        error_test_sensitivities : bool
            Whether sensitivities take part in the error test.
        scales : mapping of str to float, optional
            Sizes of parameters in place of their values: ``atol`` divided by them is that of their
            sensitivities. One where a value is zero, and for initial values.
        max_step : float, optional
            Longest step, [s]; infinity for no limit. The default is a 32nd of the shortest period
            where sines of time drive laws that act for a part of it, as diodes do; else none.
        max_steps, max_events, time_limit : int, int and float, optional
            Budgets of steps, of events that happen, and of seconds.
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
        >>> result = load("slider-pendulum").compile(["L"]).simulate((0, 10), rtol=1e-10)
        >>> round(float(result["j1.s"][-1]), 6)
        0.526045
        """
        defaults = self._scene.defaults
        settings = Settings(
            t_span=(0.0, defaults.t_end) if t_span is None else t_span,
            t_eval=t_eval,
            method=method or defaults.method,
            rtol=defaults.rtol if rtol is None else rtol,
            atol=defaults.atol if atol is None else atol,
            parameters=parameters,
            initial=initial or {},
            inputs=inputs or {},
            error_test_sensitivities=error_test_sensitivities,
            scales=scales or {},
            max_step=max_step,
            max_steps=max_steps,
            max_events=max_events,
            time_limit=time_limit,
            throw=throw,
            project=project,
        )
        run = simulate(self, settings, self.layout.units)
        built = self.times.get("compile", 0.0) + run.times["compile"]
        times = {**self.times, **run.times, "compile": built}
        return Result(**{**vars(run), "times": times}, model=self)

    def write(
        self, directory: str | Path, integrator: str = "dopri5", step: float | None = None
    ) -> CProject:
        """Write model, header, integrator and a main program that need no Python.

        Parameters
        ----------
        directory : str or Path
            Where to; made if it does not exist.
        integrator : str
            ``dopri5``, ``rkf45``, ``dop853``; if stiff ``rodas5``, ``rodas4``; of one step length
            ``rk4``, if stiff ``euler``.
        step : float, optional
            That length, [s].

        Returns
        -------
        CProject
            The files and the command that builds them.

        Raises
        ------
        CodegenError
            If the directory cannot be written, or integrator, scene and step do not go together.
        """
        from cotree.export.c_project import write_c_project

        d, to = self._scene.defaults, Path(directory)
        numbers = {"t_end": d.t_end, "rtol": d.rtol, "atol": d.atol}
        start = self.start() if self.begins_at_rest else None
        with forming:
            return write_c_project(self._program, to, integrator, **numbers, step=step, start=start)
