"""Pass: sines together. Sines and cosines of several angles become one node, which C vectorises.

Assumes nothing. Guarantees the same values to a rounding of the last place. Taken together are
angles that depend on no sine themselves; those of parameters only stay, since ``prepare`` has them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.dag.multi_output import sines
from cotree.dag.traverse import dependent
from cotree.passes.rewriting import for_each_kernel, rewrite
from cotree.passes.stage import varying_values

if TYPE_CHECKING:
    from cotree.program import Kernel, Program

#: Fewer angles than these cost less one by one.
_FEWEST = 3


def pack_sines(program: Program) -> Program:
    """Take the sines and cosines of each kernel together."""
    return for_each_kernel(program, _packed)


def _packed(kernel: Kernel) -> Kernel:
    order = kernel.order
    found = [node for node in order if node.op in ("sin", "cos")]
    varying = varying_values(order)
    # An angle that depends on a sine of its own kernel cannot be taken together with it.
    late = dependent(order, found) - set(found)
    angles = list(
        dict.fromkeys(n.args[0] for n in found if n.args[0] in varying and n.args[0] not in late)
    )
    if len(angles) < _FEWEST:
        return kernel
    dag = angles[0].dag
    # One node serves the sines and the cosines of an angle, whichever of them are read.
    with dag.labelled("sines and cosines"):
        packed = sines(dag, angles)
    place = {angle: i for i, angle in enumerate(angles)}
    first = {"sin": 0, "cos": len(angles)}
    taken = {n: packed[first[n.op] + place[n.args[0]]] for n in found if n.args[0] in place}
    return rewrite(kernel, taken, lambda node, _: taken[node])
