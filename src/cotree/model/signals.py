"""Inputs of a run that replace the scene's: numbers, expressions, tables or functions."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import ParameterError, brief, nearest
from cotree.scene.expressions import Expression, check_number
from cotree.scene.fields import parse_signal

if TYPE_CHECKING:
    from cotree.dag.lookup import LinearTable
    from cotree.model.arrays import Array

Signal = Callable[[float], float]


@dataclass(frozen=True)
class Sampled:
    """A controller function that is called at fixed intervals; see :func:`sampled`."""

    function: Callable[..., float]
    period: float
    reads_states: bool

    def __call__(self, *args: Any) -> float:
        """Call the function."""
        return self.function(*args)

    def at(self, t: float, measured: Mapping[str, float]) -> float:
        """Return the value at time t; ``measured`` contains states and outputs by name."""
        return self.function(t, measured) if self.reads_states else self.function(t)


def sampled(function: Callable[..., float], period: float) -> Sampled:
    """Return an input that calls a function at fixed intervals and is constant in between.

    Parameters
    ----------
    function : callable
        ``function(t)``, or ``function(t, x)`` if it needs states or outputs. ``x`` contains their
        values by name just before the input changes: ``x["hinge.theta"]``.
    period : float
        Time between two calls, [s]; the first call is at the start of the run.

    Raises
    ------
    ParameterError
        If the function is not callable, or the period is not a positive number.

    Examples
    --------
    >>> import cotree
    >>> model = cotree.load("cart-pole").compile()
    >>> def controller(t, x):
    ...     return -40 * x["hinge.theta"] - 8 * x["hinge.theta_dot"]
    >>> held = model.simulate((0, 2), inputs={"push": cotree.sampled(controller, 0.01)})
    >>> bool(abs(held["hinge.theta"][-1]) < 1e-4)
    True
    """
    if not callable(function):
        raise ParameterError("sampled takes a function, f(t) or f(t, x), and a period")
    if check_number(period, "the period of a sampled input") <= 0.0:
        raise ParameterError(f"the period of a sampled input is {period}: it must be positive")
    try:
        kinds = [row.kind for row in inspect.signature(function).parameters.values()]
    except (TypeError, ValueError):  # functions written in C may have no signature
        kinds = []
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    return Sampled(function, float(period), sum(kind in positional for kind in kinds) > 1)


@dataclass(frozen=True)
class ReplacedInputs:
    """Inputs that a run replaces, by index in u."""

    #: Replaced inputs as functions of time.
    by_position: Mapping[int, Signal]
    breakpoints: tuple[float, ...]  # times at which a table has a kink
    #: Times and values of the replaced inputs that are numbers or tables.
    tables: Mapping[int, tuple[Array, Array]] = field(default_factory=dict)
    #: Replaced inputs that are sampled.
    sampled: Mapping[int, Sampled] = field(default_factory=dict)

    def apply(self, t: float, u: Array) -> Array:
        """Replace entries of u in place by their values at time t."""
        for position, signal in self.by_position.items():
            u[position] = signal(t)
        return u


def read_signals(values: Mapping[str, Any], names: tuple[str, ...]) -> ReplacedInputs:
    """Read the inputs of a run: numbers, texts, (times, values) or functions, by name."""
    by_position: dict[int, Signal] = {}
    breakpoints: list[float] = []
    tables: dict[int, tuple[Array, Array]] = {}
    sampled_ones: dict[int, Sampled] = {}
    for name, value in values.items():
        if name not in names:
            raise ParameterError(f"the model has no input '{name}'{nearest(name, names)}")
        if isinstance(value, Sampled):
            sampled_ones[names.index(name)] = value
            continue
        if callable(value):
            by_position[names.index(name)] = _checked(value, name)
            continue
        parsed = parse_signal(value, f"input '{name}'")
        if isinstance(parsed, Expression):
            constant = parsed.number
            # Expressions of time are compiled into a separate model; see cotree.scene.variants.
            assert constant is not None
            # A number becomes a table with one point, which C evaluates without a call to Python.
            tables[names.index(name)] = np.zeros(1), np.array([constant])
            signal = _constant(constant)
        else:
            breakpoints += parsed.x
            signal = _function_of_time(parsed)
            tables[names.index(name)] = np.array(parsed.x), np.array(parsed.y)
        by_position[names.index(name)] = signal
    return ReplacedInputs(by_position, tuple(breakpoints), tables, sampled_ones)


def _checked(function: Callable[[float], Any], name: str) -> Signal:
    """Wrap a function of time; the wrapper raises an error if the result is not a number."""

    def signal(t: float) -> float:
        value = function(t)
        if type(value) is not float:
            try:
                value = float(value)
            except (TypeError, ValueError, OverflowError):
                raise ParameterError(
                    f"input '{name}' is {brief(repr(value))} at t = {t:g}: its function must "
                    "return a number"
                ) from None
        return value

    return signal


def _constant(value: float) -> Signal:
    return lambda t: value


def _function_of_time(value: LinearTable) -> Signal:
    x, y = np.array(value.x), np.array(value.y)
    return lambda t: float(np.interp(t, x, y))
