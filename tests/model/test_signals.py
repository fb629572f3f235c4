from __future__ import annotations

import pytest

from cotree.errors import ExpressionError, ModelError, ParameterError
from cotree.model.signals import read_signals

NAMES = ("F", "T")


def _signal(value):
    signals = read_signals({"T": value}, NAMES)
    assert set(signals.by_position) == {1}
    return signals, signals.by_position[1]


def test_numbers():
    """Expressions are compiled into a model of their own; see tests/systems/test_feedback.py."""
    assert _signal(3)[1](7.0) == 3.0
    assert _signal("-0.5")[1](7.0) == -0.5


def test_table_and_its_breakpoints():
    signals, signal = _signal(([0.0, 1.0, 2.0], [0.0, 4.0, 4.0]))
    assert [signal(t) for t in (-1.0, 0.25, 1.5, 9.0)] == [0.0, 1.0, 4.0, 4.0]
    assert signals.breakpoints == (0.0, 1.0, 2.0)
    assert list(signals.tables) == [1]


def test_function():
    signals, signal = _signal(lambda t: t * t)
    assert signal(3.0) == 9.0
    assert not signals.tables


@pytest.mark.parametrize(
    ("value", "error", "message"),
    [
        ("__import__('os')", ExpressionError, "input 'T'"),
        (([0.0], [1.0]), ModelError, "at least two"),
        (([0.0, 0.0], [1.0, 2.0]), ModelError, "times that increase"),
        (([0.0, 1.0], [1.0, float("nan")]), ModelError, "not finite"),
        (None, ModelError, "input 'T' must be"),
    ],
)
def test_wrong_values_are_refused(value, error, message):
    with pytest.raises(error, match=message):
        read_signals({"T": value}, NAMES)


def test_unknown_inputs_are_refused():
    with pytest.raises(ParameterError, match="no input 'force'; did you mean 'forces'"):
        read_signals({"force": 1.0}, ("forces", "T"))
