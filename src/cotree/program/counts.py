"""Operation counts: each + - * /, negation and function call counts as one."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.dag.nodes import Node


@dataclass(frozen=True)
class OperationCount:
    """Operations of a kernel.

    Attributes
    ----------
    by_kind : mapping of str to int
        Counts by operation: ``add``, ``sub``, ``mul``, ``div``, ``neg``, and functions by name.
    kernel, prepare : int
        Operations of the kernel alone, and of what it uses of ``prepare``.
    """

    by_kind: Mapping[str, int]
    kernel: int
    prepare: int = 0

    @property
    def total(self) -> int:
        """All operations, those of ``prepare`` that the kernel uses counted in."""
        return self.kernel + self.prepare

    def with_prepared(self, share: OperationCount) -> OperationCount:
        """Add the operations of ``prepare`` that a kernel uses."""
        return OperationCount(
            dict(Counter(self.by_kind) + Counter(share.by_kind)), self.kernel, share.kernel
        )


def count_operations(nodes: Iterable[Node]) -> OperationCount:
    """Count the operations among some nodes; reading a result of several is none.

    A linear system of n unknowns solved at run time counts (2/3) n^3 for each matrix and 2 n^2 for
    each right-hand side. A map counts for each of its columns, but for what vanishes there.
    """
    kinds: Counter[str] = Counter()
    factorised = set()
    for node in nodes:
        if node.op == "solve":
            n = node.data.size
            matrix = node.args[: n * n]
            # Nodes are interned, so solutions with the same matrix have the same tuple of entries.
            kinds["solve"] += 2 * n * n + (0 if matrix in factorised else (2 * n**3) // 3)
            factorised.add(matrix)
        elif node.op == "sines":
            # Its data is the number of angles.
            kinds["sin"] += node.data
            kinds["cos"] += node.data
        elif node.op == "map":
            kinds.update(node.data.counts)
        elif node.args and node.op != "result":
            kinds[node.op] += 1
    return OperationCount(dict(sorted(kinds.items())), kinds.total())
