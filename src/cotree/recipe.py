"""All that a model is compiled from: in another process, or with other inputs, it is made again."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cotree.build import BuildOptions
    from cotree.compiled import Model
    from cotree.formulation.first_graph import FirstGraph
    from cotree.scene.description import SceneDescription
    from cotree.scene.graphs import TreeChoice


@dataclass(frozen=True)
class Recipe:
    """All that a model is compiled from, so that it can be compiled again.

    Attributes
    ----------
    scene : SceneDescription
        The scene, which nobody changes.
    sensitivities : tuple of str
        Parameters and states to take sensitivities to.
    tree, options, baumgarte
        As of :func:`cotree.compilation.compile_scene`.
    """

    scene: SceneDescription
    sensitivities: tuple[str, ...]
    tree: TreeChoice
    options: BuildOptions
    baumgarte: float

    def made(self) -> Model:
        """Compile the model; its library comes from the cache where it is there."""
        from cotree.compilation import compile_scene
        from cotree.compiled import Model

        names = self.sensitivities
        compiled = compile_scene(self.scene, names, self.tree, self.options, self.baumgarte)
        return Model(compiled, self)

    def of(self, scene: SceneDescription, first: FirstGraph) -> Recipe:
        """Give the recipe of another scene of the same edges, in the coordinates of a model."""
        tree, own = self.tree, first.system.trees
        if scene.mechanics.edges:
            tree = {"translation": own.translation.branches, "rotation": own.rotation.branches}
        return replace(self, scene=scene, tree=tree)
