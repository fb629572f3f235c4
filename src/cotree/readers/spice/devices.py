"""Elements of netlists: a function for each letter adds the edges of an element to the scene.

As in ngspice, ``x^y`` is the power of the absolute value of x, and powers are left-associative.
"""

from __future__ import annotations

import re
from itertools import combinations, combinations_with_replacement, count, pairwise
from typing import TYPE_CHECKING, Any, TypeVar

from cotree.components.electrical import WINDINGS, coupling_field
from cotree.components.semiconductors import BASE_CHARGE
from cotree.errors import ExpressionError, brief, nearest
from cotree.readers.spice.models import (
    DeviceModel,
    channel_fields,
    device_fields,
    gated_fields,
    side_fields,
)
from cotree.readers.spice.netlist import Line, settings, split_settings, unquoted
from cotree.readers.spice.scope import Coupled, Instance
from cotree.readers.spice.sources import Source, edge_of, read_source
from cotree.readers.spice.values import SpiceFormula, Value, is_zero, read_number, scaled, text_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from cotree.readers.names import SourceLine


_MOST_ARGUMENTS, _MOST_COEFFICIENTS = 20, 80


def add_polynomial(place: Instance, line: Line) -> None:
    """Add a polynomial source, whose coefficients become parameters ``NAME_p0``, ``NAME_p1``..."""
    letter, rest = line.key[0], line.words[4:]
    # ``isdigit`` is also true for digits of other scripts.
    n = int(rest[0]) if rest and rest[0].isascii() and rest[0].isdigit() else 0
    if not 1 <= n <= _MOST_ARGUMENTS:
        raise line.at.error(
            f"POLY needs the number of its arguments in parentheses, 1 to {_MOST_ARGUMENTS}"
        )
    # Each argument is a voltage between two nodes, or the current of a named source.
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
        # A zero coefficient adds no term, so it does not become a parameter.
        if not is_zero(value):
            label = place.label(f"{line.words[0]}_p{i}")
            value = place.sheet.own_parameter(label, value, line.at)
        coefficients.append(value)
    nodes = [place.node(word) for word in line.words[1:3]]
    kind = "voltage" if letter in "eh" else "current"
    law = place.multiplied(kind, _law(coefficients, arguments))
    place.add(line.words[0], f"{kind}_source", nodes, {kind: law})


def _law(coefficients: list[Value], arguments: list[str]) -> str:
    """Return the text of a polynomial without terms that are zero."""
    terms = []
    for coefficient, factors in zip(coefficients, _monomials(arguments), strict=False):
        if not is_zero(coefficient):
            terms.append("*".join([text_of(coefficient), *factors]))
    return " + ".join(terms) or "0"


def _monomials(arguments: list[str]) -> Iterator[list[str]]:
    """Yield the factors of each monomial in SPICE's order: 1, x, y, x x, x y, y y, x x x, ..."""
    for degree in count():
        for factors in combinations_with_replacement(arguments, degree):
            powers = dict.fromkeys(factors, 0)
            for factor in factors:
                powers[factor] += 1
            yield [x if power == 1 else f"{x}**{power}" for x, power in powers.items()]


def voltage_between(place: Instance, plus: str, minus: str, at: SourceLine) -> str:
    """Return the expression for the voltage between two nodes."""
    ends = [place.node(word) for word in (plus, minus)]
    place.sheet.named += [(end, word, at) for end, word in zip(ends, (plus, minus), strict=True)]
    first, second = ("0" if node == "ground" else f"{node}.v" for node in ends)
    return f"({first} - {second})" if second != "0" else first


def current_of(place: Instance, line: Line, name: str) -> str:
    """Return the expression for the current of a voltage source in one copy of the circuit."""
    source = place.edges.get(name.lower())
    if source is None or name[0].lower() != "v":
        raise line.at.error(
            f"{line.name} takes the current of '{brief(name)}', which is not a voltage source of "
            "this circuit"
        )
    return f"{source}.i" if place.count == 1.0 else f"({source}.i/{text_of(place.count)})"


