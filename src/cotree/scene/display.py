"""A scene and its tables as people see them, at a prompt and in a notebook."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.markup import block, cut, paragraph, table

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from cotree.scene.description import Edge, SceneDescription

_MOST_LINES = 24


class Listing(dict[str, Any]):
    """A table of a scene by name, which shows itself a line a row.

    Its rows have ``cells()``: texts and numbers, the name first, under ``titles``.
    """

    titles: tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Return a line for each row, of a long table for the first ones."""
        rows = [list(map(str, row)) for row in self._rows()][:_MOST_LINES]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        lines = [
            "  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip()
            for row in rows
        ]
        hidden = len(self) - _MOST_LINES
        lines += [f"… {hidden} more"] if hidden > 0 else []
        return "\n".join(map(cut, lines)) or "{}"

    def _repr_html_(self) -> str:
        """Show the table in a notebook."""
        return block("", table("", self.titles, self._rows(), n_rows=len(self))) if self else "none"

    def _rows(self) -> Iterable[Sequence[object]]:
        return (row.cells() for row in self.values())


class ParameterListing(Listing):
    """Parameters by name."""

    titles = ("name", "value", "unit", "meaning")


class EdgeListing(Listing):
    """Edges by name."""

    titles = ("name", "type", "nodes", "fields")


def edge_cells(edge: Edge) -> tuple[str, str, str, str]:
    """Return name, type, nodes and fields of an edge, as it was stated."""
    known = {"type", "nodes", "initial"}
    fields = ", ".join(f"{k}={_plain(v)}" for k, v in edge.statement.items() if k not in known)
    between = " → " if len(edge.nodes) == 2 else ", "
    return edge.name, edge.component.name, between.join(edge.nodes), fields


def _plain(value: object) -> str:
    """Write a value of a field without quotes: texts are expressions."""
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(_plain, value))}]"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{k}={_plain(v)}' for k, v in value.items())}}}"
    return f"{value:g}" if isinstance(value, float) else str(value)


def scene_summary(scene: SceneDescription) -> str:
    """Describe a scene: its headline, and a line for each edge, part and derived parameter.

    What parts hold is not listed again, but counted in their lines.
    """
    lines = [scene.headline]
    for edge in scene.edges.values():
        if "." in edge.name:
            continue
        nodes = (" -> " if len(edge.nodes) == 2 else ", ").join(edge.nodes)
        places = [f"on {edge.statement['joint']}"] if "joint" in edge.statement else []
        places += [f"on {' - '.join(e.acts_on)}" for e in edge.ports if len(e.acts_on) == 2]
        where = ", ".join([*([nodes] if nodes else []), *places])
        lines.append(f"  {edge.name:12} {edge.component.name:12} {where}")
    lines += [f"  {part.shown}" for part in scene.parts.values()]
    derived = (row for row in scene.parameters.values() if row.is_derived and "." not in row.name)
    lines += [f"  {row.name} = {row.cells()[1]}" for row in derived]
    lines += [f"  note: {note}" for note in (scene.origin.notes if scene.origin else ())]
    return "\n".join(lines)


def scene_html(scene: SceneDescription) -> str:
    """Show the tables of a scene."""
    parameters, edges = scene.parameters.values(), scene.edges.values()
    rest = [
        (kind, name, text)
        for kind, rows in (
            ("input", {name: row.value for name, row in scene.inputs.items()}),
            ("output", scene.outputs),
            ("mode", {name: row.initial for name, row in scene.modes.items()}),
            ("event", {name: row.when for name, row in scene.events.items()}),
        )
        for name, text in ((name, getattr(row, "text", "table")) for name, row in rows.items())
    ]
    notes = scene.origin.notes if scene.origin else ()
    return block(
        f"Scene {scene.headline}",
        table("edges", EdgeListing.titles, map(edge_cells, edges), n_rows=len(edges)),
        table(
            "parameters",
            ParameterListing.titles,
            (row.cells() for row in parameters),
            n_rows=len(parameters),
        ),
        table("", ["", "name", "expression"], rest, n_rows=len(rest)),
        *(paragraph(f"note: {note}", muted=True) for note in notes[:5]),
    )
