"""Program of a scene: the results of its kernels as nodes of one graph."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, fields
from functools import cached_property
from itertools import chain
from typing import TYPE_CHECKING, Any

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import (
    ARGUMENT_OF,
    PIECE,
    TIME,
    kinds_in,
    pickled_graph,
    reachable,
    symbols_in,
    unpickled_graph,
)
from cotree.dag.restart_times import RestartTimes
from cotree.dag.switching_times import TimeEvent, longest_step
from cotree.errors import SolveError
from cotree.linear.elimination import Elimination, plan_elimination
from cotree.program.counts import OperationCount, by_need, count_operations
from cotree.program.text import Traits
from cotree.report import Table

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import Guard
    from cotree.program.kernels import KernelSpec
    from cotree.program.layout import Layout


@dataclass(frozen=True)
class Kernel:
    """One kernel of a program."""

    spec: KernelSpec  # name, arguments and kind of results
    results: tuple[Node, ...]  # values that the kernel writes
    #: Values that the kernel reads from ``k`` instead of computing them, with indices in ``k``.
    prepared: Mapping[Node, int]
    #: Whether statements are in the order that the longest path needs, not in the original order.
    is_by_need: bool = False

    @property
    def is_present(self) -> bool:
        """Whether C contains the kernel: it has results, or every model has it."""
        return bool(self.results) or self.spec.is_required

    @cached_property
    def order(self) -> list[Node]:
        """All values that the results need, including prepared values, in order of evaluation."""
        # Prepared values are not expanded, since ``prepare`` computes their arguments.
        order = reachable(self.results, stop=self.prepared)
        return by_need(order, self.prepared) if self.is_by_need else order

    @cached_property
    def operations(self) -> OperationCount:
        """Number of operations of the kernel, without those in ``prepare``."""
        return count_operations([node for node in self.order if node not in self.prepared])


@dataclass(frozen=True)
class Program:
    """The kernels of a scene, and properties that runs need."""

    dag: Dag  # graph that contains all nodes
    layout: Layout  # names and sparsity patterns
    kernels: Mapping[str, Kernel]  # kernels by name, in the order of the registry
    guards: tuple[Guard, ...]  # conditions that ``prepare`` checks
    #: Time events at which inputs jump or have kinks, by input name, with derivatives along each
    #: sensitivity. The empty name stands for all other parts of the rates.
    time_events: Mapping[str, tuple[TimeEvent, ...]] = field(default_factory=dict)
    #: Upper bounds of the step size by input name; they apply unless a run replaces the input. The
    #: empty name stands for all other parts of the rates.
    longest_steps: Mapping[str, tuple[Node, ...]] = field(default_factory=dict)

    def __reduce__(self) -> tuple[Any, ...]:
        own = tuple(getattr(self, row.name) for row in fields(self))
        return _program_of, (pickled_graph(own, self.dag),)

    def restart_times(
        self,
        p: Sequence[float],
        span: tuple[float, float],
        replaced: Container[str] = (),
        others: Sequence[float] = (),
        time_limit: float | None = None,
    ) -> RestartTimes:
        """Return the times within a span at which integration restarts, for parameters p.

        ``replaced`` names inputs that a run replaces. ``others`` contains further times, which
        depend on no parameter. Raise SolveError if a period is far too short for the span, or the
        search takes longer than ``time_limit``, [s].
        """
        if not self.time_events and not others:
            return RestartTimes.none()
        from cotree.dag.time_events import find_restart_times

        events = [
            event for name, own in self.time_events.items() if name not in replaced for event in own
        ]
        try:
            nodes = [
                node
                for event in events
                for node in (event.first, event.period, *chain.from_iterable(event.along))
            ]
            return find_restart_times(events, _parameters(nodes, p), *span, others, time_limit)
        except ValueError as error:
            raise SolveError(str(error)) from None

    def longest_step(self, p: Sequence[float], replaced: Container[str] = ()) -> float:
        """Return the upper bound of the step size, [s], or infinity if there is none."""
        if not self.longest_steps:
            return math.inf
        limits = [
            limit
            for name, own in self.longest_steps.items()
            if name not in replaced
            for limit in own
        ]
        return longest_step(limits, _parameters(limits, p))

    def values(self, kernel: str, known: Mapping[str, Sequence[float]]) -> list[float]:
        """Evaluate a kernel in Python; ``known`` maps kinds of arguments (``p``) to values."""
        roots = self.kernels[kernel].results
        given = {
            symbol: float(known[ARGUMENT_OF[symbol.data[0]]][symbol.data[1]])
            for symbol in symbols_in(roots)
            if symbol.data[0] != PIECE
        }
        found: list[float] = evaluate(roots, given)
        return found

    @cached_property
    def traits(self) -> Traits:
        """Properties of the program that determine how kernels are called."""
        layout, results = self.layout, {n: k.results for n, k in self.kernels.items()}
        # All other kernels are derivatives of these kernels.
        names = ("rhs", "initial", "inputs", "constraints", "start", "outputs", "events", "jumps")
        read = symbols_in([node for name in names for node in results[name]])
        reached = {layout.parameters[node.data[1]].name for node in read if node.data[0] == "p"}
        parameters = {row.name for row in layout.parameters}
        own = zip(layout.inputs, results["inputs"], strict=True)
        return Traits(
            n_results={n: len(k.results) for n, k in self.kernels.items() if k.is_present},
            unreached=tuple(
                n for n in layout.sensitivities if n in parameters and n not in reached
            ),
            is_rheonomic=TIME in kinds_in([*results["constraints"], *results["start"]]),
            constant_inputs=tuple(row.name for row, node in own if TIME not in kinds_in([node])),
            has_constant_start=not symbols_in(
                [*results["initial"], *results["initial_sensitivity"]]
            ),
            has_time_events=bool(self.time_events),
            has_longest_step=bool(self.longest_steps),
        )

    @property
    def n_prepared(self) -> int:
        """Number of prepared values."""
        return len(self.kernels["prepare"].results)

    @cached_property
    def elimination(self) -> Elimination | None:
        """Planned elimination for implicit methods; None if the pattern is singular."""
        layout = self.layout
        return plan_elimination(
            len(layout.states), layout.column_starts, layout.row_indices, layout.n_algebraic
        )

    @cached_property
    def operations(self) -> dict[str, OperationCount]:
        """Operation counts of each kernel, including those operations in ``prepare`` it needs."""
        counts = {}
        for name, kernel in self.kernels.items():
            used = [node for node in kernel.order if node in kernel.prepared]
            counts[name] = kernel.operations.with_prepared(count_operations(reachable(used)))
        return counts

    def summary(self) -> str:
        """Return a table of the C kernels with their operation counts."""
        present = {name: k for name, k in self.kernels.items() if k.is_present}
        counts = {name: self.operations[name] for name in present}
        rows = [
            (name, len(present[name].results), row.total, row.kernel, row.prepare)
            for name, row in counts.items()
        ]
        head = ("", "results", "operations", "in the kernel", "prepared")
        lines = [Table(head, rows, f"{self.layout.name}: {len(present)} kernels").text()]
        n_all = len(self.layout.states) * len(self.layout.sensitivities)
        if n_all:
            n_left = len(self.layout.sensitivity_rows)
            lines.append(f"sensitivities: {n_left} of {n_all} are integrated, the others are zero")
        return "\n".join(lines)


def _program_of(data: bytes) -> Program:
    return Program(*unpickled_graph(data))


def _parameters(roots: Iterable[Node | None], p: Sequence[float]) -> dict[Node, float]:
    symbols = symbols_in([root for root in roots if root is not None])
    return {symbol: float(p[symbol.data[1]]) for symbol in symbols}