#: Name, two nodes, kind and law of a source; the equals sign before the law is optional.
_LAW = re.compile(
    r"\S+[\s(,]+[^\s(),=]+[\s,]+[^\s(),=]+[\s),]+([A-Za-z]+)\s*(?:=\s*|(?=[{']))(.*)\Z", re.ASCII
)
_SIGNALS = re.compile(r"(?<![\w.])[vi]\s*\(|(?<![\w.])time(?![\w.])", re.IGNORECASE | re.ASCII)

#: Distance of a switch's shifted threshold from the centre, in multiples of the hysteresis.
_BEYOND = 1.000001

#: Kind of source, by element letter and by the word before the law.
_GIVES = {
    "b": {"v": "voltage", "i": "current"},
    "e": {"value": "voltage", "vol": "voltage", "v": "voltage"},
    "g": {"value": "current", "cur": "current", "i": "current"},
}


def has_law(line: Line) -> bool:
    """Return whether the line of a controlled source contains an expression as its law."""
    match = _LAW.match(line.text)
    return match is not None and match[1].lower() in _GIVES[line.key[0]]


def has_signals(word: str) -> bool:
    """Return whether an expression contains voltages, currents or the time."""
    return _SIGNALS.search(word) is not None


def law_of(place: Instance, line: Line, text: str) -> str:
    """Convert an expression with voltages, currents, time and parameters to one for scenes."""
    own = unquoted(text)

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
    law = place.multiplied(kind, law_of(place, line, match[2]))
    place.add(line.words[0], f"{kind}_source", nodes, {kind: law})


def add_switch(place: Instance, line: Line) -> None:
    """Add a resistance switched by a voltage (S) or current (W); ``NAME_on`` has hysteresis."""
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
        # The mode shifts the threshold beyond the levels of its events, so that these occur first.
        threshold = f"({at} + {_BEYOND!r}*{half}*(1 - 2*{name}))"
        scene.event(f"{name}_up", f"{given} - {upper}", direction=1, set={name: "1"})
        scene.event(f"{name}_down", f"{given} - {lower}", direction=-1, set={name: "0"})
        # The controlling signal determines the initial mode.
        first = f"where({given} > {upper}, 1, where({given} < {lower}, 0, {name}))"
        scene.event(f"{name}_begin", "t", direction=1, set={name: first})
    law = f"where({given} > {threshold}, {text_of(values['ron'])}, {text_of(values['roff'])})"
    nodes = [place.node(word) for word in words[:2]]
    resistance = scaled(law, place.count, "/")
    place.add(line.words[0], "resistor", nodes, {"resistance": resistance})


_Key = TypeVar("_Key")


def find_couplings(place: Instance, lines: list[Line]) -> None:
    """Group the inductors that K statements couple, before elements are added."""
    inductors = {line.key: line for line in lines if line.key[0] == "l"}
    for line in lines:
        if line.key[0] == "k":
            _couple(place, line, inductors)


def _couple(place: Instance, line: Line, inductors: Mapping[str, Line]) -> None:
    """Combine all inductors of a K statement to one group."""
    names = [word.lower() for word in line.words[1:-1]]
    if len(names) < 2 or "=" in line.words:
        raise line.at.error(f"{line.name} needs two inductors or more, and a number")
    for name in names:
        if name not in inductors:
            raise line.at.error(
                f"{line.name} couples '{brief(name)}', which is not an inductor of this circuit"
                f"{nearest(name, inductors)}"
            )
    # Coupling is transitive, so groups that contain one of the inductors are merged.
    whole = Coupled()
    for name in names:
        old = place.coupled.get(name, Coupled({name: inductors[name]}))
        whole.inductors |= old.inductors
        whole.couplings |= old.couplings
    for pair in combinations(names, 2):
        if pair[0] == pair[1] or frozenset(pair) in whole.couplings:
            raise line.at.error(f"'{brief(pair[0])}' is coupled twice to '{brief(pair[1])}'")
        whole.couplings[frozenset(pair)] = line
    whole.inductors = _in_order(whole.inductors)
    whole.couplings = _in_order(whole.couplings)
    if len(whole.inductors) > len(WINDINGS):
        raise line.at.error(f"more than {len(WINDINGS)} inductors share flux")
    place.coupled.update(dict.fromkeys(whole.inductors, whole))


