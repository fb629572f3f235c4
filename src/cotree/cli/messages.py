"""Errors and warnings as sentences on standard error."""

from __future__ import annotations

import warnings
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Exit code of a command that Ctrl-C ended, as shells have it.
INTERRUPTED = 130


def complain(sentence: str) -> None:
    """Print a sentence on standard error."""
    # On one line, whatever a name or the compiler has put into the sentence.
    typer.echo(f"cotree: {' '.join(sentence.split())}", err=True)


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Show warnings as sentences, without file names and source lines."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        complain(f"warning: {message}")

    with warnings.catch_warnings():
        # A warning is shown each time: by default Python shows those of one line of code once.
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = show
        yield
