"""Compilation of C text to shared libraries, unless they are in the cache, and their loading.

``-ffast-math`` is never used, because it breaks checks for NaN and changes the order of operations.
``-ffp-contract`` is always set, because its default depends on the compiler and affects the last
digits. Libraries are loaded by cffi in ABI mode, which needs no compiler and no Python headers.
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
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from cotree.build.cache import (
    OBJECT,
    building,
    cache_directory,
    cache_key,
    cached,
    find_published,
    private_directory,
    publish,
    save_failed_sources,
    write_files,
)
from cotree.build.toolchain import Outcome, Toolchain, run_limited
from cotree.errors import BuildError, nearest
from cotree.files import includes
from cotree.sharing import locked_cache

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cffi import FFI


_LEVELS = ("-O0", "-Og", "-O1", "-O2", "-O3")
# If the longest function has more operations than this, it is compiled with -O0, because register
# allocation with -O1 takes minutes.
_STATEMENT_LIMIT_GCC = 4_000
_STATEMENT_LIMIT_CLANG = 20_000
# If all functions together have more operations than this, gcc is called with -Og. Compilation is
# then 1.4 to 3.5 times as fast as with -O1 (motor linkage with all parameters: 0.4 s instead of
# 1.35 s). Calls of kernels take up to 10 % longer, and runs up to 3 %. With clang, -Og equals -O1.
_LONG_FOR_GCC = 500
# Flags for files with loops over equations. The number of equations is read through a pointer; only
# with strict aliasing is it constant in a loop.
_LOOPS_GCC = (
    "-O1 -fstrict-aliasing -ftree-loop-vectorize -fvect-cost-model=dynamic "
    "-finline-small-functions -ftree-pre -funswitch-loops -ftree-slp-vectorize -fpeel-loops "
    "-fgcse -frerun-cse-after-loop -fexpensive-optimizations"
)
# Vectors of this processor, without contraction: the same results to the last bit as portable code.
# Vectors of 512 bits are slower, because kernels have just written their elements one by one.
# Without -fexpensive-optimizations, gcc does not clear the upper halves of registers before calls,
# and runs with portable kernels take five times as long.
_OWN_VECTORS = "-march=native -mno-avx512f"


@dataclass(frozen=True)
class BuildOptions:
    """Compiler options for a model; invalid values raise BuildError."""

    #: ``'auto'``, or one of ``'-O0'``, ``'-Og'``, ``'-O1'``, ``'-O2'``, ``'-O3'``.
    optimize: str = "auto"
    #: Whether all instructions of this processor are used, including fused multiply-add. The
    #: library then needs a machine with the same features, and its last digits may differ.
    native: bool = False
    time_limit: float = 600.0  # time after which the compiler is stopped, [s]

    def __post_init__(self) -> None:
        if self.optimize not in ("auto", *_LEVELS):
            raise BuildError(
                f"The build option optimize is '{self.optimize}', which is unknown"
                f"{nearest(self.optimize, ('auto', *_LEVELS))}"
            )
        # The negation also rejects NaN.
        if not self.time_limit > 0.0:
            raise BuildError(
                f"The build option time_limit is {self.time_limit:g} s; give a positive time."
            )


def compiler_flags(
    toolchain: Toolchain,
    options: BuildOptions,
    n_operations: int,
    n_all: int = 0,
    is_windows: bool = sys.platform == "win32",
) -> tuple[str, ...]:
    """Return the compiler flags that precede the file names.

    With ``'auto'``, the level depends on the operations in the longest C function and in total.
    """
    flags = ["-std=c99", _level(toolchain, options, n_operations, n_all)]
    # On Windows, code is always relocatable, and clang rejects the flag.
    if not is_windows:
        flags.append("-fPIC")
    # Fused operations round once instead of twice, which changes the last digits.
    contract = "fast" if options.native else "off"
    # Square roots that need not set errno are single instructions.
    flags += ["-shared", f"-ffp-contract={contract}", "-fno-math-errno"]
    if toolchain.kind == "zig":
        # By default, Zig adds debug information and traps for signed overflow. Its runtime lacks
        # the functions that identify processors.
        flags += ["-g0", "-fno-sanitize=all", "-DCOTREE_NO_DISPATCH"]
    flags += _processor_flags(toolchain, options)
    return tuple(flags)


def loop_flags(toolchain: Toolchain) -> str:
    """Return the flags, separated by blanks, for a file whose loops over equations are vectorised.

    Compilation takes two thirds of the time with ``-O3``; at most 1 % more instructions are
    executed. On x86 processors, vectors of this processor are used; results do not depend on them.
    """
    level = "-O3" if toolchain.is_clang else _LOOPS_GCC
    return f"{level} {_OWN_VECTORS}" if _is_x86() and toolchain.kind != "zig" else level


def cpu_features() -> str:
    """Return the instruction sets of this processor, or its name if they are unknown."""
    return _processor_entry("flags", "Features") or platform.processor()


def processor_name() -> str:
    """Return the name of this processor, or its architecture if nothing else is known."""
    return _processor_entry("model name") or platform.processor() or platform.machine()


@cache
def _processor_entry(*labels: str) -> str:
    """Return the first of the given entries in Linux's processor data, or an empty string."""
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
    # Register allocation would take too long for the longest function.
    if n_operations > limit:
        return "-O0"
    # Contraction to fused operations requires -O2, whose compilation takes twice as long.
    if options.native:
        return "-O2"
    return "-Og" if n_all > _LONG_FOR_GCC and not toolchain.is_clang else "-O1"


