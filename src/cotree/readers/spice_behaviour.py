"""Expressions of voltages, currents and time: of B elements, and of ``VALUE=`` of others.

A small parser writes them in the scene's grammar. As in ngspice, ``x^y`` is that of the size of x,
and powers group from the left.
"""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, brief, nearest
from cotree.readers.spice_values import number_text, text_of
from cotree.scene.grammar import FUNCTIONS

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.readers.spice_values import Scope

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?[A-Za-zµ]*\d*)"
    r"|(?P<signal>[vViI]\s*\(\s*[^\s(),]+\s*(?:,\s*[^\s(),]+\s*)?\))"
    r"|(?P<name>[A-Za-z_][\w.]*)|(?P<sign>\*\*|<=|>=|==|!=|&&|\|\||[-+*/^(),<>?:!]))",
    re.ASCII,
)
_SIGNAL = re.compile(r"([vi])\s*\(\s*([^\s(),]+)\s*(?:,\s*([^\s(),]+)\s*)?\)", re.I | re.ASCII)
_DEEPEST, _LONGEST = 40, 6000  # levels, characters

#: Functions of other names or forms than those of scenes, with the number of their arguments.
_FORMS: dict[str, tuple[int, str]] = {
    "ln": (1, "log({0})"),
    "log10": (1, f"(log({{0}})/{math.log(10)!r})"),
    "sgn": (1, "sign({0})"),
    "arctan": (1, "atan({0})"),
    "asinh": (1, "log({0} + sqrt({0}*{0} + 1))"),
    "acosh": (1, "log({0} + sqrt({0}*{0} - 1))"),
    "atanh": (1, "(log((1 + {0})/(1 - {0}))/2)"),
    "u": (1, "where({0} > 0, 1, 0)"),
    "uramp": (1, "max({0}, 0)"),
    "ceil": (1, "(-floor(-({0})))"),
    "pwr": (2, "(sign({0})*abs({0})**({1}))"),
    "limit": (3, "min(max({0}, {1}), {2})"),
}
_CHOICES = ("if", "ternary_fcn")
_COUNTS = {
    **FUNCTIONS,
    **{name: count for name, (count, _) in _FORMS.items()},
    **dict.fromkeys(_CHOICES, 3),
    "pow": 2,
}

#: What was read, and whether it is a condition.
_Read = tuple[str, bool]


def _value(read: _Read) -> str:
    """Return a value; a condition counts one where it holds, and zero elsewhere."""
    return f"where({read[0]}, 1, 0)" if read[1] else read[0]


def _condition(read: _Read, what: str) -> str:
    if not read[1]:
        raise ExpressionError(f"{what} what is no comparison: write x > 0")
    return read[0]


def behaviour(
    text: str,
    scope: Scope,
    voltage: Callable[[str, str], str],
    current: Callable[[str], str],
) -> str:
    """Write an expression in the scene's grammar.

    Parameters
    ----------
    text : str
        The expression.
    scope : Scope
        Gives the values of parameters.
    voltage : callable
        Writes the voltage between two nodes.
    current : callable
        Writes the current of an element.

    Raises
    ------
    ExpressionError
        If it is none, or holds what scenes do not know.
    """
    parser = _Parser(_tokens(text), scope, voltage, current)
    found = parser.choice(0)
    if parser.sign() is not None:
        raise ExpressionError(f"has '{brief(parser.word())}' where nothing should follow")
    return found


def _tokens(text: str) -> list[tuple[str, str]]:
    found, i = [], 0
    while text[i:].strip():
        match = _TOKEN.match(text, i)
        if match is None:
            raise ExpressionError(f"holds '{brief(text[i:].strip()[:20])}', which is not known")
        kind = match.lastgroup
        assert kind is not None
        found.append((kind, match[kind]))
        i = match.end()
    return found


