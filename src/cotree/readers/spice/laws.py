"""Elements by laws of voltages, currents and time, and controlled sources by polynomials.

A small parser writes them in the scene's grammar. As in ngspice, ``x^y`` is that of the size of x,
and powers group from the left.
"""

from __future__ import annotations

import math
import re
from itertools import combinations_with_replacement, count
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, brief, nearest
from cotree.readers.spice.values import Scope, Value, is_zero, number_text, text_of
from cotree.scene.expressions import FUNCTIONS

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from cotree.readers.names import SourceLine
    from cotree.readers.spice.netlist import Line
    from cotree.readers.spice.scope import Instance


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


_MOST_ARGUMENTS, _MOST_COEFFICIENTS = 20, 80


def has_polynomial(line: Line) -> bool:
    """Say whether a controlled source follows a polynomial."""
    return len(line.words) > 3 and line.words[3].lower() == "poly"


def add_polynomial(place: Instance, line: Line) -> None:
    """Add a source whose voltage or current is a polynomial of voltages or currents.

    The coefficients become parameters ``NAME_p0``, ``NAME_p1``, ...

    Raises
    ------
    SceneError
        If words are missing or too many, or the current of what is no voltage source is taken.
    """
    letter, rest = line.key[0], line.words[4:]
    # Digits of other scripts pass ``isdigit``, hence ASCII is asked first.
    n = int(rest[0]) if rest and rest[0].isascii() and rest[0].isdigit() else 0
    if not 1 <= n <= _MOST_ARGUMENTS:
        raise line.at.error(f"POLY needs how many it is of, in parentheses, 1 to {_MOST_ARGUMENTS}")
    # A voltage is named by its two nodes, a current by the source that it flows in.
    each = 2 if letter in "eg" else 1
    names, words = rest[1 : 1 + each * n], rest[1 + each * n :]
    if not 1 <= len(words) <= _MOST_COEFFICIENTS:
        raise line.at.error(
            f"{line.name} has {len(words)} coefficients behind its POLY, not 1 to "
            f"{_MOST_COEFFICIENTS}"
        )
    arguments = (
        [voltage_between(place, names[i], names[i + 1], line.at) for i in range(0, 2 * n, 2)]
        if each == 2
        else [current_of(place, line, name) for name in names]
    )
    if n == len(words) == 1:
        raise line.at.error(
            "one coefficient of POLY(1) is the factor in some simulators and the constant in "
            "others: give both"
        )
    coefficients: list[Value] = []
    for i, word in enumerate(words):
        value = place.scope.value(word, line.at)
        # A zero is left out of the law instead, where a parameter would keep its term.
        if not is_zero(value):
            label = place.label(f"{line.words[0]}_p{i}")
            value = place.sheet.own_parameter(label, value, line.at)
        coefficients.append(value)
    nodes = [place.node(word) for word in line.words[1:3]]
    kind = "voltage" if letter in "eh" else "current"
    place.add(line.words[0], f"{kind}_source", nodes, {kind: _law(coefficients, arguments)})


def _law(coefficients: list[Value], arguments: list[str]) -> str:
    """Write a polynomial without its absent terms."""
    terms = []
    # The monomials go on without end.
    for coefficient, factors in zip(coefficients, _monomials(arguments), strict=False):
        if not is_zero(coefficient):
            terms.append("*".join([text_of(coefficient), *factors]))
    return " + ".join(terms) or "0"


def _monomials(arguments: list[str]) -> Iterator[list[str]]:
    """List the monomials in SPICE's order: 1, x, y, x x, x y, y y, x x x, ... for two arguments."""
    for degree in count():
        for factors in combinations_with_replacement(arguments, degree):
            powers = dict.fromkeys(factors, 0)
            for factor in factors:
                powers[factor] += 1
            yield [x if power == 1 else f"{x}**{power}" for x, power in powers.items()]


def voltage_between(place: Instance, plus: str, minus: str, at: SourceLine) -> str:
    """Write the voltage between two nodes as part of an expression.

    Parameters
    ----------
    place : Instance
        The circuit that names them.
    plus, minus : str
        The nodes, as in the netlist.
    at : SourceLine
        The line that names them.
    """
    ends = [place.node(word) for word in (plus, minus)]
    place.sheet.named += [(end, word, at) for end, word in zip(ends, (plus, minus), strict=True)]
    first, second = ("0" if node == "ground" else f"{node}.v" for node in ends)
    # The voltage of the ground is zero and no state.
    return f"({first} - {second})" if second != "0" else first


def current_of(place: Instance, line: Line, name: str) -> str:
    """Write the current of a voltage source as part of an expression.

    Parameters
    ----------
    place : Instance
        The circuit that asks.
    line : Line
        The line that asks.
    name : str
        Name of the source.

    Raises
    ------
    SceneError
        If there is no such source.
    """
    source = place.edges.get(name.lower())
    if source is None or name[0].lower() != "v":
        raise line.at.error(
            f"{line.name} takes the current of '{brief(name)}', which is no voltage source here"
        )
    return f"{source}.i"


