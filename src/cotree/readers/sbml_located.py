"""Messages about SBML models: they begin with file and line, and name the element."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, ModelError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.readers.sbml_content import Formula
    from cotree.readers.source_line import SourceLine


@contextmanager
def explained(formula: Formula) -> Iterator[None]:
    """Begin error messages about a formula with its description."""
    try:
        yield
    except ExpressionError as error:
        raise formula.at.error(f"the {formula.what} {error}") from None


@contextmanager
def located(at: SourceLine) -> Iterator[None]:
    """Begin error messages of the scene with file and line."""
    try:
        yield
    except ModelError as error:
        if str(error).startswith(f"{at.file}:"):
            raise
        raise at.error(str(error)) from None
