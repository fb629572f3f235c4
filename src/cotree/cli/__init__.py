"""The command line: arguments in, text and files out; no mathematics."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from cotree.cli.ahead import abandon_engine, begin_engine

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, with the arguments of the process by default; return the exit code."""
    begin_engine(sys.argv[1:] if arguments is None else arguments)
    # This import is slow; meanwhile the compiler runs in other processes.
    from cotree.cli.app import main as run

    code = run(arguments)
    # A Python program that passes arguments may still need the engine.
    if code and arguments is None:
        abandon_engine()
    return code
