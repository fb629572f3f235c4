"""Upper bound of the stack that a function of the generated C takes.

In: its statements. Out: a bound in bytes, from what gcc does on 64-bit machines without
optimisation: every declared value has a place on the stack, and so has each argument. An optimising
compiler keeps many of them in registers, so that its frames are smaller, mostly by a third.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

from cotree.codegen.statements import REAL, WHOLE, Array, Assign, Loop, kind_of, simple, uses
from cotree.dag.operations import OPERATIONS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cotree.codegen.blocks import Blocks
    from cotree.codegen.expressions import Form
    from cotree.codegen.statements import Statement

#: Bytes of one number; of a vector, the widest that a machine has.
NUMBER, VECTOR = 8, 64

#: The return address and the frame of the caller; a word, which a pointer and an argument have.
_LINK, _WORD = 16, 8
#: Frames are whole multiples of this; arrays that vectors are read from, of a vector.
_ALIGNMENT = 16
#: A register that a function saves where it calls others, with the place that keeps the alignment.
_SAVED = 16
#: So many intermediate values wait for the results of other functions at most.
_MOST_WAITING = 3

# What gcc 12 measures (-O0 -mno-red-zone -fstack-usage) of the functions that come with a model.
#: Of the elimination in loops, and of reading a table.
_HELPERS = {"cotree_factorise": 112, "cotree_table": 72, "cotree_cubic": 152, "cotree_plane": 192}
_HELPERS |= {"cotree_held_table": 96, "cotree_held_plane": 256}
#: Several sines at once, with the function that selects them by processor.
_SINES = 1632
#: The elimination of one to three unknowns that is written out.
_SMALLEST_SYSTEMS = {1: 224, 2: 272, 3: 368}


def n_bytes(blocks: Blocks, called: Mapping[str, int], n_arguments: int, real: int = NUMBER) -> int:
    """Count the bytes that a function and those that it calls take at most.

    Parameters
    ----------
    blocks : Blocks
        Its statements, and those of its blocks, which it calls in turn.
    called : mapping of str to int
        Bytes that other functions take which it may call, by their names in C.
    n_arguments : int
        How many arguments it has.
    real : int
        Bytes of one of the values that statements compute with.

    Returns
    -------
    int
        The bytes, without those of functions of the C library and of users.
    """
    inner = [(function.body, len(function.arguments)) for function in blocks.functions]
    own = [(blocks.statements, n_arguments), *inner]
    # Functions are told by their names in the statements that call them.
    names = {key for rows, _ in own for row in rows for key in uses(row)}
    sizes = [size for name, size in called.items() if name in names]
    sizes += [_of_helper(name) for name in names if isinstance(name, str)]
    # Blocks are called one after another, so the largest of their frames counts.
    deepest = max((_frame(*rows, real) for rows in inner), default=0)
    return _frame(blocks.statements, n_arguments, real) + deepest + max(*sizes, 0, 0)


def _of_helper(name: str) -> int:
    """Give what a function of every model takes, with those that it calls; 0 of any other name."""
    base, _, size = name.rpartition("_")
    if base == "cotree_factorise" and size.isdecimal():
        n = int(size)
        return _SMALLEST_SYSTEMS.get(n, 144 + NUMBER * n * (n + 1))
    return _SINES if name == "cotree_sines" else _HELPERS.get(name, 0)


def _frame(statements: Iterable[Statement], n_arguments: int, real: int) -> int:
    """Count the bytes that one function takes."""
    rows = list(statements)
    # Of loops, the number and parts of places.
    declared = _WORD * (n_arguments + 4 * any(isinstance(row, Loop) for row in rows))
    n_calls, is_aligned, is_computed = 0, False, False
    for row in simple(rows):
        if isinstance(row, Array):
            size = row.length * _size_of(row.kind, real)
            declared += _rounded(size, VECTOR) if row.is_aligned else size
            is_aligned |= row.is_aligned
        elif isinstance(row, Assign) and row.declares is not None:
            declared += _size_of(kind_of(row.declares), real)
        n_calls += sum(_calls_in(e.form) for e in row.expressions)
        is_computed |= any(e.form.n_operations > 1 for e in row.expressions)
    declared += real * (min(n_calls, _MOST_WAITING) + is_computed)
    # The caller's stack is aligned to less than a vector.
    return _LINK + _rounded(declared, _ALIGNMENT) + _SAVED * (n_calls > 0) + VECTOR * is_aligned


def _size_of(kind: str, real: int) -> int:
    return real if kind == REAL else 4 if kind == WHOLE else NUMBER


def _rounded(size: int, unit: int) -> int:
    return -(-size // unit) * unit


@lru_cache(maxsize=1 << 12)
def _calls_in(form: Form) -> int:
    """Count the functions that an expression calls."""
    row = OPERATIONS.get(form.op)
    is_call = form.op in ("call", "part") or (row is not None and row.is_call)
    return is_call + sum(_calls_in(arg) for arg in form.args)
