"""Controlled sources by a polynomial: POLY of E, F, G and H."""

from __future__ import annotations

from itertools import combinations_with_replacement, count
from typing import TYPE_CHECKING

from cotree.errors import brief
from cotree.readers.spice_values import is_zero, text_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from cotree.readers.source_line import SourceLine
    from cotree.readers.spice_lines import Line
    from cotree.readers.spice_values import Value
    from cotree.readers.subcircuit_scope import Instance

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