#: Name, two nodes, and what follows: a law behind the sign of equality, which some leave out.
_LAW = re.compile(
    r"\S+[\s(,]+[^\s(),=]+[\s,]+[^\s(),=]+[\s),]+([A-Za-z]+)\s*(?:=\s*|(?=[{']))(.*)\Z", re.ASCII
)
_SIGNALS = re.compile(r"(?<![\w.])[vi]\s*\(|(?<![\w.])time(?![\w.])", re.IGNORECASE | re.ASCII)

#: Share of the hysteresis at which a comparison tells whether a switch is on at the start.
_BEYOND = 1.000001

#: What each name before a law says that the source gives, by the letter of the element.
_GIVES = {
    "b": {"v": "voltage", "i": "current"},
    "e": {"value": "voltage", "vol": "voltage", "v": "voltage"},
    "g": {"value": "current", "cur": "current", "i": "current"},
}


def has_law(line: Line) -> bool:
    """Return whether a controlled source follows an expression."""
    match = _LAW.match(line.text)
    return match is not None and match[1].lower() in _GIVES[line.key[0]]


def has_signals(word: str) -> bool:
    """Return whether an expression names voltages, currents or time."""
    return _SIGNALS.search(word) is not None


def law_of(place: Instance, line: Line, text: str) -> str:
    """Write an expression of voltages, currents, time and parameters as scenes do.

    Raises
    ------
    SceneError
        If it is none.
    """
    own = text.strip()
    if own[:1] + own[-1:] in ("{}", "''"):
        own = own[1:-1]
    try:
        return behaviour(
            own,
            place.scope,
            lambda plus, minus: voltage_between(place, plus, minus, line.at),
            lambda name: current_of(place, line, name),
        )
    except ExpressionError as error:
        raise line.at.error(f"'{brief(own)}' {error}") from None


def add_law(place: Instance, line: Line) -> None:
    """Add a source whose voltage or current is an expression.

    Raises
    ------
    SceneError
        If it is not written as ``B a b V=...``, or the expression is none.
    """
    match, gives = _LAW.match(line.text), _GIVES[line.key[0]]
    if match is None or match[1].lower() not in gives:
        raise line.at.error(f"{line.name} needs two nodes, and V= or I= with an expression")
    kind = gives[match[1].lower()]
    nodes = [place.node(word) for word in line.words[1:3]]
    place.add(line.words[0], f"{kind}_source", nodes, {kind: law_of(place, line, match[2])})


def add_switch(place: Instance, line: Line) -> None:
    """Add a switch: a resistance of two values, by a voltage (S) or a current (W).

    With hysteresis, whether it is on is the mode ``NAME_on``.

    Raises
    ------
    SceneError
        If words are missing or too many, or its model is none of such a switch.
    """
    letter = line.key[0]
    words = line.words[1:]
    is_on = words[-1:] and words[-1].lower() == "on"
    if words[-1:] and words[-1].lower() in ("on", "off"):
        words = words[:-1]
    if len(words) != (5 if letter == "s" else 4) or "=" in words:
        wanted = (
            "two nodes, two that control it" if letter == "s" else "two nodes, a voltage source"
        )
        raise line.at.error(f"{line.name} needs {wanted} and a model, then ON or OFF")
    values = place.model(words[-1], letter, line).values
    if letter == "s":
        given, level, width = voltage_between(place, words[2], words[3], line.at), "vt", "vh"
    else:
        given, level, width = current_of(place, line, words[2]), "it", "ih"
    for name, least in ((width, 0.0), ("ron", None), ("roff", None)):
        found = place.sheet.amount(values[name])
        if found is not None and not (found > 0.0 or found == least):
            raise line.at.error(f"{name} of {line.name} must be positive")
    at, half = text_of(values[level]), text_of(values[width])
    upper, lower = f"({at} + {half})", f"({at} - {half})"
    threshold = at
    if not is_zero(values[width]):
        scene, name = place.sheet.scene, place.sheet.names.own(place.label(f"{line.words[0]}_on"))
        scene.mode(name, 1 if is_on else 0, doc="whether the switch is on")
        # Where the mode alone decides, which its own events change: these come first, just before
        # what the comparison would do.
        threshold = f"({at} + {_BEYOND!r}*{half}*(1 - 2*{name}))"
        scene.event(f"{name}_up", f"{given} - {upper}", direction=1, set={name: "1"})
        scene.event(f"{name}_down", f"{given} - {lower}", direction=-1, set={name: "0"})
        # What the start says is kept from there on.
        first = f"where({given} > {upper}, 1, where({given} < {lower}, 0, {name}))"
        scene.event(f"{name}_begin", "t", direction=1, set={name: first})
    law = f"where({given} > {threshold}, {text_of(values['ron'])}, {text_of(values['roff'])})"
    nodes = [place.node(word) for word in words[:2]]
    place.add(line.words[0], "resistor", nodes, {"resistance": law})
