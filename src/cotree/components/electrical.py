"""Electrical components: two-node elements, couplings, sources and windings.

Integration restarts at the kinks of waveforms, see :mod:`cotree.dag.switching_times`.
"""

from __future__ import annotations

import math
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
from cotree.components.law import ZERO, Law, argument, exp, floor, larger, log, select, sin, sqrt
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
from cotree.components.terminal import Kind, Terminal, active_port
from cotree.errors import SceneError, check_known

if TYPE_CHECKING:
    from collections.abc import Callable


_DOMAIN = "electrical"

RESISTOR = resistance(
    _DOMAIN,
    "resistor",
    "linear resistance",
    value("resistance", "ohm", "resistance R in v = R i", "nonzero"),
)

# i = C dv/dt, even if C depends on states; for i = dq/dt, see the nonlinear capacitor.
CAPACITOR = storage(
    _DOMAIN,
    "capacitor",
    "capacitor whose capacitance may depend on states",
    value("capacitance", "F", "capacitance C in i = C dv/dt", "nonzero"),
)

INDUCTOR = storage(
    _DOMAIN,
    "inductor",
    "inductor whose inductance may depend on states",
    value("inductance", "H", "inductance L in v = L di/dt", "nonzero"),
    Kind.THROUGH_STORAGE,
)

NONLINEAR_CAPACITOR = content_storage(
    _DOMAIN,
    "nonlinear_capacitor",
    "capacitor whose charge is a function of its voltage",
    value("charge", "C", "stored charge, an expression of the voltage NAME.v", ""),
)

NONLINEAR_INDUCTOR = content_storage(
    _DOMAIN,
    "nonlinear_inductor",
    "inductor whose flux linkage is a function of its current",
    value("flux", "V s", "flux linkage, an expression of the current NAME.i", ""),
    Kind.THROUGH_STORAGE,
)


def _charge(port: str) -> Terminal:
    content, ends = argument(f"charge_{port}"), (port, "common")
    return active_port(_DOMAIN, Kind.ACROSS_STORAGE, port, content=content, between=ends)


# The capacitance matrix need not be symmetric, so no port is passive.
THREE_TERMINAL_CAPACITOR = scalar(
    "three_terminal_capacitor",
    "two charges relative to a common terminal, each a function of both voltages",
    (
        value("charge_a", "C", "charge at terminal a, an expression of NAME.a.v and NAME.b.v", ""),
        value("charge_b", "C", "charge at terminal b, an expression of NAME.a.v and NAME.b.v", ""),
    ),
    _charge("a"),
    _charge("b"),
    terminals=("a", "b", "common"),
)


