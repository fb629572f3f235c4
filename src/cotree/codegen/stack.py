"""Upper bound of the stack that a function of the generated C takes.

In: its statements. Out: a bound in bytes, from its declarations: an optimising compiler keeps many
of these values in registers, one that does not optimise keeps all of them on the stack.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.codegen.statements import REAL, Array, Assign, kind_of, simple, uses

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.codegen.blocks import Blocks
    from cotree.codegen.statements import Statement

#: Bytes of one number; of a vector, the widest that a machine has.
NUMBER, VECTOR = 8, 64

#: Further bytes of each function: registers that it saves, arguments, parts of expressions.
_OWN = 512

#: Most bytes of the functions that come with every model: sines, linear systems, tables.
_HELPER = 2048


def n_bytes(blocks: Blocks, called: Mapping[str, int], real: int = NUMBER) -> int:
    """Count the bytes that a function and those that it calls take at most.

    Parameters
    ----------
    blocks : Blocks
        Its statements, and those of its blocks, which it calls in turn.
    called : mapping of str to int
        Bytes that other functions take which it may call, by their names in C.
    real : int
        Bytes of one of the values that statements compute with.

    Returns
    -------
    int
        The bytes, without those of functions of the C library and of users.
    """
    inner = [function.body for function in blocks.functions]
    # Functions are told by their names in the statements that call them.
    names = {key for rows in (blocks.statements, *inner) for row in rows for key in uses(row)}
    sizes = [size for name, size in called.items() if name in names]
    helper = any(isinstance(name, str) and name.startswith("cotree_") for name in names)
    # Blocks are called one after another, so the largest of their frames counts.
    deepest = max((_frame(rows, real) for rows in inner), default=0)
    return _frame(blocks.statements, real) + deepest + max(_HELPER * helper, *sizes, 0)


def _frame(statements: Iterable[Statement], real: int) -> int:
    """Count the bytes that one function declares."""
    found = _OWN
    for row in simple(statements):
        if isinstance(row, Array):
            found += row.length * (real if row.kind == REAL else NUMBER)
        elif isinstance(row, Assign) and row.declares is not None:
            found += real if kind_of(row.declares) == REAL else NUMBER
    return found
