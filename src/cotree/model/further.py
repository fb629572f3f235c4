"""C text of a model that is printed when it is first needed: long Jacobians, further functions."""

from __future__ import annotations

import hashlib
import pickle
from typing import TYPE_CHECKING

from cotree.build import BuildOptions, LoadedLibrary
from cotree.build.cache import cached
from cotree.codegen.c_files import render_model
from cotree.codegen.context import model_context
from cotree.model.kernels import load_kernels
from cotree.sharing import forming

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.program.text import ModelText

    #: The arguments of `load_kernels` without options.
    Rendered = tuple[Mapping[str, str], str, int, int]


def whole_files(text: ModelText) -> Mapping[str, str]:
    """Return the C files of a model by name, with a long Jacobian, too."""
    if not text.is_divided:
        return text.files
    with forming:
        return render_model(model_context(text.program))


def jacobian_files(text: ModelText) -> tuple[Mapping[str, str], int, int]:
    """Return the C files of a Jacobian, and the operations of the longest function and of all."""

    def render() -> tuple[Mapping[str, str], int, int]:
        with forming:
            model = model_context(text.program, names_of=("jacobian",))
            return render_model(model), model.n_written, model.n_written_in_all

    return cached(("jacobian", digest_of(text)), render)


def load_further(
    text: ModelText, key: tuple[object, ...], render: Callable[[], Rendered | None]
) -> LoadedLibrary | None:
    """Build and load further functions of a model, whose text is cached on disk."""

    def formed() -> Rendered | None:
        # Rendering may add nodes to the graph, which several threads share: a lock is needed.
        with forming:
            return render()

    found = cached((*key, digest_of(text)), formed)
    return None if found is None else load_kernels(*found, BuildOptions())


def digest_of(text: ModelText) -> str:
    """Return a hash that identifies the program of a text."""
    parts = sorted(text.files.items())
    data = "\0".join(map(str, parts)).encode()
    if text.is_divided:  # the files do not determine the Jacobian
        data += text.stored if isinstance(text.stored, bytes) else pickle.dumps(text.stored)
    return hashlib.sha256(data).hexdigest()
