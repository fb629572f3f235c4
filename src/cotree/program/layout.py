"""Layout of a program: names, units and sparsity patterns of kernel arguments and results."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING

from cotree.report import Facts, Report, Table, names

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.equations import DerivedParameter, EventRow, PositionRow, Quantity, RedundantRow


@dataclass(frozen=True)
class Layout:
    """Names, units and sparsity patterns of a program's arguments and results."""

    name: str  # name of the scene
    #: Quantities in the order of the arrays.
    states: tuple[Quantity, ...]
    parameters: tuple[Quantity, ...]
    inputs: tuple[Quantity, ...]
    outputs: tuple[Quantity, ...]
    sensitivities: tuple[str, ...]  # parameters and initial states with sensitivities
    parameter_values: tuple[float, ...]  # parameter values in the scene
    #: Sparsity pattern of the Jacobian in CSC form.
    column_starts: tuple[int, ...]
    row_indices: tuple[int, ...]
    #: For each input: the ``sensitivities`` on which its function in the scene depends.
    input_sensitivities: tuple[tuple[str, ...], ...]
    uncertain: tuple[str, ...]  # coordinates whose pivots must be checked at run time
    #: Constraint residuals in the order of the kernel ``constraints``.
    constraints: tuple[Quantity, ...]
    constraint_edges: tuple[str, ...]  # edge of each constraint that has a multiplier
    n_coordinates: int  # number of coordinates, which are the first states
    n_speeds: int  # number of speeds, which follow the coordinates
    #: Whether each state is an algebraic unknown; these come last, and their rates are residuals.
    algebraic: tuple[bool, ...]
    quaternions: tuple[int, ...]  # index of the first state of each quaternion
    given: tuple[bool, ...]  # whether the scene prescribes the initial value of each state
    #: Variables that are not states but have initial values, which the start must satisfy.
    start_rows: tuple[str, ...]
    start_units: tuple[str, ...]  # units of the variables in ``start_rows``
    start_is_rate: tuple[bool, ...]  # whether each variable in ``start_rows`` is a rate
    #: Whether each output depends on multipliers, that is, on reactions.
    uses_multipliers: tuple[bool, ...]
    events: tuple[EventRow, ...] = ()  # events in the order of the kernel ``events``
    event_inputs: tuple[str, ...] = ()  # inputs that the event kernels read
    #: Variables whose initial values must agree with the values that follow from the states. The
    #: last results of ``start`` are these values, then the initial values in the scene.
    redundant: tuple[RedundantRow, ...] = ()
    #: Indices of states that are storage contents, each with the index of the algebraic unknown
    #: that the content determines. Without an initial content, the unknown's initial value is used.
    followers: tuple[tuple[int, int], ...] = ()
    #: Sensitivity pattern in CSC form: for each parameter, the states that depend on it.
    sensitivity_starts: tuple[int, ...] = (0,)
    sensitivity_rows: tuple[int, ...] = ()
    #: Parameters that are computed from other parameters and are no kernel arguments.
    derived: tuple[DerivedParameter, ...] = ()
    #: For each kink, after the events: branch that ends, direction, whether steep; see ``KinkRow``.
    kinks: tuple[tuple[int, int, bool], ...] = ()
    #: Number of branches that steps freeze: the last prepared values, zero if not frozen.
    n_pieces: int = 0
    positions: tuple[PositionRow, ...] = ()  # positions in networks that are sums of states
    #: For each event, then each kink: its index in the kernel ``event_ranges``; -1 if linear.
    ranges: tuple[int, ...] = ()
    #: Number of quantities on which these ranges depend: the last results of ``events``.
    n_quantities: int = 0
    #: Coordinates and rates whose initial values the scene prescribes, in its order.
    given_names: tuple[str, ...] = ()

    @cached_property
    def sensitivity_places(self) -> tuple[int, ...]:
        """Indices of the sensitivities that are not identically zero, parameter by parameter."""
        n, starts = len(self.states), self.sensitivity_starts
        counts = [end - start for start, end in pairwise(starts)]
        # Of n states, the sensitivities to parameter j begin at index j n.
        firsts = [j * n for j, count in enumerate(counts) for _ in range(count)]
        return tuple(first + i for first, i in zip(firsts, self.sensitivity_rows, strict=True))

    @property
    def units(self) -> dict[str, str]:
        """Unit of each state, position, output, input and parameter by name."""
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
    def has_events(self) -> bool:
        """Whether the model has events, or kinks of rates at times that depend on states."""
        return bool(self.events or self.kinks)

    @property
    def has_conditions(self) -> bool:
        """Whether initial values must satisfy conditions besides the algebraic equations."""
        return bool(self.constraints or self.start_rows)

    @cached_property
    def has_start_equations(self) -> bool:
        """Whether some initial values follow from others or must be consistent with others."""
        is_found = self.has_conditions or self.n_algebraic or self.followers or self.redundant
        return bool(is_found) or any(row.is_jump for row in self.events)

    @cached_property
    def has_only_norms(self) -> bool:
        """Whether initial values must satisfy nothing but the norms of quaternions."""
        others = self.start_rows or self.n_algebraic or self.followers or self.redundant
        is_of_norms = len(self.constraints) == len(self.quaternions)
        return is_of_norms and not others and not any(row.is_jump for row in self.events)

    @cached_property
    def value_rows(self) -> tuple[int, ...]:
        """Indices of the speed constraints that are rates of coordinate constraints."""
        names = [row.name for row in self.constraints]
        n_rows = len(self.constraint_edges)
        # The kernel returns coordinate constraints, then the rates of all constraints, then
        # quaternion norms. Constraints on speeds alone occur only in the second group.
        n_values = len(names) - n_rows - len(self.quaternions)
        values, rates = set(names[:n_values]), names[n_values : n_values + n_rows]
        return tuple(i for i, name in enumerate(rates) if name.removesuffix("_dot") in values)

    @cached_property
    def n_algebraic(self) -> int:
        """Number of algebraic unknowns."""
        return sum(self.algebraic)

    def report(self, kind: str, more: Iterable[tuple[str, str]]) -> Report:
        """Return a report with names, the facts ``more`` and, in notebooks, the parameters."""
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
