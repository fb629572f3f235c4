"""Heads of C functions, and lines of tables."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Collection, Iterable

_WIDTH = 98


def function_head(result: str, name: str, arguments: Collection[str]) -> str:
    """Write a function's head, broken between arguments only.

    Parameters
    ----------
    result : str
        What stands before the name: what it returns, and how it is linked.
    name : str
        Its name.
    arguments : collection of str
        Their declarations.
    """
    lines = [f"{result} {name}("]
    indent = " " * len(lines[0])
    for i, argument in enumerate(arguments):
        separator = ")" if i == len(arguments) - 1 else ","
        if len(lines[-1]) + len(argument) > _WIDTH and not lines[-1].endswith("("):
            lines[-1] = lines[-1].rstrip()
            lines.append(indent)
        lines[-1] += f"{argument}{separator} "
    return "\n".join(lines).rstrip()


def wrapped(items: Iterable[str]) -> list[str]:
    """Fill lines with items, each followed by a comma."""
    text = " ".join(f"{item}," for item in items)
    return textwrap.wrap(text, 96, break_long_words=False, break_on_hyphens=False)
