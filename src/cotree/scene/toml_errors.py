"""Remedies for faulty TOML files, to stand at the end of the parser's own message."""

from __future__ import annotations

import difflib
import re
from typing import TYPE_CHECKING, Any

from cotree.components import COMPONENTS
from cotree.errors import brief

if TYPE_CHECKING:
    from collections.abc import Mapping

# What the parser says, and what a person would do; the first that fits counts.
_ADVICE = (
    (
        "Cannot overwrite a value",
        "this key stands twice in its table: remove one, or put back the header, such as "
        "[edges.name], that is missing between them",
    ),
    (r"Cannot declare .* twice", "this header stands twice: remove one, or rename it"),
    (r"Illegal character '\\n'", "the text that begins here has no quote at its end"),
    ("Unterminated string", "a text has no quote at its end"),
    (
        "Unclosed array",
        "here the list should go on with ',' or end with ']', unless a number before is mistyped "
        "or a quote is missing",
    ),
    (
        "Unclosed inline table",
        "here the table should go on with ',' or end with '}', unless a number before is mistyped "
        "or a quote is missing",
    ),
    ("Expected '=' after a key", "write name = value"),
    ("Invalid statement", "write name = value, or a header such as [outputs]"),
    ("Expected '.*' at the end of a table declaration", "a header ends with ']'"),
    ("Invalid initial character for a key", "a name is expected here, without quotes or signs"),
    (
        "Expected newline or end of document after a statement",
        "something is left over behind the value: numbers have a point, as 1.5, and exponents "
        "digits, as 1e-3; each statement has a line of its own",
    ),
    (
        "Invalid value",
        "behind '=' stands a number, a text in quotes, a list in [ ] or a table in { }",
    ),
    ("Cannot mutate immutable", "this table is written in { } elsewhere: add to it there"),
)


def advice(message: str, text: str) -> str:
    """Say what to do about an error of the TOML parser.

    Parameters
    ----------
    message : str
        The parser's own words, which end with a place such as ``(at line 3, column 7)``.
    text : str
        The file.

    Returns
    -------
    str
        The line at fault and the remedy, to be put behind the message.
    """
    lines = text.split("\n")
    place = re.search(r"\(at line (\d+), column (\d+)\)", message)
    number = int(place[1]) if place else len(lines)
    # The parser goes on to the next line where something is not closed; its end is the culprit.
    while number > 1 and not lines[number - 1].strip():
        number -= 1
    line = brief(lines[number - 1], 80)
    remedy = next((told for said, told in _ADVICE if re.search(said, message)), "")
    return f", in `{line}`" + (f": {remedy}" if remedy else "")


# What every edge may have, whatever its type.
_OF_EDGES = ("type", "nodes", "initial")


def misspelt_key(name: str, edge: Mapping[str, Any]) -> str:
    """Say which key stands for a misspelt ``type``, ``nodes`` or ``initial``; or nothing."""
    component = COMPONENTS.get(str(edge.get("type")))
    own = {row.name for row in component.fields} if component else set()
    absent = [key for key in _OF_EDGES if key not in edge]
    for key in edge:
        if key in _OF_EDGES or key in own:
            continue
        close = difflib.get_close_matches(str(key)[:80].lower(), absent, n=1, cutoff=0.74)
        if close:
            return f"edge '{name}' has no field '{brief(key)}'; did you mean '{close[0]}'?"
    return ""
