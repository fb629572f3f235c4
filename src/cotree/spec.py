"""All that a model is compiled from, and the way from there to kernels that can be called.

Forming equations and printing them takes most of the time of a model whose library is compiled.
Programs with their C text are therefore kept beside libraries, found by all that they follow from:
the specification and the sources of cotree itself. The stages before the program are gone through
again where someone asks for them, as linearization and animation do.
"""

from __future__ import annotations

import hashlib
import pickle
import sys
import time
import warnings
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.build import BuildOptions
from cotree.build.cache import PROGRAM, find_bytes, keep_bytes
from cotree.codegen.render import template_folder
from cotree.components import OWN
from cotree.model.loading import load_model
from cotree.quiet import level_of_user
from cotree.scene.checks import impossible_inertias
from cotree.scene.settings import OPERATING_POINT
from cotree.sharing import locked_cached_property

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from cotree.codegen.model_files import ModelText
    from cotree.model.model import CompiledModel
    from cotree.pipeline import Formed
    from cotree.program import Program
    from cotree.scene.description import SceneDescription
    from cotree.scene.graphs import TreeChoice


#: Whether programs are kept. Tests that change how they are formed must not find others' there.
KEEPS = True


@dataclass(frozen=True, eq=False)
class BuildSpec:
    """All that a model is compiled from.

    Attributes
    ----------
    scene : SceneDescription
        The scene, which nobody changes afterwards.
    sensitivities : tuple of str
        Parameters and states to take sensitivities to.
    tree : None, sequence of str, or mapping of domain to sequence of str
        The branches; None chooses them.
    options : BuildOptions
        The user's choices for the compiler.
    baumgarte : float
        Rate, [1/s], at which violated constraints decay; zero leaves them to projection.
    locates_corners : bool
        Whether runs locate the corners of rates, in place of leaving them to the error test.
    """

    scene: SceneDescription
    sensitivities: tuple[str, ...] = ()
    tree: TreeChoice = None
    options: BuildOptions = field(default_factory=BuildOptions)
    baumgarte: float = 0.0
    locates_corners: bool = True

    @cached_property
    def key(self) -> str | None:
        """Hash of all that the program and its text follow from; None if that is unknown."""
        # Laws that a user registered are functions, which cannot be compared.
        if any(edge.statement["type"] not in OWN for edge in self.scene.edges.values()):
            return None
        asked = (self.scene, self.sensitivities, self.tree, self.baumgarte, self.locates_corners)
        data = pickled(asked)
        return None if data is None else hashlib.sha256(_sources() + data).hexdigest()

    def __eq__(self, other: object) -> bool:
        """Compare what the programs follow from, and the options of the compiler."""
        if not isinstance(other, BuildSpec) or self.key is None:
            return self is other
        return (self.key, self.options) == (other.key, other.options)

    def __hash__(self) -> int:
        """Return the hash of the program's key."""
        return hash(self.key or id(self))

    def __reduce__(self) -> tuple[Any, ...]:
        # Without what was formed of it.
        return BuildSpec, tuple(getattr(self, row.name) for row in fields(self))

    @locked_cached_property
    def formed(self) -> Formed:
        """All stages up to the C text: the first graph, formulations tried, reports of passes."""
        # Where the program was kept, nothing of the formulation is even imported.
        from cotree.pipeline import form_text

        return form_text(
            self.scene, self.sensitivities, self.tree, self.baumgarte, self.locates_corners
        )

    def of(self, scene: SceneDescription, sensitivities: Sequence[str] | None = None) -> BuildSpec:
        """Return the specification of another scene of the same edges, in the same coordinates.

        Parameters
        ----------
        scene : SceneDescription
            The scene, which nobody changes afterwards.
        sensitivities : sequence of str, optional
            Parameters and states to take sensitivities to; the same ones if absent.
        """
        tree, own = self.tree, self.formed.first.system.trees
        if scene.mechanics.edges:
            tree = {"translation": own.translation.branches, "rotation": own.rotation.branches}
        names = self.sensitivities if sensitivities is None else tuple(sensitivities)
        return replace(self, scene=scene, tree=tree, sensitivities=names)

    def compile(self) -> tuple[CompiledModel, dict[str, float]]:
        """Form the equations, generate C, compile and load it; what was kept is taken.

        Returns
        -------
        model : CompiledModel
            Ready to be called.
        times : dict of str to float
            Seconds for each stage: formulate, generate, compile.

        Raises
        ------
        ModelError, FormulationError, CodegenError, BuildError
            If a stage cannot do its work; the message says which edge, node or name is at fault.

        Warns
        -----
        RuntimeWarning
            If no body has the inertia of an edge, or there is no compiler.
        """
        begun = time.perf_counter()
        key = self.key if KEEPS else None
        text = find_text(key) if key else None
        times = {"formulate": time.perf_counter() - begun, "generate": 0.0}
        if text is None:
            text, times = self.formed.text, dict(self.formed.times)
            data = pickled(text) if key else None
            if key and data:
                keep_bytes(data, key, PROGRAM)
        for sentence in impossible_inertias(self.scene):
            warnings.warn(sentence, RuntimeWarning, stacklevel=level_of_user())
        begun = time.perf_counter()
        model = load_model(text, self.options, self._at_rest(text))
        times["compile"] = time.perf_counter() - begun
        return model, times

    def _at_rest(self, text: ModelText) -> Callable[[], Program] | None:
        if self.scene.defaults.start != OPERATING_POINT:
            return None

        def form() -> Program:
            from cotree.pipeline import program_at_rest

            return program_at_rest(text.program.layout, self.scene)

        # Only bound here: the network at rest is formed when a start is first asked for.
        return form


def pickled(value: object) -> bytes | None:
    """Pickle a value; None where something in it cannot be."""
    try:
        return pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError, RecursionError):
        # Results of external functions are found by a function of Python, which may be anyone's.
        return None


def find_text(key: str) -> ModelText | None:
    """Return the program kept by a key, or None; a cache that cannot be used counts as empty."""
    found = find_bytes(key, PROGRAM)
    # The folder belongs to the user alone, and its libraries are run as they are.
    return None if found is None else pickle.loads(found)


@cache
def _sources() -> bytes:
    """Describe cotree's own files: whatever is edited there makes everything anew."""
    package = Path(__file__).parent
    # An array that one version of NumPy pickled may not be read by another.
    rows = [sys.version, np.__version__]
    for folder, pattern in ((package, "*.py"), (template_folder(), "*.jinja")):
        for path in sorted(folder.rglob(pattern)):
            status = path.stat()
            rows.append(f"{path} {status.st_size} {status.st_mtime_ns}")
    return "\n".join(rows).encode()