def _processor_flags(toolchain: Toolchain, options: BuildOptions) -> list[str]:
    if not options.native:
        # By default, only Zig compiles for the host processor.
        return ["-mcpu=baseline"] if toolchain.kind == "zig" else []
    # For other processors, all compilers accept -mcpu. Packing statements into vectors adds
    # dependencies: most kernels are faster without it, short ones by up to a third.
    return ["-march=native" if _is_x86() else "-mcpu=native", "-fno-tree-slp-vectorize"]


def _is_x86() -> bool:
    return platform.machine().lower() in ("x86_64", "amd64", "i386", "i686")


_FILE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\.[ch]")
_OUTPUT = "library.so"
# Maximum number of attempts to build a library while other processes call clear_cache().
ATTEMPTS = 3
_FULL = re.compile("no space left on device|disk quota exceeded", re.IGNORECASE)
# Free space below which a compiler cannot write its temporary files, [byte].
_LEAST_ROOM = 1 << 20


@dataclass(frozen=True)
class BuiltLibrary:
    """A shared library in the cache."""

    path: Path  # absolute path of the library
    seconds: float  # time to find or build it, [s]
    cached: bool  # whether the library was found in the cache
    #: Command lines of the compiler, with file names relative to the folder of the C text.
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
    flags: Sequence[str] = (),
    is_windows: bool = sys.platform == "win32",
) -> BuiltLibrary:
    """Return a model's library from the cache, or compile it.

    Parameters
    ----------
    files : mapping of str to str
        C text by file name. The ``.c`` files are compiled in parallel, each with all ``.h`` files.
        Object files of ``cotree_*.c``, which other libraries may contain too, are cached.
    n_operations, n_all : int
        Number of operations in the longest C function, and in all functions.
    levels : mapping of str to str
        Optimisation levels and additional flags of individual files, separated by blanks.
    flags : sequence of str
        Additional flags of all files.
    is_windows : bool
        Whether the library is for Windows.

    Raises
    ------
    BuildError
        If the compiler fails or takes too long, the cache folder cannot be used, or a file name is
        not that of a C file.
    """
    start = time.perf_counter()
    sources = _source_names(files)
    flags = (*compiler_flags(toolchain, options, n_operations, n_all, is_windows), *flags)

    def key_of(texts: Mapping[str, str], *others: str) -> str:
        is_native = any("=native" in flag for flag in (*flags, *others))
        return cache_key(
            texts,
            abi_version=abi_version,
            toolchain=toolchain,
            flags=(*flags, *others),
            cpu_features=cpu_features() if is_native else "",
        )

    *compiling, linking = _steps((*toolchain.command, *flags), sources, levels)
    # The longest compilations start first, to balance the load of the processors.
    compiling.sort(key=lambda step: (step.source not in levels, -len(files[step.source])))
    steps = [*compiling, linking]
    # The levels of individual files affect the library, so they are part of the key.
    key = key_of(files, *(f"{name} {level}" for name, level in sorted(levels.items())))
    found = find_published(key)
    path = found
    if path is None:
        # All steps except the last, which builds the library, build object files.
        steps[:-1] = [
            replace(step, key=key_of(included_files(files, name), levels.get(name, "")))
            if (name := step.source).startswith("cotree_")
            else step
            for step in steps[:-1]
        ]
        with building(key, options.time_limit):
            found = find_published(key)  # another process may have built it meanwhile
            path = found or _compile(files, steps, key, options.time_limit)
    commands = " && ".join(shlex.join(step.command) for step in steps)
    return BuiltLibrary(path, time.perf_counter() - start, found is not None, commands)


