"""Costs of a program: numbers of operations, and processor cycles estimated by a simple model.

A modern processor starts two independent operations per cycle, so the number of operations bounds
the time; so does the latency of the longest path. The model adds a fraction of the shorter of these
two times to the longer one. Its numbers are rounded values for common 64-bit processors.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from cotree.dag.nodes import Node


@dataclass(frozen=True)
class OperationCount:
    """Operation counts of a kernel.

    Attributes
    ----------
    by_kind : mapping of str to int
        Counts by operation: ``add``, ``sub``, ``mul``, ``div``, ``neg``, and names of functions.
    kernel, prepare : int
        Counts of the kernel alone, and of the operations in ``prepare`` that it needs.
    """

    by_kind: Mapping[str, int]
    kernel: int
    prepare: int = 0

    @property
    def total(self) -> int:
        """Number of all operations, including those in ``prepare`` that the kernel needs."""
        return self.kernel + self.prepare

    def with_prepared(self, share: OperationCount) -> OperationCount:
        """Return the counts with ``share``, the operations in ``prepare`` that the kernel needs."""
        return OperationCount(
            dict(Counter(self.by_kind) + Counter(share.by_kind)), self.kernel, share.kernel
        )


def count_operations(nodes: Iterable[Node]) -> OperationCount:
    """Count the operations of nodes; ``result`` nodes count zero.

    A linear system of n unknowns solved at run time counts (2/3) n^3 for each matrix and 2 n^2 for
    each right-hand side. The operations of a map count once for each column in which they are
    nonzero.
    """
    kinds: Counter[str] = Counter()
    factorised = set()
    for node in nodes:
        if node.op == "solve":
            n = node.data.size
            matrix = node.args[: n * n]
            # Equal matrices have equal tuples of entries, since nodes are interned.
            kinds["solve"] += 2 * n * n + (0 if matrix in factorised else (2 * n**3) // 3)
            factorised.add(matrix)
        elif node.op == "sines":
            # ``data`` is the number of angles.
            kinds["sin"] += node.data
            kinds["cos"] += node.data
        elif node.op == "map":
            kinds.update(node.data.counts)
        elif node.args and node.op != "result":
            kinds[node.op] += 1
    return OperationCount(dict(sorted(kinds.items())), kinds.total())


#: Cycles until the next operation can start, and until the result is available.
_COSTS = {
    "add": (0.5, 4.0),
    "sub": (0.5, 4.0),
    "mul": (0.5, 4.0),
    "neg": (0.5, 1.0),
    "div": (5.0, 13.0),
    "sqrt": (6.0, 18.0),
    "select": (1.0, 4.0),
    "sin": (8.0, 50.0),
    "cos": (8.0, 50.0),
}
_UNFILLED = 0.3  # fraction of the shorter time that the longer time does not hide
_FUNCTION = (25.0, 50.0)  # cost of a C library function


def cycles(nodes: Iterable[Node], known: Container[Node] = ()) -> float:
    """Return the estimated cycles of nodes in order of evaluation; ``known`` nodes cost none."""
    started, longest = bounds(nodes, known)
    return max(started, longest) + _UNFILLED * min(started, longest)


def bounds(nodes: Iterable[Node], known: Container[Node] = ()) -> tuple[float, float]:
    """Return the cycles to start all operations, and those of the longest path."""
    started = 0.0
    path: dict[Node, float] = {}
    for node in nodes:
        if node in known or not node.args:
            # Known values, constants and kernel arguments are available at time zero.
            continue
        start, wait = _cost(node)
        started += start
        path[node] = wait + max((path.get(arg, 0.0) for arg in node.args), default=0.0)
    return started, max(path.values(), default=0.0)


def waits(node: Node) -> float:
    """Return the latency of an operation, [cycles]."""
    return _cost(node)[1] if node.args else 0.0


def needs(order: Sequence[Node], known: Container[Node] = ()) -> dict[Node, float]:
    """Return for each value the longest path, [cycles], from this value (included) to a result."""
    need = dict.fromkeys(order, 0.0)
    # In reverse order of evaluation, all users of a value come before the value.
    for node in reversed(order):
        if node not in known:
            need[node] += waits(node)
            for arg in node.args:
                need[arg] = max(need[arg], need[node])
    return need


def by_need(order: Sequence[Node], known: Container[Node] = ()) -> list[Node]:
    """Sort values by the length of the longest path from each value to a result.

    A processor looks ahead by a few hundred operations. In this order, it finds independent
    operations to fill the latency of the longest path.
    """
    need = needs(order, known)
    # ``result`` nodes take no time: they directly follow the node that they read.
    return sorted(order, key=lambda node: (-need[node], node.index))


def _cost(node: Node) -> tuple[float, float]:
    if node.op == "result":
        return 0.0, 0.0
    if node.op == "sines":
        return 9.0 * node.data, 50.0
    # The factors take (2/3) n^3 operations, two per cycle; the rest is pivoting and substitution.
    if node.op == "solve":
        n = node.data.size
        return n**3 / 3.0 + 2.0 * n * n, 20.0 * n
    return _COSTS.get(node.op, _FUNCTION)
