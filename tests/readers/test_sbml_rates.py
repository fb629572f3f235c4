"""``rateOf`` in formulas of SBML models, against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from sbml_texts import event_text, function_text, model_text, parts_text, species_text

import cotree
from cotree.scene.parameters import parameter_values

pytest.importorskip("libsbml")

from cotree.readers.sbml.scene import read_sbml_text

#: Quantities of each kind: concentrations and amounts, in compartments that stay and that grow.
SPECIES = [
    species_text("A", initialConcentration=3.0),
    species_text("B", initialAmount=1.0, hasOnlySubstanceUnits="true"),
    species_text("C", initialConcentration=1.0, compartment="W"),
    species_text("D", initialConcentration=1.5, compartment="W"),
    species_text("E", initialConcentration=1.5, compartment="W", boundaryCondition="true"),
]
ASKED = ["A", "B", "C", "D", "E", "x", "W", "k"]


def read(text):
    return read_sbml_text(text, "m.xml", cotree.Scene).scene


def test_rates_of_all_kinds_of_quantities():
    asked = {f"of_{id}": f"rateOf({id})" for id in ASKED}
    unset = dict.fromkeys([*asked, "begin"])
    text = model_text(
        parts_text(
            SPECIES,
            {"k": 0.5, "x": 2.0, "z": 0.0, **unset},
            compartments={"V": 2.0, "W": 1.0},
            constant=False,
        ),
        assignments=asked,
        rates={"W": "0.1*W", "x": "-0.3*x", "z": "rateOf(A)"},
        initials={"begin": "rateOf(A) + rateOf(x)"},
        reactions={"R": (["A"], ["B"], "V*k*A"), "S": (["C"], ["D"], "0.2*C*W")},
    )
    scene = read(text)
    assert parameter_values(scene.parameters)["begin"] == pytest.approx(-1.5 - 0.6)
    t = np.linspace(0.0, 2.0, 9)
    result = scene.compile([]).simulate((0.0, 2.0), t, rtol=1e-11, atol=1e-13)
    size, of_d = np.exp(0.1 * t), 2.5 - np.exp(-0.2 * t)  # the amount of D
    wanted = {
        "A": -1.5 * np.exp(-0.5 * t),
        "B": 3.0 * np.exp(-0.5 * t),
        "C": -0.3 * np.exp(-0.3 * t),  # reaction and growth of the compartment
        "D": 0.2 * np.exp(-0.2 * t) / size - 0.1 * of_d / size,
        "E": -0.15 / size,
        "x": -0.6 * np.exp(-0.3 * t),
        "W": 0.1 * size,
        "k": 0.0 * t,
    }
    for id, values in wanted.items():
        np.testing.assert_allclose(result[f"of_{id}"], values, atol=1e-9, err_msg=id)
    np.testing.assert_allclose(result["z"], 3.0 * np.exp(-0.5 * t) - 3.0, atol=1e-9)


def test_events_depend_on_rates():
    # The rate of A, -A, passes -1 at t = log(3).
    text = model_text(
        parts_text(SPECIES[:1], {"k": 1.0, "p": 0.0}, constant=False),
        reactions={"R": (["A"], [], "V*k*A")},
        events=event_text("rateOf(A) > -1", {"p": "rateOf(A)"}),
    )
    result = read(text).compile([]).simulate((0.0, 2.0), rtol=1e-11, atol=1e-13)
    assert result.events["e"].t[0] == pytest.approx(np.log(3.0), rel=1e-9)
    assert result["p"][-1] == pytest.approx(-1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("rates", "functions", "law", "said"),
    [
        ({}, "", "rateOf(q)", "but 'q' has an assignment rule: replace rateOf by the derivative"),
        ({"k": "rateOf(k)"}, "", "A", "rule of 'k' depends on itself: rateOf(k) -> rateOf(k)"),
        ({"k": "rateOf(p)", "p": "rateOf(k)"}, "", "A", "rateOf(k) -> rateOf(p) -> rateOf(k)"),
        ({}, "lambda(q, rateOf(q))", "f(A)", "contains rateOf of an argument of function 'f'"),
    ],
)
def test_rates_that_cannot_be_told(rates, functions, law, said):
    text = model_text(
        parts_text(SPECIES[:1], {"k": 1.0, "p": 1.0, "q": None}, constant=False),
        assignments={"q": "2*A"},
        functions=function_text("f", functions) if functions else "",
        rates=rates,
        reactions={"R": (["A"], [], law)},
    )
    with pytest.raises(cotree.SceneError) as caught:
        read(text)
    assert said in str(caught.value)
