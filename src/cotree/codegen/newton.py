"""C text of linear systems and second derivatives of a model, for implicit methods.

The factorisation of ``shift M - J`` is straight-line code or, if that is long, tables for loops.
Factors are stored row by row in pivot order, and within a row in column order. The update of a row
by another row then consists of a few runs of consecutive entries, which C can vectorise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.codegen.context import KernelFile, file_fields, kernel_context, name_tables
from cotree.codegen.ir import Argument, Assign, apply, element, named, number, temporary
from cotree.codegen.kernel_blocks import cut_into_blocks
from cotree.codegen.printing import Body, int_table, print_body
from cotree.codegen.render import ALL, Features, render, with_runtime
from cotree.codegen.targets import DOUBLE
from cotree.dag.nodes import INPUT, TIME, kinds_in
from cotree.linear.elimination import narrow_band
from cotree.naming import c_identifier
from cotree.program.columns import form_curvature, form_time_slope
from cotree.quiet import without_collection

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from cotree.codegen.ir import CExpression, Statement
    from cotree.codegen.printing import Constants
    from cotree.codegen.targets import Target
    from cotree.linear.elimination import Elimination
    from cotree.program.program import Kernel, Program


def elimination_tables(plan: Elimination) -> list[Constants]:
    """Return the tables that the factorisation and the solution in C read.

    ``factor_values``: index of each factor among the nonzeros of the Jacobian, or -1.
    ``factor_columns``: rank of the factor's column in pivot order. ``pivot_rows``: row and column
    of each pivot, number of factors before and after it in its row, and whether the shift is added.
    ``updates``: for each pivot, the number of rows that it updates; for each of these, the index of
    the multiplier and the number of runs; for each run, its destination, source and length.
    """
    ranks = _ranks(plan)
    starts = [0]
    for row in ranks:
        starts.append(starts[-1] + len(row))
    place = {(k, j): starts[k] + at for k, row in enumerate(ranks) for at, j in enumerate(row)}
    # The tables number the factors row by row, unlike the plan.
    number = {(k, k): factor for k, factor in enumerate(plan.pivots)}
    for k in range(len(plan.rows)):
        number |= {(k, j): factor for j, factor in (*plan.lower[k], *plan.upper[k])}
    steps = [plan.factors[number[k, j]] for k, row in enumerate(ranks) for j in row]
    pivots = [
        entry
        for k, (row, column) in enumerate(zip(plan.rows, plan.columns, strict=True))
        for entry in (
            row,
            column,
            len(plan.lower[k]),
            len(plan.upper[k]),
            int(plan.factors[plan.pivots[k]].has_shift),
        )
    ]
    return [
        int_table("factor_values", [step.value for step in steps]),
        int_table("factor_columns", [j for row in ranks for j in row]),
        int_table("pivot_rows", pivots),
        int_table("updates", list(_updates(plan, place))),
    ]


def _ranks(plan: Elimination) -> list[list[int]]:
    """Return for each row the columns of its factors, as ranks in pivot order."""
    return [
        [*(m for m, _ in before), k, *(j for j, _ in after)]
        for k, (before, after) in enumerate(zip(plan.lower, plan.upper, strict=True))
    ]


def _updates(plan: Elimination, place: dict[tuple[int, int], int]) -> Iterator[int]:
    below: list[list[int]] = [[] for _ in plan.rows]
    for k, before in enumerate(plan.lower):
        for m, _ in before:
            below[m].append(k)
    for m, rows in enumerate(below):
        yield len(rows)
        columns = [j for j, _ in plan.upper[m]]
        for k in rows:
            runs = _runs([(place[k, j], place[m, j]) for j in columns])
            yield place[k, m]
            yield len(runs)
            for run in runs:
                yield from run


def _runs(pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int, int]]:
    """Join consecutive pairs of indices into runs of (destination, source, length)."""
    runs: list[tuple[int, int, int]] = []
    for to, source in pairs:
        if runs:
            first_to, first, length = runs[-1]
            if (to, source) == (first_to + length, first + length):
                runs[-1] = (first_to, first, length + 1)
                continue
        runs.append((to, source, 1))
    return runs


# Maximum number of operations of straight-line code; gcc compiles a thousand in half a second.
_LONGEST = 3000


@dataclass(frozen=True)
class EliminationContext:
    """Template data of an elimination, written as statements or as tables."""

    n: int
    n_factors: int
    n_operations: int
    is_unrolled: bool
    reads_values: bool
    reads_shift: bool
    factor: Body
    solve: Body
    tables: list[Constants]


@dataclass(frozen=True)
class LinearSystem:
    """The linear systems of an implicit method, for states and their sensitivities."""

    elimination: EliminationContext | None  # None if the matrix is structurally singular
    has_slope: bool  # whether rates depend on time explicitly
    n_carried: int  # number of values that the first kernel of second derivatives passes on
    n_couplings: int
    places: Constants  # indices of nonzero couplings among the sensitivities

    @property
    def bodies(self) -> list[Body]:
        """Functions of the file."""
        plan = self.elimination
        return [] if plan is None else [plan.factor, plan.solve]

    @property
    def text(self) -> list[str]:
        """All lines of text, from which the digest of the file is computed."""
        tables = [self.places, *(self.elimination.tables if self.elimination else ())]
        lines = [line for table in tables for line in table.lines]
        return [*lines, *(line for body in self.bodies for line in body.text)]


def linear_system(
    program: Program, target: Target, *, has_sensitivities: bool = True
) -> tuple[LinearSystem, list[Kernel]]:
    """Return a program's linear systems, and the kernels of the derivatives that they require."""
    plan = program.elimination
    slope = form_time_slope(program)
    if slope is not None and not has_sensitivities:
        slope = replace(slope, results=slope.results[: len(program.layout.states)])
    curvature = form_curvature(program) if has_sensitivities else None
    kernels = [slope] if slope is not None else []
    kernels += [curvature.at, curvature.along] if curvature is not None else []
    places = () if curvature is None else curvature.places
    system = LinearSystem(
        elimination=None if plan is None else elimination_context(plan, target),
        has_slope=slope is not None,
        n_carried=0 if curvature is None else len(curvature.at.results),
        n_couplings=len(places),
        places=int_table("coupling_places", places),
    )
    return system, kernels


