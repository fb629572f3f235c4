"""Choose the compiler's flags: options, statement count and toolchain in, flags out.

``-ffast-math`` is never among them: it breaks checks for NaN and the order of operations that
the code generator chose. ``-ffp-contract`` is said aloud because compilers differ in its default,
and the same model then gives different digits: off, unless the machine's own code is asked for.
"""

from __future__ import annotations

import platform
import sys
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

from cotree.errors import BuildError, nearest

if TYPE_CHECKING:
    from cotree.build.toolchain import Toolchain

_LEVELS = ("-O0", "-Og", "-O1", "-O2", "-O3")
# Register allocation of one long block dominates: above these counts -O1 takes minutes.
_STATEMENT_LIMIT_GCC = 4_000
_STATEMENT_LIMIT_CLANG = 20_000
# Operations of all functions together beyond which gcc gets -Og: for straight code that takes half
# the instructions of -O1 (panda with 70 parameters 16 for 30 thousand million), and what it makes
# takes 0.9 to 1.2 of the time, long kernels as often less as more. For clang it is -O1.
_LONG_FOR_GCC = 6_000
# The number of equations stands behind a pointer: it is the same in each turn of a loop only where
# types do not alias.
_LOOPS_GCC = (
    "-O1 -fstrict-aliasing -ftree-loop-vectorize -fvect-cost-model=dynamic "
    "-finline-small-functions -ftree-pre -funswitch-loops -ftree-slp-vectorize -fpeel-loops "
    "-fgcse -frerun-cse-after-loop"
)


@dataclass(frozen=True)
class BuildOptions:
    """Options for the compilation of a model.

    Attributes
    ----------
    optimize : str
        ``'auto'``, or one of ``'-O0'``, ``'-Og'``, ``'-O1'``, ``'-O2'``, ``'-O3'``.
    native : bool
        Use every instruction of this machine's processor, products and sums fused to one among
        them. The library then serves machines with the same features only, and its results may
        differ in the last digits.
    time_limit : float
        Time after which the compiler is stopped, [s].

    Raises
    ------
    BuildError
        If ``optimize`` is unknown or ``time_limit`` is not positive.

    Examples
    --------
    >>> BuildOptions().optimize
    'auto'
    """

    optimize: str = "auto"
    native: bool = False
    time_limit: float = 600.0

    def __post_init__(self) -> None:
        if self.optimize not in ("auto", *_LEVELS):
            raise BuildError(
                f"The build option optimize is '{self.optimize}', which is unknown"
                f"{nearest(self.optimize, ('auto', *_LEVELS))}"
            )
        # Written so that NaN is refused too.
        if not self.time_limit > 0.0:
            raise BuildError(
                f"The build option time_limit is {self.time_limit:g} s; give a positive time."
            )


def compiler_flags(
    toolchain: Toolchain, options: BuildOptions, n_operations: int, n_all: int = 0
) -> tuple[str, ...]:
    """Choose the flags that stand before the files' names.

    Parameters
    ----------
    toolchain : Toolchain
        The compiler.
    options : BuildOptions
        The user's choice.
    n_operations : int
        Number of operations in the longest C function.
    n_all : int
        Number of operations in all functions; both decide what ``'auto'`` means.

    Returns
    -------
    tuple of str
        Flags in the order of the command line.

    Examples
    --------
    >>> from cotree.build import BuildOptions, Toolchain, compiler_flags
    >>> gcc = Toolchain(("/usr/bin/gcc",), "gcc 12.2.0", "cc")
    >>> "-O0" in compiler_flags(gcc, BuildOptions(), n_operations=50_000)
    True
    """
    flags = ["-std=c99", _level(toolchain, options, n_operations, n_all)]
    # Code on Windows is always relocatable, and clang refuses the flag there.
    if sys.platform != "win32":
        flags.append("-fPIC")
    # Fused products and sums round once instead of twice, which changes last digits.
    contract = "fast" if options.native else "off"
    # Without errno, square roots are single instructions.
    flags += ["-shared", f"-ffp-contract={contract}", "-fno-math-errno"]
    if toolchain.kind == "zig":
        # Zig adds debug information and traps on signed overflow unless told otherwise.
        # Its runtime lacks the functions that tell processors apart.
        flags += ["-g0", "-fno-sanitize=all", "-DCOTREE_NO_DISPATCH"]
    flags += _processor_flags(toolchain, options)
    return tuple(flags)


def loop_flags(toolchain: Toolchain) -> str:
    """Choose the level of a file whose loops over equations become vectors.

    These are the parts of ``-O3`` that the loops gain from: they need half of the compiler's time,
    and the code executes at most a hundredth more instructions.

    Parameters
    ----------
    toolchain : Toolchain
        The compiler.

    Returns
    -------
    str
        Flags with blanks between them.
    """
    return "-O3" if toolchain.is_clang else _LOOPS_GCC


def cpu_features() -> str:
    """Name the instruction sets of this processor, or the processor where they are not listed."""
    return _processor_entry("flags", "Features") or platform.processor()


def processor_name() -> str:
    """Name this processor, or its architecture where nothing more is known."""
    return _processor_entry("model name") or platform.processor() or platform.machine()


@cache
def _processor_entry(*labels: str) -> str:
    """Give the first entry of some labels that Linux has of a processor; empty if there is none."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8", errors="replace") as lines:
            for line in lines:
                label, _, value = line.partition(":")
                if label.strip() in labels:
                    return value.strip()
    except OSError:
        pass
    return ""


def _level(toolchain: Toolchain, options: BuildOptions, n_operations: int, n_all: int) -> str:
    if options.optimize != "auto":
        return options.optimize
    limit = _STATEMENT_LIMIT_CLANG if toolchain.is_clang else _STATEMENT_LIMIT_GCC
    # One function too long for the register allocator decides for the whole library.
    if n_operations > limit:
        return "-O0"
    # Fused products and sums come with -O2 only; it takes the compiler twice as long.
    if options.native:
        return "-O2"
    return "-Og" if n_all > _LONG_FOR_GCC and not toolchain.is_clang else "-O1"


def _processor_flags(toolchain: Toolchain, options: BuildOptions) -> list[str]:
    if not options.native:
        # Zig alone compiles for the machine it runs on unless told otherwise.
        return ["-mcpu=baseline"] if toolchain.kind == "zig" else []
    is_x86 = platform.machine().lower() in ("x86_64", "amd64", "i386", "i686")
    # Elsewhere than on x86, compilers agree on -mcpu only. Numbers of different statements put into
    # a vector wait for each other: without, most kernels are quicker, short ones by up to a third.
    return ["-march=native" if is_x86 else "-mcpu=native", "-fno-tree-slp-vectorize"]
