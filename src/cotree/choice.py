"""Choice of the tree, and of the axes of each cluster, that make the equations cheapest."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING

from cotree.dag.nodes import reachable
from cotree.errors import FormulationError, ModelError
from cotree.formulation.first_graph import form_first_graph, tree_links
from cotree.formulation.mass_matrix import is_deep
from cotree.graph import tree_walk
from cotree.program.counts import OperationCount, count_operations, cycles
from cotree.program.solved import SolvedSystem, factorise_bordered
from cotree.report import Report, Reported, Table
from cotree.scene.graphs import Trees, motion_spaces
from cotree.sensitivity.graphs import form_derivatives, unknown_tangents

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from cotree.equations import Derivative
    from cotree.formulation.first_graph import FirstGraph
    from cotree.linear.tree_elimination import TreeLink
    from cotree.scene.description import SceneDescription

_LONG = 5  # minimum number of moving branches for elimination along the tree
_PER_OPERATION = 0.5  # cycles per operation that does not wait for another operation
_SHARE_OF_JACOBIANS = 0.1  # evaluations of the Jacobian per evaluation of the right-hand side
_FEW = 3  # maximum number of rotating clusters for which all sets of axes are tried


@dataclass(frozen=True)
class Alternative:
    """A formulation of the equations, and its cost.

    Attributes
    ----------
    trees : Trees
        The trees of the translation and rotation graphs.
    own_axes : tuple of int
        The clusters resolved in their own axes.
    is_along_tree : bool
        Whether unknowns are eliminated along the tree.
    is_deferred : bool
        Whether elimination along the tree is deferred; see :mod:`cotree.linear.tree_elimination`.
    n_states, n_multipliers : int
        Numbers of states and constraint multipliers.
    n_operations : int
        Estimated operations of the right-hand side with all sensitivities.
    n_cycles : float
        Estimated cycles of these operations.
    """

    trees: Trees
    own_axes: tuple[int, ...]
    is_along_tree: bool
    is_deferred: bool
    n_states: int
    n_multipliers: int
    n_operations: int
    n_cycles: float

    def cells(self) -> tuple[object, ...]:
        """Return the cells of the row in the table of :func:`tried`."""
        axes = ", ".join(map(str, self.own_axes)) or "none"
        way = "along the tree" if self.is_along_tree else "by the matrix"
        way += ", deferred" if self.is_deferred else ""
        costs = self.n_operations, round(self.n_cycles), self.n_states, self.n_multipliers
        return *costs, way, axes, self.trees.listed()


def tried(caption: str, alternatives: Iterable[Alternative]) -> Table:
    """Return a table with one row for each formulation."""
    head = "operations", "cycles", "states", "multipliers", "way", "clusters in own axes", "tree"
    return Table(head, [row.cells() for row in alternatives], caption)


class Operations(Reported, dict[str, OperationCount]):
    """Operation counts by kernel, and the formulations that were tried.

    Attributes
    ----------
    alternatives : tuple of Alternative
        The formulations that were tried, the one with the fewest estimated cycles first.
    """

    def __init__(
        self, counts: Mapping[str, OperationCount], alternatives: Sequence[Alternative]
    ) -> None:
        super().__init__(counts)
        self.alternatives = tuple(alternatives)

    def report(self) -> Report:
        """Build the report: operations of each kernel, and the formulations."""
        rows = [(name, n.kernel, n.prepare, n.total) for name, n in self.items() if n.total]
        head = "kernel", "each call", "prepared", "total"
        return Report("Operations", Table(head, rows), self.tried())

    def __repr__(self) -> str:
        return self.summary()

    def tried(self) -> Table:
        """Return a table of the formulations that were tried."""
        caption = "formulations tried, the fewest estimated cycles first"
        return tried(caption, self.alternatives)


def choose_first_graph(
    scene: SceneDescription,
    trees: Sequence[Trees],
    sensitivities: Sequence[str],
    baumgarte: float = 0.0,
    check: Callable[[FirstGraph], None] | None = None,
) -> tuple[FirstGraph, tuple[Alternative, ...]]:
    """Form the first graph in the tree and the axes with the cheapest equations.

    Also returns all alternatives, the cheapest first. ``check`` may raise an error for the first
    graph in the first tree, before other trees are tried; errors of this tree are raised.
    """
    first, *others = trees
    found = _tried(scene, first, sensitivities, baumgarte, check)
    for other in others:
        # Errors in other trees do not invalidate the scene.
        with contextlib.suppress(ModelError, FormulationError):
            found += _tried(scene, other, sensitivities, baumgarte)
    # Compare cycles, not operations, because operations that depend on each other take longer.
    found.sort(key=lambda item: item[0].n_cycles)
    return found[0][1], tuple(item[0] for item in found)


def _tried(
    scene: SceneDescription,
    trees: Trees,
    sensitivities: Sequence[str],
    baumgarte: float,
    check: Callable[[FirstGraph], None] | None = None,
) -> list[tuple[Alternative, FirstGraph]]:
    """Form the first graph in one tree for each set of axes; apply ``check`` to the first one."""
    found: list[tuple[Alternative, FirstGraph]] = []
    for own_axes in _choices(scene, trees):
        formed = form_first_graph(scene, trees, own_axes, baumgarte)
        # All axes give the same result of the check, so it is done once.
        if check is not None and not found:
            check(formed)
        eliminations = _eliminations(formed, may_defer=not sensitivities)
        ways = [replace(formed, links=links) for links in eliminations]
        for first, cost in zip(ways, _estimates(ways, sensitivities), strict=True):
            elimination = bool(first.links), any(link.is_deferred for link in first.links)
            sizes = len(first.states), len(first.constraints.rows)
            found.append((Alternative(trees, own_axes, *elimination, *sizes, *cost), first))
    return found


def _eliminations(first: FirstGraph, *, may_defer: bool) -> list[tuple[TreeLink, ...]]:
    """List the elimination methods to compare: by the matrix, along the tree, or both.

    Sensitivity operations are independent, so deferred elimination does not accelerate them.
    """
    # For few bodies, elimination along the tree only adds operations.
    if len(first.motion.geometry) < _LONG:
        return [()]
    links = tree_links(first)
    if not links:
        return [()]
    deferred = tuple(replace(link, is_deferred=True) for link in links)
    along = [links, deferred] if may_defer else [links]
    return along if is_deep(first.motion) else [(), *along]


def _choices(scene: SceneDescription, trees: Trees) -> Iterator[tuple[int, ...]]:
    """List sets of clusters to resolve in their own axes: all subsets, or if many, none and all."""
    # Axes can only be chosen if translation and rotation have the same tree.
    if not trees.is_one:
        yield ()
        return
    turning, spaces = [], motion_spaces(scene.mechanics).of
    cluster = 0  # clusters are numbered in the order of the traversal
    for step in tree_walk(trees.translation):
        # If an edge is traversed backwards, its freedoms are in reverse order.
        for kind in spaces[step.edge][:: step.sign]:
            cluster += 1
            if kind.rotates:
                turning.append(cluster)
    if len(turning) > _FEW:
        yield ()
        yield tuple(turning)
        return
    for size in range(len(turning) + 1):
        yield from combinations(turning, size)


def _estimates(
    ways: Sequence[FirstGraph], sensitivities: Sequence[str]
) -> Iterator[tuple[int, float]]:
    """Count operations and cycles of the right-hand side for each elimination method.

    The operations of one sensitivity are multiplied by the number of sensitivities. Cycles include
    the Jacobian, for implicit methods; its cost is estimated from one column.
    """
    states, n = [state.name for state in ways[0].states], len(sensitivities)
    middle = [names[len(names) // 2] for names in (sensitivities, states) if names][:1]
    direction: Derivative | None = None
    for first in ways:
        # Constraint gradients border the mass matrix; multipliers follow the accelerations.
        dag = first.system.dag
        factors = factorise_bordered(
            dag, first.matrix, first.is_safe, first.constraints.sizes, first.links, first.holdings
        )
        unknowns = factors.solve(first.forcing)
        alone = reachable(unknowns)
        n_alone, time_alone = count_operations(alone).total, cycles(alone)
        if not middle or not unknowns:
            yield n_alone, time_alone
            continue
        # Elimination only affects the unknowns; all methods share the differentiated expressions.
        direction = direction or replace(form_derivatives(first, middle)[0], rates={}, outputs={})
        known = dict(zip(first.unknowns, unknowns, strict=True))
        solved = SolvedSystem(dag, first.matrix, factors, known, unknown_tangents(first))
        (derivative,) = solved.along([direction])
        shared = set(alone)
        # Exclude nodes shared with the right-hand side, which are already counted.
        apart = [node for node in reachable(derivative.unknowns) if node not in shared]
        along = count_operations(apart).total
        # Derivatives along different directions do not wait for each other. The Jacobian has a
        # column for each state and is evaluated less often than the rates.
        times = n + _SHARE_OF_JACOBIANS * len(states)
        yield n_alone + n * along, time_alone + _PER_OPERATION * times * along
