"""Passes: transformations of a program that preserve its values, with reports of the savings.

Passes run in the order of :data:`RECIPE`. Their assumptions and results are:

reciprocals
    Assumes nothing. Values are the same to rounding. If a kernel divides by the same value more
    than once, it multiplies by the reciprocal instead. The same holds for divisors that depend only
    on parameters; ``prepare`` computes their reciprocals. Other divisions remain.
sines
    Assumes nothing. Values are the same to one unit in the last place. Sines and cosines are
    combined unless their angles depend on other sines. Sines of parameters remain, since
    ``prepare`` computes them.
balance
    Assumes that nothing is prepared yet. The number of operations does not increase. Terms are
    added in another order, so values change by the rounding of sums. A sum remains if it would not
    be complete earlier, or if the kernel has other operations to overlap. Sums of models with
    algebraic unknowns also remain: currents through large conductances cancel in the order in which
    they were formed; in another order, rounding errors stopped rodas5 at tolerances of 1e-11.
stage
    Assumes that nothing is prepared yet. Values that depend only on parameters are computed by
    ``prepare``; other kernels read them from ``k``. The branches that steps freeze follow these
    values in ``k``; they are zero until a run sets them.
order
    Assumes nothing. Operations and values are the same. If one long path of operations determines
    the time of a kernel, values are in the order in which this path needs them, so that other
    operations overlap with it. The order is unchanged if it would keep more values in memory.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial
from heapq import heapify, heappop, heappush
from operator import itemgetter
from typing import TYPE_CHECKING

from cotree.dag.multi_output import SEVERAL, sines
from cotree.dag.nodes import PARAMETER, PIECE, Node, dependent, reachable, rebuilt
from cotree.program.counts import bounds, waits

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Container, Mapping, Sequence

    from cotree.program.program import Kernel, Program


def stage_parameters(program: Program) -> Program:
    """Move the computation of values that depend only on parameters to ``prepare``."""
    # All kernels at once, so that a value that several kernels use is prepared only once.
    results = [node for kernel in program.kernels.values() for node in kernel.results]
    dag, n_pieces = program.dag, program.layout.n_pieces
    frontier = _frontier(results)
    pieces = [dag.symbol(PIECE, i) for i in range(n_pieces)]
    prepared = {node: i for i, node in enumerate([*frontier, *pieces])}
    kernels = {name: replace(kernel, prepared=prepared) for name, kernel in program.kernels.items()}
    kernels["prepare"] = replace(
        kernels["prepare"], results=(*frontier, *[dag.zero] * n_pieces), prepared={}
    )
    return replace(program, kernels=kernels)


def varying_values(order: Sequence[Node]) -> set[Node]:
    """Return the nodes in ``order`` that depend on more than parameters."""
    return dependent(order, [n for n in order if n.op == "symbol" and n.data[0] != PARAMETER])


def _frontier(results: list[Node]) -> list[Node]:
    """Return values that depend only on parameters and are results or enter varying values."""
    order = reachable(results)
    varying = varying_values(order)
    read = {arg for node in order if node in varying for arg in node.args}
    read.update(results)
    return [
        # Kernels read the results of a node with several results, not the node itself.
        node
        for node in order
        if node in read and node not in varying and node.args and node.op not in SEVERAL
    ]


def for_each_kernel(change: Callable[[Kernel], Kernel], program: Program) -> Program:
    """Apply a function to every kernel of a program."""
    kernels = {name: change(kernel) for name, kernel in program.kernels.items()}
    return replace(program, kernels=kernels)


def rewrite(
    kernel: Kernel, chosen: Container[Node], form: Callable[[Node, Mapping[Node, Node]], Node]
) -> Kernel:
    """Replace ``chosen`` values by ``form(value, replacements)``; keep labels; rebuild users."""
    new: dict[Node, Node] = {}
    for node in kernel.order:
        if node in chosen:
            with node.dag.labelled(node.section):
                made = form(node, new)
        elif not new.keys().isdisjoint(node.args):
            with node.dag.labelled(node.section):
                made = rebuilt(node, new)
        else:
            continue
        # Unchanged values are not recorded, so that their users are not rebuilt.
        if made is not node:
            new[node] = made
    return replace(kernel, results=tuple(new.get(node, node) for node in kernel.results))


def with_reciprocals(kernel: Kernel) -> Kernel:
    """Replace repeated divisions in a kernel by products with a reciprocal."""
    order = kernel.order
    # 1 / x is itself a reciprocal and is not replaced.
    divisions = [n for n in order if n.op == "div" and n.args[0] is not n.dag.one]
    if not divisions:
        return kernel
    varying = varying_values(order)
    times = Counter(node.args[1] for node in divisions)
    shared = {
        node
        for node in divisions
        if times[node.args[1]] > 1 or (node.args[1] not in varying and node in varying)
    }

    def form(node: Node, new: Mapping[Node, Node]) -> Node:
        above, below = (new.get(arg, arg) for arg in node.args)
        # Nodes are interned, so all divisions by this value share one reciprocal.
        return above * (1.0 / below)

    return rewrite(kernel, shared, form)


#: Minimum number of angles whose sines are combined; for fewer angles, single calls cost less.
_FEWEST = 3


def _packed(kernel: Kernel) -> Kernel:
    order = kernel.order
    found = [node for node in order if node.op in ("sin", "cos")]
    varying = varying_values(order)
    # Leave out angles that depend on a sine in the same kernel.
    late = dependent(order, found) - set(found)
    angles = list(
        dict.fromkeys(n.args[0] for n in found if n.args[0] in varying and n.args[0] not in late)
    )
    if len(angles) < _FEWEST:
        return kernel
    dag = angles[0].dag
    # The node computes both sine and cosine of each angle, even if only one of them is used.
    with dag.labelled("sines and cosines"):
        packed = sines(dag, angles)
    place = {angle: i for i, angle in enumerate(angles)}
    first = {"sin": 0, "cos": len(angles)}
    taken = {n: packed[first[n.op] + place[n.args[0]]] for n in found if n.args[0] in place}
    return rewrite(kernel, taken, lambda node, _: taken[node])


#: Kernels that methods call at each step.
_BALANCED = frozenset({"rhs", "augmented_rhs", "sensitivity_rhs", "jacobian"})
_SUMS = frozenset({"add", "sub", "neg"})
#: Sums are balanced only up to this (time of all operations) / (longest path). Beyond it,
#: unbalanced chains are better, because they fuse more operations.
_MOST = 2.0
_PREPARED = -1.0  # time at which values of parameters are available, before all others


def balance_sums(program: Program) -> Program:
    """Balance the sums in each kernel unless there are algebraic unknowns."""
    if any(program.layout.algebraic):
        return program
    return for_each_kernel(_balanced, program)


def _balanced(kernel: Kernel) -> Kernel:
    if kernel.spec.name not in _BALANCED:
        return kernel
    order = kernel.order
    varying = varying_values(order)
    started, longest = bounds(order, set(order) - varying)
    inner = _inner_sums(order, kernel.results, varying)
    # A shorter path is no gain if the number of operations determines the time of the kernel.
    if not inner or started > _MOST * longest:
        return kernel
    clock = _Clock(varying)

    def form(node: Node, new: Mapping[Node, Node]) -> Node:
        made = rebuilt(node, new)
        if node.op in _SUMS and node not in inner:
            # If both forms are available at the same time, the original sum is kept.
            made = min(made, _sum(_terms(node, inner, new), clock), key=clock)
        clock(made)  # store the time of this value before that of its users
        return made

    return rewrite(kernel, set(order), form)


@dataclass
class _Clock:
    """Time at which each value is available, [cycles]."""

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
    """Return the sums whose only user is another sum, into which they can be merged.

    Sums of two kernel arguments are excluded, since the difference of close arguments is exact.
    """
    uses = Counter(arg for node in order for arg in node.args)
    # A result counts as a use, since it would be lost if it were merged into another sum.
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
    """Return the terms of a sum in order, each with true if it is added, false if subtracted."""
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
            # The left term is pushed last and popped first, so that terms keep their order.
            left += [(b, is_added == (part.op == "add")), (a, is_added)]
    return terms


def _sum(terms: Sequence[tuple[Node, bool]], clock: _Clock) -> Node:
    """Return the sum of the terms: each step adds the two terms that are available first."""
    # Sorted by time, then by position, so that nodes are never compared.
    heap = [(clock(term), i, term, is_added) for i, (term, is_added) in enumerate(terms)]
    heapify(heap)
    while len(heap) > 1:
        # Of the two operands, the one whose terms come first remains first.
        operands = sorted((heappop(heap), heappop(heap)), key=itemgetter(1))
        (_, i, a, is_added), (_, j, b, other) = operands
        if is_added == other:
            total = a + b
        elif is_added:
            total = a - b
        else:
            # Form -a + b as b - a, which saves a negation.
            total, is_added = b - a, True
        heappush(heap, (clock(total), min(i, j), total, is_added))
    _, _, total, is_added = heap[0]
    return total if is_added else -total


#: Kernels with fewer operations, the look-ahead of a processor, are not reordered.
_FEW = 250
#: Kernels with more operations are not reordered: loops over repeated links require the original
#: order. They halve the text of a chain of 1000 rods. Reordering makes 100 rods twice as fast.
_MANY = 20_000
#: Ratio of (time to start all operations) to (longest path) above which any order overlaps well.
_MOST_EARLY = 3.0


def _ordered(kernel: Kernel) -> Kernel:
    """Order the values of a kernel by the needs of the longest path, if this is faster."""
    order, prepared = kernel.order, kernel.prepared
    # Kernels with maps keep their order, because a map needs the arguments of all columns.
    n = len(order) - len(prepared)
    if not _FEW <= n <= _MANY or any(node.op == "map" for node in order):
        return kernel
    started, longest = bounds(order, prepared)
    ordered = replace(kernel, is_by_need=True)
    if started >= _MOST_EARLY * longest or _lifetimes(ordered) > _lifetimes(kernel):
        return kernel
    return ordered


def _lifetimes(kernel: Kernel) -> int:
    """Return the sum of the lifetimes of all values, in operations; it indicates register use."""
    formed = [node for node in kernel.order if node.args and node not in kernel.prepared]
    # Later entries overwrite earlier ones: the index of the last user remains.
    last = {arg: i for i, node in enumerate(formed) for arg in node.args}
    return sum(last.get(node, i) - i for i, node in enumerate(formed))


#: All passes by name, in order. Reciprocals and sums come before staging, so that those that depend
#: only on parameters are prepared. The order of values is determined last.
RECIPE: dict[str, Callable[[Program], Program]] = {
    "reciprocals": partial(for_each_kernel, with_reciprocals),
    "sines": partial(for_each_kernel, _packed),
    "balance": balance_sums,
    "stage": stage_parameters,
    "order": partial(for_each_kernel, _ordered),
}


@dataclass(frozen=True)
class PassReport:
    """The effect of one pass on a program."""

    name: str  # name of the pass
    #: Program before and after the pass.
    earlier: Program
    later: Program

    @property
    def before(self) -> dict[str, int]:
        """Number of operations of each kernel without ``prepare``, before the pass."""
        return _counts(self.earlier)

    @property
    def after(self) -> dict[str, int]:
        """Number of operations of each kernel without ``prepare``, after the pass."""
        return _counts(self.later)

    def summary(self) -> str:
        """Return a table of the kernels that the pass changed."""
        head = f"pass {self.name}: operations of each kernel alone, before -> after"
        after = self.after
        rows = [f"  {k:20} {n} -> {after[k]}" for k, n in self.before.items() if n != after[k]]
        return "\n".join([head, *(rows or ["  none changed"])])


def run_passes(program: Program) -> tuple[Program, tuple[PassReport, ...]]:
    """Run all passes of :data:`RECIPE`; return the program and a report of each pass."""
    reports = []
    for name, transform in RECIPE.items():
        # Programs are immutable, so the report can keep both of them.
        earlier, program = program, transform(program)
        reports.append(PassReport(name, earlier, program))
    return program, tuple(reports)


def _counts(program: Program) -> dict[str, int]:
    return {name: kernel.operations.total for name, kernel in program.kernels.items()}