def _in_order(lines: dict[_Key, Line]) -> dict[_Key, Line]:
    return dict(sorted(lines.items(), key=lambda item: item[1].at.line))


def complete_signs(place: Instance, coupled: Coupled) -> dict[str, float] | None:
    """Return the sign of each winding relative to the first; None without complete couplings.

    A complete coupling is 1 or -1. Raise an error if only some are complete or signs conflict.
    """
    values = {
        pair: (place.scope.value(line.words[-1], line.at), line)
        for pair, line in coupled.couplings.items()
    }
    # Only a number can be a complete coupling, because runs may change parameters.
    complete = {pair: value for pair, (value, _) in values.items() if value in (1.0, -1.0)}
    if not complete:
        return None
    # The first winding defines the flux direction. The sign zero means incomplete coupling.
    first, *others = coupled.inductors
    signs = {first: 1.0} | {name: complete.get(frozenset((first, name)), 0.0) for name in others}
    # If all windings share one flux, the coupling of two windings is the product of their signs.
    for a, b in combinations(coupled.inductors, 2):
        pair = frozenset((a, b))
        if complete.get(pair, 0.0) != signs[a] * signs[b] or not signs[a] * signs[b]:
            line = values[pair][1] if pair in values else next(iter(coupled.couplings.values()))
            raise line.at.error(
                f"windings that are coupled completely share one flux, so that '{brief(a)}' and "
                f"'{brief(b)}' are coupled completely, too: give all of their couplings as 1 or "
                "-1, or smaller values for all"
            )
    return signs


def coupled_fields(
    place: Instance, coupled: Coupled, windings: Mapping[str, tuple[list[str], Any]]
) -> dict[str, Any]:
    """Return the fields of coupled inductors, given the nodes and inductance, [H], of each."""
    fields: dict[str, Any] = {}
    number = {name: i for i, name in enumerate(coupled.inductors, 1)}
    for name, (nodes, inductance) in windings.items():
        i = number[name]
        fields[WINDINGS[i - 1]], fields[f"inductance{i}"] = nodes, inductance
    values: dict[str, Any] = {}
    for pair, line in coupled.couplings.items():
        # All pairs of one statement share a parameter.
        if line.key not in values:
            values[line.key] = place.principal(line, line.words[-1], "1")
        i, j = (number[name] for name in pair)
        fields[coupling_field(i, j)] = values[line.key]
    return fields


#: Geometry parameters for capacitance and leakage per area, which are not modelled.
_UNUSED_OF_CHANNELS = {"ad", "as", "pd", "ps", "nrd", "nrs"}
_DEFAULT_SIZE = 1e-4  # default channel length and width in ngspice, [m]


def _parts(line: Line, known: set[str], counts: range) -> tuple[tuple[str, ...], dict[str, str]]:
    """Split a line into words, as many as ``counts`` permits, and settings ``name = value``."""
    words, rest = split_settings(line.words[1:])
    given = settings(_without_second(rest), line.at)
    for name in given:
        if name not in known:
            hint = nearest(name, known)
            raise line.at.error(f"{line.name} has no supported setting '{brief(name)}'{hint}")
    if len(words) not in counts:
        few = f"{counts.start}" + (f" to {counts.stop - 1}" if len(counts) > 1 else "")
        raise line.at.error(f"{line.name} is followed by {len(words)} words, not {few}")
    return words, given


def _without_second(rest: tuple[str, ...]) -> tuple[str, ...]:
    """Remove the second of two temperature coefficients, which has no effect at 27 degrees."""
    # TC=1m,2u is split into words: the next number is the second coefficient.
    words = [word.lower() for word in rest[:-3]]
    after = words.index("tc") + 3 if "tc" in words else 0
    if not after or read_number(rest[after]) is None:
        return rest
    return rest[:after] + rest[after + 1 :]


#: Temperature coefficients, which have no effect at 27 degrees.
_OF_TEMPERATURE = ("tc", "tc1", "tc2")

