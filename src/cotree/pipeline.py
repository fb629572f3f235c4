"""The named and timed stages from a scene to its C text.

::

    scene -> linear graphs -> trees -> first graph -> equations -> program -> C text

:mod:`cotree.spec` continues from there to kernels.
"""

from __future__ import annotations

import time
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.choice import choose_first_graph
from cotree.codegen.c_files import cdef, render_model
from cotree.codegen.context import model_context
from cotree.components import Kind
from cotree.errors import Error, FormulationError, TopologyError
from cotree.formulation.early import check_numbers, within_range
from cotree.hybrid.jumps import jump_values, lower_discontinuities
from cotree.program.lower import lower
from cotree.program.passes import PassReport, run_passes
from cotree.program.text import ModelText
from cotree.quiet import without_collection
from cotree.scene.checks import check_scene_units, impossible_inertias, tiny_masses
from cotree.scene.graphs import (
    Trees,
    candidate_trees,
    choose_trees,
    joint_tree,
    linear_graphs,
    separate_trees,
)
from cotree.sensitivity.graphs import form_equations, input_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.choice import Alternative
    from cotree.equations import Derivative, Equations
    from cotree.formulation.first_graph import FirstGraph
    from cotree.graph import LinearGraph, Tree
    from cotree.program.layout import Layout
    from cotree.program.program import Program
    from cotree.scene.description import SceneDescription
    from cotree.scene.graphs import TreeChoice


#: Operations of a Jacobian from which it is printed and compiled separately; gcc takes 0.2 s.
_LONG_JACOBIAN = 2_000


@dataclass(frozen=True)
class Formed:
    """The results of all stages from a scene to its C text."""

    first: FirstGraph  # first graph, from which the equations were formed
    alternatives: tuple[Alternative, ...]  # formulations that were tried, the cheapest first
    reports: tuple[PassReport, ...]  # operation counts before and after each optimisation pass
    text: ModelText  # the optimised program with its C text
    times: Mapping[str, float]  # time spent in each stage: formulate, generate, [s]


def draw_graphs(
    scene: SceneDescription, tree: TreeChoice
) -> tuple[dict[str, LinearGraph], dict[str, Tree]]:
    """Form the linear graphs of a scene and choose trees; raise TopologyError if that fails."""
    check_edges(scene)
    mechanics = scene.mechanics
    graphs = linear_graphs(mechanics)
    trees = choose_trees(mechanics, graphs, tree)
    # A scene with networks only has no multibody graphs.
    if not mechanics.edges:
        graphs, trees = {}, {}
    # Networks have a graph and a normal tree for each domain.
    from cotree.formulation.networks.network import draw_networks

    _, networks, normal = draw_networks(scene)
    # Show the tree of the across variables, as for mechanisms.
    across = {domain: tree.across for domain, tree in normal.items()}
    return {**graphs, **networks}, {**trees, **across}


def check_edges(scene: SceneDescription) -> None:
    """Raise an error for a scene without edges."""
    if not scene.edges and not scene.events:
        raise TopologyError(f"scene '{scene.name}' has no edges: add components between nodes")


@without_collection()
def formulate(
    scene: SceneDescription,
    sensitivities: Sequence[str],
    tree: TreeChoice,
    baumgarte: float = 0.0,
    check: Callable[[FirstGraph], None] | None = None,
) -> tuple[FirstGraph, Equations, tuple[Alternative, ...]]:
    """Return the first graph, the equations and the formulations tried, the cheapest first.

    ``baumgarte`` is the rate, [1/s], at which violated constraints decay; zero leaves them to
    projection. ``check`` may raise an error for the first graph in the first tree, before other
    trees are tried. Raises ModelError or FormulationError if the equations cannot be formed.
    """
    with within_range(scene):
        check_scene_units(scene)
        trees = trees_to_try(scene, tree)
        # All alternatives have circuits, cutsets, elimination and derivatives for one parameter.
        # The chosen one also has all sensitivity graphs (Eq. (4) of the paper).
        first, alternatives = choose_first_graph(scene, trees, sensitivities, baumgarte, check)
        _check_kinks(first, sensitivities)
        if sensitivities:
            _check_impacts(first)
        return first, form_equations(first, sensitivities), alternatives


def _check_kinks(first: FirstGraph, sensitivities: Sequence[str]) -> None:
    """Raise an error if sensitivities jump at a kink whose time is unknown before the run."""
    parameters = first.system.tunable
    for what, symbols in (first.network.kinks if first.network else {}).items():
        # The time of a kink that depends on states or inputs depends on all parameters.
        of_time = all(symbol.data[0] in ("p", "t") for symbol in symbols)
        for name in sensitivities:
            if of_time and parameters.get(name) not in symbols:
                continue  # the time of this kink does not depend on the parameters
            raise FormulationError(
                f"{what} has a kink, and dependent storages need its rate of change: where the "
                f"rate jumps, the sensitivity to '{name}' would jump, too, at an unknown time; "
                "give an expression without kinks, or compile without this sensitivity"
            )


