"""Passes: functions from one program to another with the same values, with reports of the savings.

They run in the order of :data:`RECIPE`. Their assumptions and guarantees are:

reciprocals
    Assumes nothing. The same values to rounding. A reciprocal is formed if a kernel divides by the
    same value more than once, or by a value of parameters only, whose reciprocal ``prepare`` then
    forms once for all calls. Other divisions stay.
sines
    Assumes nothing. The same values to a rounding of the last place. Sines and cosines of angles
    that depend on no sine themselves are combined; those of parameters only stay, since ``prepare``
    has them.
balance
    Assumes that nothing is prepared yet. At most as many operations, and the same values except for
    the rounding of sums, whose terms are added in another order. Sums that do not end earlier stay,
    and so do all sums of a kernel that has other operations to overlap. So do those of residuals:
    currents through large conductances cancel in the order in which they were formed; in another
    order, the remaining rounding has stopped rodas5 at tolerances of 1e-11.
stage
    Assumes that nothing is prepared yet. No kernel except ``prepare`` computes values of
    parameters only: it reads prepared values. The branches that steps freeze follow these, and are
    zero until a run sets them.
order
    Assumes nothing. The same operations with the same values. A kernel whose time is that of one
    long path of operations is written in the order in which the path needs values, so that other
    operations overlap with it. If that keeps more values alive, which then pass through memory,
    values stay in the order in which they were formed.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field, replace
from functools import partial
from heapq import heapify, heappop, heappush
from typing import TYPE_CHECKING

from cotree.dag.multi_output import SEVERAL, sines
from cotree.dag.nodes import PARAMETER, PIECE, Node, dependent, reachable, rebuilt
from cotree.program.counts import bounds, waits

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Container, Mapping, Sequence

    from cotree.program.program import Kernel, Program


def stage_parameters(program: Program) -> Program:
    """Move values of parameters only to ``prepare``."""
    # Over all kernels together, so that a value used by several of them is prepared once.
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
    """Return values that depend on more than parameters, among values in order of evaluation."""
    return dependent(order, [n for n in order if n.op == "symbol" and n.data[0] != PARAMETER])


def _frontier(results: list[Node]) -> list[Node]:
    """Return the values of parameters only that varying values or results use."""
    order = reachable(results)
    varying = varying_values(order)
    read = {arg for node in order if node in varying for arg in node.args}
    read.update(results)
    return [
        # Kernels use the results of such a node, never the node itself.
        node
        for node in order
        if node in read and node not in varying and node.args and node.op not in SEVERAL
    ]


def for_each_kernel(change: Callable[[Kernel], Kernel], program: Program) -> Program:
    """Change every kernel of a program separately."""
    kernels = {name: change(kernel) for name, kernel in program.kernels.items()}
    return replace(program, kernels=kernels)


def rewrite(
    kernel: Kernel, chosen: Container[Node], form: Callable[[Node, Mapping[Node, Node]], Node]
) -> Kernel:
    """Replace ``chosen`` values of a kernel, and rebuild all that depend on them.

    ``form`` makes the new value from the old one and from the replacements so far. New values keep
    the labels of the values that they replace.
    """
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
        # Values that are unchanged are not replaced, so that their users are not rebuilt.
        if made is not node:
            new[node] = made
    return replace(kernel, results=tuple(new.get(node, node) for node in kernel.results))


def with_reciprocals(kernel: Kernel) -> Kernel:
    """Replace the repeated divisions of one kernel by products with a reciprocal."""
    order = kernel.order
    # Reciprocals themselves remain unchanged.
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
        # Nodes are interned, so that this reciprocal is formed once for all divisions.
        return above * (1.0 / below)

    return rewrite(kernel, shared, form)


#: Minimum number of angles; fewer cost less one by one.
_FEWEST = 3


def _packed(kernel: Kernel) -> Kernel:
    """Combine the sines and cosines of one kernel."""
    order = kernel.order
    found = [node for node in order if node.op in ("sin", "cos")]
    varying = varying_values(order)
    # An angle that depends on a sine of its own kernel cannot be combined with it.
    late = dependent(order, found) - set(found)
    angles = list(
        dict.fromkeys(n.args[0] for n in found if n.args[0] in varying and n.args[0] not in late)
    )
    if len(angles) < _FEWEST:
        return kernel
    dag = angles[0].dag
    # One node computes the sine and the cosine of an angle, even if only one of them is used.
    with dag.labelled("sines and cosines"):
        packed = sines(dag, angles)
    place = {angle: i for i, angle in enumerate(angles)}
    first = {"sin": 0, "cos": len(angles)}
    taken = {n: packed[first[n.op] + place[n.args[0]]] for n in found if n.args[0] in place}
    return rewrite(kernel, taken, lambda node, _: taken[node])


#: Kernels that methods call at each step.
_BALANCED = frozenset({"rhs", "augmented_rhs", "sensitivity_rhs", "jacobian"})
_SUMS = frozenset({"add", "sub", "neg"})
#: If the operations divided by this exceed the longest path, sums of products are not rebalanced:
#: chains of them contain more fused operations.
_MOST = 2.0
_PREPARED = -1.0  # time at which values of parameters only are ready: before all others


def balance_sums(program: Program) -> Program:
    """Balance the sums of each kernel, if there are no algebraic unknowns."""
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
    # A shorter path does not help a kernel whose time is bound by issuing operations.
    if not inner or started > _MOST * longest:
        return kernel
    clock = _Clock(varying)

    def form(node: Node, new: Mapping[Node, Node]) -> Node:
        made = rebuilt(node, new)
        if node.op in _SUMS and node not in inner:
            # If both are available at the same time, the sum remains as it was formed.
            made = min(made, _sum(_terms(node, inner, new), clock), key=clock)
        clock(made)  # nodes come in order of evaluation, so arguments have been timed
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
    """Find the sums that are used by one other sum only.

    Sums of the kernel's arguments are excluded: the difference of two close arguments is exact and
    must not be reordered.
    """
    uses = Counter(arg for node in order for arg in node.args)
    # A result is needed as such: it would be lost if it were merged into another sum.
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
    """Add terms, at each step the two available first; ties are broken by their order."""
    # Ordered by the time at which each term is available. The position breaks ties, so that nodes
    # are never compared.
    heap = [(clock(term), i, term, is_added) for i, (term, is_added) in enumerate(terms)]
    heapify(heap)
    while len(heap) > 1:
        # Operands keep the order of their terms, independently of availability.
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


#: Number of operations within the look-ahead of a processor.
_FEW = 250
#: Kernels with more operations keep their values in the order in which they were formed: repeated
#: links then become loops. A chain of 1000 rods needs half as much C text; a chain of 100 is twice
#: as fast if ordered by need.
_MANY = 20_000
#: If all operations take longer than this multiple of the longest path, there are operations to
#: overlap in any order.
_MOST_EARLY = 3.0


def _ordered(kernel: Kernel) -> Kernel:
    """Order the values of one kernel by need, if that is faster."""
    order, prepared = kernel.order, kernel.prepared
    # Kernels with maps keep their order: a map starts when the arguments of all its columns are
    # available.
    n = len(order) - len(prepared)
    if not _FEW <= n <= _MANY or any(node.op == "map" for node in order):
        return kernel
    started, longest = bounds(order, prepared)
    ordered = replace(kernel, is_by_need=True)
    if started >= _MOST_EARLY * longest or _lifetimes(ordered) > _lifetimes(kernel):
        return kernel
    return ordered


def _lifetimes(kernel: Kernel) -> int:
    """Return the sum of the lifetimes of all values in operations, which indicates register use."""
    formed = [node for node in kernel.order if node.args and node not in kernel.prepared]
    # Later entries overwrite earlier ones, so that the index of the last user remains.
    last = {arg: i for i, node in enumerate(formed) for arg in node.args}
    return sum(last.get(node, i) - i for i, node in enumerate(formed))


#: All passes by name, in order. Reciprocals and sums are formed before staging, which then prepares
#: the reciprocals of parameters and operates on the final sums. The order of values is determined
#: last.
RECIPE: dict[str, Callable[[Program], Program]] = {
    "reciprocals": partial(for_each_kernel, with_reciprocals),
    "sines": partial(for_each_kernel, _packed),
    "balance": balance_sums,
    "stage": stage_parameters,
    "order": partial(for_each_kernel, _ordered),
}


@dataclass(frozen=True)
class PassReport:
    """Effect of one pass on a program."""

    name: str  # name of the pass
    #: Program before the pass, and after it.
    earlier: Program
    later: Program

    @property
    def before(self) -> dict[str, int]:
        """Operations of each kernel without preparation, before the pass."""
        return _counts(self.earlier)

    @property
    def after(self) -> dict[str, int]:
        """Operations of each kernel without preparation, after the pass."""
        return _counts(self.later)

    def summary(self) -> str:
        """List the kernels that the pass changed."""
        head = f"pass {self.name}: operations of each kernel alone, before -> after"
        after = self.after
        rows = [f"  {k:20} {n} -> {after[k]}" for k, n in self.before.items() if n != after[k]]
        return "\n".join([head, *(rows or ["  none changed"])])


def run_passes(program: Program) -> tuple[Program, tuple[PassReport, ...]]:
    """Run every pass of the recipe."""
    reports = []
    for name, transform in RECIPE.items():
        # Programs are immutable, so the report can refer to both.
        earlier, program = program, transform(program)
        reports.append(PassReport(name, earlier, program))
    return program, tuple(reports)


def _counts(program: Program) -> dict[str, int]:
    return {name: kernel.operations.total for name, kernel in program.kernels.items()}
