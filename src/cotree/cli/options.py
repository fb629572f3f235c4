"""Shared arguments and options of commands, parsing of their values, and messages."""

from __future__ import annotations

import warnings
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from cotree.errors import ParameterError, SceneError, TopologyError, brief
from cotree.files import check_parent
from cotree.scene.settings import ROWS, SettingRow, Settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Sequence

    from cotree.api import Scene
    from cotree.scene.graphs import TreeChoice


def given(**options: float | None) -> dict[str, float]:
    """Return the options that were set."""
    return {name: value for name, value in options.items() if value is not None}


def read_numbers(option: str, texts: Sequence[str]) -> dict[str, float]:
    """Parse the values ``name=number`` of an option that may be repeated."""
    numbers = {}
    for name, value in read_pairs(option, texts).items():
        try:
            numbers[name] = float(value)
        except ValueError:
            raise ParameterError(
                f"{option} {brief(name)}={brief(value)}: '{brief(value)}' is not a number; "
                f"write it as {option} {brief(name)}=1.5"
            ) from None
    return numbers


def read_pairs(option: str, texts: Sequence[str]) -> dict[str, str]:
    """Parse the values ``name=text`` of an option that may be repeated; names must differ."""
    pairs: dict[str, str] = {}
    for text in texts:
        # Split at the first equals sign only, because expressions may contain others.
        name, equals, value = (part.strip() for part in text.partition("="))
        if not (name and equals and value):
            raise ParameterError(
                f"{option} '{brief(text)}' is not of the form name=value: "
                f"write it as {option} L=1.5"
            )
        if name in pairs:
            raise ParameterError(f"{option} gives '{brief(name)}' twice: give it once")
        pairs[name] = value
    return pairs


def read_tolerances(texts: Sequence[str]) -> list[float | tuple[float, float]]:
    """Parse the values ``rtol`` or ``rtol,atol`` of an option that may be repeated."""
    tolerances: list[float | tuple[float, float]] = []
    for text in texts:
        try:
            # Unpacking more than two numbers also raises ValueError.
            rtol, *rest = (float(part) for part in text.split(","))
            (atol,) = rest or (None,)
        except ValueError:
            raise ParameterError(
                f"--tolerance '{brief(text)}' is not of the form rtol or rtol,atol: "
                "write it as --tolerance 1e-6"
            ) from None
        tolerances.append(rtol if atol is None else (rtol, atol))
    return tolerances


def read_tree(texts: Sequence[str]) -> TreeChoice:
    """Parse tree branches: ``j1,h2`` for both graphs, or ``translation=m rotation=s`` for each."""
    if not any("=" in text for text in texts):
        names = [name for text in texts for name in _names(text)]
        # An empty value means no branches; without the option, cotree chooses the tree.
        return names if texts else None
    tree: dict[str, list[str]] = {}
    for text in texts:
        domain, equals, names_text = text.partition("=")
        if not equals:
            raise TopologyError(
                f"--tree '{brief(text)}' names no domain, but another --tree does: "
                "write --tree translation=... --tree rotation=..."
            )
        if domain.strip() in tree:
            raise TopologyError(f"--tree gives the domain '{brief(domain)}' twice: give it once")
        tree[domain.strip()] = _names(names_text)
    return tree


def check_folder(path: Path | None) -> None:
    """Raise an error if a file cannot be written; called before any computation."""
    if path is not None:
        check_parent(path)
        if path.is_dir():
            raise SceneError(f"cannot write '{path}': it is a folder; name a file in it")


def _names(text: str) -> list[str]:
    return [name.strip() for name in text.split(",") if name.strip()]


def check_picture(path: Path | None) -> None:
    """Raise an error if a picture cannot be written; called before any computation."""
    if path is not None:
        from cotree import plot

        check_folder(path)
        plot.check_picture(path)


def check_animated(path: Path | None, scene: Scene) -> bool:
    """Return whether a scene moves in space; raise an error if its animation cannot be written."""
    if path is None:
        return False
    from cotree.watch import check_animation

    check_folder(path)
    check_animation(path)
    return bool(scene.mechanics.edges)


_Command = TypeVar("_Command", bound="Callable[..., Any]")

#: Type of options that name a file or a folder.
PATH = click.Path(path_type=Path)
path_option = partial(click.option, type=PATH)
#: Option that may be repeated: the command receives a tuple of its values.
repeated_option = partial(click.option, multiple=True)

