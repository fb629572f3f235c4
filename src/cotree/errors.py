"""The exception tree: every error a user can cause, with the builtin a caller would expect.

::

    Error
    ├── ModelError (ValueError)            the scene is wrong
    │   ├── SceneError                     a file, field, name or value of a scene
    │   ├── ExpressionError                an expression string
    │   ├── ParameterError                 a parameter's name or value
    │   └── TopologyError                  the linear graph or its tree
    ├── FormulationError (ValueError)      the equations cannot be formed
    │   └── SingularSystemError            the mass matrix is singular
    ├── CodegenError (RuntimeError)        the C text cannot be written
    ├── BuildError (RuntimeError)          the C text cannot be compiled or loaded
    └── SolveError (RuntimeError)          the integration failed or cannot start

Messages name the edge, node, parameter or file line at fault and say what to do about it.
"""

from __future__ import annotations

import difflib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable


class Error(Exception):
    """Base of every error that cotree raises on purpose."""


class ModelError(Error, ValueError):
    """The scene is wrong."""


class SceneError(ModelError):
    """A file, field, name or value of a scene is wrong."""


class ExpressionError(ModelError):
    """An expression string cannot be accepted."""


class ParameterError(ModelError):
    """A parameter's name or value is wrong."""


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
        What the compiler said.
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


def nearest(name: str, known: Iterable[str]) -> str:
    """Say which known name was probably meant, for the end of a message."""
    choices = sorted(known)
    close = difflib.get_close_matches(name, choices, n=1)
    if close:
        return f"; did you mean '{close[0]}'?"
    return f"; known: {', '.join(choices) if choices else 'none'}"
