"""Calls of a scene's lookup tables within its expressions.

Expressions are parsed deep inside the fields of edges, events and parts. The tables that they may
call are therefore known to all that is parsed during a method of their scene. A call is bound to
its table once: the name of the function carries it, through every rewriting of the tree.
"""

from __future__ import annotations

import ast
from contextlib import contextmanager
from contextvars import ContextVar
from functools import wraps
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from cotree.dag.nodes import Dag, Node

_Method = TypeVar("_Method", bound="Callable[..., Any]")


class Callee(Protocol):
    """A function that an expression may call beside those of its grammar."""

    @property
    def n_arguments(self) -> int:
        """Number of arguments."""
        ...

    @property
    def names(self) -> frozenset[str]:
        """Parameters that its values depend on."""
        ...

    def node(self, dag: Dag, args: list[Node], resolve: Callable[[str], Node]) -> Node:
        """Form the node of its value."""
        ...


_KNOWN: ContextVar[Mapping[str, Callee]] = ContextVar("known tables")
_NONE: Mapping[str, Callee] = {}


def known_tables() -> Mapping[str, Callee]:
    """Give the tables that expressions may call now."""
    return _KNOWN.get(_NONE)


@contextmanager
def knowing(tables: Mapping[str, Callee]) -> Iterator[None]:
    """Let what is parsed inside the ``with`` block call some tables, and no others."""
    token = _KNOWN.set(tables)
    try:
        yield
    finally:
        _KNOWN.reset(token)


def may_call_tables(method: _Method) -> _Method:
    """Let the expressions that a method of a scene takes call the tables of the scene."""

    @wraps(method)
    def knowing_tables(self: Any, *args: Any, **more: Any) -> Any:
        with knowing(self.tables):
            return method(self, *args, **more)

    return cast("_Method", knowing_tables)


def calls_table(text: str, tables: Mapping[str, Callee]) -> bool:
    """Tell whether a text may call one of some tables."""
    return "(" in text and any(name in text for name in tables)


def bound(tree: ast.expr, tables: Mapping[str, Callee]) -> ast.expr:
    """Bind the calls of tables in a tree that has just been parsed."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call) and (table := tables.get(ast.unparse(node.func))):
            node.func = name_of(ast.unparse(node.func), table)
    return tree


def name_of(name: str, table: Callee) -> ast.Name:
    """Make the name by which a tree calls a table."""
    made = ast.Name(name)
    made.table = table  # type: ignore[attr-defined]
    return made


def table_of(called: ast.expr) -> Callee | None:
    """Give the table that a tree calls, or None for a function of the grammar."""
    return getattr(called, "table", None)


def has_table(tree: ast.expr) -> bool:
    """Tell whether a tree calls a table anywhere."""
    return any(isinstance(node, ast.Name) and table_of(node) for node in ast.walk(tree))
