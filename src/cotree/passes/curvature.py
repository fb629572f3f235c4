"""Kernels of second derivatives: those of the sensitivities' rates by the states.

In: a program after its passes. Out: two kernels. The first computes at a point what the second
needs there; the second is linear in a direction of the states, and a method takes it once a stage.
Along the direction v it is d(J s + f_p)/dx v of every parameter: the mechanism of sensitivities,
run twice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.multi_output import SEVERAL
from cotree.dag.symbols import DIRECTION, STATE
from cotree.dag.traverse import dependent, reachable
from cotree.passes.reciprocals import with_reciprocals
from cotree.program.kernels import KERNELS, KernelSpec
from cotree.program.program import Kernel

if TYPE_CHECKING:
    from cotree.program.program import Program

_AT = KernelSpec(
    "curvature",
    KERNELS["augmented_rhs"].arguments,
    "c",
    "what curvature_along reads at a point: values that depend on no direction",
)
_ALONG = KernelSpec(
    "curvature_along",
    ("v", "k"),
    "values",
    "derivatives of the sensitivities' rates along the direction v of the states: nonzeros",
)


@dataclass(frozen=True)
class Curvature:
    """Both kernels.

    Attributes
    ----------
    at, along : Kernel
        Their ``k`` are prepared values, and what ``at`` computes.
    places : tuple of int
        Places of the results of ``along`` among the sensitivities' rates.
    """

    at: Kernel
    along: Kernel
    places: tuple[int, ...]


def form_curvature(program: Program) -> Curvature | None:
    """Differentiate the rates of sensitivities by the states.

    Parameters
    ----------
    program : Program
        After its passes.

    Returns
    -------
    Curvature or None
        None where these rates depend on the states through the sensitivities only.
    """
    dag, kernel = program.dag, program.kernels["sensitivity_rhs"]
    n = len(program.layout.states)
    direction = [dag.symbol(DIRECTION, i) for i in range(n)]
    seed = {dag.symbol(STATE, i): direction[i] for i in range(n)}
    found = tangents(kernel.results, seed)
    # Most of these derivatives vanish, and are left out of the results.
    places = tuple(i for i, node in enumerate(found) if not node.is_zero)
    if not places:
        return None
    whole = with_reciprocals(Kernel(_ALONG, tuple(found[i] for i in places), {}))
    order = reachable(whole.results)
    moving = dependent(order, direction)
    # The second kernel has no arguments but ``v`` and ``k``. Whatever else it reads, states and
    # parameters included, is therefore carried over from the first one.
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
