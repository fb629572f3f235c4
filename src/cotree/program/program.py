"""Program of a scene: the results of each kernel, as nodes of one arena."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from itertools import chain, pairwise
from typing import TYPE_CHECKING

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import ARGUMENT_OF, PIECE, reachable, symbols_in
from cotree.dag.switching_times import TimeEvent, longest_step
from cotree.dag.time_events import Corners, find_corners
from cotree.errors import SolveError
from cotree.linear.plan import plan_elimination
from cotree.program.counts import OperationCount, by_need, count_operations
from cotree.report import Facts, Report, Table, names

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Mapping, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.equations import (
        DerivedParameter,
        EventRow,
        Guard,
        PositionRow,
        Quantity,
        RedundantRow,
    )
    from cotree.linear.plan import Elimination
    from cotree.program.kernels import KernelSpec


@dataclass(frozen=True)
class Kernel:
    """One kernel: its kind and its results, in order."""

    spec: KernelSpec  # its kind
    results: tuple[Node, ...]  # the values that it writes
    #: Values that it reads from ``k`` instead of computing them, with their place there.
    prepared: Mapping[Node, int]
    #: Whether it is written in the order in which its longest path needs values, not in that of
    #: forming.
    is_by_need: bool = False

    @property
    def is_present(self) -> bool:
        """Return whether C has the kernel: without results only if every model has it."""
        return bool(self.results) or self.spec.is_required

    @cached_property
    def order(self) -> list[Node]:
        """Every value that the results need, in order of evaluation; prepared ones included."""
        # The traversal ends at prepared values: ``prepare`` computes their arguments.
        order = reachable(self.results, stop=self.prepared)
        return by_need(order, self.prepared) if self.is_by_need else order

    @cached_property
    def operations(self) -> OperationCount:
        """Operation counts of the kernel alone."""
        return count_operations([node for node in self.order if node not in self.prepared])


@dataclass(frozen=True)
class Layout:
    """Names, units and patterns of a program's arguments and results."""

    name: str  # name of the scene
    #: In the order of the arrays.
    states: tuple[Quantity, ...]
    parameters: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    sensitivities: tuple[str, ...]  # parameters and states of the sensitivities
    parameter_values: tuple[float, ...]  # the scene's values
    #: The Jacobian's pattern, compressed by columns.
    column_starts: tuple[int, ...]
    row_indices: tuple[int, ...]
    #: For each input, the ``sensitivities`` on which its scene function depends.
    input_sensitivities: tuple[tuple[str, ...], ...]
    uncertain: tuple[str, ...]  # coordinates whose pivot is checked at run time
    #: Residuals of the constraints, in the order of the kernel ``constraints``.
    constraints: tuple[Quantity, ...]
    constraint_edges: tuple[str, ...]  # the edge of each row that has a multiplier
    n_coordinates: int  # number of coordinates among the states; they come first
    n_speeds: int  # number of speeds among the states; they come next
    #: Whether each state is an algebraic unknown; these come last. Their rates are residuals.
    algebraic: tuple[bool, ...]
    quaternions: tuple[int, ...]  # the first state of each quaternion
    given: tuple[bool, ...]  # whether the scene gives the initial value of each state
    #: Further conditions on the start: initial values of variables that are not states.
    start_rows: tuple[str, ...]
    start_units: tuple[str, ...]  # their units
    start_is_rate: tuple[bool, ...]  # whether each is a rate
    #: Whether each output depends on multipliers: a reaction.
    uses_multipliers: tuple[bool, ...]
    events: tuple[EventRow, ...] = ()  # in the order of the kernel ``events``
    event_inputs: tuple[str, ...] = ()  # the inputs that these kernels read
    #: Initial values that must agree with those of states; the last results of the kernel ``start``
    #: are the values that follow from states, then the given ones.
    redundant: tuple[RedundantRow, ...] = ()
    #: States that are the content of several storages, with the algebraic unknown that follows from
    #: each: a start without a given content has that unknown.
    followers: tuple[tuple[int, int], ...] = ()
    #: The states that depend on each of them, one after another: the pattern of sensitivities, in
    #: compressed columns. Other sensitivities are zero at all times.
    sensitivity_starts: tuple[int, ...] = (0,)
    sensitivity_rows: tuple[int, ...] = ()
    #: Parameters that follow from these, and are not arguments.
    derived: tuple[DerivedParameter, ...] = ()
    #: The next results of that kernel: for each kink the branch that ends there, the direction, and
    #: whether it is steep, as in :class:`cotree.equations.CornerRow`.
    corners: tuple[tuple[int, int, bool], ...] = ()
    #: Number of branches that steps freeze: the last prepared values, zero unless frozen.
    n_pieces: int = 0
    positions: tuple[PositionRow, ...] = ()  # positions in networks that are sums of states
    #: For each event, then each kink, its place in the kernel ``event_ranges``; -1: it is linear,
    #: and has none.
    ranges: tuple[int, ...] = ()
    #: Number of quantities of these, the last results of the kernel ``events``.
    n_quantities: int = 0
    #: The initial values of coordinates and rates that the scene gives, in its order.
    given_names: tuple[str, ...] = ()

    @cached_property
    def sensitivity_places(self) -> tuple[int, ...]:
        """Places of the nonzero sensitivities among all sensitivities, parameter by parameter."""
        n, starts = len(self.states), self.sensitivity_starts
        counts = [end - start for start, end in pairwise(starts)]
        # Sensitivity j has n places, of which its pattern names a few.
        firsts = [j * n for j, count in enumerate(counts) for _ in range(count)]
        return tuple(first + i for first, i in zip(firsts, self.sensitivity_rows, strict=True))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each state, position, output, input and parameter; the last of equal names."""
        rows: tuple[Quantity | PositionRow, ...] = (
            *self.states,
            *self.positions,
            *self.outputs,
            *self.inputs,
            *self.parameters,
        )
        derived = {row.name: row.unit for row in self.derived}
        return {row.name: row.unit for row in rows} | derived

    @property
    def has_conditions(self) -> bool:
        """Return whether initial values have conditions besides those of algebraic unknowns."""
        return bool(self.constraints or self.start_rows)

    @cached_property
    def has_start_equations(self) -> bool:
        """Return whether any value follows from initial values, or has to agree with them."""
        is_found = self.has_conditions or self.n_algebraic or self.followers or self.redundant
        return bool(is_found) or any(row.is_jump for row in self.events)

    @cached_property
    def value_rows(self) -> tuple[int, ...]:
        """Indices of the speed constraints that are rates of coordinate constraints."""
        names = [row.name for row in self.constraints]
        n_rows = len(self.constraint_edges)
        # The kernel has the coordinate constraints, then the rates of all rows, then the norms of
        # quaternions. A row of speeds alone is in the second group only.
        n_values = len(names) - n_rows - len(self.quaternions)
        values, rates = set(names[:n_values]), names[n_values : n_values + n_rows]
        return tuple(i for i, name in enumerate(rates) if name.removesuffix("_dot") in values)

    @cached_property
    def n_algebraic(self) -> int:
        """Number of algebraic unknowns."""
        return sum(self.algebraic)

    def report(self, kind: str, more: Iterable[tuple[str, str]]) -> Report:
        """Build a report of names, further facts and, in notebooks, parameters."""
        groups = {"states": self.states, "inputs": self.inputs, "outputs": self.outputs}
        values = zip(self.parameters, self.parameter_values, strict=True)
        facts = [
            (noun, names([f"{row.name} [{row.unit}]" if row.unit else row.name for row in rows], 6))
            for noun, rows in groups.items()
        ]
        facts.insert(1, ("parameters", names([row.name for row in self.parameters])))
        to = f"to {names(self.sensitivities)}" if self.sensitivities else "none"
        held = names([row.name for row in self.constraints]) if self.constraints else ""
        return Report(
            f"{kind} {self.name}",
            Facts([*facts, ("sensitivities", to), ("constraints", held), *more]),
            Table(
                ("name", "value", "unit", "meaning"),
                [(row.name, value, row.unit, row.doc) for row, value in values],
                "parameters",
                in_text=0,
            ),
        )


@dataclass(frozen=True)
class Program:
    """A program."""

    dag: Dag  # the arena of all its values
    layout: Layout  # names and patterns
    kernels: Mapping[str, Kernel]  # by name, in the registry's order
    guards: tuple[Guard, ...]  # checked by ``prepare``
    #: Times at which each input, by its name, jumps or has a kink in the scene; and times of all
    #: others in the rates, by the empty name; along each sensitivity.
    stops: Mapping[str, tuple[TimeEvent, ...]] = field(default_factory=dict)
    #: Upper bounds of the steps while each input is the scene's own, by the same names.
    longest_steps: Mapping[str, tuple[Node, ...]] = field(default_factory=dict)

    def corners(
        self,
        p: Sequence[float],
        span: tuple[float, float],
        replaced: Container[str] = (),
        others: Sequence[float] = (),
    ) -> Corners:
        """List the times within a span at which integration restarts, for parameters p.

        ``replaced`` are inputs that a run replaces, ``others`` further times, which depend on no
        parameter. Raises SolveError if a period is far too short for the span.
        """
        if not self.stops and not others:
            return Corners.none()
        # A run that replaces an input has none of its time events.
        stops = [stop for name, own in self.stops.items() if name not in replaced for stop in own]
        try:
            nodes = [
                node
                for stop in stops
                for node in (stop.first, stop.period, *chain.from_iterable(stop.along))
            ]
            return find_corners(stops, _parameters(nodes, p), *span, others)
        except ValueError as error:
            raise SolveError(str(error)) from None

    def longest_step(self, p: Sequence[float], replaced: Container[str] = ()) -> float:
        """Return the upper bound of the steps, [s], infinity for none; see :meth:`corners`."""
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
        """Evaluate a kernel in Python.

        Parameters
        ----------
        kernel : str
            A name in ``KERNELS``.
        known : mapping of str to sequence of float
            Its arguments by kind, ``p`` among them; ``t`` is a sequence of one entry.
        """
        roots = self.kernels[kernel].results
        given = {
            symbol: float(known[ARGUMENT_OF[symbol.data[0]]][symbol.data[1]])
            for symbol in symbols_in(roots)
            if symbol.data[0] != PIECE
        }
        found: list[float] = evaluate(roots, given)
        return found

    @property
    def can_extend(self) -> bool:
        """Return whether algebraic unknowns have rates throughout a run, with sensitivities."""
        if self.layout.corners:
            return False  # these rates jump at kinks of the residuals
        name = "extended_augmented_rhs" if self.layout.sensitivities else "extended_rhs"
        return bool(self.kernels[name].results)

    @property
    def n_prepared(self) -> int:
        """Number of prepared values."""
        return len(self.kernels["prepare"].results)

    @cached_property
    def elimination(self) -> Elimination | None:
        """The planned elimination of implicit methods; None if the pattern is singular."""
        layout = self.layout
        return plan_elimination(
            len(layout.states), layout.column_starts, layout.row_indices, layout.n_algebraic
        )

    @cached_property
    def operations(self) -> dict[str, OperationCount]:
        """Operation counts of each kernel, with its share of ``prepare``."""
        counts = {}
        for name, kernel in self.kernels.items():
            # ``prepare`` serves all kernels; the counts of each include the values that it needs.
            used = [node for node in kernel.order if node in kernel.prepared]
            counts[name] = kernel.operations.with_prepared(count_operations(reachable(used)))
        return counts

    def summary(self) -> str:
        """Describe the kernels in C by their operation counts."""
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


def _parameters(roots: Iterable[Node | None], p: Sequence[float]) -> dict[Node, float]:
    """Return the values of the parameters on which some nodes depend; no node is made."""
    symbols = symbols_in([root for root in roots if root is not None])
    return {symbol: float(p[symbol.data[1]]) for symbol in symbols}
