"""All that a model is compiled from, so that with other inputs it is made again."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.errors import Error, ModelError
from cotree.sharing import locked_cached_property

if TYPE_CHECKING:
    from cotree.build import BuildOptions
    from cotree.compilation import Compiled
    from cotree.compiled import Model
    from cotree.formulation.first_graph import FirstGraph
    from cotree.pipeline import Formed
    from cotree.scene.description import SceneDescription
    from cotree.scene.graphs import TreeChoice
    from cotree.scene.settings import Simulation


@dataclass(frozen=True)
class Recipe:
    """All that a model is compiled from, so that it can be compiled again.

    Attributes
    ----------
    scene : SceneDescription
        The scene, which nobody changes.
    sensitivities : tuple of str
        Parameters and states to take sensitivities to.
    tree, options, baumgarte, locates_corners
        As of :func:`cotree.compilation.compile_scene`.
    """

    scene: SceneDescription
    sensitivities: tuple[str, ...]
    tree: TreeChoice
    options: BuildOptions
    baumgarte: float
    locates_corners: bool = True

    @property
    def defaults(self) -> Simulation:
        """Settings of a run that the scene gives."""
        return self.scene.defaults

    def formed(self) -> Formed:
        """Form the equations, for those who look at the stages before the program."""
        from cotree.pipeline import form_text

        return form_text(
            self.scene, self.sensitivities, self.tree, self.baumgarte, self.locates_corners
        )

    def compiled(self) -> Compiled:
        """Compile the program; its library comes from the cache where it is there."""
        # What compiles is imported at the first call.
        from cotree.compilation import compile_scene

        return compile_scene(
            self.scene,
            self.sensitivities,
            self.tree,
            self.options,
            self.baumgarte,
            self.locates_corners,
        )

    def made(self) -> Model:
        """Compile the model."""
        from cotree.compiled import Model

        return Model(self.compiled(), self)

    def of(self, scene: SceneDescription, first: FirstGraph) -> Recipe:
        """Give the recipe of another scene of the same edges, in the coordinates of a model."""
        tree, own = self.tree, first.system.trees
        if scene.mechanics.edges:
            tree = {"translation": own.translation.branches, "rotation": own.rotation.branches}
        return replace(self, scene=scene, tree=tree)


class CarriedRecipe:
    """The recipe of a model from another process: bytes until someone looks at its scene.

    Components that a user registered there need not be known here before that.

    Parameters
    ----------
    data : bytes
        The pickled recipe; empty where it could not be pickled.
    defaults : Simulation
        Settings of a run that its scene gives.
    options : BuildOptions
        The user's choices for the compiler.
    """

    def __init__(self, data: bytes, defaults: Simulation, options: BuildOptions) -> None:
        self.data, self.defaults, self.options = data, defaults, options

    @locked_cached_property
    def opened(self) -> Recipe:
        """The recipe itself.

        Raises
        ------
        ModelError
            If its scene cannot be had here.
        """
        reason = "it could not be pickled"
        if self.data:
            try:
                recipe = pickle.loads(self.data)
                assert isinstance(recipe, Recipe)
                return recipe
            except (Error, AttributeError, ImportError, pickle.UnpicklingError) as error:
                # Without the names that are known here.
                reason = str(error).split(";")[0].rstrip(".")
        raise ModelError(
            "this model came from another process as C text, and what is asked for needs its "
            f"scene, which cannot be had here ({reason}): register its components and import its "
            "modules here before, or ask where the model was compiled"
        )

    @property
    def scene(self) -> SceneDescription:
        """The scene."""
        return self.opened.scene

    def of(self, scene: SceneDescription, first: FirstGraph) -> Recipe:
        """Give the recipe of another scene; see :meth:`Recipe.of`."""
        return self.opened.of(scene, first)
