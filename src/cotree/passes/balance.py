"""Pass: balance. Long sums on the longest path become trees: what arrives first is added first.

Assumes that nothing is prepared yet. Guarantees as many operations at most, and the same values but
for the rounding of sums, whose terms are added in another order. Sums that end no earlier that way
stay, and so do all of a kernel that has other things to do while it waits. So do those of
residuals: currents through large conductances cancel in the order in which they were formed; in
another one, what rounding left of them has stopped rodas5 at tolerances of 1e-11.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

from cotree.dag.traverse import rebuilt
from cotree.passes.rewriting import for_each_kernel, rewrite
from cotree.passes.stage import varying_values
from cotree.program.cost_model import bounds, waits

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Program

#: Kernels that methods call at each step.
_BALANCED = frozenset({"rhs", "augmented_rhs", "sensitivity_rhs", "jacobian"})
_SUMS = frozenset({"add", "sub", "neg"})
#: If all operations together take longer than so many times the longest path, sums of products are
#: better left to fused operations, which chains have more of.
_MOST = 2.0
_PREPARED = -1.0  # arrival of what depends on parameters only


def balance_sums(program: Program) -> Program:
    """Balance the sums of each kernel, where there are no algebraic unknowns."""
    if any(program.layout.algebraic):
        return program
    return for_each_kernel(program, _balanced)


def _balanced(kernel: Kernel) -> Kernel:
    if kernel.spec.name not in _BALANCED:
        return kernel
    order = kernel.order
    varying = varying_values(order)
    started, longest = bounds(order, set(order) - varying)
    inner = _inner_sums(order, kernel.results, varying)
    # A kernel that is bound by starting operations gains nothing from a shorter path.
    if not inner or started > _MOST * longest:
        return kernel
    clock = _Clock(varying)

    def form(node: Node, new: Mapping[Node, Node]) -> Node:
        made = rebuilt(node, new)
        if node.op in _SUMS and node not in inner:
            # If both are there at the same time, the sum stays as it was formed.
            made = min(made, _sum(_terms(node, inner, new), clock), key=clock)
        clock(made)  # of each value in turn: those that it depends on are known
        return made

    return rewrite(kernel, set(order), form)


@dataclass
class _Clock:
    """Time at which each value is available."""

    varying: Collection[Node]
    times: dict[Node, float] = field(default_factory=dict)

    def __call__(self, node: Node) -> float:
        """Return the time at which a value is available."""
        time = self.times.get(node)
        if time is None:
            if not node.args:
                time = 0.0 if node in self.varying else _PREPARED
            else:
                latest = max(map(self, node.args))
                time = latest + waits(node) if latest > _PREPARED else _PREPARED
            self.times[node] = time
        return time


def _inner_sums(
    order: Sequence[Node], results: Sequence[Node], varying: Collection[Node]
) -> set[Node]:
    """Find the sums that are read by one other sum only.

    Sums of the kernel's own arguments stay: a difference of two that are close is exact.
    """
    uses = Counter(arg for node in order for arg in node.args)
    # A result is read from outside: merged into another sum it would be lost.
    uses.update(results)
    return {
        arg
        for node in order
        if node.op in _SUMS
        for arg in node.args
        if arg.op in _SUMS and uses[arg] == 1 and arg in varying and any(a.args for a in arg.args)
    }


def _terms(
    node: Node, inner: Collection[Node], new: Mapping[Node, Node]
) -> list[tuple[Node, bool]]:
    """List the terms of a sum in their order, and whether each is added."""
    terms: list[tuple[Node, bool]] = []
    left = [(node, True)]
    while left:
        part, is_added = left.pop()
        if part is not node and part not in inner:
            terms.append((new.get(part, part), is_added))
        elif part.op == "neg":
            left.append((part.args[0], not is_added))
        else:
            a, b = part.args
            # The left term is taken off the stack first, so that terms keep their order.
            left += [(b, is_added == (part.op == "add")), (a, is_added)]
    return terms


def _sum(terms: Sequence[tuple[Node, bool]], clock: _Clock) -> Node:
    """Add terms, at each step the two available first; ties go to those that stand first."""
    # By the time at which each is there; the place among the terms decides ties, so that nodes are
    # never compared.
    heap = [(clock(term), i, term, is_added) for i, (term, is_added) in enumerate(terms)]
    heapify(heap)
    while len(heap) > 1:
        # The operands keep the order of their terms, whichever was available first.
        (_, i, a, is_added), (_, j, b, other) = sorted((heappop(heap), heappop(heap)), key=_place)
        if is_added == other:
            total = a + b
        elif is_added:
            total = a - b
        else:
            # -a + b = b - a, which saves a negation.
            total, is_added = b - a, True
        heappush(heap, (clock(total), min(i, j), total, is_added))
    _, _, total, is_added = heap[0]
    return total if is_added else -total


def _place(item: tuple[float, int, Node, bool]) -> int:
    return item[1]
