"""Settings of a run, and the checks of those that need no model."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError, SolveError
from cotree.records import changed
from cotree.scene.expressions import check_number
from cotree.solvers.budgets import LONGEST_TIME, MOST_EVENTS, MOST_STEPS

if TYPE_CHECKING:
    from cotree.solvers.base import FloatArray


# Of more times than these preparing a run takes no time beside it.
_MOST_TIMES = 10_000

# Kinds of values that never change.
_PLAIN = frozenset((int, float, str, bool, type(None)))


@dataclass(frozen=True)
class Settings:
    """Settings of a run; see :meth:`cotree.Model.simulate`."""

    t_span: tuple[float, float]
    t_eval: Any = None
    method: str = "auto"
    rtol: float = 1e-8
    atol: float = 1e-10
    parameters: Any = None
    initial: Mapping[str, float] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    sensitivities: bool = True
    error_test_sensitivities: bool = True
    scales: Mapping[str, float] = field(default_factory=dict)
    max_step: float | None = None
    max_steps: float | None = MOST_STEPS
    max_events: float | None = MOST_EVENTS
    time_limit: float | None = LONGEST_TIME
    throw: bool = False
    project: bool = True


# Settings that are one number or name each; parameters and initial values belong to a run.
_plain = attrgetter(
    *(
        field.name
        for field in fields(Settings)
        if field.name not in {"t_span", "t_eval", "parameters", "initial", "inputs", "scales"}
    )
)


def in_python(value: Any) -> Any:
    """Return a scalar of NumPy, or an array without axes, as the number of Python that it holds."""
    if isinstance(value, np.generic) or (isinstance(value, np.ndarray) and not value.ndim):
        return value.item()
    return value


def checked_settings(settings: Settings) -> Settings:
    """Return settings with numbers of Python, and refuse those of the wrong kind, by name."""
    given = {name: in_python(value) for name, value in vars(settings).items()}
    settings = changed(settings, **given | {"t_span": read_span(settings.t_span)})
    if not isinstance(settings.method, str):
        raise SolveError(f"method is {settings.method!r}: give a name in quotes")
    if not isinstance(settings.sensitivities, bool):
        raise ParameterError(
            f"sensitivities is {settings.sensitivities!r}: give True or False; to which parameters "
            "they are is chosen where a scene is compiled"
        )
    for name in ("initial", "inputs", "scales"):
        check_mapping(name, getattr(settings, name))
    return settings


def check_mapping(name: str, value: object) -> None:
    """Refuse a setting that is no mapping."""
    if not isinstance(value, Mapping):
        raise ParameterError(f"{name} must be a mapping of names to values")


def key_of(settings: Settings) -> Hashable | None:
    """Give what tells settings apart, parameters and initial values left out; None if nothing does.

    Equal keys mean equal settings, whatever happens to arrays and mappings meanwhile. Settings with
    functions, tables or very many times have none.
    """
    times = read_times(settings.t_eval)
    if times is not None and times.size > _MOST_TIMES:
        return None
    numbers = _plain(settings)
    kinds = tuple(map(type, numbers))
    if not _PLAIN.issuperset(kinds):
        numbers = tuple([own if type(own) in _PLAIN else in_python(own) for own in numbers])
        kinds = tuple(map(type, numbers))
        if not _PLAIN.issuperset(kinds):
            return None
    t_span = settings.t_span
    if isinstance(t_span, np.ndarray):
        t_span = t_span.tolist()
    try:
        span, inputs, scales = map(_token, (t_span, settings.inputs, settings.scales))
    except _UnknownError:
        return None
    # Equal numbers of different kinds, as 1 and True, are not accepted alike. Zeros of both signs
    # are refused among them.
    wanted = None if times is None else (times.shape, times.tobytes())
    return numbers, kinds, span, inputs, scales, wanted


class _UnknownError(Exception):
    """A value that may change, or equal another one that means something else."""


def _token(value: object) -> Hashable:
    kind = type(value)
    if kind is float or kind in _PLAIN:
        # 0.0 equals -0.0, and their reciprocals differ.
        return kind, value or str(value)
    if isinstance(value, (dict, Mapping)):  # a dict is known without a look at what mappings are
        return tuple([(name, _token(own)) for name, own in value.items()]) if value else ()
    if isinstance(value, (tuple, list)):
        return tuple([_token(own) for own in value])
    plain = in_python(value)
    if plain is not value:
        return _token(plain)
    raise _UnknownError


def read_bound(value: float | None, name: str) -> float | None:
    """Accept a budget: a number, or None or infinity for none."""
    return None if value is None or value == math.inf else check_number(value, name)


def read_whole(value: float | None, name: str) -> int | None:
    """Accept a budget that is a whole number, and return it as an int."""
    bound = read_bound(value, name)
    if bound is None:
        return None
    if not bound.is_integer():
        raise ParameterError(f"{name} is {value}: give a whole number")
    return int(bound)


def read_times(t_eval: Any) -> FloatArray | None:
    """Accept the times that are asked for."""
    if t_eval is None:
        return None
    try:
        return np.array(t_eval, dtype=float)
    except (TypeError, ValueError):
        raise SolveError("t_eval must be a sequence of numbers") from None


def read_span(t_span: Any) -> tuple[float, float]:
    """Accept a start and an end."""
    try:
        first, last = t_span
    except (TypeError, ValueError):
        raise SolveError("t_span must be a pair (start, end)") from None
    return check_number(first, "start of t_span"), check_number(last, "end of t_span")
