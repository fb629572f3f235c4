"""Factors and second derivatives of a model for implicit methods, built when one is first used.

In: a program after its passes. Out: a ``cotree_newton`` in this process.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.build import BuildOptions, find_toolchain, obtain_library
from cotree.codegen.newton import newton_context, newton_declarations, render_newton
from cotree.errors import BuildError
from cotree.sharing import forming
from cotree.version import ABI_VERSION

if TYPE_CHECKING:
    from cotree.build import LoadedLibrary
    from cotree.program import Program


@dataclass(frozen=True, eq=False)
class Newton:
    """Factors and second derivatives of a model, as C sees them.

    Attributes
    ----------
    address : int
        Address of its ``cotree_newton``.
    library : LoadedLibrary
        The library, which keeps the code loaded.
    """

    address: int
    library: LoadedLibrary


def load_newton(program: Program) -> Newton | None:
    """Build and load the factors and second derivatives of a model; None where no compiler can.

    Parameters
    ----------
    program : Program
        The program after its passes.
    """
    toolchain = find_toolchain()
    if toolchain is None:
        return None
    # Second derivatives are new nodes of the model's arena, which threads share.
    with forming:
        model = newton_context(program)
        files = render_newton(model)
    try:
        _, loaded = obtain_library(
            files,
            newton_declarations(model),
            abi_version=ABI_VERSION,
            n_operations=model.n_written,
            n_all=model.n_written_in_all,
            options=BuildOptions(),
            toolchain=toolchain,
        )
    except BuildError:
        return None
    address = getattr(loaded.lib, f"{model.prefix}_newton")()
    return Newton(int(loaded.ffi.cast("uintptr_t", address)), loaded)
