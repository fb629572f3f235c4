"""C that is the same for every model: built once on a machine, and loaded.

In: files and declarations. Out: a library, or None where no compiler can build it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from cotree.build import BuildOptions, find_toolchain, loop_flags, obtain_library
from cotree.build.cache import kept
from cotree.codegen.integrators import shared_files
from cotree.errors import BuildError
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.build import LoadedLibrary


class SharedCode(NamedTuple):
    """C that is the same for every model."""

    files: Mapping[str, str]  # text by file name
    declarations: str  # what cffi reads
    shared: frozenset[str]  # files that several libraries have


def shared_code(
    files_of: Callable[..., Mapping[str, str]], declarations_of: Callable[..., str], *arguments: str
) -> SharedCode:
    """Render C, or take it from the cache.

    Parameters
    ----------
    files_of, declarations_of : callable
        Functions of :mod:`cotree.codegen`: the first returns files, and the second, of these, their
        declarations.
    *arguments : str
        Further arguments of both.
    """

    def render() -> SharedCode:
        files = files_of(*arguments)
        return SharedCode(files, declarations_of(files, *arguments), shared_files(files))

    return kept((files_of.__name__, arguments), render)


def build_engine(code: SharedCode) -> LoadedLibrary | None:
    """Build and load C that is the same for every model; None if that is not possible."""
    toolchain = find_toolchain()
    if toolchain is None:
        return None
    # The steps are worth vectors of sums over equations: a fifth faster for 8 of them, a quarter
    # for 36. A number of equations known beforehand gains nothing. What is around the steps takes
    # the compiler longer than these do, and runs no faster.
    try:
        _, loaded = obtain_library(
            code.files,
            code.declarations,
            abi_version=ABI_VERSION,
            # The level is given below, so that the count of operations decides nothing.
            n_operations=1,
            options=BuildOptions("-O1"),
            toolchain=toolchain,
            levels={"engine.c": loop_flags(toolchain)},
            shared=code.shared,
        )
    except BuildError:
        return None
    return loaded
