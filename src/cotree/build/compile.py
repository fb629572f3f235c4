"""Compile C text into a shared library, or find the library that the same text gave before.

``-ffast-math`` is never used: it breaks checks for NaN and the order of operations that the code
generator chose. ``-ffp-contract`` is explicit, since compilers differ in its default, which changes
last digits: it is off, unless ``native`` is requested.
"""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import re
import shlex
import shutil
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING

from cotree.build.cache import (
    OBJECT,
    building,
    cache_directory,
    cache_key,
    find_published,
    keep_failed,
    private_directory,
    publish,
    write_files,
)
from cotree.build.toolchain import Outcome, Toolchain, run_limited
from cotree.errors import BuildError, nearest

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path


_LEVELS = ("-O0", "-Og", "-O1", "-O2", "-O3")
# Register allocation of one long block dominates: above these counts -O1 takes minutes.
_STATEMENT_LIMIT_GCC = 4_000
_STATEMENT_LIMIT_CLANG = 20_000
# Operations of all functions together beyond which gcc gets -Og: for straight code that takes half
# the instructions of -O1 (panda with 70 parameters 16 for 30 thousand million), and what it makes
# takes 0.9 to 1.2 of the time, long kernels as often less as more. For clang it is -O1.
_LONG_FOR_GCC = 6_000
# The number of equations is read through a pointer: it is constant in a loop only if types do not
# alias.
_LOOPS_GCC = (
    "-O1 -fstrict-aliasing -ftree-loop-vectorize -fvect-cost-model=dynamic "
    "-finline-small-functions -ftree-pre -funswitch-loops -ftree-slp-vectorize -fpeel-loops "
    "-fgcse -frerun-cse-after-loop"
)


