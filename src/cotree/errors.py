"""Exceptions for errors that a user can cause, each derived from a builtin type.

Messages name the edge, node, parameter or file line at fault and the remedy.
"""

from __future__ import annotations

import difflib
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from types import TracebackType


class Error(Exception):
    """Base class of the errors that cotree raises."""

    def _render_traceback_(self) -> list[str]:
        """Return a traceback for notebooks without frames inside cotree."""
        return [*_own_frames(self.__traceback__), f"{type(self).__name__}: {self}"]


class ModelError(Error, ValueError):
    """The scene is invalid."""


class SceneError(ModelError):
    """A file, field, name or value of a scene is invalid."""


class ExpressionError(ModelError):
    """An expression string is invalid."""


class ParameterError(ModelError):
    """A parameter's name or value is invalid."""


class UnitError(ModelError):
    """A unit is unknown, or has the wrong dimension."""


class TopologyError(ModelError):
    """The linear graph is disconnected, or the named tree is not a tree."""


class FormulationError(Error, ValueError):
    """The governing equations cannot be formed."""


class SingularSystemError(FormulationError):
    """The mass matrix is singular: some motion has no inertia."""


class CodegenError(Error, RuntimeError):
    """The C source cannot be written."""


class BuildError(Error, RuntimeError):
    """The C source cannot be compiled or loaded.

    Attributes
    ----------
    command : str
        The compiler's command line, empty if no compiler was started.
    output : str
        The compiler's output.
    source : str
        Path of the kept C file, empty if none was written.
    """

    def __init__(self, message: str, command: str = "", output: str = "", source: str = "") -> None:
        super().__init__(message)
        self.command, self.output, self.source = command, output, source


class SolveError(Error, RuntimeError):
    """The integration failed, or cannot start."""


class StoreError(Error, RuntimeError):
    """The store of an ensemble cannot be read or written, or contains something else."""


class UnsolvedError(Exception):
    """The algebraic unknowns cannot be continued to a point; a shorter step may help."""


#: Maximum number of names in a message, and of names that are compared with a misspelt one.
_MOST_LISTED, _MOST_COMPARED = 200, 1000
_MOST_IN_SENTENCE = 8


def nearest(name: object, known: Iterable[str]) -> str:
    """Return the end of a message: the known name that was probably meant, or all known names."""
    choices = sorted(known)
    # Files may contain many long names, and each comparison takes time.
    close = _closest(str(name)[:80], choices[:_MOST_COMPARED])
    if close:
        return f"; did you mean '{brief(close)}'?"
    # Files of other tools may contain thousands of names.
    if len(choices) > _MOST_LISTED:
        return ""
    return f"; known: {', '.join(map(brief, choices)) if choices else 'none'}"


def _closest(name: str, choices: Sequence[str]) -> str:
    folded: dict[str, str] = {}
    for choice in choices:
        folded.setdefault(choice.lower(), choice)
    # A wrong case is the most likely mistake. In names of one letter, only case is compared.
    if name.lower() in folded:
        return folded[name.lower()]
    close = difflib.get_close_matches(name, choices, n=1)
    if not close:
        close = [folded[n] for n in difflib.get_close_matches(name.lower(), folded, n=1)]
    return close[0] if close else ""


def check_known(
    given: Iterable[object],
    known: Iterable[str],
    what: str,
    after: str = "",
    error: type[Error] = SceneError,
) -> None:
    """Raise an error for the first unknown name, with a suggestion: "WHAT 'NAME'AFTER"."""
    names = frozenset(known)
    for name in given:
        if name not in names:
            raise error(f"{what} '{brief(name)}'{after}{nearest(name, names)}")


def optional_package(name: str, what: str, extra: str, error: type[Error] = Error) -> Any:
    """Import a package; if it is missing, raise an error with the command that installs it."""
    try:
        return import_module(name)
    except ImportError:
        raise error(f"{what} {name}: run `pip install 'cotree[{extra}]'`") from None


def brief(text: object, longest: int = 60) -> str:
    """Shorten a text to one line of printable characters for a message."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))
    return line if len(line) <= longest else f"{line[: longest - 3]}..."


def listed(names: Iterable[str]) -> str:
    """Join names by commas for a message; a long list is cut after the first names."""
    names = list(names)
    hidden = len(names) - _MOST_IN_SENTENCE
    return ", ".join(names[:_MOST_IN_SENTENCE]) + (f" and {hidden} more" if hidden > 0 else "")


def _own_frames(trace: TracebackType | None) -> list[str]:
    """Return the frames of a traceback that belong to neither cotree nor notebook software."""
    package = str(Path(__file__).parent)
    # Imported here, since commands start faster without it.
    import traceback

    lines = []
    for frame in traceback.extract_tb(trace):
        parts = Path(frame.filename).parts
        if frame.filename.startswith(package) or "IPython" in parts or "ipykernel" in parts:
            continue
        # The file name of a notebook cell is not informative.
        where = "cell" if any("ipykernel" in part for part in parts) else frame.filename
        lines += [f"{where}, line {frame.lineno}, in {frame.name}", f"    {frame.line}"]
    return lines
