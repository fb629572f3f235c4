"""Kernels of an FMU besides those of the model: derivatives by everything, and times of corners.

The derivatives are those of the program's own results, formed node by node, so that they hold for
states, inputs and parameters alike, whichever sensitivities were compiled.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents_along
from cotree.dag.symbols import INPUT, PARAMETER, STATE, TIME
from cotree.dag.traverse import substitute
from cotree.program.kernels import KernelSpec
from cotree.program.program import Kernel

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.dag.nodes import Node
    from cotree.program import Program

_STATE = ("t", "x", "u", "p", "k")
_PARAMETER = ("p", "k")


@dataclass(frozen=True)
class Partials:
    """A kernel that writes the nonzeros of a matrix of derivatives.

    Attributes
    ----------
    name : str
        Its name.
    n_rows, n_columns : int
        The matrix's shape.
    starts, rows : tuple of int
        Its pattern, compressed by columns.
    kernel : Kernel
        The kernel.
    """

    name: str
    n_rows: int
    n_columns: int
    starts: tuple[int, ...]
    rows: tuple[int, ...]
    kernel: Kernel

    def columns_of(self) -> list[set[int]]:
        """List the columns with an entry in each row."""
        found: list[set[int]] = [set() for _ in range(self.n_rows)]
        for j in range(self.n_columns):
            for i in self.rows[self.starts[j] : self.starts[j + 1]]:
                found[i].add(j)
        return found


@dataclass(frozen=True)
class FmuKernels:
    """All further kernels.

    Attributes
    ----------
    partials : Partials
        Rates and residuals, outputs, event indicators, and signals, by states, inputs from outside,
        parameters and time.
    initial : Partials
        Initial states by parameters.
    constraints : Partials
        Constraints, then conditions on the start, by the columns of ``partials``.
    stops : Kernel or None
        Upper bounds of steps; then first time and period of each stop, with derivatives of both
        along each sensitivity. None where there are neither.
    starts : tuple of bool
        Whether each stop has no times before its first.
    n_limits : int
        Number of upper bounds of steps.
    """

    partials: Partials
    initial: Partials
    constraints: Partials
    stops: Kernel | None
    starts: tuple[bool, ...]
    n_limits: int

    @property
    def present(self) -> list[Kernel]:
        """The kernels that have results."""
        rows = [self.partials.kernel, self.initial.kernel, self.constraints.kernel]
        found = [kernel for kernel in rows if kernel.results]
        return [*found, self.stops] if self.stops is not None else found


def form_kernels(program: Program, outside: Sequence[int]) -> FmuKernels:
    """Form the further kernels of a program.

    Parameters
    ----------
    program : Program
        After its passes.
    outside : sequence of int
        Places of the inputs that are set from outside; the others are functions of time.
    """
    dag, layout, kernels = program.dag, program.layout, program.kernels
    own = kernels["inputs"].results
    signals = {dag.symbol(INPUT, i): own[i] for i in range(len(own)) if i not in outside}
    parameters = [dag.symbol(PARAMETER, i) for i in range(len(layout.parameters))]
    columns = [
        *(dag.symbol(STATE, i) for i in range(len(layout.states))),
        *(dag.symbol(INPUT, i) for i in outside),
        *parameters,
        dag.symbol(TIME, 0),
    ]
    rows = [
        *(node for name in ("rhs", "outputs", "events") for node in kernels[name].results),
        *signals.values(),
    ]
    starts, stops, n_limits = _stops(program, outside)
    return FmuKernels(
        _partials(program, "partials", _STATE, substitute(rows, signals), columns),
        _partials(program, "initial_partials", _PARAMETER, kernels["initial"].results, parameters),
        _partials(
            program,
            "constraint_partials",
            _STATE,
            substitute(
                [
                    *kernels["constraints"].results,
                    *kernels["start"].results[: len(layout.start_rows)],
                ],
                signals,
            ),
            columns,
        ),
        stops,
        starts,
        n_limits,
    )


def _partials(
    program: Program,
    name: str,
    arguments: tuple[str, ...],
    rows: Sequence[Node],
    columns: Sequence[Node],
) -> Partials:
    one = program.dag.one
    found = tangents_along(rows, [{column: one} for column in columns])
    starts, indices, values = [0], [], []
    for j in range(len(columns)):
        for i, row in enumerate(found):
            if j in row:
                indices.append(i)
                values.append(row[j])
        starts.append(len(indices))
    spec = KernelSpec(name, arguments, "values", f"derivatives, the nonzeros of {name} by columns")
    prepared = program.kernels["rhs"].prepared if "x" in arguments else {}
    kernel = Kernel(spec, tuple(values), prepared)
    return Partials(name, len(rows), len(columns), tuple(starts), tuple(indices), kernel)


def _stops(program: Program, outside: Sequence[int]) -> tuple[tuple[bool, ...], Kernel | None, int]:
    """Gather the stops and longest steps of all that stays a function of time."""
    dag = program.dag
    replaced = {program.layout.inputs[i].name for i in outside}
    stops = [s for name, own in program.stops.items() if name not in replaced for s in own]
    limits = [
        limit
        for name, own in program.longest_steps.items()
        if name not in replaced
        for limit in own
    ]
    if not stops and not limits:
        return (), None, 0
    values = [*limits]
    for stop in stops:
        values += [stop.first, stop.period if stop.period is not None else dag.zero]
        values += [d for pair in stop.along for d in pair]
    spec = KernelSpec(
        "stops",
        _PARAMETER,
        "values",
        "upper bounds of steps; first time, period and their derivatives of all that has corners",
    )
    return tuple(stop.starts for stop in stops), Kernel(spec, tuple(values), {}), len(limits)