def included_files(files: Mapping[str, str], name: str) -> dict[str, str]:
    """Return a file and all others that it includes, also through other files, by name."""
    found = [name]
    for own in found:
        found += [row for row in includes(files[own]) if row in files and row not in found]
    return {own: files[own] for own in found}


def _source_names(files: Mapping[str, str]) -> tuple[str, ...]:
    for name in files:
        # A name must not leave its folder or be read as a compiler option.
        if not _FILE_NAME.fullmatch(name):
            raise BuildError(
                f"The file name '{name}' is not valid for C; use letters, digits and "
                "underscores, then '.c' or '.h'."
            )
    sources = tuple(sorted(name for name in files if name.endswith(".c")))
    if not sources:
        raise BuildError("There is no C file to compile; give at least one file named '*.c'.")
    return sources


@dataclass(frozen=True)
class _Step:
    """A command, the C file that it compiles, and the key of the object file if that is cached."""

    source: str
    command: tuple[str, ...]
    key: str = ""


def _steps(
    compiler: tuple[str, ...], sources: Sequence[str], levels: Mapping[str, str]
) -> list[_Step]:
    """Return a command for each file and one that links; a single file needs only one command."""
    # Libraries are last, because a linker resolves only symbols of preceding files.
    to = ("-o", _OUTPUT, "-lm")
    # The level of a file follows the common one, because the last level takes effect.
    own = {source: (*compiler, *levels.get(source, "").split()) for source in sources}
    if len(sources) == 1:
        return [_Step(source, (*command, source, *to)) for source, command in own.items()]
    steps = [
        _Step(source, (*command, "-c", source, "-o", f"{source}.o"))
        for source, command in own.items()
    ]
    # The common flags include -shared, which affects only the last step.
    objects = [f"{source}.o" for source in sources]
    return [*steps, _Step(sources[0], (*compiler, *objects, *to))]


def _compile(files: Mapping[str, str], steps: Sequence[_Step], key: str, time_limit: float) -> Path:
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
    """Compile once; return None if another process removed the private folder."""
    with private_directory() as directory:
        try:
            write_files(files, directory)
            step, outcome = _run(steps, directory, time_limit)
            if outcome.status == 0 and (directory / _OUTPUT).is_file():
                return publish(directory / _OUTPUT, key)
        except FileNotFoundError:
            # If the sources are in the folder, it was not removed, and another file is missing.
            if _is_complete(directory, files):
                raise
            return None
        # The compiler may have failed because another process has cleared the cache.
        if not _is_complete(directory, files):
            return None
        if _is_full(directory, outcome):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    # The sources are copied for the user, because the private folder is removed.
    source = save_failed_sources(files, key) / step.source
    raise BuildError(
        _failure(outcome, source, time_limit),
        command=shlex.join(step.command),
        output=outcome.output,
        source=str(source),
    )


def _is_complete(directory: Path, files: Mapping[str, str]) -> bool:
    return all((directory / name).is_file() for name in files)


def _is_full(directory: Path, outcome: Outcome) -> bool:
    """Return whether a compiler has failed for lack of disk space, possibly without a message."""
    if _FULL.search(outcome.output):
        return True
    with contextlib.suppress(OSError):
        return shutil.disk_usage(directory).free < _LEAST_ROOM
    return False