#: Component, field, unit and permitted settings of elements that have one value, by letter.
_ONE_PORTS = {
    "r": ("resistor", "resistance", "ohm", {"m", *_OF_TEMPERATURE}),
    "c": ("capacitor", "capacitance", "F", {"m", "ic", *_OF_TEMPERATURE}),
    "l": ("inductor", "inductance", "H", {"m", "ic", *_OF_TEMPERATURE}),
}


def _valued(
    place: Instance, line: Line, known: set[str]
) -> tuple[tuple[str, ...], dict[str, str], Value]:
    """Return words, settings and value of an element; the value is a word or a setting ``R=``."""
    key = line.key[0]
    words, given = _parts(line, {key, *known}, range(2, 4))
    # Exactly one of the two forms of the value is required.
    if (len(words) == 3) == (key in given):
        raise line.at.error(f"{line.name} needs one value")
    word = words[2] if len(words) == 3 else given[key]
    if key == "r" and has_signals(word):
        return words, given, law_of(place, line, word)
    return words, given, place.principal(line, word, _ONE_PORTS[key][2])


def _one_port(place: Instance, line: Line) -> None:
    # Coupled inductors are added by their K statement.
    if line.key in place.coupled:
        return
    key = line.key[0]
    type, field, _, known = _ONE_PORTS[key]
    words, given, value = _valued(place, line, known)
    nodes = [place.node(word) for word in words[:2]]
    if place.sheet.amount(value) == 0.0:
        # A zero resistance or inductance is a short circuit; a zero capacitance is omitted.
        if key != "c":
            place.add_short(line.words[0], nodes)
        return
    initial = _initial_value(place, line, words, given)
    # For m parallel elements, capacitance is multiplied, and resistance and inductance are divided.
    whole = scaled(value, _count(place, line, given), "*" if key == "c" else "/")
    place.add(line.words[0], type, nodes, {field: whole}, initial)


def _count(place: Instance, line: Line, given: dict[str, str]) -> Value:
    """Return the number of parallel elements in all copies of the circuit."""
    own = place.multiplier(given["m"], line.at) if "m" in given else 1.0
    return scaled(place.count, own)


def _initial_value(
    place: Instance, line: Line, words: tuple[str, ...], given: dict[str, str]
) -> dict[str, Any]:
    """Return the initial ``v`` of a capacitor or ``i`` of an inductor if ``uic`` is set."""
    key = line.key[0]
    if not place.sheet.uses_initial or key == "r":
        return {}
    symbol = "v" if key == "c" else "i"
    if "ic" in given:
        value = place.scope.value(given["ic"], line.at)
        return {symbol: value if key == "c" else scaled(value, place.count)}
    if key != "c":
        return {}
    voltage = _given_voltage(place, words[0], words[1])
    return {} if is_zero(voltage) else {symbol: voltage}


def _given_voltage(place: Instance, plus: str, minus: str) -> Value:
    """Return the voltage between two nodes according to ``.ic``, by default zero."""
    # Nodes in ``.ic`` belong to the main circuit.
    known = {place.sheet.node("", name): v for name, v in place.sheet.voltages.items()}
    first, second = (known.get(place.node(word), 0.0) for word in (plus, minus))
    if is_zero(second):
        return first
    if isinstance(first, float) and isinstance(second, float):
        return first - second
    return f"{text_of(first)} - {text_of(second)}"


def _coupling(place: Instance, line: Line) -> None:
    """Add coupled inductors as one edge, with the name of their first K statement."""
    coupled = place.coupled[line.words[1].lower()]
    # Only the first K statement of a group creates the edge.
    if line.key != coupled.first:
        return
    windings: dict[str, tuple[list[str], Value]] = {}
    initial: dict[str, dict[str, Any]] = {}
    for name, inductor in coupled.inductors.items():
        words, given, value = _valued(place, inductor, {"ic"})
        if place.sheet.amount(value) == 0.0:
            raise inductor.at.error(
                f"{inductor.name} has no inductance, so it cannot be coupled: remove K"
            )
        whole = scaled(value, place.count, "/")
        windings[name] = [place.node(node) for node in words[:2]], whole
        start = _initial_value(place, inductor, words, given)
        if start:
            initial[name] = start
    # With complete coupling, the inductance matrix would be singular.
    signs = complete_signs(place, coupled)
    if signs is not None:
        _one_flux(place, coupled, windings, initial, signs)
        return
    fields = coupled_fields(place, coupled, windings)
    ports = dict(zip(windings, WINDINGS, strict=False))
    begin = {ports[name]: start for name, start in initial.items()}
    place.add(line.words[0], "coupled_inductors", (), fields, begin)