def _check_impacts(first: FirstGraph) -> None:
    """Raise an error if the inertia or friction of an impact depends on time or inputs.

    Sensitivities would need their derivatives with respect to the time of the impact.
    """
    ports = first.network.ports if first.network else {}
    stops = [port.edge.name for port in ports.values() if port.kind is Kind.STOP]
    timed = {"t", *first.scene.inputs}
    for port in ports.values() if stops else ():
        friction = port.terminal.friction
        is_pressed = friction is not None and bool(friction.presser)
        if port.kind not in (Kind.ACROSS_STORAGE, Kind.COUPLED) and not is_pressed:
            continue
        for name, field in port.edge.law_fields.items():
            names = () if name == "restitution" else getattr(field, "names", ())
            if timed.intersection(names):
                raise FormulationError(
                    f"{name} of edge '{port.edge.name}' depends on time or an input, and edge "
                    f"'{stops[0]}' has impacts, which have no sensitivities then: make it "
                    "constant, or compile without sensitivities"
                )


def trees_to_try(scene: SceneDescription, tree: TreeChoice) -> list[Trees]:
    """Return the trees that the user named, or else all trees to compare."""
    check_edges(scene)
    mechanics = scene.mechanics
    # The tree determines which across variables are coordinates (Section 3 of the paper), and thus
    # the number and length of the equations.
    if tree is None:
        return candidate_trees(mechanics)
    return [joint_tree(mechanics, choose_trees(mechanics, linear_graphs(mechanics), tree))]


@without_collection()
def count_trees(scene: SceneDescription) -> tuple[Alternative, ...]:
    """Estimate the cost of the equations in each tree; return one row per tree, the cheapest first.

    Pairs of different trees for translation and rotation come last: they are only used if named.
    The result is empty if no equations can be formed.
    """
    trees = trees_to_try(scene, None)
    try:
        alternatives = choose_first_graph(scene, trees, ())[1]
    except (Error, ArithmeticError):  # for example a constant beyond the range of doubles
        return ()
    for pair in separate_trees(scene.mechanics):
        with suppress(Error, ArithmeticError):
            alternatives += choose_first_graph(scene, [pair], ())[1]
    cheapest: dict[str, Alternative] = {}
    for row in alternatives:
        # Rows are sorted by cost, so the first row of each tree is its cheapest.
        cheapest.setdefault(row.trees.listed(), row)
    return tuple(cheapest.values())


def equations_of_deviations(first: FirstGraph) -> tuple[Equations, tuple[Derivative, ...]]:
    """Form equations without sensitivities, and their derivatives with respect to each input."""
    return form_equations(first, ()), input_columns(first)


@without_collection()
def generate(equations: Equations) -> tuple[Program, tuple[PassReport, ...]]:
    """Lower equations to a program and run the optimisation passes."""
    # Lowering eliminates the accelerations. Passes change operations but no values.
    return run_passes(lower(equations))


def text_at_rest(layout: Layout, scene: SceneDescription) -> ModelText:
    """Form the C text of the steady-state equations that determine a model's operating point."""
    # The steady state does not depend on initial values, so omit their sensitivities.
    given = [name for name in layout.sensitivities if name in scene.parameters]
    wanted = [row.name for row in layout.states]
    for total, _ in layout.followers:  # variables that follow from totals replace the totals
        wanted[total] = "0"
    from cotree.scene.variants import scene_at_rest

    try:
        at_rest = scene_at_rest(scene, wanted, jump_values(scene))
        program, _ = generate(formulate(at_rest, given, None)[1])
    except Error as error:
        hint = ""
        if isinstance(error, TopologyError):
            hint = (
                "; storages are at rest at the operating point, so only a resistance helps, or "
                "initial values without start = \"operating point\" ('uic' in a netlist)"
            )
        raise type(error)(f"the operating point: {error}{hint}") from None
    return text_of(program)


@without_collection()
def form_text(
    scene: SceneDescription,
    sensitivities: Sequence[str],
    tree: TreeChoice,
    baumgarte: float,
    locates_kinks: bool = True,
) -> Formed:
    """Form the C text of a scene; :class:`cotree.spec.BuildSpec` describes the arguments."""
    with within_range(scene):
        marks = [time.perf_counter()]
        # Jumps in expressions become events, which the engine locates. Equations for display and
        # for operating points keep them.
        acting = lower_discontinuities(scene, has_sensitivities=bool(sensitivities))
        first, equations, alternatives = formulate(
            acting, sensitivities, tree, baumgarte, check_numbers
        )
        marks.append(time.perf_counter())
        # Branches of piecewise expressions are frozen during steps, unless only for display.
        if locates_kinks and equations.is_piecewise:
            from cotree.program.surfaces import freeze_branches

            equations = freeze_branches(equations)
        program, reports = generate(equations)
        causes = [sentence for _, sentence in tiny_masses(scene)][:2]
        slow = " ".join(f"{sentence[0].upper()}{sentence[1:]}." for sentence in causes)
        cautions = tuple(impossible_inertias(scene))
        text = replace(text_of(program), slow_causes=slow, cautions=cautions)
        marks.append(time.perf_counter())
        times = {"formulate": marks[1] - marks[0], "generate": marks[2] - marks[1]}
        return Formed(first, alternatives, reports, text, times)


def text_of(program: Program) -> ModelText:
    """Print the C text of a program, without its Jacobian if that is long."""
    is_divided = program.kernels["jacobian"].operations.total >= _LONG_JACOBIAN
    names = [name for name in program.kernels if name != "jacobian" or not is_divided]
    context = model_context(program, names_of=names)
    files = render_model(context)
    return ModelText.of(
        program,
        files=files,
        is_divided=is_divided,
        declarations=cdef(files["cotree_abi.h"], context.prefix),
        prefix=context.prefix,
        n_written=context.n_written,
        n_written_in_all=context.n_written_in_all,
    )
