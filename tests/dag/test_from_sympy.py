from __future__ import annotations

import pytest
import sympy

from cotree.dag.evaluate import evaluate
from cotree.dag.from_sympy import from_sympy
from cotree.dag.nodes import Dag, reachable

X, Y, Z = sympy.symbols("x y z", real=True)

EXPRESSIONS = [
    X + Y - Z,
    -X * (Y - 2) / Z,
    X / (Y * Z),
    X**2 / Y**3,
    sympy.sqrt(X) / Y + 1 / sympy.sqrt(Z),
    X ** sympy.Rational(3, 2),
    X**Y,
    sympy.pi * X + sympy.Rational(1, 3) + sympy.E,
    sympy.exp(-X) * sympy.log(Y),
    sympy.sin(X) + sympy.cos(Y) * sympy.tan(Z),
    sympy.asin(X / 4) + sympy.acos(Y / 4) + sympy.atan(Z),
    sympy.sinh(X) + sympy.cosh(Y) + sympy.tanh(Z),
    sympy.erf(X) - sympy.erf(-Y * Z / 3),
    sympy.Mod(X, Y) + sympy.ceiling(X - Z),
    sympy.Abs(X - Y) + sympy.sign(Y - X),
    sympy.atan2(Y, X - 2),
    sympy.Max(X, Y, Z) - sympy.Min(X, Y, Z, 1),
    sympy.Piecewise((X, X < 1), (Y, X >= 2), (Z, True)),
    sympy.Piecewise((X, X <= Y), (Z**2, X > 2 * Y), (0, True)),
]
POINTS = [(0.7, 1.9, 2.5), (1.3, 0.4, 0.6), (2.2, 2.2, 1.1), (2.0, 0.5, 3.0), (1.0, 1.0, 1.0)]


def _node(expression):
    dag = Dag()
    symbols = {name: dag.symbol("x", i) for i, name in enumerate("xyz")}
    return from_sympy(expression, dag, symbols), list(symbols.values()), dag


@pytest.mark.parametrize("expression", EXPRESSIONS, ids=str)
def test_values_are_those_of_sympy(expression):
    node, symbols, _ = _node(expression)
    for point in POINTS:
        expected = float(expression.subs(dict(zip((X, Y, Z), point, strict=True))).evalf(25))
        found = evaluate([node], dict(zip(symbols, point, strict=True)))[0]
        # A few roundings; sums of a few terms of size 10 may cancel.
        assert found == pytest.approx(expected, rel=1e-14, abs=1e-14)


@pytest.mark.parametrize("expression", [X / Y, X / (Y * Z), X * Y / Z**2, (X + 1) / (Y - Z)])
def test_a_quotient_is_one_division(expression):
    node, _, _ = _node(expression)
    operations = [made.op for made in reachable([node])]
    assert operations.count("div") == 1
    assert "pow" not in operations


def test_branches_meet_where_sympy_puts_them():
    node, (x, y, z), _ = _node(sympy.Piecewise((1, X < 1), (2, X <= 2), (3, True)))
    values = [evaluate([node], {x: at, y: 0.0, z: 0.0})[0] for at in (0.5, 1.0, 1.5, 2.0, 2.5)]
    assert values == [1.0, 2.0, 2.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (sympy.Symbol("w") * X, "uses 'w', which is not one of its arguments"),
        (sympy.besselj(0, X), "the function 'besselj'"),
        (sympy.Piecewise((X, X < 1)), "has a Piecewise without a default branch"),
        (
            sympy.Piecewise((X, sympy.Eq(Y, 1)), (Z, True)),
            "has a condition that is not a comparison",
        ),
    ],
)
def test_what_cannot_be_said_is_refused(expression, message):
    with pytest.raises(ValueError, match=message):
        _node(expression)
