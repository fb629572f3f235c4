"""Texts and tables for people: HTML that a notebook shows, and columns of plain text.

In: names, numbers and texts. Out: HTML in which all of them are escaped, since they may come from a
stranger's file, in the colours of the page that it stands in, dark or light.
"""

from __future__ import annotations

import html
import textwrap
from itertools import islice
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

#: Rows and columns of a table that are shown, characters of a cell, width of a line of text, and
#: lines that a long text takes.
MOST_ROWS, MOST_COLUMNS, _MOST_TEXT, _LINE, _MOST_WRAPPED = 24, 12, 160, 96, 4

_MUTED = 'style="opacity:.7"'
_LEFT, _RIGHT = ' style="text-align:left"', ' style="text-align:right"'


def escaped(text: object, most: int = _MOST_TEXT) -> str:
    """Put a text on one line of HTML, cut short, in which nothing is markup or mathematics."""
    line = " ".join(str(text).split())
    return html.escape(line if len(line) <= most else f"{line[: most - 1]}…")


def number(value: object) -> str:
    """Write a number with six significant digits, anything else as it is."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def block(title: str, *parts: str) -> str:
    """Put a heading over parts that are HTML; those that are empty are left out."""
    # MathJax would set what stands between two dollar signs, in a unit or a message.
    head = f'<div class="tex2jax_ignore mathjax_ignore"><p><b>{escaped(title)}</b></p>'
    return "\n".join([head, *filter(None, parts), "</div>"])


def paragraph(text: str, *, muted: bool = False) -> str:
    """Write a paragraph; nothing for an empty text."""
    return f"<p{' ' + _MUTED if muted else ''}>{escaped(text, 1000)}</p>" if text else ""


def table(
    caption: str,
    head: Sequence[str],
    rows: Iterable[Sequence[object]],
    *,
    n_rows: int,
    most: int = MOST_ROWS,
) -> str:
    """Write a table of HTML, its texts to the left; nothing where there are no rows.

    Parameters
    ----------
    caption : str
        The name of the table.
    head : sequence of str
        Titles of the columns.
    rows : iterable of sequence
        Cells: numbers are written with six digits. No more rows than are shown are taken.
    n_rows : int
        How many there are.
    most : int
        How many are shown; a note says how many are not.
    """
    if not n_rows:
        return ""
    wide = len(head) > MOST_COLUMNS
    taken = [list(row[:MOST_COLUMNS]) for row in islice(rows, most)]
    # A title stands over its column as the first cell does.
    shown = [_row("th", head[:MOST_COLUMNS], taken[0])] + [_row("td", row, row) for row in taken]
    hidden = [f"{n_rows - most} more rows"] if n_rows > most else []
    hidden += [f"{len(head) - MOST_COLUMNS} more columns"] if wide else []
    note = paragraph(f"… {', '.join(hidden)}", muted=True) if hidden else ""
    body = f"<thead>{shown[0]}</thead><tbody>{''.join(shown[1:])}</tbody>"
    title = f'<caption style="text-align:left">{escaped(caption)}</caption>' if caption else ""
    # Some pages put tables into the middle.
    return f'<table style="margin-left:0">{title}{body}</table>{note}'


def _row(tag: str, cells: Sequence[object], like: Sequence[object]) -> str:
    """Write a row, with texts to the left and numbers to the right as in another one."""
    written = [
        f"<{tag}{_LEFT if isinstance(other, str) else _RIGHT}>{escaped(number(cell))}</{tag}>"
        for cell, other in zip(cells, like, strict=True)
    ]
    return f"<tr>{''.join(written)}</tr>"


def matrix(caption: str, rows: Sequence[str], columns: Sequence[str], values: object) -> str:
    """Write a matrix as a table with the names of its rows and columns.

    Parameters
    ----------
    caption : str
        Its name.
    rows, columns : sequence of str
        Names.
    values : ndarray, shape (n_rows, n_columns)
        Its entries.
    """
    if not rows or not columns:
        return ""
    entries: Sequence[Sequence[float]] = values  # type: ignore[assignment]
    body = (
        [name, *(float(x) for x in entries[i][:MOST_COLUMNS])]
        for i, name in enumerate(rows[:MOST_COLUMNS])
    )
    return table(caption, ["", *columns], body, n_rows=len(rows), most=MOST_COLUMNS)


def labelled(title: str, rows: Iterable[tuple[str, str]]) -> str:
    """Write a representation of a few lines: a title, then a label and a text under each other.

    Rows without a text are left out; long texts are wrapped.
    """
    kept = [(label, text) for label, text in rows if text]
    width = max((len(label) for label, _ in kept), default=0)
    lines = [f"<{title}>"]
    for label, text in kept:
        wrapped = textwrap.wrap(text, _LINE - width, break_on_hyphens=False)[:_MOST_WRAPPED]
        lines += [f"  {label:<{width}}  {wrapped[0]}"]
        lines += [f"  {'':<{width}}  {line}" for line in wrapped[1:]]
    return "\n".join(lines)


def cut(line: str, most: int = _LINE) -> str:
    """Cut a line of text short."""
    return line if len(line) <= most else f"{line[: most - 1]}…"


def names(items: Sequence[str], most: int = 8) -> str:
    """List names; of many the first ones and their number."""
    if len(items) <= most:
        return ", ".join(items) or "none"
    return f"{', '.join(items[:most])}, … ({len(items)})"


def preformatted(text: str) -> str:
    """Show a text as it stands, line by line; nothing for an empty one."""
    look = "font-family:monospace;white-space:pre;overflow-x:auto"
    return f'<pre style="{look}">{html.escape(text)}</pre>' if text else ""
