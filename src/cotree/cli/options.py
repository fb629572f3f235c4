"""Arguments, options and messages that several commands share."""

from __future__ import annotations

import warnings
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.api import Scene


SceneName = Annotated[
    str,
    typer.Argument(metavar="SCENE", help="A shipped scene, or a TOML, URDF, SPICE or SBML file."),
]
Sensitivity = Annotated[
    list[str],
    typer.Option(
        "--sensitivity",
        "-s",
        metavar="NAME",
        help="Parameter, or state whose initial value is meant; may be repeated.",
    ),
]
Setting = Annotated[
    list[str],
    typer.Option("--set", metavar="NAME=NUMBER", help="Value of a parameter; may be repeated."),
]
TreeOption = Annotated[
    list[str],
    typer.Option(
        "--tree",
        metavar="EDGES",
        help="Branches, as j1,h2 or once as translation=... and once as rotation=...",
    ),
]
EndTime = Annotated[
    float | None, typer.Option("--t-end", metavar="S", help="End time in s; the scene's if absent.")
]
InputOption = Annotated[
    list[str],
    typer.Option(
        "--input",
        metavar="NAME=VALUE",
        help="In place of an input: a number, or an expression of t, parameters, states and "
        "outputs; --set gives values of new names in it; may be repeated.",
    ),
]
InitialOption = Annotated[
    list[str],
    typer.Option(
        "--initial", metavar="STATE=NUMBER", help="Initial value of a state; may be repeated."
    ),
]
MaxSteps = Annotated[
    float | None,
    typer.Option(metavar="N", help="Budget of steps of a run: 1000000 if absent; inf for none."),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(metavar="S", help="Computing time of a run in s: 3600 if absent; inf for none."),
]
Method = Annotated[
    str | None,
    typer.Option(
        help="dopri5, rkf45, dop853, rodas4, rodas5, RK45, RK23, DOP853, Radau, BDF, LSODA, "
        "cvode, ida, cvodes, cvodes-simultaneous, idas or auto."
    ),
]
Rtol = Annotated[float | None, typer.Option(help="Relative tolerance of runs.")]
Atol = Annotated[float | None, typer.Option(help="Absolute tolerance of runs.")]
Plot = Annotated[Path | None, typer.Option(help="Draw to this file: .svg, .png or .pdf.")]
Csv = Annotated[Path | None, typer.Option(help="Write all columns of the run to this file.")]


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
