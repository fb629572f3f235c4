"""Partial derivatives of the rates by time, a kernel that implicit methods read.

In: a program after its passes. Out: the derivatives of the rates of states and sensitivities by
time at a fixed state, with the scene's own inputs varying in time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.derivative import tangents
from cotree.dag.symbols import INPUT, TIME
from cotree.program.kernels import KERNELS, KernelSpec
from cotree.program.program import Kernel

if TYPE_CHECKING:
    from cotree.program.program import Program

_SPEC = KernelSpec(
    "time_slope",
    KERNELS["augmented_rhs"].arguments,
    "dz",
    "derivatives by time of the rates of the states, then of the sensitivities",
)


def form_time_slope(program: Program) -> Kernel | None:
    """Differentiate the rates by time.

    Parameters
    ----------
    program : Program
        After its passes.

    Returns
    -------
    Kernel or None
        None where the rates depend on neither time nor inputs.
    """
    dag, kernels = program.dag, program.kernels
    rates = kernels["augmented_rhs"].results or kernels["rhs"].results
    time = {dag.symbol(TIME, 0): dag.one}
    # The inputs are the scene's own functions of time, so that the chain rule goes through them.
    moving = tangents(kernels["inputs"].results, time)
    # At a fixed state: states and sensitivities have no tangent.
    seed = {**time, **{dag.symbol(INPUT, i): node for i, node in enumerate(moving)}}
    found = tangents(rates, seed)
    if all(node.is_zero for node in found):
        return None
    return Kernel(_SPEC, tuple(found), kernels["rhs"].prepared)
