"""The first graph: from a scene and its tree to governing equations, step by step.

This page names the branch-chord formulation in order: bind the components, lump what moves
together, f-circuits (across), terminal equations (loads), f-cutsets (through) projected on the
motion spaces.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag
from cotree.equations import State
from cotree.formulation.across import accelerate, move
from cotree.formulation.clusters import lump
from cotree.formulation.outputs import form_outputs
from cotree.formulation.safety import check_inertia, safe_pivots
from cotree.formulation.system import bind
from cotree.formulation.through import balance, load, mass_matrix

if TYPE_CHECKING:
    from collections.abc import Collection

    from cotree.dag.nodes import Node
    from cotree.equations import Guard
    from cotree.formulation.across import Accelerations, Motion
    from cotree.formulation.outputs import Outputs
    from cotree.formulation.system import System
    from cotree.formulation.through import Balance, Loads
    from cotree.graph import Tree
    from cotree.scene.description import SceneDescription


@dataclass(frozen=True)
class FirstGraph:
    """The first graph, solved for its through and across variables.

    Attributes
    ----------
    scene : SceneDescription
        What it was made from.
    motion, loads, across, balance : Motion, Loads, Accelerations, Balance
        Across and through variables, at the accelerations ``unknowns``.
    unknowns : tuple of Node
        Symbols of the accelerations of the coordinates.
    matrix : tuple of rows of Node
        The mass matrix.
    forcing : tuple of Node
        Right-hand side of ``matrix @ unknowns = forcing``.
    is_safe : tuple of bool
        Whether each pivot of the matrix is positive for every state.
    guards : tuple of Guard
        What parameter values must satisfy.
    states : tuple of State
        Coordinates, then their rates.
    rates : tuple of Node
        Rates of the states.
    outputs : Outputs
        The outputs.
    """

    scene: SceneDescription
    motion: Motion
    loads: Loads
    across: Accelerations
    balance: Balance
    unknowns: tuple[Node, ...]
    matrix: tuple[tuple[Node, ...], ...]
    forcing: tuple[Node, ...]
    is_safe: tuple[bool, ...]
    guards: tuple[Guard, ...]
    states: tuple[State, ...]
    rates: tuple[Node, ...]
    outputs: Outputs

    @property
    def system(self) -> System:
        """The bound scene."""
        return self.motion.system


def form_first_graph(
    scene: SceneDescription, tree: Tree, own_axes: Collection[int] = ()
) -> FirstGraph:
    """Form the governing equations of a scene in the coordinates of its tree's joints.

    Parameters
    ----------
    scene : SceneDescription
        The scene.
    tree : Tree
        The tree of its joints and arms.
    own_axes : collection of int
        The clusters whose vectors are resolved in their own axes; see
        :mod:`cotree.formulation.frames`.

    Raises
    ------
    ModelError
        If an expression or a field of the scene is wrong.
    SingularSystemError
        If a coordinate moves nothing that has inertia.
    """
    dag = Dag()
    system = bind(scene, tree, dag)
    clusters = lump(system)
    motion = move(system, clusters, own_axes)
    loads = load(motion)
    matrix = mass_matrix(motion, loads)
    check_inertia(system, matrix)
    at_rest = balance(motion, loads, accelerate(motion, [dag.zero] * len(matrix)))
    unknowns = tuple(c.acceleration for c in system.coordinates)
    across = accelerate(motion, unknowns)
    values = {
        symbol: scene.parameters[name].value
        for name, symbol in system.parameters.items()
        if symbol.op == "symbol"
    }
    is_safe, pivot_guards = safe_pivots(system, clusters, lambda n: float(evaluate([n], values)[0]))
    return FirstGraph(
        scene=scene,
        motion=motion,
        loads=loads,
        across=across,
        balance=balance(motion, loads, across),
        unknowns=unknowns,
        matrix=tuple(tuple(row) for row in matrix),
        forcing=tuple(-row for row in at_rest.residual),
        is_safe=is_safe,
        guards=(*system.guards, *pivot_guards),
        states=_states(system),
        rates=(*(c.speed for c in system.coordinates), *unknowns),
        outputs=form_outputs(motion, scene.outputs),
    )


def _states(system: System) -> tuple[State, ...]:
    """List the coordinates, then their rates."""
    positions = [
        State(c.name, c.freedom.unit, c.position, c.initial_position) for c in system.coordinates
    ]
    speeds = [
        State(f"{c.name}_dot", f"{c.freedom.unit}/s", c.speed, c.initial_speed)
        for c in system.coordinates
    ]
    return (*positions, *speeds)
