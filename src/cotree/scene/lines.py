"""Lines of a scene file in which its declarations are stated."""

from __future__ import annotations

import re

_KEY = r'(?:[A-Za-z0-9_-]+|"[^"]*")'
_HEADING = re.compile(rf"\s*\[\[?\s*({_KEY}(?:\s*\.\s*{_KEY})*)\s*\]")
_ENTRY = re.compile(r"\s*\"?([A-Za-z_][A-Za-z0-9_-]*)\"?\s*[=.]")
_STEP = re.compile(_KEY)
_KINDS = {
    "edges": "edge",
    "parameters": "parameter",
    "inputs": "input",
    "outputs": "output",
    "modes": "mode",
    "events": "event",
    "parts": "part",
    "tables": "table",
}


def statement_lines(text: str, section: str = "") -> dict[tuple[str, str], int]:
    """Find where the declarations of a scene file are stated; the first line is 1.

    Parameters
    ----------
    text : str
        The file.
    section : str
        The table of the file that holds the scene, as ``scenes.leg``; the whole file where empty.

    Returns
    -------
    dict of (str, str) to int
        Lines by kind and name.
    """
    found: dict[tuple[str, str], int] = {}
    within = section.split(".") if section else []
    table, is_own = "", False
    for number, line in enumerate(text.splitlines(), 1):
        if heading := _HEADING.match(line):
            steps = [step.strip('"') for step in _STEP.findall(heading[1])]
            # Another table of the file is none of this scene.
            steps = steps[len(within) :] if steps[: len(within)] == within else []
            table = steps[0] if steps else ""
            # Keys of [edges.k] are fields of k; those of [edges] are edges.
            is_own = len(steps) > 1
            if is_own and table in _KINDS:
                found.setdefault((_KINDS[table], steps[1]), number)
        elif not is_own and table in _KINDS and (entry := _ENTRY.match(line)):
            found.setdefault((_KINDS[table], entry[1]), number)
    return found
