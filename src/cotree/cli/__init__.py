"""The command line, which converts arguments to calls and results to text and files.

The C engine of a run begins to compile before the command's packages are imported.
"""

from __future__ import annotations

import contextlib
import sys
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["main"]

_SHIPPED = Path(__file__).parents[1] / "scenes"
_OPTION = "--method"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, with the arguments of the process by default; return the exit code."""
    begin_engine(sys.argv[1:] if arguments is None else arguments)
    # The slow import overlaps with the compiler, which runs in another process.
    from cotree.cli.app import main as run

    code = run(arguments)
    # If a Python program passed arguments, it may continue to use the engine.
    engine = sys.modules.get("cotree.solvers.engine")
    if code and arguments is None and engine is not None:
        engine.abandon_ahead()
    return code


def begin_engine(arguments: Sequence[str]) -> None:
    """Begin to build the engine if the command line runs a scene.

    Scene, method and presence of events are guesses, which the command itself checks.
    """
    if "run" not in arguments or "--help" in arguments:
        return
    rest = list(arguments[arguments.index("run") + 1 :])
    scene = next(filter(None, map(_scene_file, rest)), None)
    if scene is None:  # the command reports why the scene cannot be read
        return
    method, has_events = _engine_of(scene)
    method = _method_given(rest) or method
    if method is not None:
        from cotree.solvers.engine import build_ahead

        build_ahead(method, has_events=has_events)


def _scene_file(argument: str) -> Path | None:
    if argument.startswith("-"):
        return None
    places = (Path(argument), _SHIPPED / f"{argument}.toml")
    with contextlib.suppress(OSError):  # OSError: the name is too long for a path
        return next((place for place in places if place.is_file()), None)
    return None


def _method_given(arguments: list[str]) -> str:
    for place, argument in enumerate(arguments):
        if argument == _OPTION:
            return "".join(arguments[place + 1 : place + 2])
        if argument.startswith(f"{_OPTION}="):
            return argument.removeprefix(f"{_OPTION}=")
    return ""


def _engine_of(scene: Path) -> tuple[str | None, bool]:
    """Return a scene file's method, None if it cannot be read, and whether it has events."""
    if scene.suffix != ".toml":
        return "auto", False
    try:
        described = tomllib.loads(scene.read_text(encoding="utf-8"))
        method = described.get("simulation", {}).get("method", "auto")
    except (OSError, ValueError, AttributeError, RecursionError):
        return None, False
    return (method if isinstance(method, str) else None), "events" in described