def _one_flux(
    place: Instance,
    coupled: Coupled,
    windings: Mapping[str, tuple[list[str], Value]],
    initial: Mapping[str, dict[str, Any]],
    signs: Mapping[str, float],
) -> None:
    """Add windings that share one flux: the first as an inductor, the others as ideal transformers.

    The inductor carries the magnetising current: all currents, weighted by sqrt(inductance).
    """
    (first, (nodes, own)), *others = windings.items()
    start = [text_of(initial[first]["i"])] if first in initial else []
    for name, (_, value) in others:
        if name in initial:
            root = f"sqrt({text_of(value)}/{text_of(own)})"
            start.append(f"{text_of(signs[name])}*{root}*{text_of(initial[name]['i'])}")
    begin = {"i": " + ".join(start)} if start else {}
    place.add(coupled.inductors[first].words[0], "inductor", nodes, {"inductance": own}, begin)
    for name, (pair, value) in others:
        # Numbers of turns are proportional to the square roots of inductances.
        ratio = f"{text_of(signs[name])}*sqrt({text_of(own)}/{text_of(value)})"
        fields = {"primary": nodes, "secondary": pair, "ratio": ratio}
        place.add(coupled.inductors[name].words[0], "transformer", (), fields)


def _independent(place: Instance, line: Line) -> None:
    words = _without_signs(line)
    if len(words) < 2:
        raise line.at.error(f"{line.name} needs two nodes, a value")
    is_voltage = line.key[0] == "v"
    nodes = [place.node(word) for word in words[:2]]
    source = read_source(words[2:], place.scope, place.sheet.times, line.at)
    fields = dict(source.fields)
    # Only a constant value becomes a parameter, with the name of the source.
    if source.is_constant:
        label, unit = place.label(line.words[0]), "V" if is_voltage else "A"
        fields["value"] = place.sheet.own_parameter(label, fields["value"], line.at, unit)
    count = 1.0 if is_voltage else place.count
    kind, given = edge_of(Source(source.shape, fields), is_voltage, count)
    place.add(line.words[0], kind, nodes, given)


def _without_signs(line: Line) -> tuple[str, ...]:
    """Return the words after the name of a source, without equals signs after DC and AC."""
    words = line.words[1:]
    for before, word in pairwise(words):
        if word == "=" and before.lower() not in ("dc", "ac"):
            raise line.at.error(f"'{brief(before)}' of {line.name} is not supported")
    return tuple(word for word in words if word != "=")


def _controlled(place: Instance, line: Line) -> None:
    word = line.words[3].lower() if len(line.words) > 3 else ""
    if word == "table":
        raise line.at.error(
            f"{line.name} has a TABLE, which is not supported: write an expression with VALUE="
        )
    if word == "poly":
        add_polynomial(place, line)
    elif line.key[0] in "eg" and has_law(line):
        add_law(place, line)
    elif line.key[0] in "eg":
        _by_voltage(place, line)
    else:
        _by_current(place, line)


def _by_voltage(place: Instance, line: Line) -> None:
    words, _ = _parts(line, set(), range(5, 6))
    type, field, unit = (
        ("vcvs", "gain", "1") if line.key[0] == "e" else ("vccs", "transconductance", "S")
    )
    nodes = [place.node(word) for word in words[:4]]
    factor = place.principal(line, words[4], unit)
    if line.key[0] == "g":
        factor = scaled(factor, place.count)
    ports = {"output": nodes[:2], "control": nodes[2:]}
    place.add(line.words[0], type, (), {**ports, field: factor})


