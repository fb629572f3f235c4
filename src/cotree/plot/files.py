"""Figures to files."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

_FORMATS = ("svg", "png", "pdf")


def save_figure(fig: Figure, path: str | os.PathLike[str]) -> None:
    """Write a figure to a file, whole or not at all.

    Parameters
    ----------
    fig : Figure
        The figure.
    path : path
        Where to write; its suffix says in which format: .svg, .png or .pdf.

    Raises
    ------
    SceneError
        If the suffix is unknown or the file cannot be written.
    """
    import matplotlib

    path = Path(path)
    suffix = check_suffix(path)
    # Neither date nor random identifiers, so that the same picture is the same file.
    metadata: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}}.get(
        suffix, {}
    )
    with matplotlib.rc_context({"svg.hashsalt": "cotree"}):
        write_whole(
            path,
            lambda draft: fig.savefig(draft, format=suffix, dpi=150, metadata=metadata),
            "picture",
        )


def write_whole(path: Path, write: Callable[[Path], object], what: str) -> None:
    """Write a file beside its place and move it there, so that it is whole or as it was.

    Parameters
    ----------
    path : Path
        Where to write.
    write : callable
        Writes to the path that it is given.
    what : str
        What is written, for messages.

    Raises
    ------
    SceneError
        If the file cannot be written.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        write(draft)
        os.replace(draft, path)
    except OSError as error:
        raise SceneError(f"cannot write the {what} '{path}': {error.strerror}") from None
    finally:
        with contextlib.suppress(OSError):
            draft.unlink(missing_ok=True)


def check_suffix(path: Path) -> str:
    """Give the format that a file's suffix asks for.

    Raises
    ------
    SceneError
        If the suffix is unknown.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in _FORMATS:
        known = ", ".join(f".{name}" for name in _FORMATS)
        raise SceneError(
            f"cannot draw '{path}': unknown suffix '{path.suffix}'; the known ones are {known}"
        )
    return suffix
