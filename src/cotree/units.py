"""Units: texts such as ``N m s/rad`` or ``mm``, their dimensions, and factors to SI.

Products, quotients and powers of symbols are parsed here; symbols other than SI are looked up in
pint. Only names are passed to pint, because its parser evaluates arithmetic: a text such as
``10**10**10`` from a file would never return.
"""

from __future__ import annotations

import ast
import math
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from typing import Any

from cotree.errors import UnitError, brief, nearest
from cotree.quiet import parsing

#: Exponents of m, kg, s, A, K, mol and cd, then of angle and cycles, which SI treats as
#: dimensionless. They distinguish a speed in rad/s from a frequency in Hz, both 1/s.
Dimension = tuple[float, ...]

_BASES = ("m", "kg", "s", "A", "K", "mol", "cd", "rad", "Hz")
_N_TRUE = 7  # number of physical dimensions; angle and cycles follow
_SECOND, _ANGLE, _CYCLE = 2, 7, 8


def _of(**exponents: float) -> Dimension:
    return tuple(float(exponents.get(base, 0)) for base in _BASES)


_NONE = _of()

#: Symbols with factor one. If several have the same dimension, the first one is used for output.
_SI: dict[str, Dimension] = {
    **{base: _of(**{base: 1}) for base in _BASES[:_ANGLE]},
    "rad": _of(rad=1),
    "N": _of(kg=1, m=1, s=-2),
    "Pa": _of(kg=1, m=-1, s=-2),
    "J": _of(kg=1, m=2, s=-2),
    "W": _of(kg=1, m=2, s=-3),
    "C": _of(A=1, s=1),
    "V": _of(kg=1, m=2, s=-3, A=-1),
    "F": _of(kg=-1, m=-2, s=4, A=2),
    "ohm": _of(kg=1, m=2, s=-3, A=-2),
    "Ω": _of(kg=1, m=2, s=-3, A=-2),
    "S": _of(kg=-1, m=-2, s=3, A=2),
    "H": _of(kg=1, m=2, s=-2, A=-2),
    "Wb": _of(kg=1, m=2, s=-2, A=-1),
    "T": _of(kg=1, s=-2, A=-1),
    "Hz": _of(s=-1, Hz=1),
    "1": _NONE,
    "-": _NONE,
}

_LONGEST, _LARGEST_POWER = 60, 12.0
_TOKEN = re.compile(
    r"\s*(?:(?P<name>[^\W\d_][^\W\d]*|%|°[CF]?)|(?P<number>\d+(?:\.\d+)?)"
    r"|(?P<op>\*\*|[*·.×/^()-])|(?P<power>[⁻]?[⁰¹²³⁴⁵⁶⁷⁸⁹]+))\s*"
)
_RAISED = {ord("⁻"): "-", **{ord(raised): str(i) for i, raised in enumerate("⁰¹²³⁴⁵⁶⁷⁸⁹")}}
#: Operators in Python's notation, for parsing without evaluation.
_SPELT = {"^": "**", "·": "*", ".": "*", "×": "*"}


@dataclass(frozen=True)
class Unit:
    """A unit: a value in it times ``factor`` plus ``offset`` is the value in ``si``.

    Factors are fractions, so that 35 mm is converted to the same double as 0.035 m. ``dimension``
    has the exponents of the base units, and of angle and cycles.
    """

    text: str
    si: str
    factor: Fraction
    offset: Fraction
    dimension: Dimension

    @property
    def is_si(self) -> bool:
        """Whether the unit is an SI unit."""
        return self.factor == 1 and self.offset == 0

    def to_si(self, value: float) -> float:
        """Convert a value in this unit to SI."""
        return float(Fraction(repr(value)) * self.factor + self.offset)

    def fits(self, other: Unit) -> bool:
        """Return whether both measure the same quantity; radians may be omitted, cycles not."""
        return same_dimension(self.dimension, other.dimension)


@dataclass(frozen=True)
class _Symbol:
    """The factor, offset and dimension of one unit symbol, and its text in SI symbols."""

    factor: Fraction
    offset: Fraction
    dimension: Dimension
    si: tuple[tuple[str, float], ...]


def same_dimension(a: Dimension, b: Dimension) -> bool:
    """Return whether two dimensions are equal, if radians but not cycles are ignored."""
    if any(abs(x - y) > 1e-9 for x, y in zip(a[:_N_TRUE], b[:_N_TRUE], strict=True)):
        return False
    return not ((a[_ANGLE] and b[_CYCLE]) or (b[_ANGLE] and a[_CYCLE]))


