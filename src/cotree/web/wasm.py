"""Compilation of C projects to WebAssembly with the package ``ziglang``.

The program calls no operating system except for messages, the clock and its exit; a page provides
these few functions.
"""

from __future__ import annotations

import importlib.util
import sys
from typing import TYPE_CHECKING

from cotree.build.cache import cached, private_directory, write_files
from cotree.build.toolchain import run_limited
from cotree.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Mapping

_OUTPUT = "program.wasm"
# A reactor is a program whose functions are called from outside. Stack and heap grow as needed,
# and products are never fused with sums, so that results agree with those of other compilers.
_FLAGS = (
    "-target wasm32-wasi -mexec-model=reactor -std=c99 -Os -g0 -s -w -ffp-contract=off "
    "-fno-math-errno -fno-sanitize=all -Wl,-z,stack-size=1048576"
)
_EXPORTS = "parameters initial run rows n_rows n_steps stiff_since events n_events"
# The first compilation also compiles zig's C library.
_TIME_LIMIT = 900.0


def check_zig() -> None:
    """Raise BuildError unless the package ``ziglang`` is installed."""
    if importlib.util.find_spec("ziglang") is None:
        raise BuildError('a page contains WebAssembly: run `pip install "cotree[web]"`')


def build_wasm(files: Mapping[str, str]) -> bytes:
    """Return the program of C files as WebAssembly, from the cache if possible."""
    check_zig()
    return cached(("wasm", _FLAGS, dict(files)), lambda: _build(files))


def _build(files: Mapping[str, str]) -> bytes:
    sources = sorted(name for name in files if name.endswith(".c"))
    # Without -P, a folder 'ziglang' in the current directory would be imported.
    zig = (sys.executable, "-P", "-m", "ziglang", "cc")
    with private_directory() as directory:
        write_files(files, directory)
        exports = [f"-Wl,--export=page_{name}" for name in _EXPORTS.split()]
        command = [*zig, *_FLAGS.split(), *exports, "-o", _OUTPUT, *sources, "-lm"]
        outcome = run_limited(command, directory, _TIME_LIMIT)
        made = directory / _OUTPUT
        if outcome.status != 0 or not made.exists():
            lines = [line for line in outcome.output.splitlines() if "error" in line.lower()]
            why = lines[0] if lines else "it printed no error"
            if outcome.status is None:
                why = f"it was stopped after {_TIME_LIMIT:g} s"
            raise BuildError(f"zig cannot compile the model to WebAssembly: {why}")
        return made.read_bytes()
