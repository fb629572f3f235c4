"""Waveforms of independent sources: DC, SIN, PULSE, PWL, EXP, SFFM, AM, with ngspice's defaults."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from cotree.errors import brief
from cotree.readers.spice.values import Scope, Value, is_zero, read_number, scaled, text_of

if TYPE_CHECKING:
    from cotree.readers.names import SourceLine

# Maximum number of values for each waveform.
_WAVEFORMS = {"sin": 6, "pulse": 7, "pwl": 20_000, "exp": 6, "sffm": 7, "am": 5}
_MOST_PIECES = 50  # maximum number of points of a PWL waveform that is written as an expression
_DEGREE = "0.017453292519943295"  # one degree, [rad]


@dataclass(frozen=True)
class Times:
    """Times in ``.tran``, which are defaults for waveforms; None if there is no ``.tran``."""

    step: float | None = None
    stop: float | None = None


@dataclass(frozen=True)
class Source:
    """Waveform of an independent source, as shape and fields."""

    shape: str  # ``sine``, ``pulse`` or ``piecewise``; empty for a single value
    fields: dict[str, Any]  # fields of the component; ``value`` is the voltage or current
    is_constant: bool = False  # whether the value is constant, so that it may become a parameter


def read_source(words: tuple[str, ...], scope: Scope, times: Times, at: SourceLine) -> Source:
    """Read the waveform of an independent source from the words after its nodes."""
    constant: Value = 0.0
    rest = list(words)
    waveform: Source | None = None
    is_given = False
    while rest:
        word = rest.pop(0)
        key = word.lower()
        if key == "dc":
            if not rest:
                raise at.error("DC needs a value")
            constant, is_given = scope.value(rest.pop(0), at), True
        elif key == "ac":  # the value is for a small-signal analysis
            while rest and read_number(rest[0]) is not None:
                rest.pop(0)
        elif key in _WAVEFORMS:
            # The numbers of a waveform end at the next keyword.
            count = next((i for i, w in enumerate(rest) if w.lower() in ("ac", "dc")), len(rest))
            waveform = _waveform(key, tuple(rest[:count]), scope, times, at)
            rest = rest[count:]
        elif is_given or (key.isalpha() and scope.find(key) is None):
            raise at.error(
                f"'{brief(word)}' is not a supported waveform: use DC, SIN, PULSE, PWL, EXP, SFFM "
                "or AM"
            )
        else:
            # The value is a number, or the name of a parameter without braces.
            constant, is_given = scope.value(word, at), True
    # If there is a waveform, the DC value is only for the operating point of other analyses.
    if waveform is not None:
        return waveform
    return Source("", {"value": constant}, is_constant=True)


@dataclass(frozen=True)
class _Numbers:
    """The numbers of a waveform; missing numbers count as zero."""

    values: list[Value]
    times: Times
    at: SourceLine

    def __getitem__(self, place: int) -> Value:
        return self.values[place] if place < len(self.values) else 0.0

    def or_else(self, place: int, default: float | None, what: str) -> Value:
        """Return the number at an index, or its default if it is missing or zero, as in ngspice.

        The default is None if it depends on ``.tran``, but the netlist has no ``.tran``.
        """
        if not is_zero(self[place]):
            return self[place]
        if default is None:
            raise self.at.error(f"{what} is not given, and there is no .tran to take it from")
        return default

    @property
    def once(self) -> float | None:
        """The frequency at which the run has one period."""
        return None if not self.times.stop else 1.0 / self.times.stop


def _waveform(
    key: str, words: tuple[str, ...], scope: Scope, times: Times, at: SourceLine
) -> Source:
    if len(words) == 8 and key == "pulse" and is_zero(scope.value(words[7], at)):
        words = words[:7]
    if len(words) > _WAVEFORMS[key]:
        raise at.error(f"{key.upper()} has more than {_WAVEFORMS[key]} numbers")
    if key == "pwl":
        return _piecewise([scope.value(word, at) for word in words], at)
    values = [scope.value(word, at) for word in words]
    if len(values) < 2:
        raise at.error(f"{key.upper()} needs two numbers and more")
    return _MADE[key](_Numbers(values, times, at))


def _piecewise(numbers: list[Value], at: SourceLine) -> Source:
    if len(numbers) < 2 or len(numbers) % 2:
        raise at.error("PWL needs pairs of a time and a value")
    times, values = numbers[::2], numbers[1::2]
    # A single point is a constant.
    if len(times) == 1:
        return Source("", {"value": values[0]}, is_constant=isinstance(values[0], float))
    is_plain = not any(isinstance(number, str) for number in numbers)
    if is_plain and len(set(times)) == len(times):
        return Source("piecewise", {"times": times, "values": values})
    if len(times) > _MOST_PIECES:
        raise at.error(
            "PWL with parameters, or with two values at one time, has more than "
            f"{_MOST_PIECES} points"
        )
    points = list(zip(times, values, strict=True))
    steps = [_step(*begin, *end, at) for begin, end in pairwise(points)]
    return Source("", {"value": " + ".join([text_of(values[0]), *steps])})


def _step(begin: Value, low: Value, end: Value, high: Value, at: SourceLine) -> str:
    """Return an expression for the change of a PWL waveform between two points, over time."""
    change, since = f"({text_of(high)} - {text_of(low)})", f"t - {text_of(begin)}"
    if begin == end:
        return f"where({since} >= 0, {change}, 0)"
    if isinstance(begin, float) and isinstance(end, float) and end < begin:
        raise at.error(f"the times of PWL must not decrease: {end:.6g} comes after {begin:.6g}")
    length = f"({text_of(end)} - {text_of(begin)})"
    return f"{change}*min(max({since}, 0), {length})/{length}"


def _turn(frequency: Value, time: str, phase: Value) -> str:
    """Return an expression for an angle, [rad], that grows with time from a phase in degrees."""
    angle = "" if is_zero(phase) else f" + {text_of(phase)}*{_DEGREE}"
    return f"2*pi*{text_of(frequency)}*{time}{angle}"


def _since(delay: Value) -> str:
    return "t" if is_zero(delay) else f"max(0, t - {text_of(delay)})"


def _sine(given: _Numbers) -> Source:
    frequency = given.or_else(2, given.once, "the frequency of SIN")
    delay, decay, phase = (given[i] for i in range(3, 6))
    # No component has a decaying sine, so it becomes an expression.
    if not is_zero(decay):
        passed = _since(delay)
        turn = _turn(frequency, passed, phase)
        wave = f"{text_of(given[1])}*exp(-{text_of(decay)}*{passed})*sin({turn})"
        return Source("", {"value": f"{text_of(given[0])} + {wave}"})
    fields: dict[str, Any] = {"offset": given[0], "amplitude": given[1], "frequency": frequency}
    if not is_zero(delay):
        fields["delay"] = delay
    if not is_zero(phase):
        fields["phase"] = f"{text_of(phase)}*{_DEGREE}"
    return Source("sine", fields)


def _pulse(given: _Numbers) -> Source:
    fields: dict[str, Any] = {"low": given[0], "high": given[1]}
    # Edges of zero duration last for the output step, as in simulators.
    for place, name in ((3, "rise"), (4, "fall")):
        fields[name] = given.or_else(place, given.times.step, f"the {name} of PULSE")
    # A pulse without a width lasts to the end of the run.
    fields["width"] = given.or_else(5, given.times.stop, "the width of PULSE")
    fields |= {name: given[i] for i, name in ((2, "delay"), (6, "period")) if not is_zero(given[i])}
    return Source("pulse", fields)


def _exponential(given: _Numbers) -> Source:
    low, high, step = text_of(given[0]), text_of(given[1]), given.times.step
    # In the manual of ngspice, the default of the first delay is zero, but ngspice uses the step.
    first = given.or_else(2, step, "the delay of EXP")
    rise = given.or_else(3, step, "the time constant of EXP")
    second = given.or_else(4, step, "the second delay of EXP")
    if is_zero(given[4]):
        # The default of the second delay is the first delay plus the step.
        second = f"{text_of(first)} + {text_of(second)}"
    fall = given.or_else(5, step, "the second time constant of EXP")

    # Each exponential is zero before its delay.
    def since(begin: Value, constant: Value) -> str:
        return f"(1 - exp(-max(0, t - {text_of(begin)})/{text_of(constant)}))"

    up, down = f"({high} - {low})*{since(first, rise)}", f"({low} - {high})*{since(second, fall)}"
    if isinstance(first, float) and isinstance(second, float) and second < first:
        # In ngspice, both exponentials are zero before the first delay.
        down = f"where(t > {text_of(first)}, {down}, 0)"
    return Source("", {"value": f"{low} + {up} + {down}"})


def _frequency_modulated(given: _Numbers) -> Source:
    carrier = given.or_else(2, given.once, "the carrier of SFFM")
    signal = given.or_else(4, given.once, "the frequency of SFFM")
    index, phase, inner = (given[i] for i in (3, 5, 6))
    # The modulation index is the amplitude of the phase modulation, [rad].
    swing = f"{text_of(index)}*sin({_turn(signal, 't', inner)})"
    wave = f"{text_of(given[1])}*sin({_turn(carrier, 't', phase)} + {swing})"
    return Source("", {"value": f"{text_of(given[0])} + {wave}"})


def _amplitude_modulated(given: _Numbers) -> Source:
    if len(given.values) < 4:
        raise given.at.error("AM needs two numbers, a frequency and that of its carrier")
    passed = _since(given[4])
    # The sum of offset and signal is the amplitude of the carrier.
    swing = f"({text_of(given[1])} + sin({_turn(given[2], passed, 0.0)}))"
    wave = f"sin({_turn(given[3], passed, 0.0)})"
    return Source("", {"value": f"{text_of(given[0])}*{swing}*{wave}"})


_MADE = {
    "sin": _sine,
    "pulse": _pulse,
    "exp": _exponential,
    "sffm": _frequency_modulated,
    "am": _amplitude_modulated,
}


#: Fields of a source that are voltages or currents.
_SIZES = frozenset(("value", "offset", "amplitude", "low", "high", "values"))


def edge_of(source: Source, is_voltage: bool, count: Value = 1.0) -> tuple[str, dict[str, Any]]:
    """Return the component type and the fields for ``count`` parallel sources."""
    kind = "voltage" if is_voltage else "current"
    fields = source.fields
    if count != 1.0:
        fields = {
            name: _multiplied(value, count) if name in _SIZES else value
            for name, value in fields.items()
        }
    if source.shape:
        return f"{source.shape}_{kind}", fields
    return f"{kind}_source", {kind: fields["value"]}


def _multiplied(value: Any, count: Value) -> Any:
    """Return the multiple of a value, or of each value of a list."""
    return [scaled(v, count) for v in value] if isinstance(value, list) else scaled(value, count)
