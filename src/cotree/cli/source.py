"""The scene of a command, read with the options that precede the command."""

from __future__ import annotations

from contextvars import ContextVar
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from cotree.api import Scene

#: ``base`` and ``mimic`` of the command line that is being obeyed.
_ROBOT: ContextVar[tuple[str, bool]] = ContextVar("_ROBOT", default=("fixed", True))


def read_robots_with(base: str, mimic: bool) -> None:
    """Keep how the command line wants robots to be read, for :func:`read_scene`."""
    _ROBOT.set((base, mimic))


def read_scene(source: str) -> Scene:
    """Read a shipped scene or a file; notes on what was not read go to standard error.

    Raises
    ------
    ModelError
        If there is no such scene, or it is wrong.
    """
    from cotree.api import load
    from cotree.readers import is_urdf

    if is_urdf(source):  # only robots have options of their own
        from cotree.reading import read_urdf

        scene = read_urdf(source, *_ROBOT.get())
    else:
        scene = load(source)
    # Notes go to standard error, so that output to a pipe stays as it is.
    for note in scene.origin.notes if scene.origin is not None else ():
        typer.echo(f"cotree: note: {' '.join(note.split())}", err=True)
    return scene
