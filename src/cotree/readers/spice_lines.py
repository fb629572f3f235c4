"""Lines of a netlist, with continuations joined and comments removed, by number and words."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Iterator

_LONGEST_LINE = 100_000  # characters, continued lines counted in
_COMMENT = re.compile(r";|(?:^|\s)\$(?:\s|$)")

#: An expression in braces or quotes, a sign of equality, or a word.
_WORD = re.compile(r"\{[^{}]*\}|'[^']*'|=|[^\s(),={}']+")
_BETWEEN = re.compile(r"[\s(),]*")


@dataclass(frozen=True)
class Line:
    """A statement of a netlist.

    Attributes
    ----------
    number : int
        Of its first line in the file.
    words : tuple of str
        Its words as they are written.
    """

    number: int
    words: tuple[str, ...]

    @property
    def key(self) -> str:
        """Its first word, in small letters."""
        return self.words[0].lower()


def shown(text: object) -> str:
    """Shorten a text of the file for a message, on one line."""
    line = "".join(c if c.isprintable() else "?" for c in " ".join(str(text).split()))
    return line if len(line) <= 60 else line[:57] + "..."


def read_lines(text: str, where: str) -> Iterator[Line]:
    """Give the statements of a netlist, from the second line up to ``.end``.

    Raises
    ------
    SceneError
        If a line cannot be split into words, or is too long.
    """
    number, whole = 0, ""
    is_skipped = False
    for at, raw in enumerate([*text.splitlines()[1:], ""], start=2):
        match = _COMMENT.search(raw)
        line = (raw[: match.start()] if match else raw).strip()
        if not line or line.startswith("*"):
            continue
        if line.startswith("+"):
            if not whole:
                raise SceneError(f"{where}:{at}: '+' continues a line, but there is none before it")
            whole += " " + line[1:]
            if len(whole) > _LONGEST_LINE:
                raise SceneError(f"{where}:{at}: longer than {_LONGEST_LINE} characters: split it")
            continue
        if whole:
            yield Line(number, _words(whole, f"{where}:{number}"))
        number, whole = at, ""
        first = line.split(None, 1)[0].lower()
        if first in (".control", ".endc"):  # what a simulator is to do, no part of the circuit
            is_skipped = first == ".control"
        elif first == ".end" and not is_skipped:
            return
        elif not is_skipped:
            whole = line
    if whole:
        yield Line(number, _words(whole, f"{where}:{number}"))


def _words(line: str, where: str) -> tuple[str, ...]:
    found, at = [], 0
    while True:
        at = _BETWEEN.match(line, at).end()  # type: ignore[union-attr]
        if at == len(line):
            break
        match = _WORD.match(line, at)
        if match is None:
            raise SceneError(
                f"{where}: {line[at]!r} opens or closes an expression on one side only"
            )
        found.append(match.group())
        at = match.end()
    if not found:
        raise SceneError(f"{where}: nothing but signs: '{shown(line)}'")
    return tuple(found)


def settings(words: tuple[str, ...], where: str) -> dict[str, str]:
    """Read ``name = value`` from a row of words; names in small letters.

    Raises
    ------
    SceneError
        If the words are no such row, or a name comes twice.
    """
    found: dict[str, str] = {}
    for i in range(0, len(words), 3):
        triple = words[i : i + 3]
        if len(triple) < 3 or triple[1] != "=" or "=" in (triple[0], triple[2]):
            raise SceneError(f"{where}: '{shown(words[i])}' should be followed by = and a value")
        name = triple[0].lower()
        if name in found:
            raise SceneError(f"{where}: '{shown(name)}' is given twice")
        found[name] = triple[2]
    return found


def split_settings(words: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split words into those before the first ``name = value``, and the rest."""
    at = words.index("=") - 1 if "=" in words else len(words)
    return words[: max(at, 0)], words[max(at, 0) :]