def _contact(closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    """Return a contact's resistance; its logarithm is interpolated between open and closed."""
    # The resistances differ by decades; with their logarithms, relative slopes stay moderate.
    share = select(-closed, 0, select(closed - 1, 1, closed))
    return off_resistance * exp(share * log(on_resistance / off_resistance))


def _switch_voltage(through: Any, closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    return _contact(closed, on_resistance, off_resistance) * through


def _switch_current(across: Any, closed: Any, on_resistance: Any, off_resistance: Any) -> Any:
    return across / _contact(closed, on_resistance, off_resistance)


SWITCH = scalar(
    "switch",
    "switch with a finite resistance, open or closed",
    (
        value("closed", "1", "0 if open, 1 if closed; log of resistance is linear between", ""),
        optional("on_resistance", "ohm", "resistance of the closed switch", 1e-3, "positive"),
        optional("off_resistance", "ohm", "resistance of the open switch", 1e9, "positive"),
    ),
    Terminal(_DOMAIN, Kind.DISSIPATOR, across=Law(_switch_voltage), through=Law(_switch_current)),
)


TRANSFORMER = ideal_coupling(
    "transformer",
    "ideal transformer: voltage of the primary is ratio times that of the secondary",
    value("ratio", "1", "turns of the primary per turn of the secondary", ""),
    (_DOMAIN, "primary"),
    (_DOMAIN, "secondary"),
)


GYRATOR = ideal_gyration(
    "gyrator",
    "lossless gyrator: the current of each port is proportional to the voltage of the other",
    value("conductance", "S", "current of the primary per volt of the secondary", ""),
    (_DOMAIN, "primary"),
    (_DOMAIN, "secondary"),
)

#: Ports that control a source: an open port measures a voltage, a shorted port a current.
_VOLTMETER = active_port(_DOMAIN, Kind.THROUGH_SOURCE, "control", through=ZERO)
_AMMETER = active_port(_DOMAIN, Kind.ACROSS_SOURCE, "control", across=ZERO)


def _controlled(
    name: str, by_voltage: bool, gives_voltage: bool, field: tuple[str, str, str]
) -> Component:
    """Build a source of voltage or current, controlled by a voltage or current."""
    # The controlling port does not supply the power of the controlled port: neither is passive.
    measured = "across_control" if by_voltage else "through_control"
    law = Law.taking((measured, field[0]), lambda control, factor: factor * control)
    if gives_voltage:
        output = active_port(_DOMAIN, Kind.ACROSS_SOURCE, "output", across=law)
    else:
        output = active_port(_DOMAIN, Kind.THROUGH_SOURCE, "output", through=law)
    given, by = ("voltage", "current")[not gives_voltage], ("voltage", "current")[not by_voltage]
    doc = f"{given} source controlled by a {by}"
    return scalar(name, doc, (value(*field, ""),), _VOLTMETER if by_voltage else _AMMETER, output)


VCVS = _controlled("vcvs", True, True, ("gain", "1", "output voltage per control voltage"))
VCCS = _controlled(
    "vccs", True, False, ("transconductance", "S", "output current per control voltage")
)
CCVS = _controlled(
    "ccvs", False, True, ("transresistance", "ohm", "output voltage per control current")
)
CCCS = _controlled("cccs", False, False, ("gain", "1", "output current per control current"))


# With infinite gain, input voltage and current are zero; the network determines the output.
_INPUT = active_port(_DOMAIN, Kind.NULLATOR, "input", across=ZERO, through=ZERO)
_OUTPUT = active_port(_DOMAIN, Kind.NORATOR, "output")

IDEAL_OP_AMP = scalar(
    "ideal_op_amp",
    "ideal operational amplifier with feedback: infinite gain",
    (),
    replace(_INPUT, between=("plus", "minus")),
    replace(_OUTPUT, between=("output", "ground")),
    terminals=("plus", "minus", "output"),
)

NULLOR = scalar(
    "nullor", "nullor: an ideal amplifier with a floating output port", (), _INPUT, _OUTPUT
)


#: A period longer than any run, [s]: the pulse occurs only once.
_NEVER = 1e30

VOLTAGE_SOURCE = across_source(
    _DOMAIN,
    "voltage_source",
    "prescribed voltage",
    value("voltage", "V", "voltage of the plus node relative to the minus node", ""),
)

CURRENT_SOURCE = through_source(
    _DOMAIN,
    "current_source",
    "prescribed current",
    value("current", "A", "current inside the source, positive from plus to minus", ""),
)


def _sine(t: Any, amplitude: Any, frequency: Any, phase: Any, offset: Any, delay: Any) -> Any:
    # The argument is zero during the delay, so the waveform is continuous at the end of the delay.
    passed = larger(t - delay, 0)
    return offset + amplitude * sin(2 * math.pi * frequency * passed + phase)


def _pulse(
    t: Any, low: Any, high: Any, delay: Any, rise: Any, fall: Any, width: Any, period: Any
) -> Any:
    # ``s`` is the time since the start of the current period; negative before the first pulse.
    count = floor(larger((t - delay) / period, 0))
    s = t - delay - period * count
    # Each interval of the pulse begins where the previous one ends.
    falling = select(s - (rise + width + fall), 0, 1 - (s - rise - width) / fall)
    share = select(-s, 0, select(s - rise, select(rise + width - s, 1, falling), s / rise))
    return low + (high - low) * share


def _sine_fields(unit: str) -> tuple[Field, ...]:
    return (
        value("amplitude", unit, "amplitude of the sine", ""),
        value("frequency", "Hz", "frequency, in cycles per second"),
        optional("phase", "rad", "phase of the sine until the end of the delay", 0.0),
        optional("offset", unit, "value about which the sine oscillates", 0.0),
        optional("delay", "s", "time at which the oscillation begins; constant before", 0.0),
    )


def _pulse_fields(unit: str) -> tuple[Field, ...]:
    return (
        optional("low", unit, "value before, between and after pulses", 0.0),
        value("high", unit, "value during a pulse", ""),
        optional("delay", "s", "time at which the first pulse begins", 0.0),
        optional("rise", "s", "duration of the edge from low to high", 1e-9, "positive"),
        optional("fall", "s", "duration of the edge from high to low", 1e-9, "positive"),
        value("width", "s", "duration at high, without the edges", "nonnegative"),
        optional(
            "period", "s", "time from one pulse to the next; a single pulse by default", _NEVER
        ),
    )


def _waveforms(
    name: str, doc: str, fields: Callable[[str], tuple[Field, ...]], law: Callable[..., Any]
) -> tuple[Component, Component]:
    # Both sources have the same law: it prescribes the voltage of one, the current of the other.
    voltage = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, across=Law(law))
    current = Terminal(_DOMAIN, Kind.THROUGH_SOURCE, through=Law(law))
    return (
        scalar(f"{name}_voltage", doc, fields("V"), voltage),
        scalar(f"{name}_current", doc, fields("A"), current),
    )


def _tabled(source: Component) -> Adapt:
    """Return a function that sets a source's field to the table of ``times`` and ``values``."""

    def adapt(edge: str, nodes: Nodes, fields: Given) -> Adapted:
        # A scalar field accepts a table over any expression; here the expression is the time.
        rest = dict(fields)
        for name in ("times", "values"):
            if name not in rest:
                raise SceneError(f"edge '{edge}' needs the field '{name}': a list of numbers")
        over_time = {"of": "t", "x": rest.pop("times"), "y": rest.pop("values")}
        check_known(rest, ("times", "values"), f"edge '{edge}' has no field")
        return source, nodes, {source.fields[0].name: over_time}

    return adapt


def _piecewise(source: Component) -> Component:
    given = source.fields[0]
    name, doc = f"piecewise_{given.name}", "waveform that is linear between given points"
    values = "values at these times; constant before and after them"
    fields = (
        Field("times", "s", "times of the points, ascending", Shape.NUMBERS, required=True),
        Field("values", given.unit, values, Shape.NUMBERS, required=True),
    )
    own = replace(source, name=name, doc=doc)
    return replace(own, fields=fields, adapt=_tabled(own))


#: Names of winding ports, in order.
WINDINGS = ("primary", "secondary", "winding3", "winding4", "winding5", "winding6")

_COMPLETE = (
    "has a complete coupling of its windings: give a coupling between -1 and 1; an ideal "
    "transformer with an inductor has other equations, which no parameter value reaches (in "
    "a netlist, write the coupling as the number 1)"
)
_TOO_CLOSE = "couples its windings by more than their flux: give smaller couplings"


def coupling_field(i: int, j: int) -> str:
    """Return the name of the field with the coupling of windings i and j, counted from 1."""
    first, second = sorted((i, j))
    return "coupling" if (first, second) == (1, 2) else f"coupling{first}{second}"


def _induced(*values: Any) -> Any:
    """Return the sum of k sqrt(L Lj) dij/dt from L and, for each other winding, k, Lj, dij/dt."""
    own, others = values[0], zip(values[1::3], values[2::3], values[3::3], strict=True)
    return sum(coupling * sqrt(own * other) * rate for coupling, other, rate in others)


def _winding(i: int, n: int) -> Terminal:
    """Build the port of winding i of n: self-inductance, and voltages induced by the others."""
    own = f"inductance{i}"
    # ``_induced`` takes its arguments in groups of three: k, Lj and dij/dt.
    names = [own]
    for j in (j for j in range(1, n + 1) if j != i):
        names += [coupling_field(i, j), f"inductance{j}", f"through_rate_{WINDINGS[j - 1]}"]
    induced = Law.taking(tuple(names), _induced)
    return Terminal(
        _DOMAIN, Kind.THROUGH_STORAGE, WINDINGS[i - 1], storage=argument(own), across=induced
    )


def _determinant(n: int, *couplings: Any) -> Any:
    """Return the determinant of the coupling matrix of n windings; couplings are listed by pair."""
    rows = [[1.0] * n for _ in range(n)]
    for (i, j), coupling in zip(combinations(range(n), 2), couplings, strict=True):
        rows[i][j] = rows[j][i] = coupling
    return _expanded(rows)


def _expanded(rows: list[list[Any]]) -> Any:
    """Return a determinant, expanded along its first row."""
    if not rows:
        return 1.0
    return sum(
        (-1) ** j * factor * _expanded([row[:j] + row[j + 1 :] for row in rows[1:]])
        for j, factor in enumerate(rows[0])
    )


# If all leading minors are positive, the inductance matrix is positive definite (Sylvester's
# criterion). Then the stored energy is positive, and the fluxes determine the currents.
def _demand(n: int) -> Demand:
    """Return the demand that the leading minor of the couplings of n windings is positive."""
    names = tuple(coupling_field(*pair) for pair in combinations(range(1, n + 1), 2))
    return Demand(Law.taking(names, partial(_determinant, n)), _COMPLETE if n == 2 else _TOO_CLOSE)


@lru_cache(maxsize=len(WINDINGS))
def _windings(n: int) -> Component:
    every = range(1, n + 1)
    doc = "coupling factor k: the mutual inductance is k times the root of the inductances' product"
    couplings: list[Field] = [value("coupling", "1", doc, "")]
    if n > 2:
        pairs = combinations(every, 2)
        # Two windings need a coupling. Of more windings, pairs may be uncoupled.
        couplings = [optional(coupling_field(*pair), "1", doc, 0.0) for pair in pairs]
    return scalar(
        "coupled_inductors",
        "inductors with mutual inductance",
        (
            *(value(f"inductance{i}", "H", f"self-inductance of {WINDINGS[i - 1]}") for i in every),
            *couplings,
        ),
        *(_winding(i, n) for i in every),
        # The first leading minor is always one, so demands begin with two windings.
        demands=tuple(_demand(k) for k in range(2, n + 1)),
    )


def _as_given(edge: str, nodes: Nodes, fields: Given) -> Adapted:
    del edge
    # Count the windings up to the first one without an inductance.
    n = 2
    while n < len(WINDINGS) and f"inductance{n + 1}" in fields:
        n += 1
    return _windings(n), nodes, fields


COUPLED_INDUCTORS = replace(_windings(2), adapt=_as_given)

COMPONENTS = (
    *(RESISTOR, CAPACITOR, NONLINEAR_CAPACITOR, THREE_TERMINAL_CAPACITOR),
    *(INDUCTOR, NONLINEAR_INDUCTOR, SWITCH),
    *(TRANSFORMER, GYRATOR, VCVS, VCCS, CCVS, CCCS, IDEAL_OP_AMP, NULLOR),
    *(VOLTAGE_SOURCE, CURRENT_SOURCE),
    *_waveforms("sine", "sine that begins after a delay", _sine_fields, _sine),
    *_waveforms("pulse", "one trapezoidal pulse, or a train of them", _pulse_fields, _pulse),
    _piecewise(VOLTAGE_SOURCE),
    _piecewise(CURRENT_SOURCE),
    COUPLED_INDUCTORS,
)
