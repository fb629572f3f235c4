"""Names that look like others, as slips of the keyboard do."""

from __future__ import annotations

import difflib
import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

_DIGITS = re.compile(r"\d+")
_MOST_COMPARED = 1000
_LIKE = 0.8  # share of letters in common


def look_alike(name: str, others: Iterable[str]) -> str:
    """Give the name that another may be a slip of; nothing where none is close.

    Names that differ in numbers only, as ``m1`` and ``m2``, are meant to differ; names of one part
    are compared with those of the same part.
    """
    form, owner = _DIGITS.sub("#", name), name.rpartition(".")[0]
    alike = (other for other in others if other.rpartition(".")[0] == owner)
    choices = [o for o in sorted(alike)[:_MOST_COMPARED] if o != name]
    for other in choices:
        # A letter that is typed twice, or in the wrong case.
        if other.casefold() == name.casefold() or _without_doubles(other) == _without_doubles(name):
            return other
    choices = [other for other in choices if _DIGITS.sub("#", other) != form]
    close = difflib.get_close_matches(name, choices, n=1, cutoff=_LIKE)
    return close[0] if close else ""


def _without_doubles(name: str) -> str:
    return re.sub(r"([A-Za-z])\1+", r"\1", name)
