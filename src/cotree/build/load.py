"""Load a shared library through cffi in ABI mode: no compiler and no Python headers are needed."""

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
    lib: Any  # the library; its functions and variables are attributes, found at first use


def load_library(path: str | os.PathLike[str], cdef: str) -> LoadedLibrary:
    """Load a shared library, once per process, path and declarations (without preprocessor lines).

    Only intact files belong here: the system's loader may crash on a damaged one. Raises BuildError
    if the system refuses to load the file, or it lacks something that is declared.
    """
    # Absolute, since the system searches its own folders for a bare name.
    return _load(os.path.abspath(path), cdef)


@locked_cache
def _load(path: str, cdef: str) -> LoadedLibrary:
    import cffi

    # Each library has types of its own, so that equal names in two of them never meet.
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
    # Names are looked up at first use, where a library of something else would be a riddle. An
    # engine declares what it calls in other libraries, too: one without any name is foreign.
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

    A library that another process's ``clear_cache()`` removes before it is loaded is built again.
    """
    for attempt in range(1, ATTEMPTS + 1):
        built = build_library(files, **options)
        try:
            return built, load_library(built.path, declarations)
        except BuildError:
            # A file that is still there is itself at fault, and would be again.
            if built.path.exists() or attempt == ATTEMPTS:
                raise
    raise AssertionError("the last attempt returns or raises")
