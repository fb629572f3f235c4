"""Names and line numbers in files of other tools."""

from __future__ import annotations

import keyword
import re
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.errors import ModelError, SceneError, brief, listed
from cotree.naming import RESERVED
from cotree.scene.expressions import FUNCTIONS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

_STRANGE = re.compile(r"[^A-Za-z0-9_]")
_LONGEST = 48  # maximum length of a name, which leaves space for suffixes within 64 characters


@dataclass
class Namer:
    """Generator of unique names in the scene for elements of a file."""

    #: Names in the scene that differ from those in the file, by kind and original name.
    changed: dict[tuple[str, str], str] = field(default_factory=dict)
    _taken: set[str] = field(default_factory=lambda: {"ground", *RESERVED, *FUNCTIONS})
    _alike: dict[str, int] = field(default_factory=dict)

    def give(self, kind: str, name: str) -> str:
        """Return an unused name in the scene for a name in the file, and record a change."""
        given = self.own(name)
        if given != name:
            self.changed[kind, name] = given
        return given

    def own(self, name: str) -> str:
        """Return an unused name in the scene that is equal or similar to ``name``."""
        safe = _STRANGE.sub("_", name)[:_LONGEST] or "unnamed"
        # Names in expressions must be Python identifiers.
        if safe[0].isdigit():
            safe = f"_{safe}"
        if keyword.iskeyword(safe):
            safe = f"{safe}_"
        found = safe
        while found in self._taken:
            # The count is stored, because a file may contain 100,000 equal names.
            self._alike[safe] = self._alike.get(safe, 1) + 1
            found = f"{safe}_{self._alike[safe]}"
        self._taken.add(found)
        return found


def scene_name(wish: str, kind: str) -> str:
    """Return a scene name that is equal or similar to ``wish`` and begins with a letter."""
    stem = Namer().own(wish).lstrip("_") or kind
    return stem if stem[0].isalpha() else f"{kind}_{stem}"


def renaming_notes(changed: Mapping[tuple[str, str], str]) -> list[str]:
    """Return a note on changed names, if any; see :attr:`Namer.changed`."""
    pairs = [f"{kind} '{brief(old)}' is '{new}'" for (kind, old), new in changed.items()]
    return [f"renamed: {listed(pairs)}"] if pairs else []


#: Maximum size of an untrusted file, [byte].
LARGEST_FILE = 20_000_000


@dataclass(frozen=True)
class SourceLine:
    """A line of a file, which is printed as ``file:line``."""

    file: str  # name of the file
    line: int  # line number, counted from 1

    def __str__(self) -> str:
        return f"{self.file}:{self.line}"

    def error(self, message: str) -> SceneError:
        """Return an error whose message begins with file and line."""
        return SceneError(f"{self}: {message}")


@contextmanager
def located(at: SourceLine) -> Iterator[None]:
    """Prepend file and line to the messages of errors, unless a message contains the file."""
    try:
        yield
    except ModelError as error:
        if str(error).startswith(f"{at.file}:"):
            raise
        raise at.error(" ".join(str(error).split())) from None
