"""The public classes Scene and Model: thin layers over the stages of the compiler."""

from __future__ import annotations

import time
import warnings
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.arguments import check_names
from cotree.build import BuildOptions
from cotree.compiled import Model, compile_spec
from cotree.errors import (
    FormulationError,
    ModelError,
    ParameterError,
    SingularSystemError,
    TopologyError,
)
from cotree.model.start import check_start
from cotree.readers import load_source
from cotree.scene.adding_methods import PartMethods, TableMethods
from cotree.scene.component_methods import ComponentMethods
from cotree.scene.description import SceneDescription
from cotree.scene.expressions import check_number
from cotree.spec import BuildSpec

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cotree.export.graph_report import GraphReport
    from cotree.export.symbolic import SymbolicEquations
    from cotree.lint import Finding
    from cotree.scene.graphs import TreeChoice


__all__ = ["Model", "Scene", "load"]


class Scene(SceneDescription, ComponentMethods, PartMethods, TableMethods):
    """A system drawn as edges between named nodes.

    Parameters
    ----------
    name : str
        Its name: letters, digits, underscores, dashes.
    gravity : sequence of three float or str, [m/s^2]
        Gravitational acceleration in ground axes; expressions of parameters are allowed.

    Attributes
    ----------
    parameters, inputs, modes, events : dict of str to Parameter, Input, Mode and Event
        The declarations, by name.
    edges : dict of str to Edge
        The edges, by name.
    outputs : dict of str to Expression
        The outputs, by name.
    parts : dict of str to Part
        The parts of this scene, by name; their declarations are in the tables above, too.
    ports : tuple of str
        Nodes that must be connected if this scene is a part.
    defaults : Simulation
        Default settings of runs.
    origin : Origin or None
        Data of another tool's file, if the scene was read from one.

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
        locate_kinks: bool = True,
        locate_corners: bool | None = None,
    ) -> Model:
        """Form the equations, generate C, compile and load it.

        Parameters
        ----------
        sensitivities : sequence of str
            Sensitivities are taken to these parameters, and to initial values of these states.
        tree : None, sequence of str, or mapping of domain to sequence of str
            The branches of both graphs, or separately of ``translation`` and ``rotation``; None
            chooses those with the cheapest equations.
        optimize : str
            Compiler level, ``-O0`` to ``-O3``, or ``-Og``; ``auto`` depends on the code's size.
        native : bool
            Use all instructions of this machine; the library may then fail on others.
        baumgarte : float
            Rate, [1/s], at which violations of constraints decay. By default, zero, constraints are
            satisfied to rounding by projection.
        tunable : sequence of str, optional
            Parameters that runs may change, in addition to those of sensitivities; others become
            numbers in the code. By default those declared as tunable in the scene.
        locate_kinks : bool
            Whether runs locate the kinks of absolute values, minima, maxima and linear tables that
            depend on states, and begin a new step there. False leaves them to the error test;
            ensembles then run several members at once in vectors.
        locate_corners : bool, optional
            Deprecated name of ``locate_kinks``.

        Raises
        ------
        ModelError
            If the scene is invalid: an unknown name, a floating node, an invalid value.
        FormulationError
            If its equations cannot be formed.
        BuildError
            If the C source cannot be compiled.
        """
        begun = time.perf_counter()
        names = check_names(sensitivities, "sensitivities")
        # Parameters that runs cannot change become constants in the code.
        described = self
        if tunable is not None:
            from cotree.scene.variants import keep_tunable

            described = keep_tunable(self, tunable, names)
        # A negative rate would increase violations of constraints.
        rate = check_number(baumgarte, "baumgarte")
        if rate < 0.0:
            raise ParameterError(f"baumgarte is {rate}: it must not be negative")
        options = BuildOptions(optimize=optimize, native=native)
        prepared = time.perf_counter() - begun
        # The model keeps a copy of the scene, which later changes do not affect.
        described = described.copied()
        if locate_corners is not None:
            warnings.warn(
                "locate_corners is deprecated: use locate_kinks", DeprecationWarning, stacklevel=2
            )
            locate_kinks = locate_corners
        spec = BuildSpec(described, names, tree, options, rate, bool(locate_kinks))
        try:
            with _locating_errors(self):
                model = compile_spec(spec)
                model.times["formulate"] += prepared
                # The start raises errors that depend on numbers, such as a motion without inertia.
                if model.kernels.backend != "none":
                    check_start(model.kernels)
        except (SingularSystemError, TopologyError) as error:
            # A misspelt node is a new node with one edge; the intended node then lacks an element.
            from cotree.lint import dangling_hint

            raise type(error)(f"{error}{dangling_hint(self)}") from None
        for name in model.kernels.unreached:
            warnings.warn(
                f"no state or output depends on parameter '{name}': its sensitivities are all zero",
                RuntimeWarning,
                stacklevel=2,
            )
        # Subtract the times of the stages from the elapsed time.
        model.times["start"] = time.perf_counter() - begun - sum(model.times.values())
        return model

    def with_inputs(
        self, inputs: Mapping[str, Any], parameters: Mapping[str, float] | None = None
    ) -> Scene:
        """Return a scene in which inputs are other signals, or feedback.

        Parameters
        ----------
        inputs : mapping of str to number, str or (times, values)
            New values of inputs: expressions of t, parameters, states, outputs, other inputs and
            any variables that fields may name; numbers; or tables over time. An input that depends
            on more than t and parameters becomes an output of the new scene.
        parameters : mapping of str to float, optional
            Values of new parameters, such as gains, that the expressions use. Sensitivities may be
            taken to them as to any other parameter.

        Raises
        ------
        ModelError
            If a name is unknown, a value is not accepted, or an input would depend on itself.

        Examples
        --------
        >>> scene = Scene("cart")
        >>> scene.input("push", 0.0, unit="N")
        >>> scene.edge("rail", "prismatic", "ground", "A", axis=[1, 0, 0], force="push")
        >>> scene.edge("cart", "rigid_body", "ground", "A", mass=2.0)
        >>> closed = scene.with_inputs({"push": "-k*rail.s - d*rail.s_dot"}, {"k": 8.0, "d": 4.0})
        >>> closed.compile(["k"]).linearize().A.tolist()
        [[0.0, 1.0], [-4.0, -2.0]]
        """
        from cotree.scene.variants import with_inputs

        return with_inputs(self, inputs, parameters)

    def graph(self, tree: TreeChoice = None) -> GraphReport:
        """Return the linear graphs with their trees and topology matrices.

        Raises TopologyError if a node is floating or the named edges are not a tree.
        """
        from cotree.export.graph_report import graph_report
        from cotree.pipeline import count_trees, draw_graphs

        with _locating_errors(self):
            costs = count_trees(self)
            # The report shows the tree that compile() would choose. If the equations cannot be
            # formed, there are no costs, and the trees are chosen without costs.
            if tree is None and costs:
                tree = list(costs[0].trees.branches)
            return graph_report(*draw_graphs(self, tree), costs, tuple(self.members))

    def equations(
        self, sensitivities: Sequence[str] = (), tree: TreeChoice = None
    ) -> SymbolicEquations:
        """Form the governing and sensitivity equations as SymPy expressions.

        Raises ModelError or FormulationError as :meth:`compile` does.
        """
        from cotree.export.symbolic import symbolic_equations
        from cotree.pipeline import formulate

        names = check_names(sensitivities, "sensitivities")
        with _locating_errors(self):
            return symbolic_equations(formulate(self, names, tree)[1])

    def lint(self, allow: Sequence[str] = ()) -> tuple[Finding, ...]:
        """List suspicious statements: unused parameters, dangling nodes, inconsistent units, ...

        Parameters
        ----------
        allow : sequence of str
            Intended findings, ``rule`` or ``rule:name``, in addition to those declared by
            :meth:`allow`.

        Returns
        -------
        tuple of Finding
            Each with ``rule``, ``severity``, ``kind`` and ``name`` of the element, ``line`` of the
            scene file, and ``message``.

        Raises
        ------
        SceneError
            If an entry of ``allow`` is not a rule.
        """
        from cotree.lint import lint

        return lint(self, allow)

    def save(self, path: str | Path) -> None:
        """Write the scene to a ``.toml`` file, completely or not at all.

        The file loads to the same scene, whatever the source of this one; comments and order of a
        scene file are kept. Types of :func:`cotree.register_component` are stored by name, and must
        be registered before the file is loaded. Raises SceneError if the file cannot be written, or
        attributes of the scene were changed without its methods.
        """
        from cotree.scene.toml_text import save_scene

        save_scene(self, Path(path))


@contextmanager
def _locating_errors(scene: SceneDescription) -> Iterator[None]:
    """Append to errors about a scene the locations of its parts' declarations."""
    try:
        yield
    except (ModelError, FormulationError) as error:
        if not scene.members:
            raise
        from cotree.scene.part_adding import origin_note

        note = origin_note(str(error), scene.members, scene)
        if not note or note in str(error):
            raise
        raise type(error)(f"{error}{note}") from None


def load(source: str | Path) -> Scene:
    """Read a scene by its name or from a file.

    Parameters
    ----------
    source : str or Path
        Name of a shipped scene or part, or path of a TOML, URDF, SPICE or SBML file.

    Raises
    ------
    ModelError
        If the scene does not exist, the format of the file is unknown, or the scene is invalid.

    Examples
    --------
    >>> load("slider-pendulum").nodes
    ('ground', 'A', 'C', 'D', 'B')
    """
    return load_source(source, Scene)
