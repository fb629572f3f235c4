"""The public face: Scene and Model, thin over the stages that do the work."""

from __future__ import annotations

import time
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.arguments import check_names
from cotree.build import BuildOptions
from cotree.compiled import Model, compile_spec
from cotree.errors import ParameterError, SingularSystemError, TopologyError
from cotree.model.start import check_start
from cotree.readers import load_source
from cotree.scene.component_methods import ComponentMethods
from cotree.scene.description import SceneDescription
from cotree.scene.expressions import check_number
from cotree.scene.methods import PartMethods, TableMethods
from cotree.scene.part_adding import locating_errors
from cotree.scene.variants import keep_tunable, with_inputs
from cotree.spec import BuildSpec

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

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
        Acceleration of free fall in ground axes; expressions of parameters are allowed.

    Attributes
    ----------
    name : str
        Its name.
    gravity : tuple of Expression
        Acceleration of free fall, along the axes of the ground.
    parameters, inputs, modes, events : dict of str to Parameter, Input, Mode and Event
        What was declared, by name.
    edges : dict of str to Edge
        The components between their nodes, by name.
    outputs : dict of str to Expression
        The outputs by name.
    parts : dict of str to Part
        The scenes within this one, by name; what they declare stands in the tables above, too.
    ports : tuple of str
        Nodes that must be connected where this scene is a part.
    defaults : Simulation
        Settings of runs where a call gives none.
    origin : Origin or None
        The file of another tool that the scene was read from.

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
        locate_corners: bool = True,
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
        locate_corners : bool
            Whether runs locate the corners of absolute values, minima, maxima and linear tables of
            what moves, and begin a new step there. False leaves them to the error test; ensembles
            then run several members at once in vectors.

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
        names = check_names(sensitivities, "sensitivities")
        # Parameters that no run may change become numbers, which fold into the code.
        described = keep_tunable(self, tunable, names)
        # At a negative rate violated constraints would be driven further away.
        rate = check_number(baumgarte, "baumgarte")
        if rate < 0.0:
            raise ParameterError(f"baumgarte is {rate}: it must not be negative")
        options = BuildOptions(optimize=optimize, native=native)
        prepared = time.perf_counter() - begun
        # The model keeps the scene as it is now, whatever is added to it later.
        described = described.copied()
        spec = BuildSpec(described, names, tree, options, rate, bool(locate_corners))
        try:
            with locating_errors(self):
                model = compile_spec(spec)
                model.times["formulate"] += prepared
                # Faults that only numbers show, as a motion without inertia, are refused here.
                if model.kernels.backend != "none":
                    check_start(model.kernels)
        except (SingularSystemError, TopologyError) as error:
            # A node that is misspelt leaves another one without what it should carry.
            from cotree.lint import dangling_hint

            raise type(error)(f"{error}{dangling_hint(self)}") from None
        for name in model.kernels.unreached:
            warnings.warn(
                f"no state or output depends on parameter '{name}': its sensitivities are all zero",
                RuntimeWarning,
                stacklevel=2,
            )
        # What the other stages leave of the time.
        model.times["start"] = time.perf_counter() - begun - sum(model.times.values())
        return model

    def with_inputs(
        self, inputs: Mapping[str, Any], parameters: Mapping[str, float] | None = None
    ) -> Scene:
        """Return a scene in which inputs are other signals, or feedback.

        Parameters
        ----------
        inputs : mapping of str to number, str or (times, values)
            In place of the input of that name: an expression of t, parameters, states, outputs,
            other inputs and whatever fields may name; a number; or a table over time. An input that
            depends on more than t and parameters becomes an output of the new scene.
        parameters : mapping of str to float, optional
            Values of new parameters, such as gains, that the expressions use. Sensitivities to
            them may be asked for as to any other.

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
        return with_inputs(self, inputs, parameters)

    def graph(self, tree: TreeChoice = None) -> GraphReport:
        """Draw the linear graphs, with trees and topology matrices.

        Raises
        ------
        TopologyError
            If a node is floating or the named edges are not a tree.
        """
        from cotree.export.graph_report import graph_report
        from cotree.pipeline import count_trees, draw_graphs

        with locating_errors(self):
            costs = count_trees(self)
            # The report shows the tree that compile() would take. A scene whose equations cannot be
            # formed has no costs, and its trees are chosen without them.
            if tree is None and costs:
                tree = list(costs[0].trees.branches)
            return graph_report(*draw_graphs(self, tree), costs, tuple(self.members))

    def equations(
        self, sensitivities: Sequence[str] = (), tree: TreeChoice = None
    ) -> SymbolicEquations:
        """Form governing and sensitivity equations as SymPy expressions, to read.

        Raises
        ------
        ModelError, FormulationError
            As for :meth:`compile`.
        """
        from cotree.export.symbolic import symbolic_equations
        from cotree.pipeline import formulate

        names = check_names(sensitivities, "sensitivities")
        with locating_errors(self):
            return symbolic_equations(formulate(self, names, tree)[1])

    def lint(self, allow: Sequence[str] = ()) -> tuple[Finding, ...]:
        """List what is suspicious: unused parameters, dangling nodes, contradicting units...

        Parameters
        ----------
        allow : sequence of str
            Findings that are on purpose, ``rule`` or ``rule:name``, besides those that
            :meth:`allow` has declared.

        Returns
        -------
        tuple of Finding
            Each with ``rule``, ``severity``, ``kind`` and ``name`` of the culprit, ``line`` of the
            scene file, and ``message``.

        Raises
        ------
        SceneError
            If an entry of allow names no rule.
        """
        from cotree.lint import lint

        return lint(self, allow)

    def save(self, path: str | Path) -> None:
        """Write the scene to a TOML file, whole or not at all.

        It loads to the same scene, whatever this one was read from; comments and order of a scene
        file are kept. Types of :func:`cotree.register_component` are named in it, and must be
        registered where it is read.

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
        Name of a shipped scene or part, or path of a TOML, URDF, SPICE or SBML file.

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
