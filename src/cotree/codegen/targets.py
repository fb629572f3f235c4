"""Targets of C text: types of numbers, and C names of types, qualifiers and functions."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cotree.codegen.ir import REAL, SCALAR, WHOLE, fields_of
from cotree.dag.operations import OPERATIONS
from cotree.errors import CodegenError
from cotree.tolerances import TINY

if TYPE_CHECKING:
    from cotree.codegen.ir import Argument

#: C text of operations that only C has.
_SPELLED = {"real": "(double){0}", "not": "!{0}", "fails": "{0} != 0"}


@dataclass(frozen=True, slots=True)
class Target:
    """C names of types, qualifiers and functions for one type of numbers."""

    real: str = "double"  # type of computed values: a number or a vector of numbers
    scalar: str = "double"  # type of a single number, in arguments and tables
    zero: str = "0.0"  # zero of type ``real``
    suffix: str = ""  # suffix of literals and of C library functions
    limits: str = "DBL"  # prefix of the names in ``float.h``
    infinity: str = "HUGE_VAL"  # name of positive infinity in ``math.h``
    reader: str = "strtod"  # C function that converts text to a number
    #: Qualifiers and result type of functions that were split off another function.
    function: str = "COTREE_APART static void"
    name: str = "{}"  # format of the names of such functions
    aligned: str = "COTREE_ALIGNED "  # qualifier of arrays that are loaded into vectors
    #: Qualifier of a pointer to an array that no other pointer accesses.
    restrict: str = "COTREE_RESTRICT "
    number: str = "{}"  # format of a constant
    entry: str = ""  # type of a number in a table; empty if it is ``scalar``
    #: Prefix of functions that replace selections and C library functions; empty without them.
    calls: str = ""
    #: Name of a function ``(a, b, c)`` for ``a * b + c``; empty if operators are used.
    fused: str = ""
    fused_onto: str = ""  # the same with the arguments in the order of ``c + a * b``
    size: int = 8  # size of one number, [byte]
    digits: int = 53  # binary digits of the significand
    most_decades: int = 308  # largest power of ten that the type can represent

    @property
    def has_lanes(self) -> bool:
        """Whether maps may compute several columns at once, which requires vectors of doubles."""
        return self.scalar != SINGLE.scalar

    @property
    def lanes(self) -> Target:
        """Target for vectors of the same type of numbers."""
        return replace(
            self,
            real="VECTOR",
            zero="ZERO",
            function="TARGET COTREE_APART static void",
            name="NAMED({})",
        )

    def literal(self, value: float) -> str:
        """Return the shortest literal that equals a number in double precision."""
        return repr(self.checked(float(value))) + self.suffix

    def constant(self, text: str) -> str:
        """Return the literal of a number or quotient; raise CodegenError if it is out of range."""
        parts = text.split(" / ")
        for part in parts:
            self.checked(float(part))
        return " / ".join(part + self.suffix for part in parts)

    def fitted(self, value: float) -> float:
        """Return a number in the range of the type; the smallest number ``TINY`` is scaled."""
        if value != TINY or self.most_decades == DOUBLE.most_decades:
            return self.checked(value)
        return float(self.extreme(repr(TINY)).removesuffix(self.suffix))

    def checked(self, value: float) -> float:
        """Return a number, or raise CodegenError if it is outside the range of the type."""
        if self.holds(value):
            return value
        raise CodegenError(
            f"the number {value!r} is beyond the range of {self.scalar}: scale the units of the "
            "scene, or write the project in double precision"
        )

    def holds(self, value: float) -> bool:
        """Return whether a number is in the range of the type; always true for doubles."""
        if self.most_decades == DOUBLE.most_decades or not value:
            return True
        return 10.0**-self.most_decades < abs(value) < 10.0**self.most_decades

    def share(self, tolerance: str | float) -> str:
        """Return a tolerance, or the reciprocal of one, scaled to the precision of the type."""
        value = float(tolerance)
        if self.digits == DOUBLE.digits:
            return str(tolerance)
        if value > 1.0:
            return self._literal(1.0 / self._shared(1.0 / value))
        return self._literal(self._shared(value))

    def _shared(self, value: float) -> float:
        rounding, of_double = math.ldexp(2.0, -self.digits), math.ldexp(2.0, -DOUBLE.digits)
        return rounding * math.pow(value / of_double, self.digits / DOUBLE.digits)

    def extreme(self, number: str) -> str:
        """Return a power of ten, scaled from the range of doubles to the range of the type."""
        if self.most_decades == DOUBLE.most_decades:
            return number
        decades = math.log10(float(number)) * self.most_decades / DOUBLE.most_decades
        return self._literal(10.0 ** round(decades))

    def _literal(self, value: float) -> str:
        return f"{value:.1e}{self.suffix}"

    def type_of(self, kind: str) -> str:
        """Return the C type of a kind of value; a C type is returned unchanged."""
        return {REAL: self.real, SCALAR: self.scalar, WHOLE: "int"}.get(kind, kind)

    def type_of_entry(self, kind: str) -> str:
        """Return the C type of the numbers in a table."""
        return (self.entry if kind == SCALAR else "") or self.type_of(kind)

    def declared(self, argument: Argument) -> str:
        """Return the declaration of an argument."""
        text = self.type_of(argument.kind)
        if not argument.is_array:
            return f"{text} {argument.name}"
        constant = "const " if argument.is_constant else ""
        restrict = self.restrict if argument.is_restricted else ""
        return f"{constant}{text} *{restrict}{argument.name}"

    def spelling(self, op: str) -> str:
        """Return the format string of an operation; its arguments are placeholders."""
        if op in _SPELLED:
            text = _SPELLED[op]
        else:
            row = OPERATIONS[op]
            if self.calls and row.is_call:
                # The arguments are in the order of the operation's C text, with repetitions.
                return f"{self.calls}{op}({', '.join(f'{{{i}}}' for i in fields_of(row.c))})"
            # C library functions have a suffix for the type, as in sinf; operators have none.
            is_named = row.is_call and row.c[0].isalpha()
            text = row.c.replace("(", f"{self.suffix}(", 1) if is_named else row.c
        return text.replace("double", self.scalar).replace("0.0", f"0.0{self.suffix}")


#: Target of kernels in double precision.
DOUBLE = Target()
#: Target of kernels in single precision.
SINGLE = Target(
    real="float",
    scalar="float",
    zero="0.0f",
    suffix="f",
    limits="FLT",
    infinity="HUGE_VALF",
    reader="strtof",
    size=4,
    digits=24,
    most_decades=38,
)
#: Targets of C projects, by floating-point type.
BY_REAL = {target.real: target for target in (DOUBLE, SINGLE)}
#: Target of maps, with one column per SIMD lane.
LANES = DOUBLE.lanes
#: Target of kernels for ensembles, with one member per SIMD lane.
MEMBERS = Target(
    real="VECTOR",
    scalar="VECTOR",
    zero="ZERO",
    number="ALL({})",
    entry="double",
    calls="cotree_",
    fused="cotree_fused",
    fused_onto="cotree_fused_onto",
)
