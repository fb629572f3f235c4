"""Pass: order. Kernels that wait for one long path are written in the order of its needs.

Assumes nothing. Guarantees the same operations with the same values. Values that were formed first
stand first otherwise, and all that the path could have been overlapped with is done before it
begins, farther away than a processor looks ahead.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.program.machine import bounds

if TYPE_CHECKING:
    from cotree.program import Kernel, Program

#: Operations that a processor looks ahead, whatever their order is.
_FEW = 250
#: Where all operations together take longer than so many times the longest path, something is there
#: to overlap it with in any order, and values that are formed long before they are read cost more.
_MOST = 3.0


def order_by_need(program: Program) -> Program:
    """Order the values of each kernel by need, where that helps."""
    kernels = {name: _ordered(kernel) for name, kernel in program.kernels.items()}
    return replace(program, kernels=kernels)


def _ordered(kernel: Kernel) -> Kernel:
    order = kernel.order
    # A map begins when all that any of its columns needs is there.
    if len(order) - len(kernel.prepared) < _FEW or any(node.op == "map" for node in order):
        return kernel
    started, longest = bounds(order, kernel.prepared)
    return replace(kernel, is_by_need=True) if started < _MOST * longest else kernel
