"""Waveforms of independent sources: DC, SIN, PULSE, PWL, EXP, SFFM, AM.

Numbers that are not given or zero take the defaults that ngspice has.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cotree.errors import SceneError
from cotree.readers.spice_lines import shown
from cotree.readers.spice_values import is_zero, read_number, text_of

if TYPE_CHECKING:
    from cotree.readers.spice_values import Scope, Value

_WAVEFORMS = {"sin": 6, "pulse": 7, "pwl": 20_000, "exp": 6, "sffm": 7, "am": 5}
_DEGREE = "0.017453292519943295"  # rad


@dataclass(frozen=True)
class Times:
    """Times of ``.tran``, from which waveforms take their defaults; None where there is none."""

    step: float | None = None
    stop: float | None = None


@dataclass(frozen=True)
class Source:
    """Scene form of an independent source.

    Attributes
    ----------
    shape : str
        ``""`` for one given value, ``sine``, ``pulse`` or ``piecewise``.
    fields : dict
        Fields of the component, ``value`` standing for its voltage or current.
    is_constant : bool
        Whether it is a given value as a number, worth a parameter.
    """

    shape: str
    fields: dict[str, Any]
    is_constant: bool = False


def read_source(words: tuple[str, ...], scope: Scope, times: Times, where: str) -> Source:
    """Read the waveform of a source from the words after its nodes.

    Parameters
    ----------
    words : tuple of str
        The words after its nodes.
    scope : Scope
        Parameters that they may use.
    times : Times
        Step and end of the run, which waveforms take defaults from.
    where : str
        Names the line in messages.

    Raises
    ------
    SceneError
        If it is no waveform that is known, or a number is missing.
    """
    constant: Value = 0.0
    rest = list(words)
    waveform: Source | None = None
    is_given = False
    while rest:
        word = rest.pop(0)
        key = word.lower()
        if key == "dc":
            if not rest:
                raise SceneError(f"{where}: DC needs a value")
            constant, is_given = scope.value(rest.pop(0), where), True
        elif key == "ac":  # what it does in an analysis of small signals
            while rest and read_number(rest[0]) is not None:
                rest.pop(0)
        elif key in _WAVEFORMS:
            count = next((i for i, w in enumerate(rest) if w.lower() in ("ac", "dc")), len(rest))
            waveform = _waveform(key, tuple(rest[:count]), scope, times, where)
            rest = rest[count:]
        elif is_given or (key.isalpha() and scope.find(key) is None):
            raise SceneError(
                f"{where}: '{shown(word)}' is no waveform that is known here: DC, SIN, PULSE, PWL, "
                "EXP, SFFM and AM are"
            )
        else:
            constant, is_given = scope.value(word, where), True
    # Beside a waveform, DC sets the operating point of other analyses only.
    if waveform is not None:
        return waveform
    return Source("", {"value": constant}, is_constant=True)


def _waveform(key: str, words: tuple[str, ...], scope: Scope, times: Times, where: str) -> Source:
    if len(words) > _WAVEFORMS[key]:
        raise SceneError(f"{where}: {key.upper()} has more than {_WAVEFORMS[key]} numbers")
    if key == "pwl":
        return _piecewise([scope.number(word, where) for word in words], where)
    values = [scope.value(word, where) for word in words]
    if len(values) < 2:
        raise SceneError(f"{where}: {key.upper()} needs two numbers and more")
    return _MADE[key](values, times, where)


def _piecewise(numbers: list[float], where: str) -> Source:
    if len(numbers) < 2 or len(numbers) % 2:
        raise SceneError(f"{where}: PWL needs pairs of a time and a value")
    times, values = numbers[::2], numbers[1::2]
    if len(times) == 1:
        return Source("", {"value": values[0]}, is_constant=True)
    return Source("piecewise", {"times": times, "values": values})


def _or_else(
    values: list[Value], place: int, default: float | None, what: str, where: str
) -> Value:
    """Give a number of a waveform, or its default if it is absent or zero."""
    if place < len(values) and not is_zero(values[place]):
        return values[place]
    if default is None:
        raise SceneError(f"{where}: {what} is not given, and there is no .tran to take it from")
    return default


def _rest(values: list[Value], places: range) -> list[Value]:
    """Return numbers, with zero for those that are not given."""
    return [values[place] if place < len(values) else 0.0 for place in places]


def _once(times: Times) -> float | None:
    """Return the frequency of one period in a run."""
    return None if not times.stop else 1.0 / times.stop


def _turn(frequency: Value, time: str, phase: Value) -> str:
    """Write an angle that grows linearly with time from a phase in degrees."""
    angle = "" if is_zero(phase) else f" + {text_of(phase)}*{_DEGREE}"
    return f"2*pi*{text_of(frequency)}*{time}{angle}"


def _since(delay: Value) -> str:
    return "t" if is_zero(delay) else f"max(0, t - {text_of(delay)})"


def _sine(values: list[Value], times: Times, where: str) -> Source:
    frequency = _or_else(values, 2, _once(times), "the frequency of SIN", where)
    delay, decay, phase = _rest(values, range(3, 6))
    # A decaying sine is no component of its own: an expression describes it.
    if not is_zero(decay):
        passed = _since(delay)
        turn = _turn(frequency, passed, phase)
        wave = f"{text_of(values[1])}*exp(-{text_of(decay)}*{passed})*sin({turn})"
        return Source("", {"value": f"{text_of(values[0])} + {wave}"})
    fields: dict[str, Any] = {"offset": values[0], "amplitude": values[1], "frequency": frequency}
    if not is_zero(delay):
        fields["delay"] = delay
    if not is_zero(phase):
        fields["phase"] = f"{text_of(phase)}*{_DEGREE}"
    return Source("sine", fields)


def _pulse(values: list[Value], times: Times, where: str) -> Source:
    fields: dict[str, Any] = {"low": values[0], "high": values[1]}
    if len(values) > 2 and not is_zero(values[2]):
        fields["delay"] = values[2]
    for place, name in ((3, "rise"), (4, "fall")):
        # An edge of no length is as long as the simulator prints.
        fields[name] = _or_else(values, place, times.step, f"the {name} of PULSE", where)
    fields["width"] = _or_else(values, 5, times.stop, "the width of PULSE", where)
    if len(values) > 6 and not is_zero(values[6]):
        fields["period"] = values[6]
    return Source("pulse", fields)


def _exponential(values: list[Value], times: Times, where: str) -> Source:
    low, high = text_of(values[0]), text_of(values[1])
    # Its manual says that the first delay is zero where it is left out; ngspice takes the step.
    first = _or_else(values, 2, times.step, "the delay of EXP", where)
    rise = _or_else(values, 3, times.step, "the time constant of EXP", where)
    second = _or_else(values, 4, times.step, "the second delay of EXP", where)
    if len(values) < 5 or is_zero(values[4]):
        # The default of the second delay counts from the first.
        second = f"{text_of(first)} + {text_of(second)}"
    fall = _or_else(values, 5, times.step, "the second time constant of EXP", where)

    def since(begin: Value, constant: Value) -> str:
        return f"(1 - exp(-max(0, t - {text_of(begin)})/{text_of(constant)}))"

    up, down = f"({high} - {low})*{since(first, rise)}", f"({low} - {high})*{since(second, fall)}"
    return Source("", {"value": f"{low} + {up} + {down}"})


def _frequency_modulated(values: list[Value], times: Times, where: str) -> Source:
    carrier = _or_else(values, 2, _once(times), "the carrier of SFFM", where)
    signal = _or_else(values, 4, _once(times), "the frequency of SFFM", where)
    index, _, phase, inner = _rest(values, range(3, 7))
    swing = f"{text_of(index)}*sin({_turn(signal, 't', inner)})"
    wave = f"{text_of(values[1])}*sin({_turn(carrier, 't', phase)} + {swing})"
    return Source("", {"value": f"{text_of(values[0])} + {wave}"})


def _amplitude_modulated(values: list[Value], times: Times, where: str) -> Source:
    del times
    if len(values) < 4:
        raise SceneError(f"{where}: AM needs two numbers, a frequency and that of its carrier")
    signal, carrier = values[2:4]
    passed = _since(*_rest(values, range(4, 5)))
    swing = f"({text_of(values[1])} + sin({_turn(signal, passed, 0.0)}))"
    return Source("", {"value": f"{text_of(values[0])}*{swing}*sin({_turn(carrier, passed, 0.0)})"})


_MADE = {
    "sin": _sine,
    "pulse": _pulse,
    "exp": _exponential,
    "sffm": _frequency_modulated,
    "am": _amplitude_modulated,
}


def edge_of(source: Source, is_voltage: bool) -> tuple[str, dict[str, Any]]:
    """Give type and fields of a source's edge."""
    kind = "voltage" if is_voltage else "current"
    if source.shape:
        return f"{source.shape}_{kind}", source.fields
    return f"{kind}_source", {kind: source.fields["value"]}
