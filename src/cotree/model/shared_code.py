"""C that is the same for every model: built once on a machine, and loaded.

In: files and declarations. Out: a library, or None where no compiler can build it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.build import BuildOptions, find_toolchain, loop_flags, obtain_library
from cotree.codegen.integrators import shared_files
from cotree.errors import BuildError
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.build import LoadedLibrary


def build_engine(files: Mapping[str, str], declarations: str) -> LoadedLibrary | None:
    """Build and load C that is the same for every model; None if that is not possible."""
    toolchain = find_toolchain()
    if toolchain is None:
        return None
    # The steps are worth vectors of sums over equations: a fifth faster for 8 of them, a quarter
    # for 36. A number of equations known beforehand gains nothing. What is around the steps takes
    # the compiler longer than these do, and runs no faster.
    try:
        _, loaded = obtain_library(
            files,
            declarations,
            abi_version=ABI_VERSION,
            # The level is given below, so that the count of operations decides nothing.
            n_operations=1,
            options=BuildOptions("-O1"),
            toolchain=toolchain,
            levels={"engine.c": loop_flags(toolchain)},
            shared=shared_files(files),
        )
    except BuildError:
        return None
    return loaded