scene_argument = click.argument(
    "scene",
    metavar="SCENE",
    help="Name of a shipped scene, or path of a TOML, URDF, SPICE or SBML file.",
)
sensitivity_option = repeated_option(
    "--sensitivity",
    "-s",
    metavar="NAME",
    help="Compute sensitivities to this parameter, or to the initial value of this state; may be "
    "repeated.",
)
tree_option = repeated_option(
    "--tree",
    metavar="EDGES",
    callback=lambda _, __, texts: read_tree(texts),
    help="Branches of the tree, such as j1,h2. For different trees of the two graphs, repeat the "
    "option: translation=... and rotation=...",
)
end_time_option = click.option(
    "--t-end", type=float, metavar="S", help="End time in s. Default: from the scene."
)
plot_option = path_option("--plot", help="Draw curves to this file: .svg, .png or .pdf.")
csv_option = path_option(
    "--csv", help="Write all states, outputs, inputs and sensitivities to this CSV file."
)


def settings_options(*leave: str, **helps: float | str) -> Callable[[_Command], _Command]:
    """Return a decorator that adds an option for each setting of runs that has a help text.

    The command receives the settings that were set as its argument ``settings``, a dict.
    Settings in ``leave`` get no option; ``helps`` replaces help texts or defaults.
    """
    rows = [(name, row) for name, row in ROWS.items() if row.option and name not in leave]

    def decorate(command: _Command) -> _Command:
        for name, row in reversed(rows):  # Click lists the option of the last decorator first
            command = _option(name, row, helps.get(name))(command)
        return command

    return decorate


def _option(
    name: str, row: SettingRow, help_: float | str | None
) -> Callable[[_Command], _Command]:
    """Return the command-line option for a setting."""
    text, value = row.option, getattr(Settings, name, None)
    if isinstance(help_, str):
        text = help_
    elif help_ is not None:
        value = help_
        text = text if "{" in text else f"{text} Default: {{:g}}."
    return click.option(
        row.flag or f"--{name.replace('_', '-')}",
        name,
        type=str if name == "method" or name in _READERS else float,
        multiple=name in _READERS,
        metavar=row.metavar,
        help=text.format(value),
        callback=_store,
        expose_value=False,
    )


_READERS: dict[str, Callable[[str, Sequence[str]], dict[str, Any]]] = {
    "parameters": read_numbers,
    "initial": read_numbers,
    "inputs": read_pairs,
}


def _store(context: click.Context, option: click.Parameter, value: Any) -> None:
    """Add the value of an option to the command's settings; options for mappings are repeated."""
    settings = context.params.setdefault("settings", {})
    name = str(option.name)
    if name in _READERS:
        settings[name] = _READERS[name](option.opts[0], value)
    elif value is not None:
        settings[name] = value


#: Values of ``base`` and ``mimic`` on the current command line.
_ROBOT: ContextVar[tuple[str, bool]] = ContextVar("_ROBOT", default=("fixed", True))


def read_robots_with(base: str, mimic: bool) -> None:
    """Store the options with which :func:`read_scene` reads robots."""
    _ROBOT.set((base, mimic))


def read_scene(
    source: str, settings: dict[str, Any] | None = None, swept: Iterable[str] = ()
) -> Scene:
    """Read a shipped scene or a file; print notes on ignored elements on standard error.

    Input expressions are moved from ``settings`` to the scene. New names in them are parameters
    that ``settings`` or, if in ``swept``, the members of an ensemble set.
    """
    from cotree.api import load
    from cotree.readers import is_urdf

    if is_urdf(source):  # the options do not apply to other formats
        from cotree.reading import read_urdf

        scene = read_urdf(source, *_ROBOT.get())
    else:
        scene = load(source)
    for note in scene.origin.notes if scene.origin is not None else ():
        click.echo(f"cotree: note: {' '.join(note.split())}", err=True)
    if settings is None or not (inputs := settings.pop("inputs")):
        return scene
    from cotree.scene.variants import new_names

    # The value one is a placeholder, which every member replaces.
    values = dict.fromkeys(swept, 1.0) | settings["parameters"]
    new = {name: values[name] for name in new_names(scene, inputs, values)}
    return scene.with_inputs(inputs, new)


def write_file(path: Path | None, write: Callable[[Path], object]) -> None:
    """Write the file that an option names, if any, and print its name."""
    if path is not None:
        write(path)
        click.echo(f"wrote {path}")


#: Exit code of a command that Ctrl-C interrupts, as in shells.
INTERRUPTED = 130


def print_error(sentence: str) -> None:
    """Print a sentence on one line of standard error."""
    click.echo(f"cotree: {' '.join(sentence.split())}", err=True)


@contextmanager
def warnings_in_one_line() -> Iterator[None]:
    """Print warnings as sentences, without file names and source lines."""

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        print_error(f"warning: {message}")

    with warnings.catch_warnings():
        # Without this filter, Python shows repeated warnings from one line of code only once.
        warnings.simplefilter("always", RuntimeWarning)
        warnings.showwarning = show
        yield
