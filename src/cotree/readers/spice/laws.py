"""Elements with laws of voltages, currents and time, and sources controlled by polynomials.

As in ngspice, ``x^y`` is the power of the absolute value of x, and powers group from the left.
"""

from __future__ import annotations

import re
from itertools import combinations_with_replacement, count
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, brief
from cotree.readers.spice.values import SpiceFormula, Value, is_zero, text_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.readers.names import SourceLine
    from cotree.readers.spice.netlist import Line
    from cotree.readers.spice.scope import Instance


_MOST_ARGUMENTS, _MOST_COEFFICIENTS = 20, 80


def has_polynomial(line: Line) -> bool:
    """Return whether a controlled source follows a polynomial."""
    return len(line.words) > 3 and line.words[3].lower() == "poly"


def add_polynomial(place: Instance, line: Line) -> None:
    """Add a source whose voltage or current is a polynomial of voltages or currents.

    The coefficients become parameters ``NAME_p0``, ``NAME_p1``, ...
    """
    letter, rest = line.key[0], line.words[4:]
    # ``isdigit`` is true for digits of other scripts.
    n = int(rest[0]) if rest and rest[0].isascii() and rest[0].isdigit() else 0
    if not 1 <= n <= _MOST_ARGUMENTS:
        raise line.at.error(
            f"POLY needs the number of its arguments in parentheses, 1 to {_MOST_ARGUMENTS}"
        )
    # A voltage has two nodes, a current the name of its source.
    each = 2 if letter in "eg" else 1
    names, words = rest[1 : 1 + each * n], rest[1 + each * n :]
    if not 1 <= len(words) <= _MOST_COEFFICIENTS:
        raise line.at.error(
            f"{line.name} has {len(words)} coefficients after its POLY, not 1 to "
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
        # Zeros omit terms of the law, so they do not become parameters.
        if not is_zero(value):
            label = place.label(f"{line.words[0]}_p{i}")
            value = place.sheet.own_parameter(label, value, line.at)
        coefficients.append(value)
    nodes = [place.node(word) for word in line.words[1:3]]
    kind = "voltage" if letter in "eh" else "current"
    place.add(line.words[0], f"{kind}_source", nodes, {kind: _law(coefficients, arguments)})


def _law(coefficients: list[Value], arguments: list[str]) -> str:
    """Return the text of a polynomial without its zero terms."""
    terms = []
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
    """Return the text of the voltage between two nodes."""
    ends = [place.node(word) for word in (plus, minus)]
    place.sheet.named += [(end, word, at) for end, word in zip(ends, (plus, minus), strict=True)]
    first, second = ("0" if node == "ground" else f"{node}.v" for node in ends)
    return f"({first} - {second})" if second != "0" else first


def current_of(place: Instance, line: Line, name: str) -> str:
    """Return the text of the current of a voltage source."""
    source = place.edges.get(name.lower())
    if source is None or name[0].lower() != "v":
        raise line.at.error(
            f"{line.name} takes the current of '{brief(name)}', which is not a voltage source of "
            "this circuit"
        )
    return f"{source}.i"


#: Name, two nodes, and a law after an equals sign, which some simulators omit.
_LAW = re.compile(
    r"\S+[\s(,]+[^\s(),=]+[\s,]+[^\s(),=]+[\s),]+([A-Za-z]+)\s*(?:=\s*|(?=[{']))(.*)\Z", re.ASCII
)
_SIGNALS = re.compile(r"(?<![\w.])[vi]\s*\(|(?<![\w.])time(?![\w.])", re.IGNORECASE | re.ASCII)

#: Distance of the thresholds of a comparison from the centre, in multiples of the hysteresis.
_BEYOND = 1.000001

#: Kind of the source by the name before its law, for each letter of elements.
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
    """Convert an expression of voltages, currents, time and parameters to that of a scene."""
    own = text.strip()
    if own[:1] + own[-1:] in ("{}", "''"):
        own = own[1:-1]

    def signal(letter: str, first: str, second: str | None) -> str:
        if letter == "v":
            return voltage_between(place, first, second or "0", line.at)
        return current_of(place, line, first)

    try:
        return SpiceFormula(place.scope, signal).text(own)
    except ExpressionError as error:
        raise line.at.error(f"'{brief(own)}' {error}") from None


def add_law(place: Instance, line: Line) -> None:
    """Add a source whose voltage or current is an expression."""
    match, gives = _LAW.match(line.text), _GIVES[line.key[0]]
    if match is None or match[1].lower() not in gives:
        raise line.at.error(f"{line.name} needs two nodes, and V= or I= with an expression")
    kind = gives[match[1].lower()]
    nodes = [place.node(word) for word in line.words[1:3]]
    place.add(line.words[0], f"{kind}_source", nodes, {kind: law_of(place, line, match[2])})


def add_switch(place: Instance, line: Line) -> None:
    """Add a switch: a resistance of two values, controlled by a voltage (S) or a current (W).

    With hysteresis it has a mode ``NAME_on``.
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
        # The mode shifts the threshold beyond the levels of its events, which then occur first.
        threshold = f"({at} + {_BEYOND!r}*{half}*(1 - 2*{name}))"
        scene.event(f"{name}_up", f"{given} - {upper}", direction=1, set={name: "1"})
        scene.event(f"{name}_down", f"{given} - {lower}", direction=-1, set={name: "0"})
        # The mode at the start follows from the signal.
        first = f"where({given} > {upper}, 1, where({given} < {lower}, 0, {name}))"
        scene.event(f"{name}_begin", "t", direction=1, set={name: first})
    law = f"where({given} > {threshold}, {text_of(values['ron'])}, {text_of(values['roff'])})"
    nodes = [place.node(word) for word in words[:2]]
    place.add(line.words[0], "resistor", nodes, {"resistance": law})
