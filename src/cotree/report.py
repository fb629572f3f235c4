"""Reports of objects: text in terminals, HTML in notebooks.

All texts are escaped in HTML, since they may come from untrusted files.
"""

from __future__ import annotations

import html
import math
import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.errors import optional_package

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

#: Largest numbers of rows and columns of an HTML table, of characters in a cell and in a line of
#: text, and of lines of a long text.
MOST_ROWS, MOST_COLUMNS, _MOST_TEXT, _LINE, _MOST_WRAPPED = 24, 12, 160, 96, 4

_SIDES = {"l": ' style="text-align:left"', "r": ' style="text-align:right"'}


@dataclass(frozen=True)
class Table:
    """A table of texts and numbers under headings; numbers are right-aligned.

    ``align`` has for each column ``l`` or ``r``, by default decided by the first row. ``digits``
    are significant digits of numbers. In text, only the first ``in_text`` columns are shown; in
    HTML, at most ``most`` rows.
    """

    head: Sequence[str]
    rows: Sequence[Sequence[object]]
    caption: str = ""
    align: str = ""
    digits: int = 6
    in_text: int | None = None
    most: int = MOST_ROWS

    @property
    def is_headed(self) -> bool:
        """Return whether the text has headings."""
        return any(self.head)

    @property
    def is_apart(self) -> bool:
        """Return whether empty lines surround the table in text."""
        return bool(self.caption) or self.is_headed

    def text(self, most: int | None = None) -> str:
        """Return the rows in aligned columns, or an empty string if there are none."""
        if not self.rows or self.in_text == 0:
            return ""
        lines = self._lines([self._written(row[: self.in_text]) for row in self.rows[:most]])
        lines = [line.rstrip() for line in lines]
        if most is not None:
            lines = [cut(line) for line in lines]
            lines += [f"… {len(self.rows) - most} more"] if len(self.rows) > most else []
        margin = "  " if self.caption or not self.is_headed else ""
        lines = [f"{margin}{line}" for line in lines]
        return "\n".join([self.caption, *lines] if self.caption else lines)

    def html(self) -> str:
        """Return the table as HTML, or an empty string if it has no rows."""
        if not self.rows or not self.most:
            return ""
        shown = [_row("td", self._written(row), self._sides) for row in self.rows[: self.most]]
        head = _row("th", self.head, self._sides) if any(self.head) else ""
        hidden = {"rows": len(self.rows) - self.most, "columns": len(self.head) - MOST_COLUMNS}
        note = ", ".join(f"{n} more {what}" for what, n in hidden.items() if n > 0)
        title = f'<caption style="text-align:left">{escaped(self.caption)}</caption>'
        body = f"<thead>{head}</thead><tbody>{''.join(shown)}</tbody>"
        # The style overrides pages that centre all tables.
        found = f'<table style="margin-left:0">{title if self.caption else ""}{body}</table>'
        return found + (f'<p style="opacity:.7">… {note}</p>' if note else "")

    def _lines(self, rows: Sequence[Sequence[str]]) -> list[str]:
        rows = [self.head[: self.in_text], *rows] if self.is_headed else rows
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        return [
            "  ".join(
                f"{cell:>{width}}" if side == "r" else f"{cell:<{width}}"
                for cell, width, side in zip(row, widths, self._sides, strict=False)
            )
            for row in rows
        ]

    @property
    def _sides(self) -> str:
        return self.align or "".join("l" if isinstance(x, str) else "r" for x in self.rows[0])

    def _written(self, row: Sequence[object]) -> list[str]:
        return [f"{x:.{self.digits}g}" if isinstance(x, float) else str(x) for x in row]


def _row(tag: str, cells: Sequence[str], sides: str) -> str:
    written = [
        f"<{tag}{_SIDES[side]}>{escaped(cell)}</{tag}>"
        for cell, side in list(zip(cells, sides, strict=False))[:MOST_COLUMNS]
    ]
    return f"<tr>{''.join(written)}</tr>"


class Values(Table):
    """A table of named values with units, and with further columns in HTML."""

    is_headed = False

    def _lines(self, rows: Sequence[Sequence[str]]) -> list[str]:
        width = max(len(row[0]) for row in rows)
        # A positive number begins with a space, to align it with negative numbers.
        gaps = [" " if isinstance(row[1], float) and not row[1] < 0.0 else "" for row in self.rows]
        return [
            f"{name:<{width}} = {gap}{' '.join(rest)}"
            for gap, (name, *rest) in zip(gaps, rows, strict=False)
        ]


class Facts(Table):
    """A table of labels and texts; long texts are wrapped."""

    def __init__(self, rows: Iterable[tuple[str, str]]) -> None:
        """Keep only the rows that contain text."""
        super().__init__((), [(label, text) for label, text in rows if text])

    def _lines(self, rows: Sequence[Sequence[str]]) -> list[str]:
        width = max(len(row[0]) for row in rows)
        return [
            f"{label if first else '':<{width}}  {line}"
            for label, text in rows
            for first, line in _wrapped(text, _LINE - width)
        ]


