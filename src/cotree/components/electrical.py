"""Electrical components: elements of two nodes, couplings, sources and windings.

Sources, couplings and semiconductors have modules of their own.

Kinks of pulses and of piecewise linear waveforms are found from their laws, so that integration
stops at each; see :mod:`cotree.dag.switching_times`.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

from cotree.components.component import (
    Adapt,
    Adapted,
    Component,
    Demand,
    Field,
    Given,
    Nodes,
    Shape,
    optional,
    value,
)
from cotree.components.law import Law
from cotree.components.ports import (
    across_source,
    content_storage,
    ideal_coupling,
    ideal_gyration,
    resistance,
    scalar,
    storage,
    through_source,
)
from cotree.components.terminal import Kind, Terminal
from cotree.errors import SceneError, check_known

if TYPE_CHECKING:
    from collections.abc import Callable


_DOMAIN = "electrical"

RESISTOR = resistance(
    _DOMAIN,
    "resistor",
    "linear resistance",
    value("resistance", "ohm", "voltage per current", "nonzero"),
)

# i = C dv/dt also if C depends on states. If charge is a function of the voltage, the nonlinear
# capacitor conserves it: i = dq/dt.
CAPACITOR = storage(
    _DOMAIN,
    "capacitor",
    "linear capacitance, or one that depends on states",
    value("capacitance", "F", "current per rate of voltage"),
)

INDUCTOR = storage(
    _DOMAIN,
    "inductor",
    "linear inductance, or one that depends on states",
    value("inductance", "H", "voltage per rate of current"),
    Kind.THROUGH_STORAGE,
)

NONLINEAR_CAPACITOR = content_storage(
    _DOMAIN,
    "nonlinear_capacitor",
    "charge by voltage",
    value("charge", "C", "an expression of NAME.v", ""),
)

NONLINEAR_INDUCTOR = content_storage(
    _DOMAIN,
    "nonlinear_inductor",
    "flux linkage by current",
    value("flux", "V s", "an expression of NAME.i", ""),
    Kind.THROUGH_STORAGE,
)


def _charge(port: str) -> Terminal:
    content, ends = Law.field(f"charge_{port}"), (port, "common")
    return Terminal(
        _DOMAIN, Kind.ACROSS_STORAGE, port, content=content, is_passive=False, between=ends
    )


# Each charge depends on both voltages; the derivatives of both form a matrix that need not be
# symmetric, so that neither port is passive.
THREE_TERMINAL_CAPACITOR = scalar(
    "three_terminal_capacitor",
    "two charges against a common terminal, each by both voltages",
    (
        value("charge_a", "C", "an expression of NAME.a.v and NAME.b.v", ""),
        value("charge_b", "C", "another one", ""),
    ),
    _charge("a"),
    _charge("b"),
    terminals=("a", "b", "common"),
)


def _contact(closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    """Return the resistance of a contact, interpolated logarithmically between open and closed."""
    import sympy

    # Resistances differ by many decades: interpolating their logarithms keeps slopes moderate
    # compared with the values.
    share = sympy.Piecewise((0, closed <= 0), (1, closed >= 1), (closed, True))
    return off_resistance * sympy.exp(share * sympy.log(on_resistance / off_resistance))


def _switch_voltage(through: Any, closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    return _contact(closed, on_resistance, off_resistance) * through


def _switch_current(across: Any, closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    return across / _contact(closed, on_resistance, off_resistance)


SWITCH = scalar(
    "switch",
    "resistance between open and closed",
    (
        value("closed", "1", "open up to 0, closed from 1 on, between them in between", ""),
        optional("on_resistance", "ohm", "where it is closed", 1e-3, "positive"),
        optional("off_resistance", "ohm", "where it is open", 1e9, "positive"),
    ),
    Terminal(_DOMAIN, Kind.DISSIPATOR, across=Law(_switch_voltage), through=Law(_switch_current)),
)


TRANSFORMER = ideal_coupling(
    "transformer",
    "ideal transformer: voltage of the primary is ratio times that of the secondary",
    value("ratio", "1", "turns of the primary for each of the secondary", ""),
    (_DOMAIN, "primary"),
    (_DOMAIN, "secondary"),
)


GYRATOR = ideal_gyration(
    "gyrator",
    "current of each port in proportion to the voltage of the other, without losses",
    value("conductance", "S", "current of the primary per voltage of the secondary", ""),
    (_DOMAIN, "primary"),
    (_DOMAIN, "secondary"),
)

#: Controlling ports: an open one measures a voltage, a short-circuited one a current.
_VOLTMETER = Terminal(
    _DOMAIN, Kind.THROUGH_SOURCE, "control", through=Law(lambda: 0), is_passive=False
)
_AMMETER = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, "control", across=Law(lambda: 0), is_passive=False)


def _controlled(
    name: str, by_voltage: bool, gives_voltage: bool, field: tuple[str, str, str]
) -> Component:
    """Make a controlled source."""
    # Only the controlled port absorbs power, which no other port supplies: none of these is
    # passive.
    measured = "across_control" if by_voltage else "through_control"
    law = Law.taking((measured, field[0]), lambda control, factor: factor * control)
    if gives_voltage:
        output = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, "output", across=law, is_passive=False)
    else:
        output = Terminal(_DOMAIN, Kind.THROUGH_SOURCE, "output", through=law, is_passive=False)
    given, by = ("voltage", "current")[not gives_voltage], ("voltage", "current")[not by_voltage]
    doc = f"{given} in proportion to a {by} elsewhere"
    return scalar(name, doc, (value(*field, ""),), _VOLTMETER if by_voltage else _AMMETER, output)


VCVS = _controlled("vcvs", True, True, ("gain", "1", "voltage per voltage"))
VCCS = _controlled("vccs", True, False, ("transconductance", "S", "current per voltage"))
CCVS = _controlled("ccvs", False, True, ("transresistance", "ohm", "voltage per current"))
CCCS = _controlled("cccs", False, False, ("gain", "1", "current per current"))


# Infinite gain keeps voltage and current of the input zero; those of the output follow from the
# rest of the network.
_INPUT = Terminal(
    _DOMAIN,
    Kind.NULLATOR,
    "input",
    across=Law(lambda: 0),
    through=Law(lambda: 0),
    is_passive=False,
)
_OUTPUT = Terminal(_DOMAIN, Kind.NORATOR, "output", is_passive=False)

IDEAL_OP_AMP = scalar(
    "ideal_op_amp",
    "operational amplifier of infinite gain, with feedback",
    (),
    replace(_INPUT, between=("plus", "minus")),
    replace(_OUTPUT, between=("output", "ground")),
    terminals=("plus", "minus", "output"),
)

NULLOR = scalar("nullor", "ideal amplifier whose output may float", (), _INPUT, _OUTPUT)


#: Longer than any run, [s]: the period of a single pulse.
_NEVER = 1e30

VOLTAGE_SOURCE = across_source(
    _DOMAIN, "voltage_source", "given voltage", value("voltage", "V", "plus minus minus", "")
)

CURRENT_SOURCE = through_source(
    _DOMAIN,
    "current_source",
    "given current, from plus to minus inside",
    value("current", "A", "from plus to minus inside", ""),
)


def _sine(t: Any, amplitude: Any, frequency: Any, phase: Any, offset: Any, delay: Any) -> Any:
    import sympy

    # The argument is constant until the end of the delay, so that the waveform is continuous there.
    passed = sympy.Max(0, t - delay)
    return offset + amplitude * sympy.sin(2 * sympy.pi * frequency * passed + phase)


def _pulse(
    t: Any,
    low: Any,
    high: Any,
    delay: Any,
    rise: Any,
    fall: Any,
    width: Any,
    period: Any,
) -> Any:
    import sympy

    # ``s`` counts from the beginning of the current period; it is negative before the first pulse.
    count = sympy.floor(sympy.Max(0, (t - delay) / period))
    s = t - delay - period * count
    # Branches are evaluated in order; each begins at the end of the previous one.
    share = sympy.Piecewise(
        (0, s <= 0),
        (s / rise, s < rise),
        (1, s <= rise + width),
        (1 - (s - rise - width) / fall, s < rise + width + fall),
        (0, True),
    )
    return low + (high - low) * share


def _sine_fields(unit: str) -> tuple[Field, ...]:
    return (
        value("amplitude", unit, "half of what lies between the extremes", ""),
        value("frequency", "Hz", "turns per second"),
        optional("phase", "rad", "at the delay and before", 0.0),
        optional("offset", unit, "mean value", 0.0),
        optional("delay", "s", "before it nothing changes", 0.0),
    )


def _pulse_fields(unit: str) -> tuple[Field, ...]:
    return (
        optional("low", unit, "before, between and after", 0.0),
        value("high", unit, "for its width", ""),
        optional("delay", "s", "when the first edge begins", 0.0),
        optional("rise", "s", "length of the first edge", 1e-9, "positive"),
        optional("fall", "s", "length of the second edge", 1e-9, "positive"),
        value("width", "s", "between the edges", "nonnegative"),
        optional("period", "s", "from one pulse to the next; by default there is one", _NEVER),
    )


def _waveforms(
    name: str, doc: str, fields: Callable[[str], tuple[Field, ...]], law: Callable[..., Any]
) -> tuple[Component, Component]:
    """Make voltage and current sources with a waveform."""
    # One law serves both: the field that has the waveform determines the given variable.
    voltage = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, across=Law(law))
    current = Terminal(_DOMAIN, Kind.THROUGH_SOURCE, through=Law(law))
    return (
        scalar(f"{name}_voltage", doc, fields("V"), voltage),
        scalar(f"{name}_current", doc, fields("A"), current),
    )


def _tabled(source: Component) -> Adapt:
    """Combine ``times`` and ``values`` into a table over time in the field of a source."""

    def adapt(edge: str, nodes: Nodes, fields: Given) -> Adapted:
        # Any scalar field accepts a table over an expression; here the expression is the time.
        rest = dict(fields)
        for name in ("times", "values"):
            if name not in rest:
                raise SceneError(f"edge '{edge}' needs the field '{name}': a list of numbers")
        over_time = {"of": "t", "x": rest.pop("times"), "y": rest.pop("values")}
        check_known(rest, ("times", "values"), f"edge '{edge}' has no field")
        return source, nodes, {source.fields[0].name: over_time}

    return adapt


def _piecewise(source: Component) -> Component:
    """Make the source of a table over time."""
    given = source.fields[0]
    name, doc = f"piecewise_{given.name}", "linear between given points"
    fields = (
        Field("times", "s", "that increase", Shape.NUMBERS, required=True),
        Field(
            "values",
            given.unit,
            "at these times; constant outside them",
            Shape.NUMBERS,
            required=True,
        ),
    )
    own = replace(source, name=name, doc=doc)
    return replace(own, fields=fields, adapt=_tabled(own))


#: Names of the windings' ports, in order.
WINDINGS = ("primary", "secondary", "winding3", "winding4", "winding5", "winding6")

_COMPLETE = (
    "has a complete coupling of its windings: give a coupling between -1 and 1; an ideal "
    "transformer with an inductor has other equations, which no parameter value reaches (in "
    "a netlist, write the coupling as the number 1)"
)
_TOO_CLOSE = "couples its windings by more than their flux: give smaller couplings"


def coupling_field(i: int, j: int) -> str:
    """Return the field name of the coupling of two windings, counted from 1."""
    first, second = sorted((i, j))
    return "coupling" if (first, second) == (1, 2) else f"coupling{first}{second}"


def _induced(*values: Any) -> Any:
    """Sum k sqrt(L Lj) dij/dt over the other windings; values are L, then k, Lj and the rates."""
    import sympy

    # Mutual inductance k sqrt(L Lj) times the rate of the other current.
    own, others = values[0], zip(values[1::3], values[2::3], values[3::3], strict=True)
    return sum(coupling * sympy.sqrt(own * other) * rate for coupling, other, rate in others)


def _winding(i: int, n: int) -> Terminal:
    """Make the port of a winding among n: its own flux, and the induction by the others."""
    own = f"inductance{i}"
    # ``_induced`` separates these names in threes (k, Lj and the rate of ij).
    names = [own]
    for j in (j for j in range(1, n + 1) if j != i):
        names += [coupling_field(i, j), f"inductance{j}", f"through_rate_{WINDINGS[j - 1]}"]
    return Terminal(
        _DOMAIN,
        Kind.THROUGH_STORAGE,
        WINDINGS[i - 1],
        storage=Law.field(own),
        across=Law.taking(tuple(names), _induced),
    )


def _determinant(n: int, *couplings: Any) -> Any:
    """Return the determinant of the matrix of the couplings of n windings, in order of pairs."""
    import sympy

    matrix = sympy.eye(n)
    for (i, j), coupling in zip(combinations(range(n), 2), couplings, strict=True):
        matrix[i, j] = matrix[j, i] = coupling
    return sympy.expand(matrix.det())


# Positive leading minors make the matrix of inductances positive definite (Sylvester), so that
# energy is stored and the fluxes determine the currents.
def _demand(n: int) -> Demand:
    """Require a positive minor of the first n windings: then the fluxes determine the currents."""
    names = tuple(coupling_field(*pair) for pair in combinations(range(1, n + 1), 2))
    return Demand(Law.taking(names, partial(_determinant, n)), _COMPLETE if n == 2 else _TOO_CLOSE)


@lru_cache(maxsize=len(WINDINGS))
def _windings(n: int) -> Component:
    every = range(1, n + 1)
    doc = "mutual inductance, by the root of the product of the two"
    couplings: list[Field] = [value("coupling", "1", doc, "")]
    if n > 2:
        pairs = combinations(every, 2)
        # For two windings the coupling is required; for more, pairs may be uncoupled.
        couplings = [optional(coupling_field(*pair), "1", doc, 0.0) for pair in pairs]
    return scalar(
        "coupled_inductors",
        "windings that share a part of their flux",
        (
            *(value(f"inductance{i}", "H", f"of {WINDINGS[i - 1]} alone") for i in every),
            *couplings,
        ),
        *(_winding(i, n) for i in every),
        # The first leading minor is one, so that the minors of two windings and more remain.
        demands=tuple(_demand(k) for k in range(2, n + 1)),
    )


def _as_given(edge: str, nodes: Nodes, fields: Given) -> Adapted:
    """Make as many windings as have an inductance."""
    del edge
    # Windings are counted by the inductances that a scene gives in order.
    n = 2
    while n < len(WINDINGS) and f"inductance{n + 1}" in fields:
        n += 1
    return _windings(n), nodes, fields


COUPLED_INDUCTORS = replace(_windings(2), adapt=_as_given)

COMPONENTS = (
    *(RESISTOR, CAPACITOR, NONLINEAR_CAPACITOR, THREE_TERMINAL_CAPACITOR),
    *(INDUCTOR, NONLINEAR_INDUCTOR, SWITCH),
    TRANSFORMER,
    GYRATOR,
    VCVS,
    VCCS,
    CCVS,
    CCCS,
    IDEAL_OP_AMP,
    NULLOR,
    VOLTAGE_SOURCE,
    CURRENT_SOURCE,
    *_waveforms("sine", "sine from a delay on", _sine_fields, _sine),
    *_waveforms("pulse", "one pulse with straight edges, or many", _pulse_fields, _pulse),
    _piecewise(VOLTAGE_SOURCE),
    _piecewise(CURRENT_SOURCE),
    COUPLED_INDUCTORS,
)
