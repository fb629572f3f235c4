"""Electrical sources: given voltages and currents, as waveforms of time or by any expression.

Kinks of pulses and of piecewise linear waveforms are found from their laws, so that integration
stops at each; see :mod:`cotree.dag.stops`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Field, Role, Shape
from cotree.components.law import Law
from cotree.components.ports import across_source, one_port, optional, through_source, value
from cotree.components.terminal import Kind, Terminal
from cotree.errors import SceneError, check_known

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from cotree.components.component import Adapt

_DOMAIN = "electrical"

#: Beyond the span of any run, [s]: a pulse that does not come back.
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

    count = sympy.floor(sympy.Max(0, (t - delay) / period))
    s = t - delay - period * count
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


def _waveform(
    name: str, doc: str, is_voltage: bool, fields: tuple[Field, ...], law: Callable[..., Any]
) -> Component:
    """Make a source of a waveform."""
    if is_voltage:
        terminal = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, across=Law(law))
    else:
        terminal = Terminal(_DOMAIN, Kind.THROUGH_SOURCE, through=Law(law))
    return one_port(name, doc, fields, terminal)


def _tabled(source: Component) -> Adapt:
    """Turn ``times`` and ``values`` into a table over time in the field of a source."""

    def adapt(
        edge: str, nodes: Sequence[object], fields: Mapping[str, Any]
    ) -> tuple[Component, Sequence[object], Mapping[str, Any]]:
        rest = dict(fields)
        for name in ("times", "values"):
            if name not in rest:
                raise SceneError(f"edge '{edge}' needs the field '{name}': a list of numbers")
        over_time = {"of": "t", "x": rest.pop("times"), "y": rest.pop("values")}
        check_known(rest, ("times", "values"), f"edge '{edge}' has no field")
        return source, nodes, {source.fields[0].name: over_time}

    return adapt


def _piecewise(name: str, doc: str, source: Component, unit: str) -> Component:
    fields = (
        Field("times", "s", "that increase", Shape.NUMBERS, required=True),
        Field(
            "values", unit, "at these times; constant outside them", Shape.NUMBERS, required=True
        ),
    )
    own = replace(source, name=name, doc=doc)
    return Component(
        name,
        Role.NETWORK,
        doc,
        fields=fields,
        domains=(_DOMAIN,),
        ports=source.ports,
        adapt=_tabled(own),
    )


SINE_VOLTAGE = _waveform("sine_voltage", "sine from a delay on", True, _sine_fields("V"), _sine)
SINE_CURRENT = _waveform("sine_current", "sine from a delay on", False, _sine_fields("A"), _sine)
PULSE_VOLTAGE = _waveform(
    "pulse_voltage", "one pulse with straight edges, or many", True, _pulse_fields("V"), _pulse
)
PULSE_CURRENT = _waveform(
    "pulse_current", "one pulse with straight edges, or many", False, _pulse_fields("A"), _pulse
)
PIECEWISE_VOLTAGE = _piecewise(
    "piecewise_voltage", "linear between given points", VOLTAGE_SOURCE, "V"
)
PIECEWISE_CURRENT = _piecewise(
    "piecewise_current", "linear between given points", CURRENT_SOURCE, "A"
)

COMPONENTS = (
    VOLTAGE_SOURCE,
    CURRENT_SOURCE,
    SINE_VOLTAGE,
    SINE_CURRENT,
    PULSE_VOLTAGE,
    PULSE_CURRENT,
    PIECEWISE_VOLTAGE,
    PIECEWISE_CURRENT,
)
