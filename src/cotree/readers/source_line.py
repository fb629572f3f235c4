"""Lines in files of other tools, by which messages begin."""

from __future__ import annotations

from dataclasses import dataclass

from cotree.errors import SceneError

#: Bytes that a file may have: it may come from a stranger.
LARGEST_FILE = 20_000_000


@dataclass(frozen=True)
class SourceLine:
    """A line of a file; as text ``file:line``.

    Attributes
    ----------
    file : str
        Name of the file.
    line : int
        Number of the line, from 1.
    """

    file: str
    line: int

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"

    def error(self, message: str) -> SceneError:
        """Make the error that something is wrong on this line."""
        return SceneError(f"{self}: {message}")