@dataclass(frozen=True)
class NewtonContext(KernelFile):
    """Template data of ``<model>_newton.c``."""

    target: Target
    system: LinearSystem
    is_autonomous: bool

    @property
    def bodies(self) -> list[Body]:
        """Functions of the file."""
        return [*super().bodies, *self.system.bodies]


def render_newton(model: NewtonContext, features: Features = ALL) -> Mapping[str, str]:
    """Return the file of a model, and the headers that it includes, by name."""
    target = model.target
    files = {
        f"{model.prefix}_newton{end}": render(f"c/newton/newton{end}.jinja", target, model=model)
        for end in (".h", ".c")
    }
    return with_runtime(files, target, features=features, has_sources=False)


def newton_declarations(model: NewtonContext) -> str:
    """Return the declarations of the file for cffi."""
    return f"const void *{model.prefix}_newton(void);\n"


@without_collection()
def newton_context(program: Program, target: Target = DOUBLE) -> NewtonContext:
    """Build the template data of ``<model>_newton.c`` for a target with scalar numbers."""
    name = program.layout.name
    system, made = linear_system(program, target)
    nodes = [node for kernel in made for node in kernel.order]
    names = name_tables(nodes)
    kernels = [
        kernel_context(c_identifier(name), kernel, program, names, {}, target) for kernel in made
    ]
    rates = [*program.kernels["rhs"].results, *program.kernels["augmented_rhs"].results]
    return NewtonContext(
        # The digest of the file must change with the elimination, too.
        **file_fields(name, nodes, kernels, system.text, target),
        target=target,
        system=system,
        is_autonomous=kinds_in(rates).isdisjoint((TIME, INPUT)),
    )


def is_unrolled(plan: Elimination) -> bool:
    """Return whether an elimination is written as straight-line code."""
    return plan.n_operations <= _LONGEST


def elimination_context(plan: Elimination, target: Target) -> EliminationContext:
    """Build the template data of an elimination: statements or, if too many, tables."""
    lines = is_unrolled(plan)
    nothing = Body([], [], [])
    return EliminationContext(
        n=len(plan.rows),
        n_factors=len(plan.factors),
        n_operations=plan.n_operations,
        is_unrolled=lines,
        reads_values=any(entry.value >= 0 for entry in plan.factors),
        reads_shift=any(entry.has_shift for entry in plan.factors),
        factor=_factor(plan, target) if lines else nothing,
        solve=_solve(plan, target) if lines else nothing,
        tables=[] if lines else elimination_tables(plan),
    )


