"""Reasons of failed members, counted by sentences that differ in their numbers alone."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from cotree.ensemble.results import NOT_RUN

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

_NUMBER = re.compile(r"[-+.\d]+(e[-+]?\d+)?")


class Reasons:
    """Sentences of members that failed; it is mutable, and bounded by how many differ in words.

    Attributes
    ----------
    failed : int
        How many members failed.
    first : (int, str) or None
        The first of them by its number, and its sentence.
    """

    def __init__(self) -> None:
        self.failed = 0
        self.first: tuple[int, str] | None = None
        self._counts: Counter[str] = Counter()
        self._shown: dict[str, tuple[int, str]] = {}

    def add(self, first: int, status: npt.NDArray[np.int8], messages: Sequence[str]) -> None:
        """Take in some members, of which the first is given by its number."""
        for i in np.flatnonzero((status != 0) & (status != NOT_RUN)).tolist():
            row = first + i, str(messages[i])
            reason = _NUMBER.sub("#", row[1])
            self.failed += 1
            self._counts[reason] += 1
            self._shown[reason] = min(row, self._shown.get(reason, row))
            self.first = row if self.first is None else min(row, self.first)

    def told(self, n_members: int) -> str:
        """Say how many of all members failed, and why most of them did; empty if none failed."""
        if not self.failed:
            return ""
        # Of reasons that are as frequent, that of the first member.
        reason, count = min(self._counts.items(), key=lambda row: (-row[1], self._shown[row[0]]))
        often = f", {count} of them for this reason" if count < self.failed else ""
        return (
            f"{self.failed} of {n_members} members failed and are nan{often}: "
            + (self._shown[reason][1])
        )
