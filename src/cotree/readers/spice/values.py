"""Numbers with suffixes, and expressions of parameters in the scene's own small grammar."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError, brief, nearest
from cotree.scene.expressions import FUNCTIONS, parse

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from cotree.dag.nodes import Node
    from cotree.readers.names import SourceLine

#: A number, or the text of an expression in the scene's grammar.
Value = float | str

#: A parameter: its name and value as written, and its line.
ParameterRow = tuple[str, str, "SourceLine"]

_DIGITS = r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_NUMBER = re.compile(rf"([+-]?{_DIGITS})([A-Za-zµ]*)\Z", re.ASCII)
_TOKEN = re.compile(
    rf"\s*(?:(?P<number>{_DIGITS})(?P<suffix>[A-Za-zµ]*)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<sign>\*\*|[-+*/^(),]))",
    re.ASCII,
)
#: A factor in the place of the point, as resistors are printed.
_PRINTED = re.compile(r"([+-]?\d+)([A-Za-zµ]+)(\d+)\Z", re.ASCII)
_ATTO = re.compile(rf"(?<![\w.]){_DIGITS}([aA][A-Za-z]*)(?!\w)", re.ASCII)
_SUFFIXES = {
    **{"t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "mil": 25.4e-6, "m": 1e-3},
    **{"u": 1e-6, "µ": 1e-6, "n": 1e-9, "p": 1e-12, "f": 1e-15, "a": 1e-18},
}
_WORD = re.compile(r"[a-z_]\w*", re.ASCII)
_OTHER_NAMES = {"ln": "log", "sgn": "sign", "arctan": "atan"}
_LONGEST = 3000  # characters of an expression, parameters put in


def ordered(rows: Mapping[str, ParameterRow], given: Collection[str] = ()) -> list[str]:
    """Sort parameters such that each comes after those that its value names.

    They stay in the order of the file otherwise. A name that leads back to itself is left where it
    is: it means that of the circuit around, or is unknown.

    Parameters
    ----------
    rows : mapping of str to (str, str, SourceLine)
        Names, values as written, and lines, by name in small letters.
    given : collection of str
        Those whose values are known already.
    """
    done: dict[str, None] = {}
    begun: set[str] = set()
    for first in rows:
        waiting = [first]
        while waiting:
            name = waiting[-1]
            begun.add(name)
            words = () if name in given else _WORD.findall(rows[name][1].lower())
            ahead = [word for word in words if word in rows and word not in begun]
            if ahead:
                waiting.append(ahead[0])
            else:
                done[waiting.pop()] = None
    return list(done)


def read_number(word: str) -> float | None:
    """Read a number with a suffix; a unit is ignored. None if it is no number."""
    match = _NUMBER.match(word)
    if match is None:
        return None
    value = _scaled(match.group(1), match.group(2))
    return value if math.isfinite(value) else None


def number_text(word: str) -> str:
    """Write a number with a suffix as scenes do.

    Raises
    ------
    ExpressionError
        If it is none, or has its factor in the place of the point.
    """
    check_point(word)
    value = read_number(word)
    if value is None:
        raise ExpressionError(f"holds '{brief(word)}', which is no finite number")
    return repr(value)


def check_point(word: str) -> None:
    """Refuse numbers with their factor in the place of the point, which simulators read apart.

    Raises
    ------
    ExpressionError
        If the word is one.
    """
    match = _PRINTED.match(word)
    if match is not None:
        whole, factor, rest = match.groups()
        raise ExpressionError(
            f"is {whole}.{rest}{factor} in some simulators and {whole}{factor} in others: write "
            "which is meant"
        )


def _is_ampere(letters: str) -> bool:
    """Whether a number ends with a unit that looks like the factor atto."""
    small = letters.lower()
    return small == "a" or small.startswith("amp")


def _scaled(digits: str, letters: str) -> float:
    small = letters.lower()
    if _is_ampere(letters):
        return float(digits)
    # Upper and lower case are the same, so that m is milli and meg is mega; letters after the
    # factor are a unit.
    suffix = next((s for s in ("meg", "mil") if small.startswith(s)), small[:1])
    if suffix not in _SUFFIXES:
        return float(digits)
    power = round(math.log10(_SUFFIXES[suffix])) if suffix != "mil" else 0
    # A mil is no power of ten, and digits with an exponent take no second one.
    if suffix == "mil" or "e" in digits.lower():
        return float(digits) * _SUFFIXES[suffix]
    return float(f"{digits}e{power}")  # rounded once: 1.1u is 1.1e-6


@dataclass(frozen=True)
class Scope:
    """Meaning of names in a circuit or in an instance of a subcircuit.

    Attributes
    ----------
    values : dict of str to Value
        By name in small letters: numbers, or texts of expressions.
    outer : Scope or None
        Scope in which names that are not found here are looked up.
    remarks : list of str
        Remarks about the file, kept in the outermost scope.
    """

    values: dict[str, Value] = field(default_factory=dict)
    outer: Scope | None = None
    remarks: list[str] = field(default_factory=list)

    def remark(self, text: str) -> None:
        """Add a note for the user, once."""
        # Remarks belong to the file: those of instances are kept in the outermost scope.
        scope = self
        while scope.outer is not None:
            scope = scope.outer
        if text not in scope.remarks:
            scope.remarks.append(text)

    def find(self, name: str) -> Value | None:
        """Look up a parameter, in the inner scope first."""
        scope: Scope | None = self
        while scope is not None:
            if name in scope.values:
                return scope.values[name]
            scope = scope.outer
        return None

    def value(self, word: str, at: SourceLine) -> Value:
        """Read a number, a parameter's name, or an expression in braces or quotes.

        Raises
        ------
        SceneError
            If it is none of these.
        """
        self._check_unit(word, at)
        # Numbers go first: what looks like one is never a name.
        number = read_number(word)
        if number is not None:
            return number
        body = word[1:-1] if word[:1] in ("{", "'") else word
        try:
            check_point(body.strip())
            return self._expression(body)
        except ExpressionError as error:
            raise at.error(f"'{brief(word)}' {error}") from None

    def number(self, word: str, at: SourceLine) -> float:
        """Read what must be a number.

        Raises
        ------
        SceneError
            If it is none, or depends on parameters.
        """
        value = self.value(word, at)
        if isinstance(value, str):
            raise at.error(f"'{brief(word)}' must be a number without parameters")
        return value

    def _check_unit(self, word: str, at: SourceLine) -> None:
        """Note that simulators disagree on the letter a, which may be a unit or a factor."""
        for match in _ATTO.finditer(word):
            is_ampere = _is_ampere(match[1])
            meaning = "in amperes" if is_ampere else "1e-18 of its unit"
            self.remark(
                f"{at}: '{brief(match[0])}' is taken as {meaning}; some simulators take the "
                "letter a for 1e-18 everywhere, some nowhere: write the power of ten"
            )

    def _expression(self, body: str) -> Value:
        made, i = [], 0
        while body[i:].strip():
            match = _TOKEN.match(body, i)
            if match is None:
                raise ExpressionError("is neither a number nor an expression of parameters")
            i = match.end()
            # A name before a parenthesis is a function, any other a parameter, whose value or text
            # is put in.
            made.append(self._piece(match, body[i:].lstrip()[:1] == "("))
            # Parameters are put in as text, which may double with each level of definitions.
            if sum(map(len, made)) > _LONGEST:
                raise ExpressionError(f"is longer than {_LONGEST} characters with its parameters")
        text = " ".join(made)
        expression = parse(text, "an expression")
        # Names in the text are parameters of the scene, on which the value is to depend.
        return text if expression.names else _folded(text)

    def _piece(self, match: re.Match[str], is_call: bool) -> str:
        if match["number"] is not None:
            value = _scaled(match["number"], match["suffix"])
            if not math.isfinite(value):
                raise ExpressionError("holds a number that is not finite")
            # Digits that read back as the same number: the text is parsed again by the scene.
            return repr(value)
        if match["sign"] is not None:
            return "**" if match["sign"] == "^" else match["sign"]
        name = match["name"].lower()
        if is_call:
            own = _OTHER_NAMES.get(name, name)
            if own not in FUNCTIONS:
                hint = nearest(own, FUNCTIONS)
                raise ExpressionError(f"calls '{brief(name)}', which is no function here{hint}")
            return own
        found = self.find(name)
        # A parameter may be called pi, too, and goes before the constant.
        if found is None and name == "pi":
            return repr(math.pi)
        if found is None:
            raise ExpressionError(f"names '{brief(name)}', which is no parameter")
        return text_of(found)


def _folded(text: str) -> float:
    """Give the value of an expression without parameters."""
    node = parse(text, "an expression").lower(Dag(), _unknown)
    if node.value is None or not math.isfinite(node.value):
        raise ExpressionError("has no finite value")
    return node.value


def _unknown(name: str) -> Node:
    raise ExpressionError(f"names '{brief(name)}'")


def text_of(value: Value) -> str:
    """Write a value as a part of an expression."""
    # Parentheses keep the value one operand whatever stands beside it.
    return f"({value!r})" if isinstance(value, float) else f"({value})"


def scaled(value: Value, factor: Value, sign: str = "*") -> Value:
    """Multiply or divide two values; a factor of one changes nothing.

    Parameters
    ----------
    value, factor : float or str
        Numbers or expressions.
    sign : {'*', '/'}
        The operation.

    Returns
    -------
    float or str
        A number where both are.
    """
    if factor == 1.0:
        return value
    if isinstance(value, float) and isinstance(factor, float):
        return value * factor if sign == "*" else value / factor
    return f"{text_of(value)}{sign}{text_of(factor)}"


def is_zero(value: Value | None) -> bool:
    """Say whether a value is absent or the number zero."""
    return value is None or value == 0.0
