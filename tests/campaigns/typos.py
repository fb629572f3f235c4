"""Single slips of the hand in scene files: one changed word, name, number, unit, node or line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import random
    from collections.abc import Callable

_NEXT = {"a": "s", "e": "r", "i": "o", "o": "p", "n": "m", "t": "z", "s": "d", "r": "t", "m": "n"}
_CONVERTIBLE = {
    **{"m": "mm", "kg": "g", "s": "ms", "rad": "deg", "N": "kN", "N/m": "N/mm", "K": "degC"},
    **{"Ohm": "kOhm", "F": "uF", "H": "mH", "V": "mV", "A": "mA", "J/K": "kJ/K", "Pa": "bar"},
}
_NONSENSE = ("furlong", "kgm", "N//m", "mettre", "m^", "1/", "parsnip")


@dataclass(frozen=True)
class Typo:
    """A scene file with one slip.

    Attributes
    ----------
    text : str
        The file.
    kind : str
        What was done.
    line : int
        Number of the line, from 1.
    before, after : str
        That line, before and after; empty where there is none.
    section : str
        The header of the table that the line belongs to.
    """

    text: str
    kind: str
    line: int
    before: str
    after: str
    section: str

    @property
    def words(self) -> set[str]:
        """Return the words of the line and of its header, one of which is wrong."""
        return _words(f"{self.before}\n{self.after}\n{self.section}") - {"edges", "type"}

    @property
    def below(self) -> set[str]:
        """Return the words below a deleted header, whose values belong to the previous table."""
        if not self.before.startswith("[") or self.after == self.before:
            return set()
        return _words("\n".join(self.text.split("\n")[self.line - 1 : self.line + 2]))


def _words(text: str) -> set[str]:
    bare = re.sub(r"#.*", "", text)
    return set(re.findall(r"\w[\w-]*", bare)) | set(re.findall(r"-?\d[\d.e+-]*", bare))


def _slip(word: str, rng: random.Random) -> str:
    """Mistype a word."""
    i = rng.randrange(len(word))
    ways = [word[:i] + word[i + 1 :], word[:i] + word[i] * 2 + word[i + 1 :]]
    if len(word) > 1:
        j = rng.randrange(len(word) - 1)
        ways.append(word[:j] + word[j + 1] + word[j] + word[j + 2 :])
    ways += [word.swapcase(), word.capitalize()]
    if word[i].lower() in _NEXT:
        ways.append(word[:i] + _NEXT[word[i].lower()] + word[i + 1 :])
    return rng.choice([way for way in ways if way not in ("", word)] or [word + "x"])


def _changed(pattern: str, made: Callable[[str, random.Random], str]) -> Callable[..., str | None]:
    """Change one match of a pattern in a line, its comment left out."""

    def change(line: str, rng: random.Random) -> str | None:
        # Slips in comments and descriptions mean nothing.
        code = re.split(r"#|doc = ", line)[0]
        rest = line[len(code) :]
        found = list(re.finditer(pattern, code))
        if not found:
            return None
        match = rng.choice(found)
        new = made(match[0], rng)
        return code[: match.start()] + new + code[match.end() :] + rest

    return change


def _number(text: str, rng: random.Random) -> str:
    return rng.choice(["0", f"-{text}", text.replace(".", ","), f"{text}e", "0.0", f"{text}0"])


def _unit(text: str, rng: random.Random) -> str:
    unit = text.split('"')[1]
    other = rng.choice([_CONVERTIBLE.get(unit, _slip(unit, rng)), rng.choice(_NONSENSE)])
    return text.replace(f'"{unit}"', f'"{other}"')


# A change of a line by kind; None where the line has nothing of that kind.
_CHANGES: dict[str, Callable[..., str | None]] = {
    "field or key": _changed(r"(?<![\w\"'.])[A-Za-z_]\w*(?=\s*=)", _slip),
    "header": _changed(r"(?<=\[)[A-Za-z_]\w*(?=[.\]])", _slip),
    "name in a header": _changed(r"(?<=\.)[A-Za-z_][\w-]*(?=\])", _slip),
    "type": _changed(r'(?<=type = ")\w+', _slip),
    "word in quotes": _changed(r'(?<=["\s(*/+-])[A-Za-z_]\w*(?=[\w\s*/+().-]*")', _slip),
    "node": _changed(
        r'(?<=")[A-Za-z]\w*(?=")(?=.*\])', lambda word, rng: rng.choice((_slip(word, rng), "zz"))
    ),
    "number": _changed(r"(?<![\w.\"])\d+\.?\d*(?:e-?\d+)?(?![\w.])", _number),
    "unit": _changed(r'unit = "[^"]+"', _unit),
    "sign of punctuation": _changed(
        r"[\[\]{}\",=]", lambda _, rng: rng.choice(("", ",", ";", "."))
    ),
}


def typo(text: str, rng: random.Random) -> Typo:
    """Build one slip in a scene file."""
    lines = text.split("\n")
    filled = [i for i, line in enumerate(lines) if line.partition("#")[0].strip()]
    while True:
        i = rng.choice(filled)
        kind = rng.choice(
            [*_CHANGES, *("field or key", "node", "number", "unit"), "deleted", "twice"]
        )
        section = next((row for row in lines[i::-1] if row.startswith("[")), "")
        if kind in ("deleted", "twice"):
            new = [] if kind == "deleted" else [lines[i], lines[i]]
        else:
            line = _CHANGES[kind](lines[i], rng)
            if line is None or line == lines[i]:
                continue
            new = [line]
        made = "\n".join([*lines[:i], *new, *lines[i + 1 :]])
        return Typo(made, kind, i + 1, lines[i], "\n".join(new), section)
