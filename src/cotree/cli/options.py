"""Arguments, options and messages that several commands share."""

from __future__ import annotations

import functools
import inspect
import warnings
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeVar, get_type_hints

import typer

from cotree.scene.settings import ROWS, Settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from cotree.api import Scene


_Command = TypeVar("_Command", bound="Callable[..., None]")

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
Plot = Annotated[Path | None, typer.Option(help="Draw to this file: .svg, .png or .pdf.")]
Csv = Annotated[Path | None, typer.Option(help="Write all columns of the run to this file.")]


def with_settings(*leave: str, **defaults: float) -> Callable[[_Command], _Command]:
    """Return a command an option for each setting of runs that has a help text.

    The command gets those that are given as its argument ``settings``, whose place in the signature
    the options take.

    Parameters
    ----------
    *leave : str
        Settings that have no option.
    **defaults
        What the command takes if a setting is not given, for the help.
    """
    rows = {name: row for name, row in ROWS.items() if row.option and name not in leave}

    options = [
        inspect.Parameter(
            name,
            inspect.Parameter.POSITIONAL_OR_KEYWORD,
            default=None,
            annotation=_option(name, row.option, row.metavar, defaults),
        )
        for name, row in rows.items()
    ]

    def decorate(command: _Command) -> _Command:
        @functools.wraps(command)
        def run(**options: Any) -> None:
            given = {name: options.pop(name) for name in rows}
            settings = {name: value for name, value in given.items() if value is not None}
            command(**options, settings=settings)

        hints, listed = get_type_hints(command, include_extras=True), []
        for name, own in inspect.signature(command).parameters.items():
            listed += options if name == "settings" else [own.replace(annotation=hints[name])]
        run.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined]
        run.__annotations__ = {option.name: option.annotation for option in listed}
        return run  # type: ignore[return-value]

    return decorate


def _option(name: str, text: str, metavar: str | None, defaults: Mapping[str, float]) -> Any:
    kind = str if name == "method" else float
    if name in defaults and "{" not in text:
        text = f"{text.rstrip('.')}: {{:g}} if absent."
    text = text.format(defaults.get(name, getattr(Settings, name)))
    return Annotated[kind | None, typer.Option(metavar=metavar, help=text)]


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
