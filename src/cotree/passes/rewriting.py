"""The driver of passes that put other values in the place of some: one walk over each kernel."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.dag.traverse import rebuilt

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Mapping

    from cotree.dag.nodes import Node
    from cotree.program import Kernel, Program


def for_each_kernel(program: Program, change: Callable[[Kernel], Kernel]) -> Program:
    """Change every kernel of a program by itself."""
    kernels = {name: change(kernel) for name, kernel in program.kernels.items()}
    return replace(program, kernels=kernels)


def rewrite(
    kernel: Kernel, chosen: Container[Node], form: Callable[[Node, Mapping[Node, Node]], Node]
) -> Kernel:
    """Put other values in the place of some, and rebuild all that depend on them.

    Parameters
    ----------
    kernel : Kernel
        The kernel.
    chosen : container of Node
        The values that are replaced.
    form : callable
        Gives the new value of one of these, from it and from what has been replaced so far.

    Returns
    -------
    Kernel
        New values keep the labels of those that they replace.
    """
    new: dict[Node, Node] = {}
    for node in kernel.order:
        if node in chosen:
            with node.dag.labelled(node.section):
                made = form(node, new)
        elif not new.keys().isdisjoint(node.args):
            with node.dag.labelled(node.section):
                made = rebuilt(node, new)
        else:
            continue
        # Values that come out the same are not replaced, so that nothing above them is rebuilt.
        if made is not node:
            new[node] = made
    return replace(kernel, results=tuple(new.get(node, node) for node in kernel.results))
