"""C text that runs members of an ensemble side by side, one in each lane of vectors.

In: a program after its passes, a tableau and a width. Out: ``<model>_lanes.c``: the kernels of
rates once more, for the target ``MEMBERS``, and steps of the method around them. A Rosenbrock
method also reads kernels of derivatives, and solves with the scalar engine's elimination.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise
from typing import TYPE_CHECKING, Any

from cotree.codegen.context import KernelFile, file_fields, kernel_context, name_tables
from cotree.codegen.integrators import INTEGRATORS, conditions
from cotree.codegen.model_files import declarations
from cotree.codegen.newton import elimination_context
from cotree.codegen.node_statements import SINES
from cotree.codegen.printing import int_table, wrapped
from cotree.codegen.render import render
from cotree.codegen.runtime import header_text, resolve, with_runtime
from cotree.codegen.targets import MEMBERS
from cotree.dag.nodes import substitute
from cotree.dag.operations import OPERATIONS
from cotree.naming import c_identifier
from cotree.program.implicit import form_curvature, form_time_slope
from cotree.program.passes import rewrite
from cotree.quiet import without_collection
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.codegen.newton import EliminationContext
    from cotree.codegen.printing import Body, Constants
    from cotree.dag.multi_output import LinearMap
    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Layout, Program


@dataclass(frozen=True)
class StiffLanes:
    """Data of the template."""

    elimination: EliminationContext  # the factors of ``shift - J`` and solutions with them
    n_values: int  # nonzeros of J
    #: Values of the two kernels of second derivatives; zero where there are none.
    n_carried: int
    n_couplings: int
    #: Whether rates change with time, so that there is a kernel of these derivatives.
    has_slope: bool
    is_whole: bool  # whether no sensitivity vanishes
    tables: list[Constants]  # the pattern of J by rows, and of the sensitivities

    @property
    def text(self) -> list[str]:
        """Its lines, for the digest of a file."""
        tables = [*self.elimination.tables, *self.tables]
        lines = [line for table in tables for line in table.lines]
        return [*self.elimination.factor.text, *self.elimination.solve.text, *lines]


def form_stiff(program: Program, *, has_sensitivities: bool) -> tuple[StiffLanes, list[Kernel]]:
    """Form what a Rosenbrock method needs besides the rates.

    Parameters
    ----------
    program : Program
        After its passes, one without algebraic unknowns.
    has_sensitivities : bool
        Whether sensitivities are integrated.

    Returns
    -------
    stiff : StiffLanes
        Data of the template.
    kernels : list of Kernel
        Derivatives of the rates, which are still to be printed.
    """
    layout, plan = program.layout, program.elimination
    assert plan is not None  # the shift is on all of the diagonal
    slope = form_time_slope(program)
    if slope is not None and not has_sensitivities:
        slope = replace(slope, results=slope.results[: len(layout.states)])
    curvature = form_curvature(program) if has_sensitivities else None
    kernels = [program.kernels["jacobian"]]
    kernels += [slope] if slope is not None else []
    kernels += [curvature.at, curvature.along] if curvature is not None else []
    couplings = () if curvature is None else curvature.places
    tables = [*_rows_of(layout)]
    if couplings:
        tables.append(int_table("couplings", couplings))
    widths = {b - a for a, b in pairwise(layout.sensitivity_starts)} if has_sensitivities else set()
    is_whole = widths <= {len(layout.states)}
    if not is_whole:
        tables.append(int_table("sensitivity_starts", layout.sensitivity_starts))
        tables.append(int_table("sensitivity_rows", layout.sensitivity_rows))
    stiff = StiffLanes(
        elimination=elimination_context(plan, MEMBERS),
        n_values=len(layout.row_indices),
        n_carried=0 if curvature is None else len(curvature.at.results),
        n_couplings=len(couplings),
        has_slope=slope is not None,
        is_whole=is_whole,
        tables=tables,
    )
    return stiff, kernels


def _rows_of(layout: Layout) -> Iterable[Constants]:
    """List where rows of the Jacobian begin, and places and columns of their values."""
    entries: list[tuple[int, int, int]] = []
    for column, (first, last) in enumerate(pairwise(layout.column_starts)):
        entries += [(layout.row_indices[at], at, column) for at in range(first, last)]
    entries.sort()
    lengths = Counter(row for row, _, _ in entries)
    rows = range(len(layout.states))
    yield int_table("row_starts", [*accumulate((lengths[row] for row in rows), initial=0)])
    yield int_table("row_values", [at for _, at, _ in entries])
    yield int_table("row_columns", [column for _, _, column in entries])


#: Functions that are left to the C library, lane by lane.
_LIBRARY = ("tan asin acos atan sinh cosh tanh erf floor atan2 pow").split()  # noqa: SIM905
#: Operations beyond which compiling takes longer than vectors are worth.
_MOST_OPERATIONS = 20_000


@dataclass(frozen=True)
class Lanes:
    """Vectors of a processor."""

    width: int  # numbers in a vector
    n_bundles: int  # vectors in turn: one is worked at while another waits for its own results
    #: The instructions that they need besides the common ones, as compilers name them.
    instructions: str
    is_fused: bool  # whether they round a product and a sum once


@dataclass(frozen=True)
class LanesContext(KernelFile):
    """Data of the template."""

    width: int
    n_bundles: int
    instructions: str
    is_fused: bool
    has_sensitivities: bool
    packs_sines: bool
    library: dict[str, str]
    n: int
    n_full: int
    block: int
    row: int
    n_states: int
    n_parameters: int
    n_prepared: int
    n_inputs: int
    has_outputs: bool
    n_outputs: int
    n_sensitivities: int
    corners: tuple[tuple[int, int], ...]
    n_pieces: int
    ranges: tuple[int, ...]
    n_quantities: int
    places: list[str]
    stiff: StiffLanes | None

    @property
    def bodies(self) -> list[Body]:
        """Its functions."""
        plan = None if self.stiff is None else self.stiff.elimination
        return [*super().bodies, *(() if plan is None else (plan.factor, plan.solve))]

    @property
    def part(self) -> int:
        """Numbers of a remembered row that are worked at together."""
        return min(self.block, self.width)

    @property
    def point(self) -> int:
        """Numbers of a remembered point, in whole vectors."""
        return -(-2 * self.row // 8) * 8


def lanes_refusal(program: Program, method: str, *, has_sensitivities: bool) -> str:
    """Describe why members of a model do not run in lanes; empty where they can.

    Parameters
    ----------
    program : Program
        After its passes.
    method : str
        The method.
    has_sensitivities : bool
        Whether sensitivities are integrated.

    Returns
    -------
    str
        A sentence without a capital and an end.
    """
    layout = program.layout
    if method not in INTEGRATORS:
        return f"'{method}' is no method of cotree"
    if layout.events:
        return "there are events"
    if layout.constraints:
        return "there are constraints"
    if layout.n_algebraic:
        return "there are algebraic unknowns"
    if not layout.states:
        return "there are no states"
    kernels = _kernels(program, has_sensitivities=has_sensitivities)
    if INTEGRATORS[method].is_implicit:
        kernels.append(program.kernels["jacobian"])
    return _kernels_refusal(kernels)


def _kernels_refusal(kernels: Sequence[Kernel]) -> str:
    """Describe why vectors do not evaluate some kernels; empty where they can."""
    ops = {node.op for kernel in kernels for node in kernel.order}
    if "solve" in ops:
        return "a linear system is solved with pivots that are chosen at run time"
    if "call" in ops:
        return "a function from outside is called"
    if sum(kernel.operations.total for kernel in kernels) > _MOST_OPERATIONS:
        return f"rates and their derivatives have more than {_MOST_OPERATIONS} operations"
    return ""


@without_collection()
def lanes_context(
    program: Program, method: str, lanes: Lanes, *, has_sensitivities: bool
) -> LanesContext:
    """Gather what the template needs.

    Parameters
    ----------
    program : Program
        After its passes, one that :func:`lanes_refusal` accepts.
    method : str
        The method.
    lanes : Lanes
        The vectors.
    has_sensitivities : bool
        Whether sensitivities are integrated.
    """
    layout, prefix = program.layout, c_identifier(program.layout.name)
    kernels = _kernels(program, has_sensitivities=has_sensitivities)
    outputs = _output_kernels(program, has_sensitivities=has_sensitivities)
    has_outputs = bool(layout.outputs) and not _kernels_refusal(outputs)
    kernels += outputs if has_outputs else []
    stiff = None
    if INTEGRATORS[method].is_implicit:
        stiff, derivatives = form_stiff(program, has_sensitivities=has_sensitivities)
        kernels += derivatives
    kernels = [*map(_written_out, kernels)]
    nodes = [node for kernel in kernels for node in kernel.order]
    ops = {node.op for node in nodes}
    packs_sines = "sines" in ops
    names: dict[Any, str] = {**name_tables(nodes)}
    if packs_sines:
        names[SINES] = "cotree_sines"
    contexts = [kernel_context(prefix, k, program, names, {}, MEMBERS) for k in kernels]
    n, n_s = len(layout.states), len(layout.sensitivities) if has_sensitivities else 0
    n_blocks = 1 + n_s
    places = [*range(n)]
    if has_sensitivities:
        places += [n + place for place in layout.sensitivity_places]
    block = next(length for length in (2, 4, 8) if len(places) <= length or length == 8)
    return LanesContext(
        **file_fields(layout.name, nodes, contexts, () if stiff is None else stiff.text),
        width=lanes.width,
        n_bundles=lanes.n_bundles,
        instructions=lanes.instructions,
        is_fused=lanes.is_fused,
        has_sensitivities=has_sensitivities,
        packs_sines=packs_sines,
        library={op: OPERATIONS[op].c.split("(")[0] for op in _LIBRARY if op in ops},
        n=len(places),
        n_full=n * n_blocks,
        block=block,
        row=-(-len(places) // block) * block,
        n_states=n,
        n_parameters=len(layout.parameters),
        n_prepared=program.n_prepared,
        n_inputs=len(layout.inputs),
        has_outputs=has_outputs,
        n_outputs=len(layout.outputs),
        n_sensitivities=n_s,
        corners=layout.corners,
        n_pieces=layout.n_pieces,
        ranges=layout.ranges,
        n_quantities=layout.n_quantities,
        # Most often nothing vanishes.
        places=[] if places == [*range(n * n_blocks)] else wrapped(map(str, places)),
        stiff=stiff,
    )


def render_lanes(model: LanesContext, method: str) -> Mapping[str, str]:
    """Write the file of a model, and the headers that it includes.

    Returns
    -------
    mapping of str to str
        Text by file name.
    """
    own = INTEGRATORS[method]
    text = render("c/lanes/lanes.c.jinja", model=model, method=own, limits=LIMITS)
    return with_runtime(
        {f"{model.prefix}_lanes.c": resolve(text, conditions(own))}, has_sources=False
    )


def lanes_declarations(model: LanesContext) -> str:
    """Return the declarations that cffi reads."""
    header = header_text("cotree_lanes.h")
    declared = declarations({"cotree_lanes.h": header}, ["cotree_lanes.h"])
    return f"{declared}const cotree_lanes *{model.prefix}_lanes(void);\n"


def _kernels(program: Program, *, has_sensitivities: bool) -> list[Kernel]:
    """Return the kernels of rates, and of inputs and of corners where there are any."""
    names = ["inputs"] if program.layout.inputs else []
    names.append("augmented_rhs" if has_sensitivities else "rhs")
    names += ["events"] if program.layout.corners else []
    names += ["event_ranges"] if program.layout.n_quantities else []
    return [program.kernels[name] for name in names]


def _output_kernels(program: Program, *, has_sensitivities: bool) -> list[Kernel]:
    """Return the kernels of outputs."""
    names = ["outputs", *(["output_sensitivity"] if has_sensitivities else [])]
    return [program.kernels[name] for name in names]


def _written_out(kernel: Kernel) -> Kernel:
    """Write the columns of maps out, each with its own values: lanes hold members instead."""
    columns: dict[Node, list[Node]] = {}

    def form(node: Node, new: Mapping[Node, Node]) -> Node:
        if node.op == "map":
            linear: LinearMap = node.data
            args = [new.get(arg, arg) for arg in node.args]
            given = [dict(zip(linear.inputs, row, strict=True)) for row in linear.given_to(args)]
            columns[node] = [root for row in given for root in substitute(linear.results, row)]
            return node
        place: int = node.data
        return columns[node.args[0]][place]

    chosen = {
        node
        for node in kernel.order
        if node not in kernel.prepared
        and (node.op == "map" or (node.op == "result" and node.args[0].op == "map"))
    }
    return replace(rewrite(kernel, chosen, form)) if chosen else kernel
