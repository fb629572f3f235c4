"""The linear graphs of a scene with their trees and topology matrices, as text and pictures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.choice import tried
from cotree.graph import f_circuit, f_cutset, incidence
from cotree.report import Facts, Report, Table, names

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from matplotlib.figure import Figure

    from cotree.choice import Alternative
    from cotree.graph import LinearGraph, TopologyMatrix, Tree


@dataclass(frozen=True, repr=False)
class GraphReport:
    """Linear graphs, trees and matrices by domain.

    Attributes
    ----------
    graphs, trees : mapping of str to LinearGraph and Tree
        By domain: ``translation`` and ``rotation``.
    incidence, f_cutset, f_circuit : mapping of str to TopologyMatrix
        Integer matrices with the names of their rows and columns.
    costs : tuple of Alternative
        Cost of the right-hand side for each compared tree, the cheapest first; then for pairs of
        different trees for translation and rotation.
    parts : tuple of str
        Parts of the scene; the edges of each part have a background of one colour.
    """

    graphs: Mapping[str, LinearGraph]
    trees: Mapping[str, Tree]
    incidence: Mapping[str, TopologyMatrix]
    f_cutset: Mapping[str, TopologyMatrix]
    f_circuit: Mapping[str, TopologyMatrix]
    costs: tuple[Alternative, ...] = ()
    parts: tuple[str, ...] = ()

    def draw(self) -> Figure:
        """Draw the graphs side by side, with trees in bold."""
        from cotree.plot import draw_graphs
        from cotree.plot.figures import figure_for_people

        return draw_graphs(self._pairs(), figure_for_people, self.parts)

    def save(self, path: str | Path) -> None:
        """Draw the graphs into an SVG, PNG or PDF file; raise SceneError if that is impossible."""
        from cotree.plot import draw_graphs, save_figure

        save_figure(draw_graphs(self._pairs(), parts=self.parts), path)

    def _pairs(self) -> list[tuple[LinearGraph, Tree]]:
        return [(graph, self.trees[name]) for name, graph in self.graphs.items()]

    def summary(self) -> str:
        """Return a text with the graphs, trees and matrices."""
        parts: list[str | Table] = []
        for name, graph in self.graphs.items():
            above = "\n" if parts else ""
            parts += [f"{above}{graph.summary()}", self.trees[name].summary()]
            parts += ["f-cutsets", self.f_cutset[name].summary()]
            parts += ["f-circuits", self.f_circuit[name].summary()]
        for is_one, caption in (
            # Only trees common to translation and rotation are chosen automatically.
            (True, "trees by operations of the right-hand side; the first is used"),
            (False, "different trees for translation and rotation, used only if named"),
        ):
            parts.append(tried(caption, [row for row in self.costs if row.trees.is_one == is_one]))
        return Report("", *parts).text()

    def __repr__(self) -> str:
        trees = [(f"{name} tree", names(tree.branches)) for name, tree in self.trees.items()]
        return Report("GraphReport", Facts(trees)).brief()

    def _repr_svg_(self) -> str:
        from cotree.plot import draw_graphs, svg_text

        return svg_text(draw_graphs(self._pairs(), parts=self.parts))

    def __str__(self) -> str:
        """Return a text with the graphs, trees and matrices."""
        return self.summary()


def graph_report(
    graphs: Mapping[str, LinearGraph],
    trees: Mapping[str, Tree],
    costs: tuple[Alternative, ...] = (),
    parts: tuple[str, ...] = (),
) -> GraphReport:
    """Build the report with graphs, trees and their matrices ([1] eq. 1, 2) by domain."""
    return GraphReport(
        graphs,
        trees,
        {name: incidence(graph) for name, graph in graphs.items()},
        {name: f_cutset(tree) for name, tree in trees.items()},
        {name: f_circuit(tree) for name, tree in trees.items()},
        costs,
        parts,
    )
