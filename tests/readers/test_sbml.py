"""SBML models against closed forms, and what a scene has of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sbml_reference import Reference
from sbml_texts import (
    function_text,
    math_text,
    model_text,
    parts_text,
    species_text,
)

import cotree
from cotree.scene.parameters import parameter_values

pytest.importorskip("libsbml")

DECAY = model_text(
    parts_text(
        [
            species_text("A", initialConcentration=3),
            species_text("B", initialAmount=1, hasOnlySubstanceUnits="true"),
        ],
        {"k": 0.5},
    ),
    reactions={"R": (["A"], ["B"], "V*k*A")},
)


def read(tmp_path, text, name="model.xml"):
    path = tmp_path / name
    path.write_text(text)
    return cotree.read_sbml(path)


def test_a_decay_has_its_closed_form_and_names_mean_what_sbml_says(tmp_path):
    scene = read(tmp_path, DECAY)
    model = scene.compile(["k", "V", "A_0"])
    result = model.simulate((0.0, 2.0), [0.0, 1.0, 2.0], rtol=1e-11, atol=1e-13)
    left = math.exp(-0.5 * 2.0)
    # A is a concentration, B an amount: the volume of 2 times what A has lost.
    assert result["A"][-1] == pytest.approx(3.0 * left, rel=1e-9)
    assert result["B"][-1] == pytest.approx(1.0 + 2.0 * 3.0 * (1.0 - left), rel=1e-9)
    assert result["R"][-1] == pytest.approx(2.0 * 0.5 * 3.0 * left, rel=1e-9)
    # Derivatives of the closed forms; the amount of B grows with the volume.
    assert result.sensitivity("A", "k")[-1] == pytest.approx(-2.0 * 3.0 * left, rel=1e-8)
    assert result.sensitivity("A", "A_0")[-1] == pytest.approx(left, rel=1e-8)
    assert result.sensitivity("B", "V")[-1] == pytest.approx(3.0 * (1.0 - left), rel=1e-8)


def test_load_tells_models_from_robots_by_their_outermost_element(tmp_path):
    path = tmp_path / "model.xml"
    path.write_text(DECAY)
    assert "A" in cotree.load(path).outputs
    robot = tmp_path / "robot.xml"
    robot.write_text('<?xml version="1.0"?><!-- <sbml> --><robot name="r"><link name="a"/></robot>')
    assert "a" in cotree.load(robot).nodes


def test_a_saved_model_loads_to_the_same_run(tmp_path):
    scene = read(tmp_path, DECAY)
    scene.save(tmp_path / "model.toml")
    again = cotree.load(tmp_path / "model.toml")
    assert again.origin.file == scene.origin.file
    first, second = (s.compile([]).simulate((0.0, 1.0), [1.0]) for s in (scene, again))
    np.testing.assert_array_equal(first.y, second.y)


def agree(tmp_path, text, t_end, rel=1e-7):
    """Compare a run with the other route: both at tolerances of 1e-10, a thousand times tighter."""
    scene = read(tmp_path, text)
    times = np.linspace(0.0, t_end, 6)
    result = scene.compile([]).simulate((0.0, t_end), times, rtol=1e-10, atol=1e-12)
    for id, values in Reference(text).run(times).items():
        np.testing.assert_allclose(result[id], values, rtol=rel, atol=1e-9, err_msg=id)
    return scene, result


def test_a_reversible_reaction_and_its_equilibrium(tmp_path):
    text = model_text(
        parts_text(
            [species_text("A", initialConcentration=1), species_text("B", initialConcentration=0)],
            {"k1": 0.8, "k2": 0.6},
        ),
        reactions={"R": (["A"], ["B"], "V*(k1*A - k2*B)")},
    )
    result = read(tmp_path, text).compile(["k1"]).simulate((0, 1.5), [1.5], rtol=1e-11, atol=1e-13)
    share = 0.6 / 1.4
    exact = share + (1.0 - share) * math.exp(-1.4 * 1.5)
    assert result["A"][-1] == pytest.approx(exact, rel=1e-9)


def test_initial_assignments_follow_each_other_in_any_order(tmp_path):
    text = model_text(
        parts_text(
            [
                species_text("A", initialConcentration=0.5),
                species_text("B"),
                species_text("C", hasOnlySubstanceUnits="true"),
                species_text("D", initialAmount=4, compartment="W"),
            ],
            {"k": None, "p": None, "q": 3.0},
            compartments={"V": 2.0, "W": 1.0},
            constant=False,
        ),
        initials={"k": "B*R", "B": "2*A + q*p + D", "C": "V*B + time", "W": "q/2"},
        assignments={"p": "q + W"},
        reactions={"R": (["A"], ["B"], "0.1*A*W"), "S": (["B"], [], "0.1*k*B")},
    )
    scene, _ = agree(tmp_path, text, 3.0)
    # D = 4/1.5, p = 4.5, B = 1 + 13.5 + D: the numbers by hand.
    model = scene.compile(["q"])
    result = model.simulate((0.0, 1e-9), [0.0])
    assert result["B"][0] == pytest.approx(14.5 + 4.0 / 1.5)
    assert result["C"][0] == pytest.approx(2.0 * (14.5 + 4.0 / 1.5))
    # dB/dq = p + q (1 + 1/2) - 4/(W q): through the size that q makes.
    assert result.sensitivity("B", "q")[0] == pytest.approx(4.5 + 4.5 - 4.0 / (1.5 * 3.0))


def test_a_compartment_that_grows_dilutes_what_is_in_it(tmp_path):
    text = model_text(
        parts_text(
            [
                species_text("A", initialConcentration=3),
                species_text(
                    "C", initialConcentration=1, constant="true", boundaryCondition="true"
                ),
            ],
            {"g": 0.3},
            constant=False,
        ),
        rates={"V": "g*V"},
        reactions={"R": (["A"], [], "0*V")},
    )
    result = read(tmp_path, text).compile(["g"]).simulate((0, 2), [2.0], rtol=1e-11, atol=1e-13)
    assert result["A"][-1] == pytest.approx(3.0 * math.exp(-0.6), rel=1e-9)
    assert result["C"][-1] == pytest.approx(math.exp(-0.6), rel=1e-9)
    assert result.sensitivity("A", "g")[-1] == pytest.approx(-6.0 * math.exp(-0.6), rel=1e-8)


def test_rules_of_all_kinds_agree_with_the_other_route(tmp_path):
    text = model_text(
        parts_text(
            [
                species_text("A", initialConcentration=1.0),
                species_text("B", initialConcentration=0.5, compartment="W"),
                species_text("E", initialAmount=2.0, hasOnlySubstanceUnits="true"),
                species_text("F", initialConcentration=1.0, boundaryCondition="true"),
                species_text("G", boundaryCondition="true"),
            ],
            {"k": 0.3, "p": None, "x": 1.0},
            compartments={"V": 2.0, "W": 0.5},
            constant=False,
        ),
        functions=function_text("f", "lambda(a, b, a*b/(1 + a))")
        + function_text("h", "lambda(a, f(a, a) + f(a, 2))"),
        assignments={"p": "k*R + x", "G": "A + E/V", "W": "0.5 + 0.1*time"},
        rates={"x": "-0.2*x + 0.01*G", "F": "0.1*cos(time)"},
        reactions={
            "R": (["A", "A"], ["B", "E"], "V*k*h(A)*F"),
            "S": (["B"], ["A"], "W*0.4*B"),
            "T": (["E", "G"], [], "0.1*E*p"),
        },
    )
    agree(tmp_path, text, 4.0)


def test_local_parameters_hide_others_and_have_names_of_their_own(tmp_path):
    text = model_text(
        parts_text([species_text("A", initialConcentration=1)], {"k": 5.0}),
        reactions={"R": (["A"], [], "V*k*A"), "S": (["A"], [], "V*k*A*0")},
    ).replace(
        "</math></kineticLaw>",
        '</math><listOfLocalParameters><localParameter id="k" value="0.25"/>'
        "</listOfLocalParameters></kineticLaw>",
        1,
    )
    result = read(tmp_path, text).compile(["R_k"]).simulate((0, 2), [2.0], rtol=1e-11, atol=1e-13)
    assert result["A"][-1] == pytest.approx(math.exp(-0.5), rel=1e-9)
    assert result.sensitivity("A", "R_k")[-1] == pytest.approx(-2.0 * math.exp(-0.5), rel=1e-8)


def test_names_that_scenes_do_not_accept_are_changed_and_listed(tmp_path):
    text = model_text(
        parts_text([species_text("in", initialConcentration=1)], {"t": 0.5, "sin": 1.0}),
        reactions={"lambda": (["in"], [], "V*1*1")},
    ).replace("<cn", "<ci> in </ci><ci> t </ci><ci> sin </ci><cn", 1)
    scene = read(tmp_path, text)
    changed = {old: new for (_, old), new in scene.origin.names.items()}
    assert changed == {"in": "in_", "t": "t_2", "sin": "sin_2", "lambda": "lambda_"}
    assert scene.origin.notes[0].startswith("renamed: species 'in' is 'in_', parameter 't' is")
    result = scene.compile([]).simulate((0, 2), [2.0], rtol=1e-11, atol=1e-13)
    assert result["in_"][-1] == pytest.approx(math.exp(-1.0), rel=1e-9)


def test_stoichiometries_are_numbers_rules_and_formulas(tmp_path):
    text = model_text(
        parts_text(
            [species_text("A", initialConcentration=1), species_text("B", initialConcentration=0)],
            {"k": 0.5},
        ),
        initials={"n": "3*k"},
        reactions={"R": (["A"], ["B"], "V*k*A")},
    ).replace('species="B" stoichiometry="1"', 'species="B" id="n" stoichiometry="1"')
    scene = read(tmp_path, text)
    result = scene.compile(["k"]).simulate((0, 2), [2.0], rtol=1e-11, atol=1e-13)
    assert result["B"][-1] == pytest.approx(1.5 * (1.0 - math.exp(-1.0)), rel=1e-9)


def test_level_2_with_a_formula_for_a_stoichiometry(tmp_path):
    law = math_text("V*k*A")
    text = f"""<?xml version="1.0"?>
    <sbml xmlns="http://www.sbml.org/sbml/level2/version4" level="2" version="4"><model id="two">
    <listOfCompartments><compartment id="V" size="2"/></listOfCompartments>
    <listOfSpecies><species id="A" compartment="V" initialAmount="2"/>
      <species id="B" compartment="V" initialConcentration="0"/></listOfSpecies>
    <listOfParameters><parameter id="k" value="0.5"/></listOfParameters>
    <listOfReactions><reaction id="R"><listOfReactants><speciesReference species="A"/>
      </listOfReactants><listOfProducts><speciesReference species="B"><stoichiometryMath>
      {math_text("4*k")}</stoichiometryMath></speciesReference></listOfProducts>
      <kineticLaw>{law}</kineticLaw></reaction></listOfReactions></model></sbml>"""
    scene = read(tmp_path, text)
    result = scene.compile(["V"]).simulate((0, 2), [2.0], rtol=1e-11, atol=1e-13)
    # The amount of A is given: its concentration is that over the size.
    assert result["A"][-1] == pytest.approx(math.exp(-1.0), rel=1e-9)
    assert result.sensitivity("A", "V")[-1] == pytest.approx(-math.exp(-1.0) / 2.0, rel=1e-8)
    assert result["B"][-1] == pytest.approx(2.0 * (1.0 - math.exp(-1.0)), rel=1e-9)


def test_an_absent_species_in_a_law_of_hill_has_sensitivities_to_its_exponent(tmp_path):
    text = model_text(
        parts_text(
            [species_text("A", initialConcentration=0), species_text("B", initialConcentration=1)],
            {"n": 2.5},
        ),
        reactions={"R": (["B"], ["A"], "V*(0.1*B + A^n/(1 + A^n))")},
    )
    model = read(tmp_path, text).compile(["n"])
    exact = model.simulate((0, 3), [3.0], rtol=1e-11, atol=1e-13).sensitivity("A", "n")[-1]
    h = 1e-4  # central differences err by h^2, and by tolerance over h
    up, down = (
        model.simulate((0, 3), [3.0], rtol=1e-12, atol=1e-14, parameters={"n": 2.5 + d})["A"][-1]
        for d in (h, -h)
    )
    assert exact == pytest.approx((up - down) / (2.0 * h), rel=1e-6)


def test_long_formulas_are_cut_into_parts(tmp_path):
    many = " + ".join(f"k*A^{i}/{i + 1}" for i in range(1, 60))
    deep = "A"
    for _ in range(90):
        deep = f"(1 + 0.1/({deep}))"
    text = model_text(
        parts_text([species_text("A", initialConcentration=0.5)], {"k": 0.1, "q": None}),
        initials={"q": many},
        reactions={"R": (["A"], [], f"V*(({many}) + 0.01*({deep}))*q/q")},
    )
    agree(tmp_path, text, 1.0)


def test_a_law_that_several_species_share_is_computed_once(tmp_path):
    names = [f"S{i}" for i in range(6)]
    species = [species_text(name, initialConcentration=i + 1.0) for i, name in enumerate(names)]
    law = "V*k*exp(S0)*S1"
    text = model_text(parts_text(species, {"k": 0.1}), reactions={"R": (names[:2], names[2:], law)})
    program = read(tmp_path, text).compile([]).kernels.program
    # One exponential, two products and the division by the volume: twice at most, with the signs.
    assert program.operations["rhs"].total <= 8
    # Both columns of two species reach all six, and nothing else.
    assert len(program.kernels["jacobian"].results) == 12


def test_quotients_and_remainders_round_towards_zero_and_implications_are_conditions(tmp_path):
    """As SBML has it, the remainder has the sign of what is divided."""
    given = {"a": "quotient(-7, 3)", "b": "rem(-7, 3)", "c": "rem(7, -3)", "d": "quotient(p, 1)"}
    rates = {"p": "1", "x": "piecewise(1, implies(p > 1, p > 2), 0)"}
    parts = parts_text([], {**dict.fromkeys(given), "p": -2.5, "x": 0.0}, constant=False)
    text = model_text(parts, assignments=given, rates=rates)
    # These operations came with Version 2.
    text = text.replace("level3/version1", "level3/version2").replace('version="1"', 'version="2"')
    scene = read(tmp_path, text)
    values = parameter_values(scene.parameters)
    assert [values[id] for id in "abc"] == [-2.0, -1.0, 1.0]
    result = scene.compile().simulate((0.0, 6.0), [0.0, 0.7, 6.0], rtol=1e-9)
    assert result["d"].tolist() == [-2.0, -1.0, 3.0]
    # The implication is false for 1 s of the 6, from p = 1 to 2; corners are found to rounding.
    assert result["x"][-1] == pytest.approx(5.0, rel=1e-9)
