"""Lines of a scene file in which its parts are stated."""

from __future__ import annotations

import re

_HEADING = re.compile(r"\s*\[\s*([A-Za-z_]+)\s*(?:\.\s*\"?([A-Za-z0-9_-]+)\"?\s*)?[\].]")
_ENTRY = re.compile(r"\s*\"?([A-Za-z_][A-Za-z0-9_-]*)\"?\s*[=.]")
_KINDS = {
    "edges": "edge",
    "parameters": "parameter",
    "inputs": "input",
    "outputs": "output",
    "modes": "mode",
    "events": "event",
}


def statement_lines(text: str) -> dict[tuple[str, str], int]:
    """Find where the parts of a scene file are stated, by kind and name; the first line is 1."""
    found: dict[tuple[str, str], int] = {}
    section, is_own = "", False
    for number, line in enumerate(text.splitlines(), 1):
        if heading := _HEADING.match(line):
            section, name = heading[1], heading[2]
            # Keys of [edges.k] are fields of k; those of [edges] are edges.
            is_own = name is not None
            if name is not None and section in _KINDS:
                found.setdefault((_KINDS[section], name), number)
        elif not is_own and section in _KINDS and (entry := _ENTRY.match(line)):
            found.setdefault((_KINDS[section], entry[1]), number)
    return found