@dataclass(frozen=True)
class BuildOptions:
    """Options for the compilation of a model.

    Raises
    ------
    BuildError
        If ``optimize`` is unknown or ``time_limit`` is not positive.

    Examples
    --------
    >>> BuildOptions().optimize
    'auto'
    """

    #: ``'auto'``, or one of ``'-O0'``, ``'-Og'``, ``'-O1'``, ``'-O2'``, ``'-O3'``.
    optimize: str = "auto"
    #: Use every instruction of this machine's processor, products and sums fused to one among them.
    #: The library then serves machines with the same features only, and its results may differ in
    #: the last digits.
    native: bool = False
    time_limit: float = 600.0  # time after which the compiler is stopped, [s]

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

    The numbers of operations in the longest C function and in all decide what ``'auto'`` means.

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
    """Return the flags, separated by blanks, of a file whose loops over equations become vectors.

    These are the parts of ``-O3`` that the loops gain from: they need half of the compiler's time,
    and the code executes at most a hundredth more instructions.
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
    """Return the first of some labels that Linux has of a processor; empty if there is none."""
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


_FILE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\.[ch]")
_OUTPUT = "library.so"
# The most attempts at a library that another process's clear_cache() keeps removing.
ATTEMPTS = 3
_FULL = re.compile("no space left on device|disk quota exceeded", re.IGNORECASE)
# Less room than this for a compiler's temporary files is none.
_LEAST_ROOM = 1 << 20


@dataclass(frozen=True)
class BuiltLibrary:
    """A shared library in the cache."""

    path: Path  # absolute path of the library
    seconds: float  # time spent on finding or building it, [s]
    cached: bool  # true if the compiler was not needed
    #: The compiler's command lines, with file names relative to the folder of the C text.
    command: str


def build_library(
    files: Mapping[str, str],
    *,
    abi_version: int,
    n_operations: int,
    n_all: int = 0,
    options: BuildOptions,
    toolchain: Toolchain,
    levels: Mapping[str, str] = MappingProxyType({}),
    shared: Collection[str] = (),
) -> BuiltLibrary:
    """Compile a model, unless the cache holds it.

    Parameters
    ----------
    files : mapping of str to str
        C text by file name. The ``.c`` files are compiled side by side, each with all ``.h`` files.
    abi_version : int
        Version of the contract between the library and its caller.
    n_operations, n_all : int
        Number of operations in the longest C function, and in all.
    options, toolchain : BuildOptions, Toolchain
        The user's choice and the compiler.
    levels : mapping of str to str
        Compiler levels of single files, with further flags behind blanks.
    shared : collection of str
        Files that other libraries have, too, with the same text, and that include only each other:
        the objects of these ``.c`` files are kept in the cache.

    Raises
    ------
    BuildError
        If the compiler fails or takes too long: it holds the command, the compiler's output and
        the path of the kept C file. Also if the cache folder cannot be used, or a file name is
        not that of a C file.
    """
    start = time.perf_counter()
    sources = _source_names(files)
    flags = compiler_flags(toolchain, options, n_operations, n_all)

    def key_of(texts: Mapping[str, str], *others: str) -> str:
        return cache_key(
            texts,
            abi_version=abi_version,
            toolchain=toolchain,
            flags=(*flags, *others),
            cpu_features=cpu_features() if options.native else "",
        )

    *compiling, linking = _steps((*toolchain.command, *flags), sources, levels)
    # What takes longest begins first, so that no processor waits for it at the end.
    compiling.sort(key=lambda step: (step.source not in levels, -len(files[step.source])))
    steps = [*compiling, linking]
    # Levels of single files change the bytes of the library, so they belong to its key.
    key = key_of(files, *(f"{name} {level}" for name, level in sorted(levels.items())))
    found = find_published(key)
    path = found
    if path is None:
        headers = {name: files[name] for name in shared if name.endswith(".h")}
        # The last step links, or is the only one: it makes a library and no object.
        steps[:-1] = [
            replace(step, key=key_of({**headers, name: files[name]}, levels.get(name, "")))
            if (name := step.source) in shared
            else step
            for step in steps[:-1]
        ]
        with building(key, options.time_limit):
            found = find_published(key)  # another process may have built it meanwhile
            path = found or _compile(files, steps, key, options.time_limit)
    commands = " && ".join(shlex.join(step.command) for step in steps)
    return BuiltLibrary(path, time.perf_counter() - start, found is not None, commands)


def _source_names(files: Mapping[str, str]) -> tuple[str, ...]:
    """Return the names of the C files, in an order that does not depend on the mapping's."""
    for name in files:
        # A name must stay inside its folder, and must not read as a compiler's option.
        if not _FILE_NAME.fullmatch(name):
            raise BuildError(
                f"The file name '{name}' cannot be used for C text; use letters, digits and "
                "underscores, then '.c' or '.h'."
            )
    sources = tuple(sorted(name for name in files if name.endswith(".c")))
    if not sources:
        raise BuildError("There is no C file to compile; give at least one file named '*.c'.")
    return sources


@dataclass(frozen=True)
class _Step:
    """A command, the C file that it compiles, and the key of its object where that is kept."""

    source: str
    command: tuple[str, ...]
    key: str = ""


def _steps(
    compiler: tuple[str, ...], sources: Sequence[str], levels: Mapping[str, str]
) -> list[_Step]:
    """Write the commands: one for a single file, else one for each file and one that links."""
    # The library comes last: linkers take from it only what the files before it ask for.
    to = ("-o", _OUTPUT, "-lm")
    # The level of a single file comes after the common one: of several levels the last one counts.
    own = {source: (*compiler, *levels.get(source, "").split()) for source in sources}
    if len(sources) == 1:
        return [_Step(source, (*command, source, *to)) for source, command in own.items()]
    steps = [
        _Step(source, (*command, "-c", source, "-o", f"{source}.o"))
        for source, command in own.items()
    ]
    # The common flags hold -shared, which matters only to this last step, the one that links.
    objects = [f"{source}.o" for source in sources]
    return [*steps, _Step(sources[0], (*compiler, *objects, *to))]


