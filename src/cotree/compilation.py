"""From a scene to kernels that can be called; what was formed before is taken from the cache.

Forming equations and printing them takes most of the time of a model whose library is compiled.
Programs with their C text are therefore kept beside libraries, found by all that they follow from:
the scene, what was asked for, and the sources of cotree itself. The stages before the program are
gone through again where someone looks at them, as linearization and animation do.
"""

from __future__ import annotations

import hashlib
import os
import sys
import time
import warnings
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cotree.build import BuildOptions, find_toolchain, obtain_library
from cotree.codegen.model_files import ModelText, cdef, find_text, keep_text, pickled
from cotree.codegen.render import template_folder
from cotree.components import OWN
from cotree.model.kernels import CKernels, PythonKernels
from cotree.scene.checks import impossible_inertias
from cotree.sharing import locked_cached_property
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.model.kernels import Kernels
    from cotree.pipeline import Formed
    from cotree.scene.description import SceneDescription
    from cotree.scene.graphs import TreeChoice


#: Whether programs are kept. Tests that change how they are formed must not find others' there.
KEEPS = True


class Compiled:
    """A program whose kernels can be called.

    Parameters
    ----------
    text : ModelText
        The program and its C text.
    kernels : Kernels
        Ready to be called.
    cached : bool
        Whether the library was compiled before.
    times : mapping of str to float
        Seconds for each stage: formulate, generate, compile.
    form : callable
        Forms the equations, for those who look at the stages before the program.
    """

    def __init__(
        self,
        text: ModelText,
        kernels: Kernels,
        cached: bool,
        times: Mapping[str, float],
        form: Callable[[], Formed],
    ) -> None:
        self.text, self.kernels, self.cached, self.times = text, kernels, cached, times
        self._form = form

    @locked_cached_property
    def formed(self) -> Formed:
        """The first graph, the formulations that were tried, and what the passes did."""
        return self._form()


def compile_scene(
    scene: SceneDescription,
    sensitivities: Sequence[str],
    tree: TreeChoice,
    options: BuildOptions,
    baumgarte: float = 0.0,
    locates_corners: bool = True,
) -> Compiled:
    """Take a scene all the way to kernels that can be called.

    Parameters
    ----------
    scene : SceneDescription
        The scene, which nobody changes afterwards.
    sensitivities : sequence of str
        Parameters and states to take sensitivities to.
    tree : None, sequence of str, or mapping of domain to sequence of str
        The branches; None chooses them.
    options : BuildOptions
        The user's choices for the compiler.
    baumgarte : float
        Rate, [1/s], at which violated constraints decay; zero leaves them to projection.
    locates_corners : bool
        Whether runs locate the corners of rates, in place of leaving them to the error test.

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

    def form() -> Formed:
        # Where the program was kept, nothing of the formulation is even imported.
        from cotree.pipeline import form_text

        return form_text(scene, sensitivities, tree, baumgarte, locates_corners)

    key = _key(scene, tuple(sensitivities), tree, baumgarte, locates_corners)
    text, formed = find_text(key) if key else None, None
    times = {"formulate": time.perf_counter() - begun, "generate": 0.0}
    if text is None:
        formed = form()
        text, times = formed.text, dict(formed.times)
        if key:
            keep_text(key, text)
    for sentence in impossible_inertias(scene):
        warnings.warn(sentence, RuntimeWarning, stacklevel=4)  # whoever asked for the model
    loaded = time.perf_counter()
    kernels, cached = load_kernels(text, options)
    times["compile"] = time.perf_counter() - loaded
    compiled = Compiled(text, kernels, cached, times, form)
    if formed is not None:
        compiled.__dict__["formed"] = formed  # where the property finds it
    return compiled


def load_kernels(text: ModelText, options: BuildOptions) -> tuple[Kernels, bool]:
    """Compile and load the C text, or evaluate the program where there is no compiler.

    Returns
    -------
    kernels : Kernels
        Ready to be called.
    cached : bool
        Whether the library was compiled before.
    """
    toolchain = find_toolchain()
    if toolchain is None:
        is_asked = os.environ.get("COTREE_COMPILER") == "none"
        reason = (
            "COTREE_COMPILER=none"
            if is_asked
            else "no C compiler was found (CC, cc, gcc, clang); install one, or: "
            "pip install ziglang"
        )
        warnings.warn(
            f"{reason}: the model is evaluated in Python, which is much slower",
            RuntimeWarning,
            stacklevel=5,  # whoever asked for the model
        )
        # The same nodes without C: a model always runs, if slowly.
        return PythonKernels(text.program), False
    library, loaded = obtain_library(
        text.files,
        cdef(text.files["cotree_abi.h"], text.prefix),
        abi_version=ABI_VERSION,
        n_operations=text.n_written,
        n_all=text.n_written_in_all,
        options=options,
        toolchain=toolchain,
    )
    return CKernels(text.program, loaded, text.prefix), library.cached


def _key(scene: SceneDescription, *asked_for: object) -> str | None:
    """Hash all that a program and its text follow from; None where that is not possible."""
    # Laws that a user registered are functions, of which nobody can tell whether they are the same.
    if not KEEPS or any(edge.statement["type"] not in OWN for edge in scene.edges.values()):
        return None
    asked = pickled((scene, *asked_for))
    return None if asked is None else hashlib.sha256(_sources() + asked).hexdigest()


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