def _by_current(place: Instance, line: Line) -> None:
    words, _ = _parts(line, set(), range(4, 5))
    current = current_of(place, line, words[2])
    nodes = [place.node(word) for word in words[:2]]
    kind, unit = ("voltage", "ohm") if line.key[0] == "h" else ("current", "1")
    # The controlling current flows through a voltage source.
    law = place.multiplied(kind, f"{text_of(place.principal(line, words[3], unit))}*{current}")
    place.add(line.words[0], f"{kind}_source", nodes, {kind: law})


def _area(place: Instance, line: Line, words: tuple[str, ...], given: dict[str, str]) -> Value:
    """Return the area factor of a device; ``off``, a guess for the operating point, is ignored."""
    rest = [word for word in words if word.lower() != "off"]
    if len(rest) > 1 or (rest and "area" in given):
        raise line.at.error(f"'{brief(rest[-1])}' is one word too many")
    area: Value = 1.0
    if rest or "area" in given:
        area = place.scope.value(rest[0] if rest else given["area"], line.at)
    return scaled(area, _count(place, line, given))


def _diode(place: Instance, line: Line) -> None:
    words, given = _parts(line, {"area", "m", "ic"}, range(3, 6))
    model = place.model(words[2], "d", line)
    fields = device_fields(model, _area(place, line, words[3:], given), place.gmin)
    _hold_charges(place, line, fields)
    nodes = [place.node(word) for word in words[:2]]
    initial: dict[str, Any] = {}
    # With a series resistance, the state is an inner voltage, which ``.ic`` does not set.
    is_state = {"junction_capacitance", "transit_time"} & fields.keys()
    if place.sheet.uses_initial and is_state and "series_resistance" not in fields:
        voltage = _given_voltage(place, words[0], words[1])
        if "ic" in given:
            voltage = place.scope.value(given["ic"], line.at)
        initial = {} if is_zero(voltage) else {"v": voltage}
    place.add(line.words[0], "diode", nodes, fields, initial)


def _bipolar(place: Instance, line: Line) -> None:
    words, given = _parts(line, {"area", "m"}, range(4, 8))
    # The fourth word is the model or, if no model has that name, the substrate.
    at = 3 if place.has_model(words[3]) or len(words) == 4 else 4
    model = place.model(words[at], "q", line)
    area, gmin = _area(place, line, words[at + 1 :], given), place.sheet.gmin
    fields = device_fields(model, area, scaled(gmin, _count(place, line, given)) if gmin else 0.0)
    _hold_charges(place, line, fields)
    nodes = [place.node(word) for word in words[:3]]
    substrate = place.node(words[3] if at == 4 else "0")
    # Without these fields, no current flows into the substrate.
    if {"leakage", "substrate_capacitance"} & fields.keys():
        nodes.append(substrate)
    place.add(line.words[0], model.component, nodes, fields)


#: Names of transit times, and of the junction capacitances that these require.
_TRANSITS = {
    "transit_time": "junction_capacitance",
    "forward_transit_time": "be_capacitance",
    "reverse_transit_time": "bc_capacitance",
}

#: Default capacitance of junctions with a transit time, relative to the duration of the run, [F/s].
#: A milliampere then changes the voltage by one volt within 5e-8 of the run. Without a capacitance,
#: the voltage would jump when the stored charge becomes zero.
_LEAST_CAPACITANCE = 5e-11


def _hold_charges(place: Instance, line: Line, fields: dict[str, Value]) -> None:
    """Add a small capacitance to junctions that have a transit time but no capacitance."""
    if not place.sheet.times.stop:
        return
    least = _LEAST_CAPACITANCE * place.sheet.times.stop
    wanted = [capacity for transit, capacity in _TRANSITS.items() if transit in fields]
    # With base-width modulation, the base charge also depends on the collector junction's voltage.
    is_modulated = fields.keys() & BASE_CHARGE and "forward_transit_time" in fields
    if is_modulated and "bc_capacitance" not in wanted:
        wanted.append("bc_capacitance")
    missing = [capacity for capacity in wanted if capacity not in fields]
    if missing:
        fields |= dict.fromkeys(missing, scaled(least, place.count))
        place.scope.remark(
            f"{line.at}: {brief(line.words[0])} has transit times and no capacitance of "
            f"{' and '.join(name.partition('_')[0] for name in missing)}: {least:.3g} F is "
            "added"
        )


