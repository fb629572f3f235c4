"""Models on their way to other processes and machines: C text, program and options as bytes.

In: a compiled model. Out: bytes small enough to be sent, from which another machine has the model
without forming equations: it compiles the text once, or finds the library in its cache. The scene
travels along as bytes of its own, opened when someone asks for a stage before the program.
"""

from __future__ import annotations

import hashlib
import pickle
import platform
import time
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.model_files import pickled
from cotree.errors import BuildError
from cotree.recipe import CarriedRecipe, Recipe
from cotree.version import ABI_VERSION, VERSION

if TYPE_CHECKING:
    from cotree.codegen.model_files import ModelText
    from cotree.compiled import Model
    from cotree.program import Program


def carry(
    text: ModelText, recipe: Recipe | CarriedRecipe, at_rest: Program | None
) -> tuple[Any, ...]:
    """Give what a model is pickled as: a function, and its arguments.

    Parameters
    ----------
    text : ModelText
        Its program and C text.
    recipe : Recipe or CarriedRecipe
        What it was compiled from.
    at_rest : Program or None
        The network at rest of a model that begins at its operating point.
    """
    data = pickled((text, at_rest, recipe.defaults, recipe.options))
    if data is None:
        # A program may call functions of Python; the scene may still be pickled.
        return Recipe.made, (recipe.opened if isinstance(recipe, CarriedRecipe) else recipe,)
    scene = recipe.data if isinstance(recipe, CarriedRecipe) else pickled(recipe)
    # Programs and texts repeat themselves: this takes a few milliseconds and leaves a quarter.
    return arrived, (_versions(), zlib.compress(data), scene or b"")


def arrived(versions: dict[str, str], data: bytes, scene: bytes) -> Model:
    """Make a model of what :func:`carry` gave.

    Raises
    ------
    BuildError
        If another version of cotree sent it, or its text cannot be read or compiled here.
    """
    from cotree.compilation import Compiled, load_kernels
    from cotree.compiled import Model

    # Another version could read the program and compute something else.
    if any(versions.get(name) != _versions()[name] for name in ("cotree", "ABI")):
        raise BuildError(
            f"this model was pickled by cotree {_listed(versions)}, and here is cotree "
            f"{_listed(_versions())}: install one version on all machines, or save the scene and "
            "compile it here"
        )
    try:
        text, at_rest, defaults, options = pickle.loads(zlib.decompress(data))
    except (AttributeError, ImportError, TypeError, ValueError, pickle.UnpicklingError) as error:
        raise BuildError(
            f"this model was pickled by cotree {_listed(versions)} and cannot be read by cotree "
            f"{_listed(_versions())} ({error}): install the same versions on all machines"
        ) from error
    begun = time.perf_counter()
    kernels, cached = load_kernels(text, options)
    times = {"formulate": 0.0, "generate": 0.0, "compile": time.perf_counter() - begun}
    recipe = CarriedRecipe(scene, defaults, options)
    compiled = Compiled(text, kernels, cached, times, lambda: recipe.opened.formed())
    return Model(compiled, recipe, at_rest)


def digest(text: ModelText, at_rest: Program | None) -> str:
    """Hash what the numbers of a model follow from; 64 hexadecimal digits."""
    parts = [VERSION, repr(text.program.layout), *_files(text.files)]
    if at_rest is not None:
        # Its nodes, too, are told apart by the text that would be printed for them.
        from cotree.codegen.context import model_context
        from cotree.codegen.model_files import render_model

        parts += [repr(at_rest.layout), *_files(render_model(model_context(at_rest)))]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _files(files: Any) -> list[str]:
    return [part for name in sorted(files) for part in (name, files[name])]


def _versions() -> dict[str, str]:
    return {
        "cotree": VERSION,
        "ABI": str(ABI_VERSION),
        "Python": platform.python_version(),
        "NumPy": np.__version__,
    }


def _listed(versions: dict[str, str]) -> str:
    others = ", ".join(f"{name} {value}" for name, value in versions.items() if name != "cotree")
    return f"{versions.get('cotree')} ({others})"
