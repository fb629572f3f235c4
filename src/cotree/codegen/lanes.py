"""C text that evaluates kernels for several members or points at once, each in one SIMD lane.

The file ``<model>_lanes.c`` contains the rate kernels of a program for the target ``MEMBERS``, and
the steps of a method. A Rosenbrock method also needs kernels of derivatives; it uses the same
elimination as the scalar engine. The file ``<model>_points.c`` contains one kernel, evaluated at
many points.
"""

from __future__ import annotations

import platform
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from cotree.codegen.c_files import INTEGRATORS, conditions, declarations
from cotree.codegen.context import KernelFile, file_fields, kernel_context, name_tables
from cotree.codegen.newton import linear_system
from cotree.codegen.node_statements import SINES
from cotree.codegen.printing import int_table
from cotree.codegen.render import header_text, render, resolve, with_runtime
from cotree.codegen.targets import MEMBERS
from cotree.dag.nodes import substitute
from cotree.dag.operations import OPERATIONS
from cotree.naming import c_identifier
from cotree.program.columns import INPUT_JACOBIAN, form_input_jacobian
from cotree.program.kernels import KERNELS
from cotree.program.passes import rewrite
from cotree.quiet import without_collection
from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cotree.codegen.newton import LinearSystem
    from cotree.codegen.printing import Body
    from cotree.dag.multi_output import LinearMap
    from cotree.dag.nodes import Node
    from cotree.program.kernels import KernelSpec
    from cotree.program.layout import Layout
    from cotree.program.program import Kernel, Program

#: C library functions that are called separately for each lane.
_LIBRARY = ("tan asin acos atan sinh cosh tanh erf floor atan2 pow").split()  # noqa: SIM905
#: Maximum number of operations: with more, compilation takes longer than vectors save.
_MOST_OPERATIONS = 20_000
#: Two interleaved vectors are faster if all members of one integrate at most this many numbers.
_FEW = 48


@dataclass(frozen=True)
class Lanes:
    """Vector width and instruction sets of a processor."""

    width: int  # number of lanes in a vector
    n_bundles: int  # number of vectors processed together, to hide the latency of operations
    #: Instruction sets that the vectors need, as named by compilers.
    instructions: str
    is_fused: bool  # whether fused multiply-add instructions exist


