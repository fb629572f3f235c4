"""The command line: arguments in, text and files out; no mathematics."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from cotree.cli.ahead import abandon_engine, begin_engine

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Parameters
    ----------
    arguments : sequence of str, optional
        Without the name of the program; those of the process where absent.

    Returns
    -------
    int
        Exit code.
    """
    begin_engine(sys.argv[1:] if arguments is None else arguments)
    # Imported here, while a compiler may be at work.
    from cotree.cli.app import main as obey

    code = obey(arguments)
    # A program of Python that calls with arguments of its own goes on, and may need the engine.
    if code and arguments is None:
        abandon_engine()
    return code
