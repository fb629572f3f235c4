"""Lines of a netlist, with continuations joined and comments removed, by number and words."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import brief
from cotree.readers.source_line import SourceLine

if TYPE_CHECKING:
    from collections.abc import Iterator

_LONGEST_LINE = 100_000  # characters, continued lines counted in
# A dollar begins a comment only between spaces: it may be part of a name.
_COMMENT = re.compile(r";|//|(?:^|\s)\$(?:\s|$)")

#: An expression in braces or quotes, a sign of equality, or a word.
_WORD = re.compile(r"\{[^{}]*\}|'[^']*'|=|[^\s(),={}']+")
_ASSIGNMENT = re.compile(r"(?<![\w.])([A-Za-z_][\w.]*)\s*=(?!=)\s*", re.ASCII)
_BETWEEN = re.compile(r"[\s(),]*")


@dataclass(frozen=True)
class Line:
    """A statement of a netlist.

    Attributes
    ----------
    at : SourceLine
        Its first line in the file.
    words : tuple of str
        Its words as they are written.
    text : str
        All of it, continuations joined.
    """

    at: SourceLine
    words: tuple[str, ...]
    text: str = ""

    @property
    def key(self) -> str:
        """Its first word, in small letters."""
        return self.words[0].lower()

    @property
    def name(self) -> str:
        """Its first word as it is written, in quotes, for messages."""
        return f"'{brief(self.words[0])}'"


def read_lines(text: str, file: str) -> Iterator[Line]:
    """Give the statements of a netlist, from the second line up to ``.end``.

    Raises
    ------
    SceneError
        If a line cannot be split into words, or is too long.
    """
    at, whole = SourceLine(file, 0), ""
    is_skipped = False
    # The first line is the title, whatever it looks like.
    for number, raw in enumerate([*text.splitlines()[1:], ""], start=2):
        here = SourceLine(file, number)
        match = _COMMENT.search(raw)
        line = (raw[: match.start()] if match else raw).strip()
        if not line or line.startswith("*"):
            continue
        if line.startswith("+"):
            if not whole:
                raise here.error("'+' continues a line, but there is none before it")
            whole += " " + line[1:]
            if len(whole) > _LONGEST_LINE:
                raise here.error(f"longer than {_LONGEST_LINE} characters: split it")
            continue
        if whole:
            yield Line(at, _words(whole, at), whole)
        at, whole = here, ""
        first = line.split(None, 1)[0].lower()
        if first in (".control", ".endc"):  # what a simulator is to do, no part of the circuit
            is_skipped = first == ".control"
        elif first == ".end" and not is_skipped:
            return
        elif not is_skipped:
            whole = line
    if whole:
        yield Line(at, _words(whole, at), whole)


def _words(line: str, at: SourceLine) -> tuple[str, ...]:
    found, i = [], 0
    while True:
        # Parentheses and commas separate words as spaces do.
        i = _BETWEEN.match(line, i).end()  # type: ignore[union-attr]
        if i == len(line):
            break
        match = _WORD.match(line, i)
        if match is None:
            raise at.error(f"{line[i]!r} opens or closes an expression on one side only")
        found.append(match.group())
        i = match.end()
    if not found:
        raise at.error(f"nothing but signs: '{brief(line)}'")
    return tuple(found)


def settings(words: tuple[str, ...], at: SourceLine) -> dict[str, str]:
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
            raise at.error(f"'{brief(words[i])}' should be followed by = and a value")
        name = triple[0].lower()
        if name in found:
            raise at.error(f"'{brief(name)}' is given twice")
        found[name] = triple[2]
    return found


def assignments(line: Line) -> dict[str, tuple[str, str]]:
    """Read ``name = value`` behind the first word, where values may hold spaces and parentheses.

    Returns
    -------
    dict of str to (str, str)
        Names and values as written, by name in small letters.

    Raises
    ------
    SceneError
        If the line holds anything else, or a name comes twice.
    """
    text = line.text.split(None, 1)[1] if len(line.words) > 1 else ""
    marks = list(_ASSIGNMENT.finditer(text))
    found: dict[str, tuple[str, str]] = {}
    if not marks or text[: marks[0].start()].strip(" \t,"):
        raise line.at.error(f"{line.name} should be followed by names, each with = and a value")
    for mark, following in zip(marks, [*(m.start() for m in marks[1:]), len(text)], strict=True):
        name, value = mark[1], text[mark.end() : following].strip(" \t,")
        if name.lower() in found:
            raise line.at.error(f"'{brief(name)}' is given twice")
        if not value:
            raise line.at.error(f"'{brief(name)}' should be followed by = and a value")
        found[name.lower()] = name, value
    return found


def split_settings(words: tuple[str, ...]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split words into those before the first ``name = value``, and the rest."""
    at = words.index("=") - 1 if "=" in words else len(words)
    return words[: max(at, 0)], words[max(at, 0) :]
