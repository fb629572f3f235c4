"""Chunks of the dimensions of members, such that each holds members that follow each other.

Members lie in the order of their rows, and in a grid the last axis goes fastest. A chunk is one
place of the first axes, some places of one axis, and all of the others: its members are a range.
"""

from __future__ import annotations

import math
from itertools import product
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


def chunk_lengths(shape: Sequence[int], wanted: int) -> tuple[int, ...]:
    """Give the lengths of chunks of at most so many members, and at least one.

    Examples
    --------
    >>> chunk_lengths((4, 10, 3), 7)
    (1, 2, 3)
    """
    lengths, left = [1] * len(shape), max(1, wanted)
    for axis in reversed(range(len(shape))):
        n_chunks = math.ceil(shape[axis] / left)
        lengths[axis] = math.ceil(shape[axis] / n_chunks)
        if n_chunks > 1:
            break
        left = max(1, left // shape[axis])
    return tuple(lengths)


def chunk_places(shape: Sequence[int], lengths: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Give the places of all chunks, in the order of their members."""
    counts = [math.ceil(n / length) for n, length in zip(shape, lengths, strict=True)]
    return product(*map(range, counts))


def chunk_region(
    shape: Sequence[int], lengths: Sequence[int], place: Sequence[int]
) -> tuple[slice, ...]:
    """Give the part of the dimensions that a chunk holds."""
    rows = zip(place, lengths, shape, strict=True)
    return tuple(slice(i * length, min((i + 1) * length, n)) for i, length, n in rows)


def member_range(shape: Sequence[int], region: Sequence[slice]) -> tuple[int, int]:
    """Give the first member of a chunk, and the one behind its last."""
    first = 0
    for n, part in zip(shape, region, strict=True):
        first = first * n + part.start
    return first, first + math.prod(part.stop - part.start for part in region)
