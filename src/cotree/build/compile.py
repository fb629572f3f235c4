"""Compile C text into a shared library, or find the library that the same text gave before."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import shlex
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
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
from cotree.build.options import BuildOptions, compiler_flags, cpu_features
from cotree.build.process import Outcome, run_limited
from cotree.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence
    from pathlib import Path

    from cotree.build.toolchain import Toolchain

_FILE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\.[ch]")
_OUTPUT = "library.so"
# The most attempts at a library that another process's clear_cache() keeps removing.
ATTEMPTS = 3
_FULL = re.compile("no space left on device|disk quota exceeded", re.IGNORECASE)
# Less room than this for a compiler's temporary files is none.
_LEAST_ROOM = 1 << 20


@dataclass(frozen=True)
class BuiltLibrary:
    """A shared library in the cache.

    Attributes
    ----------
    path : Path
        Absolute path of the library.
    seconds : float
        Time spent on finding or building it, [s].
    cached : bool
        True if the compiler was not needed.
    command : str
        The compiler's command lines, with file names relative to the folder of the C text.
    """

    path: Path
    seconds: float
    cached: bool
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
    n_operations : int
        Number of operations in the longest C function.
    n_all : int
        Number of operations in all functions.
    options : BuildOptions
        The user's choice.
    toolchain : Toolchain
        The compiler, from :func:`find_toolchain`.
    levels : mapping of str to str
        Compiler level of single files, where it is another one than that of ``options``, with
        further flags behind blanks.
    shared : collection of str
        Names of files that other libraries have, too, with the same text. They include no files but
        each other. The objects of these ``.c`` files are kept in the cache for those libraries.

    Returns
    -------
    BuiltLibrary
        The library, intact in the cache.

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
    """Give the names of the C files, in an order that does not depend on the mapping's."""
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
    """Compile once; None where the private folder was taken away meanwhile.

    Raises
    ------
    BuildError
        If the compiler refuses the text or takes too long.
    OSError
        If the folder cannot be written, as on a full disk.
    """
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
    # The private folder is gone by now, so the user gets sources of his own to look at.
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
    """Tell whether a compiler failed for lack of disk space; it may have died without a message."""
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
    return (
        f"The C compiler failed on '{source}' with exit status {outcome.status}: "
        f"{_first_complaint(outcome.output)}"
    )


def _first_complaint(output: str) -> str:
    """Pick the first error line of a compiler's output."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    complaints = [line for line in lines if "error" in line.lower()]
    return next(iter(complaints or lines), "it said nothing.")
