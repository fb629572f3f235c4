"""Load shared libraries with cffi in ABI mode, without a compiler or Python headers."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.build.compile import ATTEMPTS, BuiltLibrary, build_library
from cotree.errors import BuildError
from cotree.sharing import locked_cache

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cffi import FFI


@dataclass(frozen=True)
class LoadedLibrary:
    """A shared library in this process."""

    ffi: FFI  # the types of the declarations; makes and casts pointers
    lib: Any  # the library; functions and variables are attributes, resolved at first use


def load_library(path: str | os.PathLike[str], cdef: str) -> LoadedLibrary:
    """Load a shared library, once per process, path and declarations.

    The declarations have no preprocessor lines. The file must be intact, since the system's loader
    may crash on a damaged one. Raises BuildError if the system cannot load it, or a declared name
    is missing.
    """
    # An absolute path, since the system would search its own folders for a bare name.
    return _load(os.path.abspath(path), cdef)


@locked_cache
def _load(path: str, cdef: str) -> LoadedLibrary:
    import cffi

    # Each library has its own types, so that equal names in two libraries do not conflict.
    ffi = cffi.FFI()
    ffi.cdef(cdef)
    try:
        lib = ffi.dlopen(path)
    except OSError as error:
        raise BuildError(
            f"The compiled library '{path}' cannot be loaded ({error}); run clear_cache() if it "
            "was built on another system, and check that compiler and Python are of one "
            "architecture."
        ) from error
    # Names are resolved at first use, where the wrong library would cause an obscure error. An
    # engine also declares functions of other libraries: only a library without any of the names is
    # foreign.
    names = [name for name in dir(lib) if not hasattr(lib, name)]
    if names and len(names) == len(dir(lib)):
        raise BuildError(
            f"The compiled library '{path}' has no '{names[0]}', so that it is not what its name "
            "says; run clear_cache()."
        )
    return LoadedLibrary(ffi, lib)


def obtain_library(
    files: Mapping[str, str], declarations: str, **options: Any
) -> tuple[BuiltLibrary, LoadedLibrary]:
    """Find or build a library and load it; ``options`` are those of :func:`build_library`.

    If the ``clear_cache()`` of another process removes the library before it is loaded, it is built
    again.
    """
    for attempt in range(1, ATTEMPTS + 1):
        built = build_library(files, **options)
        try:
            return built, load_library(built.path, declarations)
        except BuildError:
            # If the file still exists, it is invalid, and building it again would not help.
            if built.path.exists() or attempt == ATTEMPTS:
                raise
    raise AssertionError("the last attempt returns or raises")
