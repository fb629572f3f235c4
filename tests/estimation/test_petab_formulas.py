"""Translation of PEtab formulas to expressions of scenes, against values from Python."""

from __future__ import annotations

import math

import pytest

from cotree.errors import ExpressionError
from cotree.estimation.petab.sbml_model import PetabFormula, number_of

VALUES = {"a": 0.7, "b": -1.3, "time": 2.0}


def value_of(text):
    # With numbers in place of names, the expression is evaluated by constant folding.
    formula = PetabFormula(text)
    return number_of(formula.expression(lambda name: f"({VALUES[name]})"), "formula")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2^3^2", 512.0),
        ("-2^2", -4.0),
        ("pow(a, 2)", 0.49),
        ("ln(a)", math.log(0.7)),
        ("log(a)", math.log(0.7)),
        ("log10(a)", math.log10(0.7)),
        ("log2(a)", math.log2(0.7)),
        ("log(a, 3)", math.log(0.7, 3)),
        ("sec(a) + csc(a) + cot(a)", 1 / math.cos(0.7) + 1 / math.sin(0.7) + 1 / math.tan(0.7)),
        ("arcsinh(b)", math.asinh(-1.3)),
        ("arccosh(3)", math.acosh(3.0)),
        ("arctanh(a)", math.atanh(0.7)),
        ("arctan(b)", math.atan(-1.3)),
        ("coth(a)", 1 / math.tanh(0.7)),
        ("piecewise(1, a < b, 2, a == 0.7, 3)", 2.0),
        ("piecewise(1, a > 0 && !(b > 0), 2)", 1.0),
        ("piecewise(1, (a < 0 || b > 0) && a > b, 2)", 2.0),
        ("piecewise(1, a != b, 2)", 1.0),
        ("min(a, b) + max(a, b) + abs(b) + sqrt(4) + sign(b)", 0.7 - 1.3 + 1.3 + 2.0 - 1.0),
        ("1e-3*.5E1", 5e-3),
    ],
)
def test_formulas_have_the_correct_values(text, expected):
    assert value_of(text) == pytest.approx(expected, rel=1e-15)


def test_time_is_t_and_names_are_listed():
    formula = PetabFormula("a*exp(-b*time)")
    assert formula.names == ("a", "b")
    assert formula.expression({"a": "x.c", "b": "(k)"}.__getitem__) == "x.c * exp(-k * t)"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a; import os", "contains ';'"),
        ("a.b", r"contains '\.'"),
        ("a['x']", r"contains '\['"),
        ("__import__(a)", "not a function here"),
        ("open(a)", "not a function here"),
        ("piecewise(1, a)", "gives piecewise 2 arguments"),
        ("a +", "is not an expression"),
        ("piecewise(1, a < b && b < 0 || a > 0, 2)", "mixes && and"),
        ("1" * 5000, "longer than"),
        ("(" * 3000 + "a" + ")" * 900, "is not an expression"),
    ],
)
def test_invalid_formulas_are_refused(text, message):
    with pytest.raises(ExpressionError, match=message):
        PetabFormula(text).expression(lambda name: name)
