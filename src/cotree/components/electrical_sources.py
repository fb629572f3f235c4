"""Electrical sources: given voltages and currents, as waveforms of time or by any expression.

Kinks of pulses and of piecewise linear waveforms are found from their laws, so that integration
stops at each; see :mod:`cotree.dag.stops`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Field, Shape, optional, value
from cotree.components.law import Law
from cotree.components.ports import across_source, scalar, through_source
from cotree.components.terminal import Kind, Terminal
from cotree.errors import SceneError, check_known

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree.components.component import Adapt, Adapted, Given, Nodes

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

    # The argument is held until the delay is over, so that the waveform is continuous there.
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
    # Branches are looked at in order; each begins where the one before it ends.
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
    """Make the sources of a voltage and of a current that follow a waveform."""
    # One law serves both: the field of which the waveform is decides on the variable that is given.
    voltage = Terminal(_DOMAIN, Kind.ACROSS_SOURCE, across=Law(law))
    current = Terminal(_DOMAIN, Kind.THROUGH_SOURCE, through=Law(law))
    return (
        scalar(f"{name}_voltage", doc, fields("V"), voltage),
        scalar(f"{name}_current", doc, fields("A"), current),
    )


def _tabled(source: Component) -> Adapt:
    """Turn ``times`` and ``values`` into a table over time in the field of a source."""

    def adapt(edge: str, nodes: Nodes, fields: Given) -> Adapted:
        # Any scalar field takes a table over an expression; here the expression is the time.
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


COMPONENTS = (
    VOLTAGE_SOURCE,
    CURRENT_SOURCE,
    *_waveforms("sine", "sine from a delay on", _sine_fields, _sine),
    *_waveforms("pulse", "one pulse with straight edges, or many", _pulse_fields, _pulse),
    _piecewise(VOLTAGE_SOURCE),
    _piecewise(CURRENT_SOURCE),
)