def _factor(plan: Elimination, target: Target) -> Body:
    """Return straight-line code of the factorisation, divided into blocks if it is long."""
    given = [Argument("v"), Argument("shift", is_array=False), Argument("f", is_constant=False)]
    return print_body(cut_into_blocks("factorise_{}", _factor_rows(plan), given), target)


def _solve(plan: Elimination, target: Target) -> Body:
    """Return straight-line code of the substitution, divided into blocks if it is long."""
    given = [Argument("f"), Argument("b", is_constant=False)]
    return print_body(cut_into_blocks("solve_{}", _solve_rows(plan), given), target)


def _factor_rows(plan: Elimination) -> list[Statement]:
    """Return the assignments of the factors; those read by later factors are also temporaries."""
    read = {i for entry in plan.factors for pair in entry.products for i in pair}
    read.update(entry.pivot for entry in plan.factors)
    rows: list[Statement] = []
    for i, entry in enumerate(plan.factors):
        # A factor is an entry of shift M - J minus products of earlier factors. M is diagonal: one
        # for states with a rate, zero for algebraic unknowns.
        total = named("shift") if entry.has_shift else None
        if entry.value >= 0:
            total = _less(total, element("v", entry.value))
        for a, b in entry.products:
            total = _less(total, temporary("f", a), temporary("f", b))
        assert total is not None
        if entry.is_pivot:
            # Store the reciprocal of a pivot, because products are faster than divisions.
            total = apply("div", number(1.0), total)
        elif entry.pivot >= 0:
            total = apply("mul", total, temporary("f", entry.pivot))
        # All factors are stored for the substitution; temporaries can stay in registers.
        declared = [temporary("f", i)] if i in read else []
        rows.append(Assign((*declared, element("f", i)), total))
    return rows


def _less(total: CExpression | None, *factors: CExpression) -> CExpression:
    """Return ``total``, or zero if None, minus the product of one or two factors."""
    if total is not None:
        return apply("sub", total, factors[0] if len(factors) == 1 else apply("mul", *factors))
    first = apply("neg", factors[0])
    return first if len(factors) == 1 else apply("mul", first, factors[1])


def _solve_rows(plan: Elimination) -> list[Statement]:
    rows: list[Statement] = []
    # Forward substitution with L (unit diagonal), then backward with U (inverted pivots).
    for k, (row, pairs) in enumerate(zip(plan.rows, plan.lower, strict=True)):
        total = element("b", row)
        for m, factor in pairs:
            total = _less(total, element("f", factor), temporary("y", m))
        rows.append(Assign((temporary("y", k),), total))
    for k in reversed(range(len(plan.rows))):
        total = temporary("y", k)
        for j, factor in plan.upper[k]:
            total = _less(total, element("f", factor), temporary("x", j))
        total = apply("mul", total, element("f", plan.pivots[k]))
        rows.append(Assign((temporary("x", k),), total))
    # Compute all values before writing any: rows and columns may be exchanged.
    columns = enumerate(plan.columns)
    return rows + [Assign((element("b", at),), temporary("x", k)) for k, at in columns]


@dataclass(frozen=True)
class StepWork:
    """Operation counts of one implicit step."""

    #: Operations of the rates, of the rates with sensitivities, and of the Jacobian.
    rates: int
    augmented: int
    jacobian: int
    #: Entries of the factors in the planned sparse elimination, and products to compute them.
    n_factors: int
    n_products: int
    is_unrolled: bool  # whether the C code has no loops
    #: Both counts for factors with row exchanges, in banded form if the band is narrow.
    n_banded: int
    n_banded_products: int


def count_step_work(program: Program) -> StepWork | None:
    """Count the operations of an implicit step; None if its matrix is structurally singular."""
    layout, plan = program.layout, program.elimination
    if plan is None:
        return None

    n, counts = len(layout.states), program.operations
    lower, upper, places = narrow_band(n, layout.column_starts, layout.row_indices)
    is_banded = places is not None
    return StepWork(
        counts["rhs"].total,
        counts["augmented_rhs"].total,
        counts["jacobian"].total,
        len(plan.factors),
        sum(len(entry.products) for entry in plan.factors),
        is_unrolled(plan),
        n * (2 * lower + upper + 1 if is_banded else n),
        n * lower * (lower + upper) if is_banded else n**3 // 3,
    )