def unit_text(dimension: Dimension) -> str:
    """Write a dimension as an SI unit: one symbol if possible, otherwise base units."""
    # Omit radians next to other units, as in a torque per radian times radians.
    if any(dimension[base] for base in range(_N_TRUE) if base != _SECOND):
        dimension = (*dimension[:_ANGLE], 0.0, *dimension[_ANGLE + 1 :])
    if dimension == _SI["J"]:
        return "N m"  # energies and torques are both displayed in N m
    for symbol, known in _SI.items():
        if known == dimension:
            return symbol
    return _written([(b, e) for b, e in zip(_BASES, dimension, strict=True) if e])


def check_unit(text: str, what: str) -> Unit | None:
    """Parse a unit, such as ``kg m^2`` or ``W/(m^2 K)``; None for an empty text.

    ``what`` names its owner in messages: "unit of parameter 'L'".
    """
    if not text.strip():
        return None
    try:
        return read_unit(text)
    except UnitError as error:
        raise UnitError(f"{what} is '{brief(text)}', {error}") from None


def stated_unit(text: str) -> Unit | None:
    """Parse the unit of a field or result; None if it is empty or a choice of several units."""
    if not text or text == "any" or " or " in text:
        return None
    try:
        return read_unit(text)
    except UnitError:
        return None  # user-defined components may have any text


def check_fits(unit: Unit, wanted: str, what: str) -> None:
    """Raise UnitError if the dimension of ``unit`` is not that of ``wanted``."""
    stated = stated_unit(wanted)
    if stated is None or unit.fits(stated):
        return
    about = (
        " (a cycle is 2*pi rad)" if unit.dimension[:_N_TRUE] == stated.dimension[:_N_TRUE] else ""
    )
    raise UnitError(f"{what} is given in '{unit.text}', but is in '{wanted}'{about}")


@lru_cache(maxsize=1024)
def read_unit(text: str) -> Unit:
    """Parse a unit; raise UnitError if it is invalid."""
    if len(text) > _LONGEST:
        raise UnitError(f"which is longer than {_LONGEST} characters")
    parts = _parts(text.strip())
    symbols = [(_symbol(name), power) for name, power in parts]
    if len(parts) > 1 or any(power != 1.0 for _, power in parts):
        for (name, _), (symbol, _) in zip(parts, symbols, strict=True):
            if symbol.offset:
                raise UnitError(
                    f"where '{name}' has its own zero: a difference is in 'K' or 'delta_{name}'"
                )
    factor = Fraction(1)
    for symbol, power in symbols:
        whole = power.is_integer()
        # An integer power of a fraction is exact; another power is computed as a double.
        factor *= symbol.factor ** int(power) if whole else _exact(float(symbol.factor) ** power)
    if not 1e-100 < factor < 1e100:
        raise UnitError("whose factor to SI is too large or too small")
    total = [0.0] * len(_BASES)
    for symbol, power in symbols:
        total = [a + power * b for a, b in zip(total, symbol.dimension, strict=True)]
    offset = symbols[0][0].offset if symbols else Fraction(0)
    si = _written([(n, e * power) for symbol, power in symbols for n, e in symbol.si])
    return Unit(text, text if factor == 1 and not offset else si, factor, offset, tuple(total))


def _exact(value: float) -> Fraction:
    return Fraction(repr(float(value)))


def _parts(text: str) -> list[tuple[str, float]]:
    words: list[str] = []
    names: list[str] = []
    at, is_operand = 0, False
    while at < len(text):
        match = _TOKEN.match(text, at)
        if match is None:
            raise UnitError(f"which holds '{brief(text[at])}'")
        at, kind = match.end(), str(match.lastgroup)
        word = match[kind]
        if is_operand and (kind in ("name", "number") or word == "("):
            words.append("*")
        is_operand = kind != "op" or word == ")"
        if kind == "name":
            names.append(word)
            word = f"u{len(names) - 1}"
        word = f"**{word.translate(_RAISED)}" if kind == "power" else word
        words.append(_SPELT.get(word, word))
    if words == ["-"]:
        return []  # a dash denotes that there is no unit
    try:
        with parsing:
            tree = ast.parse("".join(words), mode="eval").body
        return _factors(tree, names, 1.0)
    except SyntaxError:
        raise UnitError("which is not a product of powers of symbols") from None


