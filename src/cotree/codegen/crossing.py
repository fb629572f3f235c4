"""Places for values that cross between groups of statements.

Blocks of a kernel and segments of a map keep their temporaries to themselves. What one group
computes and a later one reads stands in an array besides, where a place serves again as soon as
its value is read no more.
"""

from __future__ import annotations

from heapq import heappop, heappush
from typing import TYPE_CHECKING

from cotree.codegen.expressions import element, read_from
from cotree.codegen.statements import (
    REAL,
    WHOLE,
    Assign,
    changed,
    declared_by,
    kind_of,
    uses,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.codegen.expressions import CExpression, Temporary
    from cotree.codegen.statements import Statement

#: Arrays that hold what crosses, by its kind.
FRAMES = {REAL: "w", WHOLE: "ranks"}


class Crossing:
    """Allots places, and writes each group of statements with them.

    Parameters
    ----------
    groups : sequence of sequence of Statement
        In the order in which they are run.

    Attributes
    ----------
    places : dict of Temporary to CExpression
        Place of each temporary that crosses: an element of an array.
    lengths : dict of str to int
        Length of the array of each kind.
    """

    def __init__(self, groups: Sequence[Sequence[Statement]]) -> None:
        self.places: dict[Temporary, CExpression] = {}
        self.lengths = dict.fromkeys(FRAMES, 0)
        self._groups = groups
        self._reads: list[set[str | Temporary]] = []  # of each group, but what a row declares
        last: dict[str | Temporary, int] = {}
        for i, group in enumerate(groups):
            reads: set[str | Temporary] = set()
            for row in group:
                used = uses(row)
                last.update(dict.fromkeys(used, i))
                reads |= used - {declared_by(row)}
            self._reads.append(reads)
        free: dict[str, list[int]] = {kind: [] for kind in FRAMES}
        leaving: dict[int, list[tuple[str, int]]] = {}
        for i, group in enumerate(groups):
            for row in group:
                made = declared_by(row)
                # A temporary that only its own group reads needs no place.
                if made is None or last[made] == i:
                    continue
                if isinstance(row, Assign) and len(row.to) > 1:  # it is kept anyway
                    self.places[made] = row.to[1]
                    continue
                kind = kind_of(made)
                if not free[kind]:
                    free[kind].append(self.lengths[kind])
                    self.lengths[kind] += 1
                # The lowest free place keeps the array short.
                slot = heappop(free[kind])
                self.places[made] = element(FRAMES[kind], slot)
                leaving.setdefault(last[made], []).append((kind, slot))
            # A place is free behind the whole group, not behind the last reading statement: the
            # group reads what crosses in from its array at any point.
            for kind, slot in leaving.pop(i, ()):
                heappush(free[kind], slot)

    def written(self, number: int) -> list[Statement]:
        """Write a group: it stores values that others read, and reads theirs from their places."""
        rows, reads = self._groups[number], self._reads[number]
        makes = set(map(declared_by, rows))
        places = {key: self.places[key] for key in reads - makes if key in self.places}

        def placed(expression: CExpression) -> CExpression:
            return read_from(expression, places)

        found: list[Statement] = []
        for row in rows:
            if isinstance(row, Assign) and (made := row.declares) in self.places:
                # The temporary itself is declared only where statements of the same group read it.
                own = row.to[:1] if made in reads else ()
                found.append(Assign((*own, self.places[made]), placed(row.value)))
            else:
                found.append(changed(row, placed) if places else row)
        return found
