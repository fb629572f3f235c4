"""Adjoint kernels: derivatives of a weighted sum of results in reverse mode.

Reverse accumulation runs from the results of a kernel to the states and to the *sources*: the
parameters that kernels read, and the values that ``prepare`` computes from parameters. A run sums
the adjoints of the sources over all evaluations. Only once, at its end, the kernel
``source_adjoint`` converts them to derivatives with respect to the parameters. The number of
operations per evaluation is therefore a small multiple of that of the kernel itself, whatever the
number of parameters.

The inputs of the scene are functions of time and parameters, so their adjoints are passed on to
their own sources.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag.derivative import adjoints
from cotree.dag.nodes import INPUT, PARAMETER, SENSITIVITY, STATE, reachable
from cotree.program.kernels import KERNELS, KernelSpec
from cotree.program.passes import with_reciprocals
from cotree.program.program import Kernel

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable, Sequence

    from cotree.dag.nodes import Dag, Node
    from cotree.program.program import Program

#: Arguments of all adjoint kernels; ``s`` contains the weights of the results.
_ARGUMENTS = KERNELS["augmented_rhs"].arguments

_OF = "derivatives of the {} weighted by s, with respect to the states, then to the sources"
SPECS = {
    "rhs": KernelSpec("rate_adjoint", _ARGUMENTS, "adjoint", _OF.format("rates")),
    "outputs": KernelSpec("output_adjoint", _ARGUMENTS, "adjoint", _OF.format("outputs")),
    "initial": KernelSpec("initial_adjoint", _ARGUMENTS, "adjoint", _OF.format("initial states")),
}
_SOURCES = KernelSpec(
    "source_adjoint",
    _ARGUMENTS,
    "adjoint",
    "derivatives of the sources weighted by s, with respect to the parameters",
)


@dataclass(frozen=True)
class AdjointKernels:
    """The adjoint kernels of a program."""

    kernels: tuple[Kernel, ...]  # of the rates, outputs and initial states, then of the sources
    n_sources: int  # number of parameters and prepared values with adjoints


def form_adjoints(
    program: Program, parameters: Sequence[str], replaced: Collection[str] = ()
) -> AdjointKernels:
    """Form the adjoint kernels of a program for derivatives with respect to ``parameters``.

    Inputs in ``replaced`` depend on time only.
    """
    dag, kernels = program.dag, program.kernels
    names = [row.name for row in program.layout.parameters]
    symbols = [dag.symbol(PARAMETER, names.index(name)) for name in parameters]
    inputs = _inputs(program, replaced)
    sources = _sources([*(kernels[name] for name in SPECS), inputs], symbols)
    formed = []
    for name, spec in SPECS.items():
        kernel = kernels[name]
        found = _adjoints(program, kernel, inputs, sources)
        formed.append(with_reciprocals(Kernel(spec, tuple(found), kernel.prepared)))
    last = adjoints(sources, _weights(dag, len(sources)), symbols) if sources else []
    formed.append(with_reciprocals(Kernel(_SOURCES, tuple(last), kernels["rhs"].prepared)))
    return AdjointKernels(tuple(formed), len(sources))


def _weights(dag: Dag, n: int) -> list[Node]:
    return [dag.symbol(SENSITIVITY, i) for i in range(n)]


def _sources(kernels: Iterable[Kernel], symbols: Sequence[Node]) -> list[Node]:
    """Return the values read by kernels that depend on certain parameters and nothing else."""
    read: dict[Node, None] = {}
    for kernel in kernels:
        read |= {
            node: None
            for node in kernel.order
            if node in kernel.prepared or (node.op == "symbol" and node.data[0] == PARAMETER)
        }
    wanted = set(symbols)
    return [node for node in read if not wanted.isdisjoint(reachable([node]))]


def _inputs(program: Program, replaced: Collection[str]) -> Kernel:
    """Return the kernel of the inputs, with zeros for those that a run replaces."""
    kernel, zero = program.kernels["inputs"], program.dag.zero
    rows = zip(program.layout.inputs, kernel.results, strict=True)
    return replace(
        kernel, results=tuple(zero if row.name in replaced else node for row, node in rows)
    )


def _adjoints(
    program: Program, kernel: Kernel, inputs: Kernel, sources: Sequence[Node]
) -> list[Node]:
    """Return the adjoints of states and sources, including those through the inputs."""
    dag, n, m = program.dag, len(program.layout.states), len(inputs.results)
    own = [dag.symbol(STATE, i) for i in range(n)] + [dag.symbol(INPUT, i) for i in range(m)]
    # The arguments of other prepared values are not reached, either.
    ends = [*dict.fromkeys([*own, *sources, *kernel.prepared])]
    weights = _weights(dag, len(kernel.results))
    found = dict(zip(ends, adjoints(kernel.results, weights, ends), strict=False))
    # A kernel without results has no adjoints.
    of_own = [found.get(node, dag.zero) for node in own]
    through = dict(zip(ends, adjoints(inputs.results, of_own[n:], ends), strict=False))
    zero = dag.zero
    return [*of_own[:n], *(found.get(x, zero) + through.get(x, zero) for x in sources)]
