"""C text in double precision to the same text in another.

Templates are written in double precision. Their text is read as tokens of C: types, constants,
functions of the C library and limits of the type are spelt as a target does, and nothing else
changes. Tolerances differ by more than their spelling: templates ask the target for them.
"""

from __future__ import annotations

import re
from functools import partial
from typing import TYPE_CHECKING

from cotree.codegen.targets import DOUBLE
from cotree.errors import CodegenError

if TYPE_CHECKING:
    from cotree.codegen.targets import Target

#: Functions of the C library that the text calls, whose names end by type.
_FUNCTIONS = frozenset(
    (
        *("sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh"),
        *("acosh", "atanh", "exp", "expm1", "log", "log10", "log1p", "log2", "pow", "sqrt", "cbrt"),
        *(
            "hypot",
            "fabs",
            "floor",
            "ceil",
            "fmin",
            "fmax",
            "fmod",
            "round",
            "trunc",
            "erf",
            "erfc",
        ),
        *("copysign", "nextafter", "ldexp", "frexp", "fma"),
    )
)

#: Other names of the C library, in single precision.
_NAMES = {"strtod": "strtof", "HUGE_VAL": "HUGE_VALF"}

_TOKEN = re.compile(
    r"""
    (?P<comment>/\*.*?\*/)
    | (?P<text>"(?:\\.|[^"\\])*"|'(?:\\.|[^'\\])*')
    | (?P<directive>\#[ ]*include[^\n]*)
    | (?P<name>[A-Za-z_]\w*)(?=(?P<call>\()?)
    | (?P<number>(?:\d+\.\d*|\.\d+)(?:[eE][-+]?\d+)?[fF]?|\d+[eE][-+]?\d+[fF]?|\d\w*)
    """,
    re.VERBOSE | re.DOTALL,
)


def respelt(text: str, target: Target) -> str:
    """Spell C text in double precision as a target does.

    Parameters
    ----------
    text : str
        C, also with parts that the target spelt already.
    target : Target
        A target whose statements compute with one number at a time.

    Raises
    ------
    CodegenError
        If a constant is beyond the range of the type.
    """
    if target.scalar == DOUBLE.scalar:
        return text
    return _TOKEN.sub(partial(_token, target), text)


def _token(target: Target, found: re.Match[str]) -> str:
    text = found[0]
    if found["name"]:
        return _name(text, target, is_call=found["call"] is not None)
    if found["number"]:
        return _number(text, target)
    if found["comment"]:
        return text.replace("doubles", f"{target.scalar}s")
    return text


def _name(name: str, target: Target, *, is_call: bool) -> str:
    if name == DOUBLE.scalar:
        return target.scalar
    if name.startswith("DBL_"):
        return f"FLT_{name[4:]}"
    if is_call and name in _FUNCTIONS:
        return name + target.suffix
    return _NAMES.get(name, name)


def _number(text: str, target: Target) -> str:
    digits = text.rstrip("fF")
    # Whole numbers, and those that are not decimal, have the same text in all types.
    if text[:2] in ("0x", "0X") or not any(mark in digits for mark in ".eE"):
        return text
    value = abs(float(digits))
    if value and not 10.0**-target.most_decades < value < 10.0**target.most_decades:
        raise CodegenError(
            f"the number {digits} is beyond the range of {target.scalar}: scale the units of the "
            "scene, or write the project in double precision"
        )
    return digits + target.suffix
