"""Pass: order. Kernels that wait for one long path are written in the order of its needs.

Assumes nothing. Guarantees the same operations with the same values. Values that were formed first
stand first otherwise, and all that the path could have been overlapped with is done before it
begins, farther away than a processor looks ahead. Where the order of needs keeps more values alive,
which then pass through memory, that costs more than it gains.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.passes.rewriting import for_each_kernel
from cotree.program.cost_model import bounds

if TYPE_CHECKING:
    from cotree.program import Kernel, Program

#: Operations that a processor looks ahead, whatever their order is.
_FEW = 250
#: Operations beyond which values stay as they were formed: links that repeat then become loops. A
#: chain of 1000 rods is written in half the C; one of 100 is twice as quick in the order of needs.
_MANY = 20_000
#: If all operations together take longer than so many times the longest path, there are operations
#: to overlap it with in any order.
_MOST = 3.0


def order_by_need(program: Program) -> Program:
    """Order the values of each kernel by need, where that helps."""
    return for_each_kernel(program, _ordered)


def _ordered(kernel: Kernel) -> Kernel:
    order, prepared = kernel.order, kernel.prepared
    # A map begins when all that any of its columns needs is there.
    n = len(order) - len(prepared)
    if not _FEW <= n <= _MANY or any(node.op == "map" for node in order):
        return kernel
    started, longest = bounds(order, prepared)
    ordered = replace(kernel, is_by_need=True)
    if started >= _MOST * longest or _lifetimes(ordered) > _lifetimes(kernel):
        return kernel
    return ordered


def _lifetimes(kernel: Kernel) -> int:
    """Sum up how many values are formed while each waits to be read: the registers it takes."""
    formed = [node for node in kernel.order if node.args and node not in kernel.prepared]
    # Later statements overwrite: the last reader stays.
    last = {arg: i for i, node in enumerate(formed) for arg in node.args}
    return sum(last.get(node, i) - i for i, node in enumerate(formed))
