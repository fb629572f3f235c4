from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag
from cotree.errors import ExpressionError
from cotree.scene.expressions import FUNCTIONS, parse

VALUES = {"a": 0.7, "b": -1.3, "t": 2.5, "j1.s": 0.4}


def _value(text):
    dag = Dag()
    symbols = {name: dag.symbol("x", i) for i, name in enumerate(VALUES)}
    node = parse(text, "field f").lower(dag, symbols.__getitem__)
    return evaluate([node], {symbols[name]: VALUES[name] for name in VALUES})[0]


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1.0),
        ("1_000", 1000.0),
        (" 2*pi ", 2 * math.pi),
        ("a + b*t - j1.s/2", 0.7 - 1.3 * 2.5 - 0.2),
        ("-a**2", -0.49),
        ("2**-1", 0.5),
        ("2**3**2", 512.0),
        ("+(-a)", -0.7),
        ("m2*(r**2/4)".replace("m2", "a").replace("r", "b"), 0.7 * 1.69 / 4),
        ("atan2(b, a)", math.atan2(-1.3, 0.7)),
        ("min(a, b) + 10*max(a, b)", -1.3 + 7.0),
        ("abs(b) + sign(b) + sqrt(t)", 1.3 - 1.0 + math.sqrt(2.5)),
        ("sin(cos(tan(a)))", math.sin(math.cos(math.tan(0.7)))),
        ("1e3 * .5", 500.0),
        ("erf(a) - erf(-b*a)", math.erf(0.7) - math.erf(0.91)),
        ("where(a > b, 1, 2)", 1.0),
        ("where(a < b, 1, 2)", 2.0),
        ("where(a <= 0.7, 1, 2) + 10*where(a < 0.7, 1, 2)", 21.0),
        ("where(a >= 0.7, 1, 2) + 10*where(a > 0.7, 1, 2)", 21.0),
        ("where(b < a < t, a, t)", 0.7),
        ("where(b < a < 0.5, a, t)", 2.5),
        ("where(a < b or t > 2, a, t) + where(a < b and t > 2, a, t)", 3.2),
        ("where(not (a < b or t < 2), where(not a > 0, 1, 2), 3)", 2.0),
    ],
)
def test_grammar(text, value):
    assert _value(text) == pytest.approx(value, rel=1e-14)


@pytest.mark.parametrize("number", [3, 2.5, np.float64(2.5)])
def test_numbers_are_expressions(number):
    assert _value(number) == float(number)


def test_every_function_is_known_to_the_arena():
    for name, arity in FUNCTIONS.items():
        assert math.isfinite(_value(f"{name}({', '.join(['a'] * arity)})"))


def test_names_are_collected():
    parsed = parse("k*(j1.s - s0) + sin(w*t)", "force of edge 'F'")
    assert parsed.names == {"k", "j1.s", "s0", "w", "t"}
    assert parsed.text == "k*(j1.s - s0) + sin(w*t)"


NASTY = [
    "__import__('os').system('true')",
    "__import__('os')",
    "a.b.",
    "a..b",
    "a.b()",
    "().__class__",
    "x[0]",
    "lambda: 1",
    "(y := 1)",
    "f'{a}'",
    "'a'",
    "b'a'",
    "[a, b]",
    "{a: b}",
    "a if b else t",
    "a < b",
    "a and b",
    "not a",
    "~a",
    "a // b",
    "a % b",
    "a @ b",
    "a << 1",
    "where(a, b, t)",
    "where(1, b, t)",
    "where(a == b, a, t)",
    "where(a != b, a, t)",
    "where(a < b, a)",
    "where(a < b, a, t, t)",
    "where(a < b, a, t=t)",
    "where(a < (b < t), a, t)",
    "where(a < b, a, b < t)",
    "where(a in b, a, t)",
    "where(True, a, t)",
    "where(" * 150 + "a < b, a, b)" + ", a, b)" * 149,
    "where(" + "not " * 150 + "a < b, a, b)",
    "sin(*a)",
    "sin(x=1)",
    "sin()",
    "sin(a, b)",
    "print(a)",
    "await a",
    "yield",
    "a; b",
    "a = b",
    "import os",
    "1\n+2",
    "a\x00b",
    "1j",
    "True",
    "None",
    "...",
    "",
    "   ",
    ")",
    "1e999",
    "9" * 3999,
    "(" * 1000 + "1" + ")" * 1000,
    "-" * 3900 + "1",
    "sin(" * 150 + "1" + ")" * 150,
    "+".join(["1"] * 150),
    "1+" * 5000 + "1",
]


@pytest.mark.parametrize("text", NASTY, ids=range(len(NASTY)))
def test_nasty_text_is_refused_in_one_sentence(text):
    with pytest.raises(ExpressionError, match="stiffness of edge 'k'") as caught:
        parse(text, "stiffness of edge 'k'")
    message = str(caught.value)
    assert "\n" not in message
    assert len(message) < 300
    assert type(caught.value.__cause__) is type(None)


def test_integers_too_long_for_decimal_digits_are_refused():
    with pytest.raises(ExpressionError):
        parse("0x" + "f" * 3990, "field f")


@pytest.mark.parametrize("value", [True, None, [1.0], {"a": 1}, math.nan, math.inf, 10**400, b"1"])
def test_what_is_no_number_is_refused(value):
    with pytest.raises(ExpressionError, match="field f"):
        parse(value, "field f")


def test_messages_show_the_text():
    with pytest.raises(ExpressionError, match=r"field f: '2 \*\* sin\(' is not an expression"):
        parse("2 ** sin(", "field f")
    with pytest.raises(ExpressionError, match="did you mean 'sqrt'"):
        parse("sqr(a)", "field f")


@pytest.mark.parametrize("text", ["1/0", "sqrt(-1)", "log(0)", "10**400", "1e308*10", "a/(b - b)"])
def test_constants_without_a_value_are_refused(text):
    with pytest.raises(ExpressionError, match=r"field f: .* has no value"):
        _value(text)


def test_unknown_names_are_said_with_the_field():
    def resolve(name):
        raise ExpressionError(f"uses '{name}', which is unknown")

    with pytest.raises(ExpressionError, match="field f: uses 'q', which is unknown"):
        parse("2*q", "field f").lower(Dag(), resolve)


# Python's parser warns about texts such as '1if'.
@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::SyntaxWarning", "ignore::DeprecationWarning")
@given(st.text(max_size=60))
def test_any_text_is_accepted_or_refused(text):
    try:
        parsed = parse(text, "field f")
    except ExpressionError:
        return
    assert all(isinstance(name, str) for name in parsed.names)
