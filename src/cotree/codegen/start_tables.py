"""Tables for the search for consistent initial states (``start/cotree_start.h``)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.naming import c_string, split_name
from cotree.quantities import Quantity

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.codegen.printing import Constants
    from cotree.program.layout import Layout


@dataclass(frozen=True)
class StartTables:
    """Tables of a model; attributes have the names of the C fields."""

    #: Numbers of coordinates, speeds, constraints and results.
    n_coordinates: int
    n_speeds: int
    n_values: int
    n_rows: int
    n_start: int
    n_groups: int
    #: Arrays of indices; see cotree_start_tables.h.
    value_rows: tuple[int, ...]
    quaternions: tuple[int, ...]
    is_rate: tuple[int, ...]
    groups: tuple[int, ...]
    given: tuple[int, ...]
    seeds: tuple[int, ...]
    contents: tuple[int, ...]
    #: States on which each redundant value depends, in compressed form.
    redundant_starts: tuple[int, ...]
    redundant_states: tuple[int, ...]
    #: Names and units of the residuals, and of the redundant values.
    rows: tuple[Quantity, ...]
    redundant: tuple[Quantity, ...]

    @property
    def has_assembly(self) -> bool:
        """Whether the model has constraints, or conditions on initial values."""
        return bool(self.rows or self.quaternions or self.n_start)

    @property
    def arrays(self) -> list[Constants]:
        """Arrays as C text; their names are those of the fields with the prefix ``start_``."""
        # Imported here because only code generation needs it.
        from cotree.codegen.printing import Constants, int_table

        numbers = {
            name: getattr(self, name)
            for name in ("given", "seeds", "contents")
            + ("value_rows", "quaternions", "is_rate", "groups") * self.has_assembly
            + ("redundant_starts", "redundant_states") * bool(self.redundant)
        }
        found = [int_table(f"start_{name}", values) for name, values in numbers.items() if values]
        for name in ("rows", "redundant"):
            quantities = getattr(self, name)
            if quantities:
                lines = [f"{{{c_string(row.name)}, {c_string(row.unit)}}}," for row in quantities]
                found.append(Constants("cotree_quantity", f"start_{name}", len(lines), lines))
        return found


def start_tables(layout: Layout) -> StartTables:
    """Build the tables of a model."""
    n_rows = len(layout.constraint_edges)
    n_values = len(layout.constraints) - n_rows - len(layout.quaternions)
    conditions = [Quantity(*row) for row in zip(layout.start_rows, layout.start_units, strict=True)]
    rates = layout.constraints[n_values : n_values + n_rows]
    # The constraint axes of an edge are arbitrary, so its rows with the same unit form a group.
    edges = [(edge, row.unit) for edge, row in zip(layout.constraint_edges, rates, strict=True)]
    edges += [(split_name(row.name)[0], row.unit) for row in conditions]
    numbers = {edge: i for i, edge in enumerate(dict.fromkeys(edges))}
    states = [row.name for row in layout.states]
    read = [[states.index(name) for name in row.states] for row in layout.redundant]
    return StartTables(
        n_coordinates=layout.n_coordinates,
        n_speeds=layout.n_speeds,
        n_values=n_values,
        n_rows=n_rows,
        n_start=len(conditions) + 2 * len(layout.redundant),
        n_groups=len(numbers),
        value_rows=layout.value_rows,
        quaternions=layout.quaternions,
        is_rate=tuple(map(int, layout.start_is_rate)),
        groups=tuple(numbers[edge] for edge in edges),
        given=tuple(map(int, layout.given)),
        seeds=tuple(_seeds(layout, states)),
        contents=tuple(place for pair in zip(*layout.followers, strict=True) for place in pair),
        redundant_starts=tuple(_ends(read)),
        redundant_states=tuple(place for own in read for place in own),
        rows=(*layout.constraints[: n_values + n_rows], *conditions),
        redundant=tuple(Quantity(row.name, "") for row in layout.redundant),
    )


def _seeds(layout: Layout, states: Sequence[str]) -> Iterable[int]:
    """Return the parameter index of each sensitivity, or -1 minus the index of its state."""
    places = {row.name: i for i, row in enumerate(layout.parameters)}
    return (
        places[name] if name in places else -1 - states.index(name) for name in layout.sensitivities
    )


def _ends(read: Iterable[Sequence[int]]) -> Iterable[int]:
    end = 0
    yield end
    for own in read:
        end += len(own)
        yield end