def _field_effect(place: Instance, line: Line) -> None:
    """Add a field-effect transistor with overlap capacitances, bulk diodes and resistances."""
    known = {"w", "l", "m"} | _UNUSED_OF_CHANNELS
    words, given = _parts(line, known, range(5, 7))
    model = place.model(words[4], "m", line)
    if len(words) == 6 and words[5].lower() != "off":
        raise line.at.error(f"'{brief(words[5])}' is one word too many")
    width, length = (
        place.scope.value(given[key], line.at) if key in given else _DEFAULT_SIZE
        for key in ("w", "l")
    )
    count = _count(place, line, given)
    drain, gate, source, bulk = map(place.node, words[:4])
    # Channel, diodes and overlap capacitances are connected to the inner nodes of drain and source.
    drain = _inner(place, line, model, "rd", drain, count)
    source = _inner(place, line, model, "rs", source, count)
    fields = channel_fields(model, scaled(width, count), length)
    ends = (drain, gate, source) if "body_effect" not in fields else (drain, gate, source, bulk)
    place.add(line.words[0], model.component, ends, fields)
    for side, end in (("cbd", drain), ("cbs", source)):
        if bulk != end:
            # Diodes conduct from the bulk for an n-channel, and into the bulk for a p-channel.
            pair = (bulk, end) if model.component == "mosfet_n" else (end, bulk)
            own = side_fields(model, side, place.gmin, count)
            place.add(f"{line.words[0]}_{side}", "diode", pair, own)
    overlaps = (("cgdo", drain, width), ("cgso", source, width), ("cgbo", bulk, length))
    for side, end, size in overlaps:
        per_length = model.values[side]
        if not is_zero(per_length) and end != gate:
            name = f"{line.words[0]}_{side}"
            capacitance = scaled(scaled(per_length, size), count)
            place.add(name, "capacitor", (gate, end), {"capacitance": capacitance})


def _junction_gate(place: Instance, line: Line) -> None:
    """Add a junction field-effect transistor as a channel, two diodes and resistances."""
    words, given = _parts(line, {"area", "m"}, range(4, 7))
    model = place.model(words[3], "j", line)
    area = _area(place, line, words[4:], given)
    gmin = scaled(place.sheet.gmin, _count(place, line, given)) if place.sheet.gmin else 0.0
    drain, gate, source = map(place.node, words[:3])
    drain = _inner(place, line, model, "rd", drain, area)
    source = _inner(place, line, model, "rs", source, area)
    place.add(line.words[0], model.component, (drain, gate, source), gated_fields(model, area))
    for side, end in (("cgd", drain), ("cgs", source)):
        if gate != end:
            pair = (gate, end) if model.component == "mosfet_n" else (end, gate)
            own = side_fields(model, side, gmin, area)
            place.add(f"{line.words[0]}_{side}", "diode", pair, own)


def _inner(
    place: Instance, line: Line, model: DeviceModel, name: str, node: str, count: Value
) -> str:
    """Add the resistance between a terminal and the channel, if any; return the inner node."""
    if is_zero(model.values[name]):
        return node
    inner = place.sheet.names.own(place.label(f"{line.words[0]}_{name}"))
    value = {"resistance": scaled(model.values[name], count, "/")}
    place.add(f"{line.words[0]}_{name}", "resistor", (node, inner), value)
    return inner


#: Functions that add elements to a scene, by first letter of the element.
DEVICES: dict[str, Callable[[Instance, Line], None]] = {
    **dict.fromkeys("rcl", _one_port),
    "k": _coupling,
    **dict.fromkeys("vi", _independent),
    **dict.fromkeys("efgh", _controlled),
    "b": add_law,
    **dict.fromkeys("sw", add_switch),
    "d": _diode,
    "q": _bipolar,
    "m": _field_effect,
    "j": _junction_gate,
}
