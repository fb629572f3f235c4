"""Typed, plain data for the templates. A template arranges text and decides nothing else."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.codegen.column_storage import own_rows
from cotree.codegen.features import Features
from cotree.codegen.kernel_text import KernelFile, file_fields, kernel_context, name_tables
from cotree.codegen.maps import MapContext, constant_columns, map_context
from cotree.codegen.node_statements import SINES
from cotree.codegen.printing import Body, Constants, wrapped
from cotree.codegen.result_offsets import name_starts
from cotree.codegen.targets import DOUBLE
from cotree.dag.traverse import reachable
from cotree.naming import c_comment, c_identifier, c_string
from cotree.quiet import without_collection

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.codegen.targets import Target
    from cotree.equations import Quantity
    from cotree.program import Layout, Program


#: What stands in the place of ``kind`` for a kink, see ``cotree_jumps.h``.
_KINK = 11


@dataclass(frozen=True)
class QuantityContext:
    """A row of a table of names."""

    name: str
    unit: str
    doc: str
    name_literal: str
    unit_literal: str


@dataclass(frozen=True)
class EnumContext:
    """Named positions of one kind of quantities."""

    kind: str
    names: list[str]


@dataclass(frozen=True)
class EventContext:
    """One event."""

    name_literal: str
    direction: int
    is_stop: bool
    is_jump: int  # above one: what of dry friction or of a rigid stop it looks at
    is_count: bool
    n_kept: int
    n_targets: int
    targets: list[str]
    piece: int  # that ends at a corner
    range: int  # its place among ranges; -1: it has none


@dataclass(frozen=True)
class HybridContext:
    """Data of a model that its events need; not written for a model without any, or corners."""

    events: list[EventContext]  # then the corners
    n_corners: int
    n_pieces: int
    n_ranges: int
    n_quantities: int
    n_jumps: int
    n_coordinates: int
    n_speeds: int
    n_values: int
    n_rows: int
    value_rows: list[str]
    n_quaternions: int
    quaternions: list[str]


@dataclass(frozen=True)
class ModelContext(KernelFile):
    """One model."""

    target: Target
    name_literal: str
    upper: str
    guard: str
    uses_vectors: bool
    packs_sines: bool
    maps: list[MapContext]
    constants: list[Constants]  # of maps: what columns do not share, and where they begin
    clears_columns: bool
    kernel_pointers: list[str]
    states: list[QuantityContext]
    parameters: list[QuantityContext]
    inputs: list[QuantityContext]
    outputs: list[QuantityContext]
    sensitivities: list[str]
    sensitivity_literals: list[str]
    guard_literals: list[str]
    parameter_values: list[str]
    enums: list[EnumContext]
    column_starts: list[str]
    row_indices: list[str]
    sensitivity_starts: list[str]
    sensitivity_rows: list[str]
    n_prepared: int
    n_guards: int
    n_nonzeros: int
    n_reached: int
    n_constraints: int
    n_algebraic: int
    hybrid: HybridContext

    def features(self) -> Features:
        """Return what the model uses of the runtime, with an explicit method and no helper."""
        return Features(
            sensitivities=bool(self.sensitivities),
            inputs=bool(self.inputs),
            algebraic=self.n_algebraic > 0,
            constraints=self.n_constraints > 0,
            events=bool(self.hybrid.events),
            moving_corners=False,
            implicit=False,
            helper=False,
        )

    @property
    def bodies(self) -> list[Body]:
        """The functions."""
        return [*super().bodies, *(row.body for row in self.maps)]


@without_collection()
def model_context(program: Program, target: Target = DOUBLE) -> ModelContext:
    """Gather what the templates of a model need.

    Parameters
    ----------
    program : Program
        After its passes.
    target : Target
        The type of numbers, one at a time.
    """
    layout = program.layout
    prefix = c_identifier(layout.name)
    nodes = [node for kernel in program.kernels.values() for node in kernel.order]
    nodes += reachable([guard.value for guard in program.guards])  # prepare checks them
    tables = name_tables(nodes)
    maps = list(dict.fromkeys(node for node in nodes if node.op == "map"))
    # Applications of one map with equal storage share a function.
    applied = {own_rows(node): node for node in maps}
    functions_of = {rows: f"cotree_map{i}" for i, rows in enumerate(applied)}
    # Applications whose columns are all constants read a table of the file.
    columns = {
        node: table
        for i, node in enumerate(maps)
        if (table := constant_columns(node, f"cotree_columns{i}", target))
    }
    present = [k for k in program.kernels.values() if k.is_present]
    packs_sines = any(node.op == "sines" for node in nodes)
    names: dict[Any, str] = {**tables, **functions_of}
    names |= {node: table.name for node, table in columns.items()}
    # A kernel that keeps the tail of another writes no map itself.
    starts = name_starts(kernel for kernel in present if not kernel.spec.tail_of)
    names |= {places: table.name for places, table in starts.items()}
    if packs_sines:
        names[SINES] = "cotree_sines"
    contexts = [map_context(applied[rows], name, target) for rows, name in functions_of.items()]
    # Kernels come in the order of the registry: one that calls another comes behind it, and knows
    # the bytes of its stack.
    kernels, called = [], {row.name: row.n_stack for row in contexts}
    for kernel in present:
        own = kernel_context(prefix, kernel, program, names, called, target)
        kernels.append(own)
        called[f"{prefix}_{kernel.spec.name}"] = own.n_stack  # others may call it
    return ModelContext(
        **file_fields(layout.name, nodes, kernels, target=target),
        target=target,
        name_literal=c_string(layout.name),
        upper=prefix.upper(),
        guard=f"COTREE_MODEL_{prefix.upper()}_H",
        uses_vectors=packs_sines or bool(maps),
        packs_sines=packs_sines,
        maps=contexts,
        constants=[*columns.values(), *starts.values()],
        # Columns that are no constants are filled at each call, between zeros that are set before.
        clears_columns=any(node not in columns for node in maps),
        # The structure of a model has a place for each kernel of the registry, in its order.
        kernel_pointers=[
            f"{prefix}_{k.spec.name}" if k in present else "NULL" for k in program.kernels.values()
        ],
        states=[_quantity(row) for row in layout.states],
        parameters=[_quantity(row) for row in layout.parameters],
        inputs=[_quantity(row) for row in layout.inputs],
        outputs=[_quantity(row) for row in layout.outputs],
        sensitivities=list(layout.sensitivities),
        sensitivity_literals=wrapped(map(c_string, layout.sensitivities)),
        guard_literals=[f"{c_string(guard.what + guard.source)}," for guard in program.guards],
        parameter_values=wrapped(map(target.literal, layout.parameter_values)),
        enums=_enums(prefix.upper(), layout),
        column_starts=wrapped(map(str, layout.column_starts)),
        row_indices=wrapped(map(str, layout.row_indices)),
        sensitivity_starts=wrapped(map(str, layout.sensitivity_starts)),
        sensitivity_rows=wrapped(map(str, layout.sensitivity_rows)),
        n_reached=len(layout.sensitivity_rows),
        n_prepared=program.n_prepared,
        n_guards=len(program.guards),
        n_nonzeros=len(layout.row_indices),
        n_constraints=len(layout.constraints),
        n_algebraic=layout.n_algebraic,
        hybrid=_hybrid_context(layout),
    )


def _hybrid_context(layout: Layout) -> HybridContext:
    places = layout.ranges
    events = [
        EventContext(
            c_string(row.name),
            row.direction,
            row.is_stop,
            row.part or int(row.is_jump),
            row.is_count,
            len(row.kept),
            len(row.targets),
            wrapped(map(str, row.targets)),
            piece=0,
            range=place,
        )
        for row, place in zip(layout.events, places, strict=False)
    ]
    events += [
        EventContext(c_string(""), direction, False, _KINK, False, 0, 0, [], piece, place)
        for (piece, direction), place in zip(
            layout.corners, places[len(layout.events) :], strict=True
        )
    ]
    return HybridContext(
        events,
        len(layout.corners),
        layout.n_pieces,
        1 + max(places, default=-1),
        layout.n_quantities,
        sum(event.n_targets for event in events),
        layout.n_coordinates,
        layout.n_speeds,
        len(layout.value_rows),
        len(layout.constraint_edges),
        wrapped(map(str, layout.value_rows)),
        len(layout.quaternions),
        wrapped(map(str, layout.quaternions)),
    )


def _enums(upper: str, layout: Layout) -> list[EnumContext]:
    """Name the positions of what a model has, as the scene spells them."""
    rows = {
        "state": [row.name for row in layout.states],
        "parameter": [row.name for row in layout.parameters],
        "input": [row.name for row in layout.inputs],
        "output": [row.name for row in layout.outputs],
        "sensitivity": list(layout.sensitivities),
    }
    return [
        EnumContext(kind, _enumerators(f"{upper}_{kind.upper()}", names))
        for kind, names in rows.items()
        if names
    ]


def _enumerators(prefix: str, names: Sequence[str]) -> list[str]:
    """Turn names into enumerators; those that C cannot tell apart get a number."""
    found: dict[str, None] = {}
    for name in names:
        own = first = f"{prefix}_{re.sub('[^A-Za-z0-9_]', '_', name)}"
        n = 1
        while own in found:
            n += 1
            own = f"{first}_{n}"
        found[own] = None
    return list(found)


def _quantity(row: Quantity) -> QuantityContext:
    return QuantityContext(
        row.name, c_comment(row.unit), c_comment(row.doc), c_string(row.name), c_string(row.unit)
    )
