"""f-cutsets and f-circuits as formulas: the balances of the branches, projected (paper, Eq. (5)).

In: trees and the writer of terminal equations. Out: for each direction of a motion space the
balance along it, in whatever across variables are asked for: those of the chords (Eq. (5)), or
those of the branches that stand for them (Eq. (6)).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.components import Role
from cotree.export.blackboard import NOTHING, Pair
from cotree.export.terminal import present
from cotree.graph import f_circuit, f_cutset, tree_walk

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.components import Freedom
    from cotree.export.terminal import Across, Terminal
    from cotree.graph import TopologyMatrix, Tree
    from cotree.scene.description import Edge

#: Signs and names of edges.
Terms = tuple[tuple[int, str], ...]

_ROTATIONAL = frozenset("Rφωα")


def signed_sum(terms: Iterable[tuple[int, Pair]]) -> Pair:
    """Add and subtract."""
    total = NOTHING
    for sign, term in terms:
        total = total + term if sign > 0 else total - term
    return total


@dataclass(frozen=True)
class Balances:
    """Writes the f-cutset equations of a scene's branches.

    Attributes
    ----------
    trees : mapping of str to Tree
        The trees of the translation and rotation graphs.
    terminal : Terminal
        Writes terminal equations.
    """

    trees: Mapping[str, Tree]
    terminal: Terminal

    @cached_property
    def cutsets(self) -> dict[str, TopologyMatrix]:
        """The f-cutset matrix of each graph."""
        return {domain: f_cutset(tree) for domain, tree in self.trees.items()}

    @cached_property
    def circuits(self) -> dict[str, TopologyMatrix]:
        """The f-circuit matrix of each graph."""
        return {domain: f_circuit(tree) for domain, tree in self.trees.items()}

    def circuit(self, kind: str, chord: str) -> Terms:
        """Give the branches whose across variables add up to that of a chord."""
        matrix = self.circuits["rotation" if kind in _ROTATIONAL else "translation"]
        return tuple((-sign, edge) for sign, edge in matrix.terms(chord) if edge != chord)

    def moments(self, branch: str) -> list[tuple[int, str, Terms]]:
        """List the forces across a rotational cut that have a moment about the branch's head.

        Returns
        -------
        list of (int, str, Terms)
            Sign and name of the force's edge, and the branches that lead from the head of
            ``branch`` to the force's point of action, the head of its edge.
        """
        tree = self.trees["rotation"]
        own = tree.graph.edge(branch)
        beyond: set[str] = set()
        for step in tree_walk(tree):
            if step.edge == branch or step.parent in beyond:
                beyond.add(step.child)
        translation = self.trees["translation"]
        forces = []
        for edge in translation.graph.edges:
            if edge.name != branch and (edge.head in beyond) != (edge.tail in beyond):
                path = _path(translation, own.head, edge.head)
                same_way = (edge.head in beyond) == (own.head in beyond)
                if path:
                    forces.append((1 if same_way else -1, edge.name, path))
        return forces

    def moment(self, sign: int, path: Terms, force: Pair, across: Across) -> Pair:
        """Write the moment of a force at the end of a path of branches."""
        arm = signed_sum((s, across("r", name)) for s, name in path)
        return signed_sum([(sign, arm.cross(force))])

    def projected(self, edge: Edge, freedom: Freedom, across: Across) -> Pair:
        """Write the balance of a branch along one direction of its motion space."""
        scene, terminal = self.terminal.scene, self.terminal
        # What a joint or arm transmits is unknown but for its own law; a body's inertia is not.
        unknown = () if edge.component.role is Role.BODY else (edge.name,)
        if freedom.rotates:
            cutset = self.cutsets["rotation"].terms(edge.name)
            total = signed_sum(
                (sign, terminal.torque(scene.edges[name], across))
                for sign, name in cutset
                if name not in unknown
            )
            for sign, name, path in self.moments(edge.name):
                force = terminal.force(scene.edges[name], across)
                total += self.moment(sign, path, force, self.of_branches)
        else:
            cutset = self.cutsets["translation"].terms(edge.name)
            total = signed_sum(
                (sign, terminal.force(scene.edges[name], across))
                for sign, name in cutset
                if name not in unknown
            )
        return total.dot(terminal.direction(edge, freedom)) + terminal.effort(edge, freedom)

    def of_branches(self, kind: str, edge: str) -> Pair:
        """Write an across variable with those of the branches; what is zero is left out."""
        if edge in self.terminal.branches:
            symbol, row = self.terminal.symbol(kind, edge), self.terminal.scene.edges[edge]
            return present(symbol, self.terminal.across(row)[kind])
        return signed_sum(
            (sign, self.of_branches(kind, name)) for sign, name in self.circuit(kind, edge)
        )


def _path(tree: Tree, start: str, end: str) -> Terms:
    """Give the branches from one node to another."""
    to_root: dict[str, tuple[str, int, str]] = {
        step.child: (step.parent, step.sign, step.edge) for step in tree_walk(tree)
    }

    def climb(node: str) -> list[tuple[int, str]]:
        found = []
        while node in to_root:
            node, sign, edge = to_root[node]
            found.append((sign, edge))
        return found

    down, up = climb(end)[::-1], climb(start)[::-1]
    while down and up and down[0] == up[0]:
        down, up = down[1:], up[1:]
    return (*((-sign, edge) for sign, edge in reversed(up)), *down)
