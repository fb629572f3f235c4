"""The specification of a model, and its compilation to kernels.

Programs with their C text are cached, too, with the specification and cotree's own sources as key:
forming and printing equations would take most of the time if the library is cached. The stages
before the program are repeated if needed, as by linearization and animation.
"""

from __future__ import annotations

import pickle
import time
import warnings
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

from cotree.build import BuildOptions
from cotree.build.cache import cached
from cotree.components import OWN
from cotree.errors import Error, ModelError
from cotree.model.loading import load_model
from cotree.quiet import level_of_user
from cotree.scene.settings import OPERATING_POINT
from cotree.sharing import locked_cached_property

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.model.model import CompiledModel
    from cotree.pipeline import Formed
    from cotree.program.text import ModelText
    from cotree.scene.description import SceneDescription
    from cotree.scene.graphs import TreeChoice


@dataclass(frozen=True, eq=False)
class BuildSpec:
    """The scene and the options that a model is compiled from."""

    scene: SceneDescription  # the scene, which must not be changed afterwards
    sensitivities: tuple[str, ...] = ()  # parameters and states to which sensitivities are taken
    tree: TreeChoice = None  # the branches; None chooses them automatically
    #: Compiler options of the user.
    options: BuildOptions = field(default_factory=BuildOptions)
    #: Decay rate of constraint violations, [1/s]; zero: constraints are satisfied by projection.
    baumgarte: float = 0.0
    #: Whether runs locate kinks of the rates; otherwise the error test detects them.
    locates_kinks: bool = True

    @property
    def key(self) -> object:
        """Cache key: everything that determines the program and its C text; None if unknown."""
        # Registered laws are functions, which cannot be compared.
        if any(edge.statement["type"] not in OWN for edge in self.scene.edges.values()):
            return None
        return self.scene, self.sensitivities, self.tree, self.baumgarte, self.locates_kinks

    def __reduce__(self) -> tuple[Any, ...]:
        # Keep the fields, drop cached properties.
        return BuildSpec, tuple(getattr(self, row.name) for row in fields(self))

    @locked_cached_property
    def formed(self) -> Formed:
        """Results of all stages up to the C text."""
        # Imported here, because a cached program requires no formulation.
        from cotree.pipeline import form_text

        own = self.sensitivities, self.tree, self.baumgarte, self.locates_kinks
        return form_text(self.scene, *own)

    def of(self, scene: SceneDescription, sensitivities: Sequence[str] | None = None) -> BuildSpec:
        """Return the specification with another scene that has the same edges and coordinates.

        The scene is not changed afterwards. Sensitivities are the same unless given.
        """
        tree, own = self.tree, self.formed.first.system.trees
        if scene.mechanics.edges:
            tree = {"translation": own.translation.branches, "rotation": own.rotation.branches}
        names = self.sensitivities if sensitivities is None else tuple(sensitivities)
        return replace(self, scene=scene, tree=tree, sensitivities=names)

    def compile(self) -> tuple[CompiledModel, dict[str, float]]:
        """Form the equations, generate C, compile and load it; cached results are used.

        Also returns the seconds for each stage: formulate, generate, compile. Raises ModelError,
        FormulationError, CodegenError or BuildError if a stage fails. Warns if an edge's inertia
        belongs to no body, or there is no compiler.
        """
        begun = time.perf_counter()
        text = cached(self.key, lambda: self.formed.text)
        # These stages did not run if the program was cached.
        formed = vars(self).get("formed")
        times = {"formulate": time.perf_counter() - begun, "generate": 0.0}
        times = dict(formed.times) if formed else times
        for sentence in text.cautions:
            warnings.warn(sentence, RuntimeWarning, stacklevel=level_of_user())
        begun = time.perf_counter()
        model = load_model(text, self.options, self._at_rest(text))
        times["compile"] = time.perf_counter() - begun
        return model, times

    def _at_rest(self, text: ModelText) -> Callable[[], ModelText] | None:
        if self.scene.defaults.start != OPERATING_POINT:
            return None

        def form() -> ModelText:
            from cotree.pipeline import text_at_rest

            return text_at_rest(text.layout, self.scene)

        # The steady-state equations are formed by a function at the first request of a start.
        key = None if self.key is None else ("at rest", self.key)
        return lambda: cached(key, form)


def open_spec(data: bytes) -> BuildSpec:
    """Read the specification of a model that was pickled in another process."""
    reason = "it could not be pickled"
    if data:
        try:
            spec = pickle.loads(data)
            assert isinstance(spec, BuildSpec)
            return spec
        except (Error, AttributeError, ImportError, pickle.UnpicklingError) as error:
            # The scene may contain components that only the other process has registered.
            reason = str(error).split(";")[0].rstrip(".")
    raise ModelError(
        "this model came from another process as C source, and the request needs its scene, "
        f"which cannot be read here ({reason}): first register its components and import its "
        "modules here, or make the request where the model was compiled"
    )