def _run(steps: Sequence[_Step], directory: Path, time_limit: float) -> tuple[_Step, Outcome]:
    """Run all steps except the last in parallel, then the last; return the last or a failed one."""
    *first, last = steps
    owner = threading.current_thread()  # also owns steps that run in other threads

    def run(step: _Step) -> Outcome:
        made = directory / f"{step.source}.o"
        found = find_published(step.key, OBJECT) if step.key else None
        # Another process may clear the cache between the check and the copy.
        with contextlib.suppress(FileNotFoundError):
            if found is not None:
                shutil.copyfile(found, made)
                return Outcome(0, "")
        outcome = run_limited(step.command, directory, time_limit, owner)
        if step.key and outcome.status == 0 and made.exists():
            # One copy is linked, and the other copy is published in the cache.
            copy = shutil.copyfile(made, directory / f"{step.source}.kept.o")
            publish(copy, step.key, OBJECT)
        return outcome

    # Threads suffice, because each only waits for a process. The first failure is reported.
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
    errors = [line for line in lines if "error" in line.lower()]
    shown = next(iter(errors or lines), "it printed nothing.")
    if outcome.status == 0:
        return f"The C compiler ended without an error on '{source}', but wrote no file: {shown}"
    return f"The C compiler failed on '{source}' with exit status {outcome.status}: {shown}"


@dataclass(frozen=True)
class LoadedLibrary:
    """A shared library that is loaded into this process."""

    ffi: FFI  # object with the C declarations, which creates and casts pointers
    lib: Any  # library with functions and variables as attributes, resolved at first use


def load_library(path: str | os.PathLike[str], cdef: str) -> LoadedLibrary:
    """Load a shared library, once in a process for each path and set of declarations.

    The declarations must not contain preprocessor lines; a damaged file may crash the process.
    Raise BuildError if the system cannot load the file, or if all declared names are missing.
    """
    # The path is absolute, because the system would search its own folders for a bare name.
    return _load(os.path.abspath(path), cdef)


def _declared(cdef: str) -> FFI:
    """Return an object with C declarations, which are parsed only if the cache has no result.

    The parser takes a tenth of a second, longer than the run of a small model.
    """
    import _cffi_backend

    def parse() -> str:
        from cffi import FFI
        from cffi.recompiler import make_py_source

        ffi = FFI()
        ffi.cdef(cdef)
        with tempfile.TemporaryDirectory() as directory:
            path = os.path.join(directory, "declarations.py")
            make_py_source(ffi, "declarations", path)
            with open(path, encoding="utf-8") as file:
                return file.read()

    names: dict[str, Any] = {}
    exec(cached(("declarations", cdef, _cffi_backend.__version__), parse), names)
    return names["ffi"]


def _has(ffi: FFI, lib: Any, name: str) -> bool:
    try:
        getattr(lib, name)
    except (AttributeError, ffi.error):
        return False
    return True


@locked_cache
def _load(path: str, cdef: str) -> LoadedLibrary:
    # Each library has separate types, so that equal names in two libraries do not conflict.
    ffi = _declared(cdef)
    try:
        lib = ffi.dlopen(path)
    except OSError as error:
        raise BuildError(
            f"The compiled library '{path}' cannot be loaded ({error}); run clear_cache() if it "
            "was built on another system, and check that compiler and Python are of one "
            "architecture."
        ) from error
    # Names are resolved at first use, when a wrong library would cause an obscure error. An engine
    # also declares functions of other libraries: only a library without any name is wrong.
    names = dir(lib)
    if names and not any(_has(ffi, lib, name) for name in names):
        raise BuildError(
            f"The compiled library '{path}' has no '{names[0]}', so that it is not what its name "
            "says; run clear_cache()."
        )
    return LoadedLibrary(ffi, lib)


def obtain_library(
    files: Mapping[str, str], declarations: str, **options: Any
) -> tuple[BuiltLibrary, LoadedLibrary]:
    """Find or build a library and load it; see :func:`build_library` for ``options``.

    The library is built again if another process calls ``clear_cache()`` before it is loaded.
    """
    for attempt in range(1, ATTEMPTS + 1):
        built = build_library(files, **options)
        try:
            return built, load_library(built.path, declarations)
        except BuildError:
            # If the file still exists, it is invalid, and another build would not help.
            if built.path.exists() or attempt == ATTEMPTS:
                raise
    raise AssertionError("the last attempt returns or raises")
