"""The exception tree: every error a user can cause, with the builtin a caller would expect.

::

    Error
    ├── ModelError (ValueError)            the scene is wrong
    │   ├── SceneError                     a file, field, name or value of a scene
    │   ├── ExpressionError                an expression string
    │   ├── ParameterError                 a parameter's name or value
    │   ├── UnitError                      a unit that is none, or does not fit
    │   └── TopologyError                  the linear graph or its tree
    ├── FormulationError (ValueError)      the equations cannot be formed
    │   └── SingularSystemError            the mass matrix is singular
    ├── CodegenError (RuntimeError)        the C text cannot be written
    ├── BuildError (RuntimeError)          the C text cannot be compiled or loaded
    ├── SolveError (RuntimeError)          the integration failed or cannot start
    └── StoreError (RuntimeError)          the store of an ensemble cannot be used

Messages name the edge, node, parameter or file line at fault and say what to do about it; the
functions below shorten what they quote.
"""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from types import TracebackType


class Error(Exception):
    """Base of every error that cotree raises on purpose."""

    def _render_traceback_(self) -> list[str]:
        """Show a notebook the statements of its user and the sentence, without frames of cotree.

        ``%debug`` still has all frames.
        """
        return [*_own_frames(self.__traceback__), f"{type(self).__name__}: {self}"]


class ModelError(Error, ValueError):
    """The scene is wrong."""


class SceneError(ModelError):
    """A file, field, name or value of a scene is wrong."""


class ExpressionError(ModelError):
    """An expression string cannot be accepted."""


class ParameterError(ModelError):
    """A parameter's name or value is wrong."""


class UnitError(ModelError):
    """A unit is unknown, or does not fit where it stands."""


class TopologyError(ModelError):
    """The linear graph is disconnected, or the named tree is not a tree."""


class FormulationError(Error, ValueError):
    """The governing equations cannot be formed."""


class SingularSystemError(FormulationError):
    """The mass matrix is singular: something moves without inertia."""


class CodegenError(Error, RuntimeError):
    """The C text cannot be written."""


class BuildError(Error, RuntimeError):
    """The C text cannot be compiled or loaded.

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
        self.command = command
        self.output = output
        self.source = source


class SolveError(Error, RuntimeError):
    """The integration failed, or cannot start."""


class StoreError(Error, RuntimeError):
    """The store of an ensemble cannot be read or written, or holds something else."""


class UnsolvedError(Exception):
    """The algebraic unknowns cannot be followed to a point; a shorter step may help."""


#: Names that a message lists, and names among which a similar one is looked for.
_MOST_LISTED, _MOST_COMPARED = 200, 1000
_MOST_IN_SENTENCE = 8


def nearest(name: object, known: Iterable[str]) -> str:
    """Return a hint at the known name that was probably meant, for the end of a message."""
    choices = sorted(known)
    # Names come from files: they may be many and long, and every pair takes time to compare.
    close = _closest(str(name)[:80], choices[:_MOST_COMPARED])
    if close:
        return f"; did you mean '{brief(close)}'?"
    # A file of another tool may name thousands of things.
    if len(choices) > _MOST_LISTED:
        return ""
    return f"; known: {', '.join(map(brief, choices)) if choices else 'none'}"


def _closest(name: str, choices: Sequence[str]) -> str:
    """Find the choice that is most alike: but for the case of its letters, or else with it."""
    folded: dict[str, str] = {}
    for choice in choices:
        folded.setdefault(choice.lower(), choice)
    # Another case alone is the likeliest slip, and the only one that a single letter shows.
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
    """Raise an error for the first name that is not known, and suggest one that is.

    The message has ``what`` before the name, as in ``"edge 'k' has no field"``, and ``after``
    behind it.
    """
    names = frozenset(known)
    for name in given:
        if name not in names:
            raise error(f"{what} '{brief(name)}'{after}{nearest(name, names)}")


def brief(text: object, longest: int = 60) -> str:
    """Put a text on one line of printable characters, cut short, for a message."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))
    return line if len(line) <= longest else f"{line[: longest - 3]}..."


def listed(names: Iterable[str]) -> str:
    """List names in a sentence; of a long list the first ones, enough to find the mistake."""
    names = list(names)
    hidden = len(names) - _MOST_IN_SENTENCE
    return ", ".join(names[:_MOST_IN_SENTENCE]) + (f" and {hidden} more" if hidden > 0 else "")


def _own_frames(trace: TracebackType | None) -> list[str]:
    """List the frames of a traceback outside this package and the notebook's machinery.

    A line for each frame, with the statement under it.
    """
    package = str(Path(__file__).parent)
    # Only where a notebook shows an error: commands start faster without.
    import traceback

    lines = []
    for frame in traceback.extract_tb(trace):
        parts = Path(frame.filename).parts
        if frame.filename.startswith(package) or "IPython" in parts or "ipykernel" in parts:
            continue
        # A cell has a file name that tells nobody anything.
        where = "cell" if any("ipykernel" in part for part in parts) else frame.filename
        lines += [f"{where}, line {frame.lineno}, in {frame.name}", f"    {frame.line}"]
    return lines