def _compile(files: Mapping[str, str], steps: Sequence[_Step], key: str, time_limit: float) -> Path:
    """Compile in a private folder, publish the library and give its path."""
    try:
        for _ in range(ATTEMPTS):
            found = _attempt(files, steps, key, time_limit)
            if found is not None:
                return found
        raise OSError(errno.ENOENT, "another process keeps removing the files of the build")
    except OSError as error:
        raise BuildError(
            f"The model cannot be compiled in the cache folder '{cache_directory()}' ({error}); "
            "make room there, or name another folder with the environment variable "
            "COTREE_CACHE_DIR.",
            command=shlex.join(steps[0].command),
        ) from error


def _attempt(
    files: Mapping[str, str], steps: Sequence[_Step], key: str, time_limit: float
) -> Path | None:
    """Compile once; None if the private folder was taken away meanwhile."""
    with private_directory() as directory:
        try:
            write_files(files, directory)
            step, outcome = _run(steps, directory, time_limit)
            if outcome.status == 0 and (directory / _OUTPUT).is_file():
                return publish(directory / _OUTPUT, key)
        except FileNotFoundError:
            # With its sources still there the folder was not taken away: something else is missing.
            if _is_complete(directory, files):
                raise
            return None
        # The compiler failed because another process cleared the cache, not because of the text.
        if not _is_complete(directory, files):
            return None
        if _is_full(directory, outcome):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    # The private folder is removed: the sources are kept elsewhere for the user.
    source = keep_failed(files, key) / step.source
    raise BuildError(
        _failure(outcome, source, time_limit),
        command=shlex.join(step.command),
        output=outcome.output,
        source=str(source),
    )


def _is_complete(directory: Path, files: Mapping[str, str]) -> bool:
    return all((directory / name).is_file() for name in files)


def _is_full(directory: Path, outcome: Outcome) -> bool:
    """Return whether a compiler failed for lack of disk space; it may end without a message."""
    if _FULL.search(outcome.output):
        return True
    with contextlib.suppress(OSError):
        return shutil.disk_usage(directory).free < _LEAST_ROOM
    return False


def _run(steps: Sequence[_Step], directory: Path, time_limit: float) -> tuple[_Step, Outcome]:
    """Run all steps but the last in parallel, then the last; give a failure, or the last."""
    *first, last = steps
    owner = threading.current_thread()  # of all steps, whichever thread waits for them

    def run(step: _Step) -> Outcome:
        made = directory / f"{step.source}.o"
        found = find_published(step.key, OBJECT) if step.key else None
        # Another process may clear the cache between the look and the copy.
        with contextlib.suppress(FileNotFoundError):
            if found is not None:
                shutil.copyfile(found, made)
                return Outcome(0, "")
        outcome = run_limited(step.command, directory, time_limit, owner)
        if step.key and outcome.status == 0:
            # The library is linked from the one, the other moves to the cache.
            copy = shutil.copyfile(made, directory / f"{step.source}.kept.o")
            publish(copy, step.key, OBJECT)
        return outcome

    # Threads suffice, as each waits for a process. The first file that fails is reported.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for step, outcome in zip(first, pool.map(run, first), strict=True):
            if outcome.status != 0:
                return step, outcome
    return last, run(last)


def _failure(outcome: Outcome, source: Path, time_limit: float) -> str:
    if outcome.status is None:
        return (
            f"The C compiler was stopped after {time_limit:g} s on '{source}'; raise the build "
            "option time_limit, or set optimize to '-O0'."
        )
    lines = [line.strip() for line in outcome.output.splitlines() if line.strip()]
    complaints = [line for line in lines if "error" in line.lower()]
    shown = next(iter(complaints or lines), "it printed nothing.")
    return f"The C compiler failed on '{source}' with exit status {outcome.status}: {shown}"