def lanes_of(features: Sequence[str], wanted: int | None = None, n_integrated: int = 64) -> Lanes:
    """Choose width and number of vectors for a processor with the given features."""
    machine, own = platform.machine().lower(), set(features)
    width, instructions, is_fused = 2, [], machine in ("aarch64", "arm64")
    if machine in ("x86_64", "amd64"):
        # The processor, not the width, determines whether products are fused with sums.
        is_fused = {"avx2", "fma"} <= own
        if is_fused and {"avx512f", "avx512dq", "avx512vl"} <= own:
            width, instructions = 8, ["avx512f", "avx512dq", "avx512vl"]
        elif "avx2" in own:
            width, instructions = 4, ["avx2"]
        instructions += ["fma"] * is_fused
    # Two interleaved vectors are 5 to 10 % faster if their data fit in the first-level cache.
    wanted = wanted or (2 * width if width > 2 and width * n_integrated <= _FEW else width)
    width = min(width, wanted)
    return Lanes(width, wanted // width, ",".join(instructions), is_fused)


@dataclass(frozen=True)
class VectorFile(KernelFile):
    """Template data of a C file of kernels in SIMD lanes."""

    lanes: Lanes
    layout: Layout
    packs_sines: bool
    library: dict[str, str]
    n_prepared: int


@dataclass(frozen=True)
class PointsContext(VectorFile):
    """Template data of ``<model>_points.c``."""

    spec: KernelSpec
    n_skipped: int  # number of first results that are not wanted

    @property
    def takes_sensitivities(self) -> bool:
        """Whether the kernel has sensitivities as an argument."""
        return "s" in self.spec.arguments

    @property
    def n_sensitivities(self) -> int:
        """Number of sensitivities that the kernel reads."""
        layout = self.layout
        if self.spec.is_packed:
            return len(layout.sensitivity_places)
        return len(layout.states) * len(layout.sensitivities) if self.takes_sensitivities else 0


@dataclass(frozen=True)
class LanesContext(VectorFile):
    """Template data of ``<model>_lanes.c``."""

    has_sensitivities: bool
    n: int
    n_full: int
    block: int
    row: int
    has_outputs: bool
    n_sensitivities: int
    is_packed: bool  # whether arrays omit sensitivities that are identically zero
    stiff: LinearSystem | None

    @property
    def bodies(self) -> list[Body]:
        """Functions of the file."""
        return [*super().bodies, *(self.stiff.bodies if self.stiff is not None else ())]

    @property
    def part(self) -> int:
        """Number of values of a stored row that are processed together."""
        return min(self.block, self.lanes.width)

    @property
    def point(self) -> int:
        """Number of values of a stored point, rounded up to whole vectors."""
        return -(-2 * self.row // 8) * 8


def lanes_refusal(program: Program, method: str, *, has_sensitivities: bool) -> str:
    """Return a clause that states why members cannot run in SIMD lanes; empty if they can."""
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
    """Return the reason why kernels cannot be vectorised; empty if they can."""
    ops = {node.op for kernel in kernels for node in kernel.order}
    if "solve" in ops:
        return "a linear system is solved with pivots that are chosen at run time"
    if "call" in ops:
        return "an external function is called"
    if sum(kernel.operations.total for kernel in kernels) > _MOST_OPERATIONS:
        return f"rates and their derivatives have more than {_MOST_OPERATIONS} operations"
    return ""


@without_collection()
def lanes_context(
    program: Program, method: str, lanes: Lanes, *, has_sensitivities: bool
) -> LanesContext:
    """Build the template data of a program for which :func:`lanes_refusal` is empty."""
    layout = program.layout
    kernels = _kernels(program, has_sensitivities=has_sensitivities)
    outputs = _output_kernels(program, has_sensitivities=has_sensitivities)
    has_outputs = bool(layout.outputs) and not _kernels_refusal(outputs)
    kernels += outputs if has_outputs else []
    n, n_s = len(layout.states), len(layout.sensitivities) if has_sensitivities else 0
    places = [*range(n), *(n + place for place in layout.sensitivity_places if n_s)]
    is_packed = places != [*range(n * (1 + n_s))]
    tables = [int_table("places", places)] if is_packed else []
    stiff = None
    if INTEGRATORS[method].is_implicit:
        stiff, derivatives = linear_system(program, MEMBERS, has_sensitivities=has_sensitivities)
        kernels += [program.kernels["jacobian"], *derivatives]
        names = "column_starts", "row_indices", "sensitivity_starts", "sensitivity_rows"
        tables += [int_table(name, getattr(layout, name)) for name in names[: 4 if n_s else 2]]
        tables += [stiff.places] if stiff.n_couplings else []
    block = next(length for length in (2, 4, 8) if len(places) <= length or length == 8)
    lines = [line for table in tables for line in table.lines]
    further = [*lines, *(stiff.text if stiff is not None else ())]
    fields = _vector_fields(program, kernels, lanes, further)
    fields["tables"] += tables
    return LanesContext(
        **fields,
        has_sensitivities=has_sensitivities,
        n=len(places),
        n_full=n * (1 + n_s),
        block=block,
        row=-(-len(places) // block) * block,
        has_outputs=has_outputs,
        n_sensitivities=n_s,
        is_packed=is_packed,
        stiff=stiff,
    )


def _vector_fields(
    program: Program, kernels: Sequence[Kernel], lanes: Lanes, further: Sequence[str] = ()
) -> dict[str, Any]:
    """Return the fields of :class:`VectorFile`; the lines ``further`` also enter its digest."""
    layout = program.layout
    prefix, kernels = c_identifier(layout.name), [*map(_written_out, kernels)]
    nodes = [node for kernel in kernels for node in kernel.order]
    ops = {node.op for node in nodes}
    packs_sines = "sines" in ops
    called: dict[Any, str] = {**name_tables(nodes)}
    if packs_sines:
        called[SINES] = "cotree_sines"
    contexts = [kernel_context(prefix, k, program, called, {}, MEMBERS) for k in kernels]
    return {
        **file_fields(layout.name, nodes, contexts, further),
        "lanes": lanes,
        "layout": layout,
        "packs_sines": packs_sines,
        "library": {op: OPERATIONS[op].c.split("(")[0] for op in _LIBRARY if op in ops},
        "n_prepared": program.n_prepared,
    }


@without_collection()
def points_context(program: Program, name: str, lanes: Lanes) -> PointsContext | str:
    """Build the template data of a kernel at many points, or return why it has no SIMD lanes."""
    kernels, n_skipped = [program.kernels["inputs"]] * bool(program.layout.inputs), 0
    if name == INPUT_JACOBIAN.name:
        kernels.append(form_input_jacobian(program))
    else:
        # The last results of another kernel are computed by that kernel.
        kernels.append(program.kernels[KERNELS[name].tail_of or name])
        n_skipped = len(kernels[-1].results) - len(program.kernels[name].results)
    why = _kernels_refusal(kernels)
    if why:
        return why
    fields = _vector_fields(program, kernels, lanes)
    return PointsContext(**fields, spec=kernels[-1].spec, n_skipped=n_skipped)


def render_points(model: PointsContext) -> tuple[Mapping[str, str], str]:
    """Return the file of a kernel with the headers that it includes, and its declaration."""
    files = {f"{model.prefix}_points.c": render("c/lanes/points.c.jinja", model=model)}
    headers = map(header_text, ("cotree_abi.h", "cotree_points.h"))
    arguments = "const cotree_points *c, int first, int last, double *work"
    declared = (
        f"{declarations(headers, ['cotree_points'])}int {model.prefix}_points({arguments});\n"
    )
    return with_runtime(files, has_sources=False), declared


def render_lanes(model: LanesContext, method: str) -> Mapping[str, str]:
    """Return the file of a model, and the headers that it includes, by name."""
    own = INTEGRATORS[method]
    text = render("c/lanes/lanes.c.jinja", model=model, method=own, limits=LIMITS)
    return with_runtime(
        {f"{model.prefix}_lanes.c": resolve(text, conditions(own))}, has_sources=False
    )


def lanes_declarations(model: LanesContext) -> str:
    """Return the declarations of the file for cffi."""
    declared = declarations([header_text("cotree_lanes.h")], ["cotree_lanes"])
    return f"{declared}const cotree_lanes *{model.prefix}_lanes(void);\n"


def _kernels(program: Program, *, has_sensitivities: bool) -> list[Kernel]:
    """Return the rate kernels and, if present, the kernels of inputs and kinks."""
    names = ["inputs"] if program.layout.inputs else []
    names.append("augmented_rhs" if has_sensitivities else "rhs")
    names += ["events"] if program.layout.kinks else []
    names += ["event_ranges"] if program.layout.n_quantities else []
    return [program.kernels[name] for name in names]


def _output_kernels(program: Program, *, has_sensitivities: bool) -> list[Kernel]:
    names = ["outputs", *(["output_sensitivity"] if has_sensitivities else [])]
    return [program.kernels[name] for name in names]


def _written_out(kernel: Kernel) -> Kernel:
    """Replace maps by statements for each column, since lanes are used for members instead."""
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
