"""Kernels that implicit methods need: second derivatives, and derivatives by time.

In: a program after its passes. Out: three kernels. The first computes at a point what the second
needs there; the second is linear in a direction of the states, and a method takes it once a stage.
Along the direction v it is d(J s + f_p)/dx v of every parameter: the mechanism of sensitivities,
run twice. The third gives the derivatives of the rates of states and sensitivities by time at a
fixed state, with the scene's own inputs varying in time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from cotree.dag.derivative import tangents
from cotree.dag.multi_output import SEVERAL
from cotree.dag.nodes import DIRECTION, INPUT, STATE, TIME, dependent, reachable
from cotree.program.kernels import KERNELS, KernelSpec
from cotree.program.passes import with_reciprocals
from cotree.program.program import Kernel, Program

_AT = KernelSpec(
    "curvature",
    KERNELS["augmented_rhs"].arguments,
    "c",
    "values at a point for curvature_along, independent of the direction",
)
_ALONG = KernelSpec(
    "curvature_along",
    ("v", "k"),
    "values",
    "derivatives of the sensitivities' rates along the direction v of the states: nonzeros",
)


@dataclass(frozen=True)
class Curvature:
    """Both kernels."""

    #: Their ``k`` are prepared values, and what ``at`` computes.
    at: Kernel
    along: Kernel
    places: tuple[int, ...]  # places of the results of ``along`` among the sensitivities' rates


def form_curvature(program: Program) -> Curvature | None:
    """Differentiate the rates of sensitivities by the states.

    None if these rates depend on the states through the sensitivities only.
    """
    dag, kernel = program.dag, program.kernels["sensitivity_rhs"]
    n = len(program.layout.states)
    direction = [dag.symbol(DIRECTION, i) for i in range(n)]
    seed = {dag.symbol(STATE, i): direction[i] for i in range(n)}
    found = tangents(kernel.results, seed)
    # Most of these derivatives are zero, and are left out of the results.
    places = tuple(i for i, node in enumerate(found) if not node.is_zero)
    if not places:
        return None
    whole = with_reciprocals(Kernel(_ALONG, tuple(found[i] for i in places), {}))
    order = reachable(whole.results)
    moving = dependent(order, direction)
    # The second kernel has the arguments ``v`` and ``k`` only. All other values that it reads,
    # states and parameters included, are carried over from the first one.
    read = {arg for node in order if node in moving for arg in node.args}
    carried = [
        node
        for node in order
        if node in read and node not in moving and node.value is None and node.op not in SEVERAL
    ]
    return Curvature(
        Kernel(_AT, tuple(carried), kernel.prepared),
        replace(whole, prepared={node: i for i, node in enumerate(carried)}),
        places,
    )


_SPEC = KernelSpec(
    "time_slope",
    KERNELS["augmented_rhs"].arguments,
    "dz",
    "derivatives by time of the rates of the states, then of the sensitivities",
)


def form_time_slope(program: Program) -> Kernel | None:
    """Differentiate the rates by time; None if they depend on neither time nor inputs."""
    dag, kernels = program.dag, program.kernels
    rates = kernels["augmented_rhs"].results or kernels["rhs"].results
    time = {dag.symbol(TIME, 0): dag.one}
    # The inputs are the scene's functions of time, so that the chain rule includes them.
    moving = tangents(kernels["inputs"].results, time)
    # At a fixed state: states and sensitivities have no tangent.
    seed = {**time, **{dag.symbol(INPUT, i): node for i, node in enumerate(moving)}}
    found = tangents(rates, seed)
    if all(node.is_zero for node in found):
        return None
    return Kernel(_SPEC, tuple(found), kernels["rhs"].prepared)
