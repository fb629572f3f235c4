"""Models that are refused, each in one sentence with file, line and the element's identifier."""

from __future__ import annotations

import sys

import pytest
from sbml_texts import function_text, math_text, model_text, parts_text, species_text, whole_text

import cotree

pytest.importorskip("libsbml")

from cotree.readers.sbml.scene import read_sbml_model, read_sbml_text

A = species_text("A", initialConcentration=1)
PARTS = parts_text([A], {"k": 1.0, "p": None}, constant=False)


def decay(law="k*A", **rest):
    return model_text(rest.pop("parts", PARTS), reactions={"R": (["A"], [], law)}, **rest)


def refused(text):
    with pytest.raises(cotree.SceneError) as caught:
        read_sbml_text(text, "m.xml", cotree.Scene)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("law", "said"),
    [
        (
            "k*X",
            "the kinetic law of reaction 'R' contains 'X', which is not a compartment, species",
        ),
        ("k*aa", "contains 'aa'"),
        ("g(k)", "calls 'g', which is not a function"),
        ("factorial(3)", "contains factorial"),
        ("delay(A, 1)", "contains delay"),
        ("rateOf(A)", "depends on itself: R -> rateOf(A) -> R"),
        ("rateOf(Q)", "contains rateOf(Q), but 'Q' is not a compartment, species or parameter"),
        ("piecewise(1, A > 1)", "contains piecewise without otherwise"),
        ("piecewise(1, A, 2)", "contains 'A' instead of a condition"),
        ("k/0", "has no value"),
    ],
)
def test_formulas_that_are_not_known(law, said):
    if law == "k/0":
        # A constant division has no value; it is said where the equations are formed.
        scene = read_sbml_text(decay(law, assignments={"p": "1"}), "m.xml", cotree.Scene).scene
        with pytest.raises(cotree.Error, match="'k / 0' has no value"):
            scene.compile([])
        return
    message = refused(decay(law, assignments={"p": "1"}))
    assert message.startswith("m.xml:")
    assert said in message


def test_quantities_without_values_and_rules_that_lead_nowhere():
    assert "parameter 'p' has no value: give it one" in refused(decay("k*A*p"))
    loops = {"p": "k*A", "k": "p + 1"}
    assert "depends on itself: " in refused(decay(assignments=loops))
    assert "depends on itself: " in refused(decay("k*A*p", initials={"p": "k", "k": "p"}))
    both = refused(decay(assignments={"A": "1", "p": "1"}))
    assert "species 'A' has a rule, and reactions change it" in both
    assert "determines 'Q', which is not a compartment" in refused(decay(assignments={"Q": "1"}))
    fixed = parts_text([A], {"k": 1.0})
    assert "determines a constant" in refused(decay(parts=fixed, rates={"k": "1"}))


def test_files_that_are_no_models():
    assert refused("").startswith("m.xml:1: not valid XML")
    assert refused("<sbml>").startswith("m.xml:1: not valid XML")
    assert refused("<html/>") == "m.xml:1: not SBML: its outermost element is <html>, not <sbml>"
    head = decay().partition("<model")[0]
    assert "holds no <model>" in refused(f"{head}</sbml>") or "not valid SBML" in refused(
        f"{head}</sbml>"
    )
    entity = "<!DOCTYPE s [<!ENTITY a SYSTEM 'file:///etc/passwd'>]><sbml>&a;</sbml>"
    assert "a document type declaration" in refused(entity)
    still = model_text(parts_text([], {"k": 1.0}))
    assert refused(still).startswith("m.xml: nothing in the model changes with time")
    package = decay().replace(' level="3"', ' xmlns:c="urn:x" c:required="true" level="3"', 1)
    assert "the package 'c' changes the meaning of the model" in refused(package)


def test_elements_that_are_not_read():
    rule = f"<listOfRules><algebraicRule>{math_text('A - k')}</algebraicRule></listOfRules>"
    text = decay().replace("<listOfReactions>", f"{rule}<listOfReactions>")
    assert "the algebraic rule 0 = A - k is not supported" in refused(text)
    assert "reaction 'R' is fast" in refused(decay().replace('fast="false"', 'fast="true"'))
    nothing = decay().partition("<kineticLaw>")[0] + "</reaction></listOfReactions></model></sbml>"
    assert "reaction 'R' has no kinetic law" in refused(nothing)
    assert "which is not a species" in refused(decay().replace('species="A" st', 'species="k" st'))
    lost = decay().replace('compartment="V"', 'compartment="W"')
    assert "species 'A' is in 'W', which is not a compartment" in refused(lost)


def test_functions_that_call_themselves_or_grow_without_bound():
    one = {"p": "1"}
    again = function_text("f", "lambda(x, f(x))")
    assert "calls 'f', which calls itself" in refused(
        decay("f(k)*A", functions=again, assignments=one)
    )
    wrong = function_text("f", "lambda(x, x)")
    assert "with 2 arguments instead of 1" in refused(
        decay("f(k, k)", functions=wrong, assignments=one)
    )
    doubling = "".join(
        function_text(f"f{i}", f"lambda(x, f{i - 1}(x) + f{i - 1}(1 - x))" if i else "lambda(x, x)")
        for i in range(30)
    )
    message = refused(decay("f29(k)", functions=doubling, assignments=one))
    assert "more than" in message or "nested deeper" in message


def test_values_that_a_file_leaves_out_may_be_given(tmp_path):
    path = tmp_path / "m.xml"
    path.write_text(decay("k*A*p"))
    model = read_sbml_model(path, cotree.Scene, {"p": 2.0})
    assert model.scene.parameters["p"].value == 2.0
    symbol = model.symbols["A"]
    assert (symbol.name, symbol.state, symbol.initial) == ("A", "A.c", "A_0")
    assert model.symbols["R"].name == "R"


def test_without_libsbml_a_sentence_names_the_extra(monkeypatch):
    text = whole_text()
    monkeypatch.setitem(sys.modules, "libsbml", None)
    with pytest.raises(cotree.Error, match=r"pip install 'cotree\[sbml\]'"):
        read_sbml_text(text, "m.xml", cotree.Scene)
