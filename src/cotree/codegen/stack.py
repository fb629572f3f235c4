"""Upper bound of the stack that a function of the generated C takes.

In: its lines. Out: a bound in bytes, from its declarations: an optimising compiler keeps many of
these values in registers, one that does not optimise keeps all of them on the stack.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.codegen.c_statements import ALIGNED, ARRAY, SCALAR

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.codegen.blocks import Block

#: Bytes of one number; of a vector, the widest that a machine has.
_SIZES = {"double": 8, "int": 8, "VECTOR": 64}

#: Further bytes of each function: registers that it saves, arguments, parts of expressions.
_OWN = 512

#: Most bytes of the functions that come with every model: sines, linear systems, tables.
_HELPER = 2048


def n_bytes(lines: Iterable[str], blocks: Iterable[Block], called: Mapping[str, int]) -> int:
    """Count the bytes that a function and those that it calls take at most.

    Parameters
    ----------
    lines : iterable of str
        Its statements.
    blocks : iterable of Block
        Its blocks, which it calls in turn.
    called : mapping of str to int
        Bytes that other functions take which it may call, by their names in C.

    Returns
    -------
    int
        The bytes, without those of functions of the C library and of users.
    """
    rows, inner = list(lines), [block.lines for block in blocks]
    text = "\n".join(line for part in (rows, *inner) for line in part)
    sizes = [size for name, size in called.items() if f"{name}(" in text]
    helper = _HELPER if "cotree_" in text else 0
    return _frame(rows) + max(map(_frame, inner), default=0) + max(helper, *sizes, 0)


def _frame(lines: Iterable[str]) -> int:
    """Count the bytes that one function declares."""
    found = _OWN
    for line in lines:
        if scalar := SCALAR.match(line.strip()):
            found += _SIZES[scalar.group(1)]
        elif array := ARRAY.match(line):
            kind, _, first, _, second, _ = array.groups()
            found += _SIZES[kind.removeprefix(ALIGNED)] * (int(first) + int(second or 0))
    return found