class _Parser:
    """Reads tokens from the left; each method reads one level of precedence."""

    def __init__(
        self,
        tokens: list[tuple[str, str]],
        scope: Scope,
        voltage: Callable[[str, str], str],
        current: Callable[[str], str],
    ) -> None:
        self._tokens, self._at = tokens, 0
        self._scope, self._voltage, self._current = scope, voltage, current

    def word(self) -> str:
        """Return the next token as it is written."""
        return self._tokens[self._at][1] if self._at < len(self._tokens) else "its end"

    def sign(self) -> str | None:
        """Return the next token where it is a sign; what else follows is none of an expression."""
        return self.word() if self._at < len(self._tokens) else None

    def _took(self, *signs: str) -> str | None:
        if self._at < len(self._tokens) and self._tokens[self._at][1] in signs:
            self._at += 1
            return self._tokens[self._at - 1][1]
        return None

    def _expect(self, sign: str) -> None:
        if not self._took(sign):
            raise ExpressionError(f"has '{brief(self.word())}' where '{sign}' should stand")

    def choice(self, depth: int) -> str:
        """Read ``condition ? value : value``, a comparison, or a value."""
        return _value(self._choice(depth))

    def _choice(self, depth: int) -> _Read:
        if depth > _DEEPEST:
            raise ExpressionError(f"is nested deeper than {_DEEPEST} levels: split it")
        read = self._joined(
            depth, "||", "or", lambda d: self._joined(d, "&&", "and", self._compared)
        )
        if not self._took("?"):
            return read
        condition = _condition(read, "chooses by")
        first = self.choice(depth + 1)
        self._expect(":")
        return f"where({condition}, {first}, {self.choice(depth + 1)})", False

    def _joined(self, depth: int, sign: str, name: str, part: Callable[[int], _Read]) -> _Read:
        read = part(depth)
        while self._took(sign):
            both = (_condition(row, f"joins by '{sign}'") for row in (read, part(depth)))
            read = f"({f' {name} '.join(both)})", True
        return read

    def _compared(self, depth: int) -> _Read:
        read = self._sum(depth)
        sign = self._took("<", ">", "<=", ">=", "==", "!=")
        if sign in ("==", "!="):
            raise ExpressionError(f"compares by '{sign}': compare by < <= > >=")
        return read if sign is None else (f"{_value(read)} {sign} {_value(self._sum(depth))}", True)

    def _sum(self, depth: int) -> _Read:
        read = self._product(depth)
        while sign := self._took("+", "-"):
            read = f"{_value(read)} {sign} {_value(self._product(depth))}", False
        return self._bounded(read[0]), read[1]

    def _product(self, depth: int) -> _Read:
        read = self._signed(depth)
        while sign := self._took("*", "/"):
            read = f"{_value(read)}{sign}{_value(self._signed(depth))}", False
        return read

    def _signed(self, depth: int) -> _Read:
        if depth > _DEEPEST:
            raise ExpressionError(f"is nested deeper than {_DEEPEST} levels: split it")
        if self._took("!"):
            return f"(not {_condition(self._signed(depth + 1), 'negates')})", True
        if self._took("-"):
            return f"(-{_value(self._signed(depth + 1))})", False
        return self._signed(depth + 1) if self._took("+") else self._power(depth)

    def _power(self, depth: int) -> _Read:
        read = self._operand(depth)
        while self._took("^", "**"):
            minus = "-" if self._took("-") else ""
            read = self._raised(_value(read), minus + _value(self._operand(depth))), False
        return read

    def _raised(self, base: str, exponent: str) -> str:
        # An even power needs no sign removed, nor does the power of a number.
        is_even = re.fullmatch(r"\d*[02468]\.0", exponent) is not None
        is_number = re.fullmatch(r"[\d.e+]+", base) is not None
        if is_even or is_number:
            return f"({base})**({exponent})"
        self._scope.remark(
            "powers of voltages and currents are those of their sizes, as in ngspice: write "
            "products where signs are to stay"
        )
        return f"abs({base})**({exponent})"

    def _operand(self, depth: int) -> _Read:
        if self._took("("):
            text, is_condition = self._choice(depth + 1)
            self._expect(")")
            return f"({text})", is_condition
        if self._at >= len(self._tokens):
            raise ExpressionError("ends where a value should stand")
        kind, word = self._tokens[self._at]
        self._at += 1
        if kind == "number":
            return number_text(word), False
        if kind == "signal":
            match = _SIGNAL.fullmatch(word)
            assert match is not None
            if match[1].lower() == "v":
                return self._voltage(match[2], match[3] or "0"), False
            if match[3]:
                raise ExpressionError(f"takes a current of two names: '{brief(word)}'")
            return self._current(match[2]), False
        if kind == "name":
            is_call = self._took("(") is not None
            return self._called(word.lower(), depth) if is_call else self._named(word), False
        raise ExpressionError(f"has '{brief(word)}' where a value should stand")

    def _named(self, word: str) -> str:
        name = word.lower()
        found = self._scope.find(name)
        if found is not None:
            return text_of(found)
        known = {"time": "t", "pi": repr(math.pi), "temper": "27.0"}
        if name not in known:
            why = "is no parameter"
            if name in ("v", "i"):
                why = "takes a name in parentheses: V(node), V(node, node) or I(source)"
            raise ExpressionError(f"names '{brief(word)}', which {why}")
        return known[name]

    def _called(self, name: str, depth: int) -> str:
        if name in ("v", "i"):
            self._named(name)
        read = [self._choice(depth + 1)]
        while self._took(","):
            read.append(self._choice(depth + 1))
        self._expect(")")
        count = _COUNTS.get(name)
        if count is None:
            hint = nearest(name, _COUNTS)
            raise ExpressionError(f"calls '{brief(name)}', which is no function here{hint}")
        if len(read) != count:
            raise ExpressionError(f"gives {name} {len(read)} arguments, not {count}")
        if name in _CHOICES:
            condition = _condition(read[0], f"calls {name} with")
            return self._bounded(f"where({condition}, {_value(read[1])}, {_value(read[2])})")
        given = [_value(row) for row in read]
        if name == "pow":
            return self._raised(given[0], given[1])
        if name in _FORMS:
            # A value in the place of a form's argument stays one operand.
            return self._bounded(_FORMS[name][1].format(*(f"({text})" for text in given)))
        return f"{name}({', '.join(given)})"

    def _bounded(self, text: str) -> str:
        if len(text) > _LONGEST:
            raise ExpressionError(f"is longer than {_LONGEST} characters in the scene's grammar")
        return text
