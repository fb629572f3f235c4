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
    """Load a shared library, once per process, path and declarations.

    Parameters
    ----------
    path : str or path-like
        The library, usually :attr:`BuiltLibrary.path`. Only intact files belong here: the system's
        loader may crash on a damaged one.
    cdef : str
        C declarations without preprocessor lines.

    Returns
    -------
    LoadedLibrary
        The same object for the same arguments.

    Raises
    ------
    BuildError
        If the system refuses to load the file, or it lacks something that is declared.
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
    """Find or build a library and load it.

    A library that another process's ``clear_cache()`` removes before it is loaded is built again.

    Parameters
    ----------
    files : mapping of str to str
        C text by file name.
    declarations : str
        C declarations of what it exports, without preprocessor lines.
    **options
        The other arguments of :func:`build_library`.

    Returns
    -------
    tuple of BuiltLibrary and LoadedLibrary
        The library's file, and its functions.
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
