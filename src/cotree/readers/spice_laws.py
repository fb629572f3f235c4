"""Elements by laws of voltages, currents and time: B, E and G with VALUE, and switches S and W."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from cotree.errors import ExpressionError, brief
from cotree.readers.spice_behaviour import behaviour
from cotree.readers.spice_polynomials import current_of, voltage_between
from cotree.readers.spice_values import is_zero, text_of

if TYPE_CHECKING:
    from cotree.readers.spice_lines import Line
    from cotree.readers.subcircuit_scope import Instance

#: Name, two nodes, and what follows: a law behind the sign of equality, which some leave out.
_LAW = re.compile(
    r"\S+[\s(,]+[^\s(),=]+[\s,]+[^\s(),=]+[\s),]+([A-Za-z]+)\s*(?:=\s*|(?=[{']))(.*)\Z", re.ASCII
)
_SIGNAL = re.compile(r"(?<![\w.])[vi]\s*\(|(?<![\w.])time(?![\w.])", re.IGNORECASE | re.ASCII)

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
    return _SIGNAL.search(word) is not None


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
