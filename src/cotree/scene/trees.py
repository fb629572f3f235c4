"""The trees that coordinates are formed from: one of the translation and one of the rotation graph.

Mostly they have the same branches. Where they differ a joint may be a branch of one graph and a
chord of the other: it then has the coordinates of the first and the constraints of the second.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

from cotree.components import Freedom, Role
from cotree.errors import FormulationError

if TYPE_CHECKING:
    from cotree.graph import Tree
    from cotree.scene.description import Edge, SceneDescription

_GRAPHS = ("translation", "rotation")


@dataclass(frozen=True)
class Trees:
    """The trees of the translation and of the rotation graph.

    Attributes
    ----------
    translation, rotation : Tree
        Of graphs on the same nodes.
    """

    translation: Tree
    rotation: Tree

    @cached_property
    def _branches(self) -> tuple[frozenset[str], frozenset[str]]:
        return frozenset(self.translation.branches), frozenset(self.rotation.branches)

    @cached_property
    def is_one(self) -> bool:
        """Whether both have the same branches."""
        first, second = self._branches
        return first == second

    @cached_property
    def branches(self) -> tuple[str, ...]:
        """Names of the branches of either, in edge order."""
        either = self._branches[0] | self._branches[1]
        return tuple(name for name in self.translation.graph.edge_names if name in either)

    def is_branch(self, name: str, rotates: bool) -> bool:
        """Say whether an edge is a branch of the rotation tree, or of that of translation."""
        # The pair is of translation and rotation, so that false and true are its places.
        return name in self._branches[rotates]

    def listed(self) -> str:
        """List the branches, those of each tree where they differ."""
        if self.is_one:
            return ", ".join(self.branches)
        return "; ".join(
            f"{tree.graph.domain}: {', '.join(tree.branches)}"
            for tree in (self.translation, self.rotation)
        )


def check_coupled(scene: SceneDescription, trees: Trees) -> None:
    """Refuse trees that separate a coupled translation and rotation.

    Raises
    ------
    FormulationError
        If an arm, a weld or a screw is a branch of one tree only.
    """
    for name in trees.branches:
        edge = scene.edges[name]
        if not _is_coupled(edge):
            continue
        # A part of the translation follows from the rotation of the same edge: one is no coordinate
        # without the other.
        held = [d for d in _GRAPHS if trees.is_branch(name, d == "rotation")]
        if len(held) == 1:
            raise FormulationError(
                f"{edge.component.name} '{name}' is a branch of the {held[0]} tree only, but it "
                "couples translation to rotation: name it in both trees, or in neither"
            )


def _is_coupled(edge: Edge) -> bool:
    """Whether the edge's translation follows from its rotation."""
    if edge.component.role is Role.ARM:
        return True
    # The pitch of a screw ties its translation to its angle.
    return any(isinstance(s, Freedom) and s.pitch for s in edge.component.motion_space)
