"""From C text to loaded functions, whatever other processes do to the cache in between."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.build.compile import ATTEMPTS, BuiltLibrary, build_library
from cotree.build.load import LoadedLibrary, load_library
from cotree.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Mapping


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

    Raises
    ------
    BuildError
        If it cannot be compiled or loaded.
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
