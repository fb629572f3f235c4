"""Expressions as Python's parser reads them, where nodes and edges may be called by its own words.

Words such as ``in`` and ``not`` may name what stands before a dot: a letter follows it there, which
nothing else of the grammar has. The parser reads such a name with a mark, which is taken off again.
"""

from __future__ import annotations

import ast
import keyword
import re

from cotree.errors import ExpressionError
from cotree.quiet import without_warnings

_WORDS = re.compile(rf"(?<!\w)({'|'.join(keyword.kwlist)})(?=\.[A-Za-z_])")
_MARK = "_ö"


def read_tree(text: str) -> ast.expr:
    """Parse a text; what the grammar of expressions refuses may still be in it.

    Raises
    ------
    ExpressionError
        If it is no expression of Python.
    """
    marked = _WORDS.sub(rf"\1{_MARK}", text.strip())
    try:
        # Leading spaces would be an indentation to Python's parser.
        with without_warnings(category=SyntaxWarning):  # what it warns of is refused later
            tree = ast.parse(marked, mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ExpressionError("is not an expression") from None
    if _MARK in marked:
        for node in ast.walk(tree):
            if isinstance(node, ast.Name):
                node.id = node.id.removesuffix(_MARK)
            elif isinstance(node, ast.Attribute):
                node.attr = node.attr.removesuffix(_MARK)
    return tree
