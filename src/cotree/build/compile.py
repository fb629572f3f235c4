"""Compile C text into a shared library, or find the library that the same text gave before."""

from __future__ import annotations

import re
import shlex
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.build.cache import (
    cache_directory,
    cache_key,
    find_library,
    keep_failed,
    private_directory,
    publish_library,
    write_files,
)
from cotree.build.options import BuildOptions, compiler_flags, cpu_features
from cotree.build.process import Outcome, run_limited
from cotree.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from cotree.build.toolchain import Toolchain

_FILE_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\.[ch]")
_OUTPUT = "library.so"


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
        The compiler's command line, with file names relative to the folder of the C text.
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
) -> BuiltLibrary:
    """Compile a model, unless the cache holds it.

    Parameters
    ----------
    files : mapping of str to str
        C text by file name. All ``.c`` files are compiled together, with the ``.h`` files beside
        them.
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
    command = (*toolchain.command, *flags, *sources, "-o", _OUTPUT, "-lm")
    key = cache_key(
        files,
        abi_version=abi_version,
        toolchain=toolchain,
        flags=flags,
        cpu_features=cpu_features() if options.native else "",
    )
    found = find_library(key)
    path = found or _compile(files, sources, command, key, options.time_limit)
    return BuiltLibrary(path, time.perf_counter() - start, found is not None, shlex.join(command))


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


def _compile(
    files: Mapping[str, str],
    sources: Sequence[str],
    command: Sequence[str],
    key: str,
    time_limit: float,
) -> Path:
    try:
        with private_directory() as directory:
            write_files(files, directory)
            outcome = run_limited(command, directory, time_limit)
            if outcome.status == 0 and (directory / _OUTPUT).is_file():
                return publish_library(directory / _OUTPUT, key)
        source = keep_failed(files, key) / sources[0]
    except OSError as error:
        raise BuildError(
            f"The model cannot be compiled in the cache folder '{cache_directory()}' ({error}); "
            "make room there, or name another folder with the environment variable "
            "COTREE_CACHE_DIR.",
            command=shlex.join(command),
        ) from error
    raise BuildError(
        _failure(outcome, source, time_limit),
        command=shlex.join(command),
        output=outcome.output,
        source=str(source),
    )


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
    """Pick the line a reader looks for first."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    complaints = [line for line in lines if "error" in line.lower()]
    return next(iter(complaints or lines), "it said nothing.")