def _wrapped(text: str, width: int) -> list[tuple[bool, str]]:
    """Wrap a text; return its lines up to a limit, each with whether it is the first."""
    lines = textwrap.wrap(text, width, break_on_hyphens=False)[:_MOST_WRAPPED]
    return [(i == 0, line) for i, line in enumerate(lines)]


@dataclass(frozen=True)
class Report:
    """A title with sentences and tables; empty parts are left out."""

    title: str
    parts: tuple[str | Table, ...]

    def __init__(self, title: str, *parts: str | Table) -> None:
        object.__setattr__(self, "title", title)
        object.__setattr__(self, "parts", parts)

    def text(self, most: int | None = None) -> str:
        """Return the report as text; ``most`` limits the rows of each table."""
        lines, was_apart = [self.title] if self.title else [], False
        for part in self.parts:
            text = part if isinstance(part, str) else part.text(most)
            if text:
                is_apart = not isinstance(part, str) and part.is_apart
                lines += [""] if lines and (is_apart or was_apart) else []
                lines.append(text)
                was_apart = is_apart
        return "\n".join(lines)

    def brief(self) -> str:
        """Return the title and the facts below it."""
        facts = [part for part in self.parts if isinstance(part, (Facts, Values))]
        shown = [part.text() for part in facts if part.rows and not part.caption]
        return "\n".join([f"<{self.title}>", *shown])

    def html(self) -> str:
        """Return the report as HTML."""
        # These classes prevent MathJax from formatting text between dollar signs.
        head = '<div class="tex2jax_ignore mathjax_ignore">'
        title = f"<p><b>{escaped(self.title, 1000)}</b></p>" if self.title else ""
        parts = [
            f"<p>{escaped(part, 1000)}</p>" if isinstance(part, str) else part.html()
            for part in self.parts
            if part
        ]
        return "\n".join([head + title, *filter(None, parts), "</div>"])


class Reported:
    """Base class of objects that are displayed as a report in terminals and notebooks."""

    def report(self) -> Report:
        """Build the report."""
        raise NotImplementedError

    def summary(self) -> str:
        """Return the report as text."""
        return self.report().text()

    def __str__(self) -> str:
        """Return the report as text."""
        return self.report().text()

    def __repr__(self) -> str:
        """Return the title and the facts of the report."""
        return self.report().brief()

    def _repr_html_(self) -> str:
        return self.report().html()


class Listing(Reported, dict[str, Any]):
    """Objects by name, shown as a table of their ``cells()``: texts and numbers, the name first."""

    def __init__(self, *head: str) -> None:
        super().__init__()
        self.head = head

    def report(self) -> Report:
        """Build the report: a table."""
        return Report("", Table(self.head, [row.cells() for row in self.values()]))

    def __repr__(self) -> str:
        """Return a line for each row, or for the first ones of a long table."""
        return self.report().text(MOST_ROWS) or "{}"

    __str__ = __repr__


def frame(data: Sequence[Mapping[str, Any]] | Mapping[str, Any], index: str | None = None) -> Any:
    """Convert rows or columns to a pandas DataFrame; raise Error if pandas is not installed."""
    table = optional_package("pandas", "tables need", "data").DataFrame(data)
    return table.set_index(index) if index and len(table) else table


def json_values(value: Any) -> Any:
    """Convert numbers, arrays and tables to JSON values; None if a number is not finite."""
    if isinstance(value, Mapping):
        return {key: json_values(item) for key, item in value.items()}
    if hasattr(value, "tolist"):  # NumPy arrays and scalars
        return json_values(value.tolist())
    if isinstance(value, (list, tuple)):
        return [json_values(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def matrix(caption: str, rows: Sequence[str], columns: Sequence[str], values: Any) -> Table:
    """Return a table for HTML of a matrix (n_rows, n_columns) with named rows and columns."""
    shown = zip(rows, values[:, :MOST_COLUMNS].tolist(), strict=True) if columns else ()
    body = [(name, *entries) for name, entries in shown]
    return Table(("", *columns), body, caption, in_text=0, most=MOST_COLUMNS)


def escaped(text: object, most: int = _MOST_TEXT) -> str:
    """Shorten a text to one line and escape it for HTML."""
    line = " ".join(str(text).split())
    return html.escape(line if len(line) <= most else f"{line[: most - 1]}…")


def cut(line: str, most: int = _LINE) -> str:
    """Shorten a line of text."""
    return line if len(line) <= most else f"{line[: most - 1]}…"


def names(items: Sequence[str], most: int = 8) -> str:
    """Join names by commas; a long list is cut and followed by the number of names."""
    if len(items) <= most:
        return ", ".join(items) or "none"
    return f"{', '.join(items[:most])}, … ({len(items)})"


def counted(n: int, noun: str) -> str:
    """Return a number and a noun, in the plural unless the number is 1."""
    return f"{n} {noun}{'s' if n != 1 else ''}"
