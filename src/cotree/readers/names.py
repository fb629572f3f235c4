"""Names and lines in files of other tools."""

from __future__ import annotations

import keyword
import re
from dataclasses import dataclass, field

from cotree.errors import SceneError
from cotree.naming import RESERVED
from cotree.scene.expressions import FUNCTIONS

_STRANGE = re.compile(r"[^A-Za-z0-9_]")
_LONGEST = 48  # leaves room for endings such as _damping within the 64 that a scene allows


@dataclass
class Namer:
    """Gives each element of a file a unique name."""

    #: Names that had to change: what the file calls it, by kind and name, to what the scene does.
    changed: dict[tuple[str, str], str] = field(default_factory=dict)
    _taken: set[str] = field(default_factory=lambda: {"ground", *RESERVED, *FUNCTIONS})
    _alike: dict[str, int] = field(default_factory=dict)

    def give(self, kind: str, name: str) -> str:
        """Translate a name of the file."""
        given = self.own(name)
        if given != name:
            self.changed[kind, name] = given
        return given

    def own(self, name: str) -> str:
        """Name an element that the scene adds, as close to the wish as is free."""
        safe = _STRANGE.sub("_", name)[:_LONGEST] or "unnamed"
        # Names are parsed as Python's in expressions: no digit first, no keyword.
        if safe[0].isdigit():
            safe = f"_{safe}"
        if keyword.iskeyword(safe):
            safe = f"{safe}_"
        found = safe
        while found in self._taken:
            # Counted on, as a file may call a hundred thousand things alike.
            self._alike[safe] = self._alike.get(safe, 1) + 1
            found = f"{safe}_{self._alike[safe]}"
        self._taken.add(found)
        return found


#: Bytes that a file may have: it may come from a stranger.
LARGEST_FILE = 20_000_000


@dataclass(frozen=True)
class SourceLine:
    """A line of a file; as text ``file:line``."""

    file: str  # name of the file
    line: int  # number of the line, from 1

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"

    def error(self, message: str) -> SceneError:
        """Make the error that something is wrong on this line."""
        return SceneError(f"{self}: {message}")
