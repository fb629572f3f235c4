"""Figures to files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.errors import SceneError
from cotree.files import written_whole

if TYPE_CHECKING:
    import os

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
    with (
        written_whole(path, "the picture") as draft,
        matplotlib.rc_context({"svg.hashsalt": "cotree"}),
    ):
        fig.savefig(draft, format=suffix, dpi=150, metadata=metadata)


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