def _factors(tree: ast.expr, names: list[str], power: float) -> list[tuple[str, float]]:
    """List the symbols of a syntax tree with their exponents, multiplied by ``power``."""
    if abs(power) > _LARGEST_POWER:
        raise UnitError(f"which has a power beyond {_LARGEST_POWER:g}")
    match tree:
        case ast.Name(id=mark):
            return [(names[int(mark[1:])], power)]
        case ast.Constant(value=1):
            return []
        case ast.BinOp(left=left, op=ast.Mult() | ast.Div() as op, right=right):
            own = power if isinstance(op, ast.Mult) else -power
            return _factors(left, names, power) + _factors(right, names, own)
        case ast.BinOp(left=left, op=ast.Pow(), right=exponent):
            digits = ast.unparse(exponent)
            if not re.fullmatch(r"-?[\d.]+", digits):
                raise UnitError("which has a power that is not a number")
            return _factors(left, names, power * float(digits))
    raise UnitError("which has a number instead of a symbol")


def _written(parts: list[tuple[str, float]]) -> str:
    total: dict[str, float] = {}
    for name, power in parts:
        total[name] = total.get(name, 0.0) + power
    above = [_raised(name, power) for name, power in total.items() if power > 0 and name != "1"]
    below = [_raised(name, -power) for name, power in total.items() if power < 0 and name != "1"]
    if not below:
        return " ".join(above) or "1"
    under = below[0] if len(below) == 1 else f"({' '.join(below)})"
    return f"{' '.join(above) or '1'}/{under}"


def _raised(name: str, power: float) -> str:
    return name if power == 1.0 else f"{name}^{power:g}"


def _symbol(name: str) -> _Symbol:
    known = _SI.get(name)
    if known is not None:
        return _Symbol(Fraction(1), Fraction(0), known, ((name, 1.0),))
    return _foreign(name)


@lru_cache(maxsize=512)
def _foreign(name: str) -> _Symbol:
    """Find a prefixed or non-SI symbol in pint."""
    import pint

    registry = _registry()
    asked = {"°": "degree", "°C": "degC", "°F": "degF", "%": "percent"}.get(name, name)
    try:
        (own,) = dict(registry.parse_units(asked)._units) or {"dimensionless": 1}
        zero, one, two = (registry.Quantity(x, own).to_base_units() for x in (0.0, 1.0, 2.0))
    except (pint.PintError, ValueError, TypeError, AttributeError, ArithmeticError):
        raise UnitError(_unknown(name, registry)) from None
    if not math.isclose(two.magnitude - one.magnitude, one.magnitude - zero.magnitude):
        raise UnitError(f"where '{name}' is logarithmic: give the number itself")
    bases = {"meter": "m", "kilogram": "kg", "second": "s", "ampere": "A", "kelvin": "K"}
    bases |= {"mole": "mol", "candela": "cd", "radian": "rad"}
    exponents: dict[str, float] = {}
    for base, power in one._units.items():
        if base not in bases:
            raise UnitError(f"which is based on '{base}', a unit that is not supported")
        exponents[bases[base]] = float(power)
    if own.endswith("hertz"):
        exponents["Hz"] = 1.0
    dimension = _of(**exponents)
    offset = _exact(zero.magnitude)
    if offset:  # pint's differences of temperatures have smaller rounding errors than its offsets
        one = registry.Quantity(1.0, f"delta_{own}").to_base_units()
    factor = _exact(one.magnitude)
    si = next((n for n, own_dimension in _SI.items() if own_dimension == dimension), None)
    parts = ((si, 1.0),) if si else tuple(exponents.items())
    return _Symbol(factor, offset, dimension, parts)


def _unknown(name: str, registry: Any) -> str:
    """Return the error message for an unknown unit, with a suggestion."""
    usual = [f"{prefix}{symbol}" for prefix in ("", *"MkcmunpG") for symbol in _SI]
    close = nearest(name, usual)
    if "did you mean" not in close:
        close = nearest(name, [row for row in registry if isinstance(row, str)])
    digits = re.match(r"([A-Za-z]+)-?\d", name)
    hint = f"; a power is written '{digits[1]}^2'" if digits else close
    return f"where '{brief(name)}' is no known unit{hint if 'known:' not in hint else ''}"


@lru_cache(maxsize=1)
def _registry() -> Any:
    """Return pint's unit table, which takes almost a second to create and is cached."""
    import pint

    return pint.UnitRegistry(cache_folder=None, autoconvert_offset_to_baseunit=True)


def quotient(unit: str, divisor: str) -> str:
    """Return the text of a quotient of units, such as m/(N m), or "" if one unit is unknown."""
    # An unknown unit makes the quotient unknown, not dimensionless.
    if not unit or not divisor:
        return ""
    if divisor == "1":
        return unit
    compound = any(mark in divisor for mark in " /*")
    return f"{unit}/{f'({divisor})' if compound else divisor}"
