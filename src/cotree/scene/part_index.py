"""Numbers of parts in arrays, put into the names of nodes and the expressions of bindings.

Names of nodes hold expressions in braces, ``n{i - 1}``; expressions hold the name itself,
``R0*(1 + 0.1*i)``. Both are of the grammar of expressions, which nothing evaluates as Python.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError, SceneError, brief
from cotree.scene.expressions import parse
from cotree.scene.part_rows import replace_names

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.dag.nodes import Node

_BRACES = re.compile(r"\{([^{}]*)\}")


def in_name(text: str, index: Mapping[str, int], what: str) -> str:
    """Put numbers in the place of braces.

    Parameters
    ----------
    text : str
        A name with expressions in braces.
    index : mapping of str to int
        The values of the index.
    what : str
        What the name belongs to, for messages.

    Raises
    ------
    SceneError, ExpressionError
        If an expression is none, holds other names, or is no whole number from 0 on.
    """
    if "{" not in text:
        return text
    return _BRACES.sub(lambda match: str(_whole(match[1], index, what)), text)


def in_value(value: Any, index: Mapping[str, int], what: str) -> Any:
    """Put the numbers of a part into a value; what is then a number becomes one."""
    if not index:
        return value
    if isinstance(value, dict):
        return {k: v if k == "unit" else in_value(v, index, what) for k, v in value.items()}
    if not isinstance(value, str):
        return value
    text = in_name(value, index, what)
    used = parse(text, what).names
    if not used & index.keys():
        return text
    filled = replace_names(text, lambda name: str(index.get(name, name)))
    # A value that the index alone decides is a number, which runs may change.
    return _number(filled, {}, what) if used <= {*index, "pi"} else filled


def _whole(text: str, index: Mapping[str, int], what: str) -> int:
    number = _number(text, index, what)
    if not number.is_integer() or not 0 <= number < 2**53:
        raise SceneError(
            f"{what}: '{{{brief(text)}}}' is {number:g}: give a whole number that is not negative"
        )
    return int(number)


def _number(text: str, index: Mapping[str, int], what: str) -> float:
    dag = Dag()

    def resolve(name: str) -> Node:
        if name not in index:
            known = ", ".join(index) if index else "none, since it is no array"
            raise ExpressionError(f"uses '{brief(name)}', which is no index; known: {known}")
        return dag.constant(float(index[name]))

    found = parse(text, what).lower(dag, resolve).value
    assert found is not None  # constants fold
    return float(found)
