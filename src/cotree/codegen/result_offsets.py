"""Maps that write into the results of a kernel, where these stand together by columns."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.codegen.expressions import element
from cotree.codegen.printing import Constants, int_table
from cotree.dag.multi_output import results as results_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.codegen.expressions import CExpression
    from cotree.dag.nodes import Node
    from cotree.program import Kernel


@dataclass(frozen=True)
class Starts:
    """Start of each column of a map in the array of a kernel's results."""

    array: str
    places: tuple[int, ...]

    def place(self, i: int, n_rows: int) -> CExpression:
        """Give the element that holds a result of the map."""
        # Nodes number the results of a map column by column.
        column, row = divmod(i, n_rows)
        return element(self.array, self.places[column] + row)


def starts_of_maps(kernel: Kernel) -> dict[Node, Starts]:
    """Find maps whose columns are all results of the kernel unchanged, and their places there."""
    first: dict[Node, int] = {}
    for i, root in enumerate(kernel.results):
        first.setdefault(root, i)
    found = {}
    for node in kernel.order:
        if node.op != "map":
            continue
        n, own = len(node.data.results), results_of(node, node.data.n_results)
        # The first result of each column; the others must follow it in the kernel's results.
        places = tuple(first.get(root, 0) for root in own[::n])
        if all(
            kernel.results[place : place + n] == own[n * j : n * (j + 1)]
            for j, place in enumerate(places)
        ):
            found[node] = Starts(kernel.spec.result, places)
    return found


def name_starts(kernels: Iterable[Kernel]) -> Mapping[tuple[int, ...], Constants]:
    """Give each table of places a name."""
    tables = dict.fromkeys(
        starts.places for kernel in kernels for starts in starts_of_maps(kernel).values()
    )
    return {places: int_table(f"cotree_starts{i}", places) for i, places in enumerate(tables)}
