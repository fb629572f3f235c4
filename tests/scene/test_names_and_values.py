"""First steps of newcomers: names, values of loaded scenes, proposals, pickles."""

from __future__ import annotations

import copy
import keyword
import pickle

import numpy as np
import pytest

import cotree
from cotree import ExpressionError, ParameterError, Scene, SceneError
from cotree.errors import nearest

# A resistor charges a capacitor; every name is a word of Python.


def charging():
    scene = Scene("words")
    scene.parameter("R", 2.0)
    scene.voltage_source("not", "in", "ground", voltage=3.0)
    scene.resistor("lambda", "in", "is", resistance="R*(1 + 0*in.v)")
    scene.capacitor("for", "is", "ground", capacitance=0.5)
    scene.output("drop", "in.v - is.v + 0*lambda.i")
    scene.output("late", "where(not is.v < 2 and .5 < in.v, 1, 0)")
    return scene


@pytest.mark.compiler
def test_nodes_and_edges_may_be_called_by_any_word(tmp_path):
    scene = charging()
    scene.save(tmp_path / "words.toml")
    assert cotree.load(tmp_path / "words.toml") == scene
    model = scene.compile(["R"], optimize="-O0")
    assert model.states == ("for.v",)
    result = model.simulate((0, 2), rtol=1e-9, atol=1e-11)
    # drop = V exp(-t / (R C)); its slope by R is that times t / (R**2 C). The run is to 1e-9.
    assert abs(result["drop"][-1] - 3 * np.exp(-2.0)) < 1e-8
    assert abs(result.sensitivity("drop", "R")[-1] - 3 * np.exp(-2.0)) < 1e-7
    assert result["late"].tolist() == [float(v >= 2) for v in 3 - result["drop"]]
    assert "v_dot - (3 - v)" in str(scene.equations()).replace("2*", "")


def test_extremes_take_several_arguments():
    scene = Scene("several")
    scene.output("y", "max(1, t, min(4 - t, t + 2, 3))")
    scene.capacitor("C", "a", "ground", capacitance=1.0)
    y = scene.compile(optimize="-O0").simulate((0, 4), [0, 0.5, 2, 4])["y"]
    assert y.tolist() == [2, 2.5, 2, 4]
    with pytest.raises(ExpressionError, match="gives max 1 arguments"):
        scene.output("z", "max(t)")


@pytest.mark.parametrize("word", keyword.kwlist)
def test_every_word_is_a_node_and_no_word_a_parameter(word):
    scene = Scene("s")
    scene.resistor("r", word, "ground", resistance=1.0)
    scene.output("y", f"2*{word}.v")
    assert scene.outputs["y"].names == {f"{word}.v"}
    with pytest.raises(SceneError, match=f"parameter name '{word}' is a reserved word"):
        scene.parameter(word, 1.0)
    with pytest.raises(ExpressionError, match=r"is not an expression|holds"):
        scene.output("z", f"{word} + 1")


@pytest.mark.parametrize(
    ("name", "known", "proposed"),
    [
        ("l", ["L", "g", "m"], "L"),
        ("OMEGA", ["omega", "alpha"], "omega"),
        ("VOut", ["vout", "VOut2"], "vout"),
        ("omegas", ["Omega", "stiffness"], "Omega"),
        ("h.THETA", ["h.theta", "h.theta_dot"], "h.theta"),
    ],
)
def test_proposals_look_past_the_case_of_letters(name, known, proposed):
    assert nearest(name, known) == f"; did you mean '{proposed}'?"


def test_a_misspelt_sensitivity_is_proposed_for():
    with pytest.raises(
        ParameterError, match="'l' is neither a parameter nor a state; did you mean 'L'"
    ):
        cotree.load("slider-pendulum").compile(["l"])


def test_values_of_a_loaded_scene_can_be_set():
    scene = cotree.load("slider-pendulum")
    with pytest.raises(SceneError, match=r'taken: .*; scene\.set\("L", \.\.\.\) changes its value'):
        scene.parameter("L", 2.0)
    # What the message says works.
    before = list(scene.parameters)
    scene.set("L", 2.0)
    row = scene.parameters["L"]
    assert (row.value, row.unit, row.doc) == (2.0, "m", "length of the rod")
    assert list(scene.parameters) == before
    scene.set("L", 350, unit="mm")
    assert scene.parameters["L"].value == pytest.approx(0.35, rel=1e-15)
    scene.set("L", "10*r")
    assert scene.parameters["L"].is_derived
    tanks = cotree.load("two-tanks")
    tanks.set("opening", [[0, 1], [0, 0.5]])
    tanks.set("opening", "0.5 + 0.1*sin(t)")
    assert tanks.inputs["opening"].value.text == "0.5 + 0.1*sin(t)"


@pytest.mark.parametrize(
    ("name", "value", "unit", "told"),
    [
        ("l", 1.0, "", "'l' is neither a parameter nor an input; did you mean 'L'"),
        ("L", float("inf"), "", "give a finite number"),
        ("L", "2*L", "", "depends on itself"),
        ("L", 1.0, "kg", "'L' is in 'm', which 'kg' cannot be converted to"),
    ],
)
def test_what_cannot_be_set_leaves_the_scene_as_it_was(name, value, unit, told):
    scene = cotree.load("slider-pendulum")
    with pytest.raises(cotree.ModelError, match=told):
        scene.set(name, value, unit=unit)
    assert scene == cotree.load("slider-pendulum")


@pytest.mark.compiler
def test_a_parameter_hides_the_output_of_its_name_everywhere():
    scene = Scene("shared-name")
    scene.parameter("c", 2.0)
    scene.output("c", "sign(t - 0.5)")  # a charge that followed this would jump, and be refused
    scene.nonlinear_capacitor("C", "a", "ground", charge="c*C.v")
    scene.current_source("I", "ground", "a", current=3.0)
    result = scene.compile(optimize="-O0").simulate((0, 1))
    # Three amperes for a second, at twice the voltage in coulombs.
    assert abs(result["C.q"][-1] - 3.0) < 1e-7
    assert abs(result["C.v"][-1] - 1.5) < 1e-7
    assert result["c"][-1] == 1.0


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize(("name", "sensitivities"), [("motor-linkage", ["R"]), ("heated-room", [])])
def test_models_and_scenes_are_pickled(name, sensitivities):
    """Windings, gears and events: laws are functions, and libraries belong to a process."""
    scene = cotree.load(name)
    model = scene.compile(sensitivities, optimize="-O0")
    again = pickle.loads(pickle.dumps(model))
    assert again.kernels.source == model.kernels.source
    assert again.kernels.cached
    wanted, found = (m.simulate((0, 0.02)) for m in (model, again))
    assert (wanted.y == found.y).all()
    assert pickle.loads(pickle.dumps(scene)) == copy.deepcopy(scene) == scene


def test_a_pickled_model_does_not_follow_its_scene():
    scene = charging()
    model = scene.compile(optimize="-O0")
    scene.set("R", 5.0)
    scene.output("more", "for.v")
    again = pickle.loads(pickle.dumps(model))
    assert again.outputs == model.outputs == ("drop", "late")
    assert again.default_parameters.tolist() == model.default_parameters.tolist()


def test_nodes_are_given_by_place_or_as_a_list():
    scene = Scene("listed")
    scene.edge("R", "resistor", nodes=["a", "ground"], resistance=1.0)
    scene.resistor("S", nodes=("a", "ground"), resistance=1.0)
    assert scene.edges["R"].nodes == scene.edges["S"].nodes == ("a", "ground")
    with pytest.raises(SceneError, match=r"edge 'Q' needs two nodes.*; there are 3"):
        scene.edge("Q", "resistor", nodes=["a", "b", "c"], resistance=1.0)
    with pytest.raises(SceneError, match=r"edge 'Q' .* needs 3 nodes.*; there is 1"):
        scene.edge("Q", "mosfet_n", nodes=["a"])
    with pytest.raises(SceneError, match="edge 'Q' has nodes as arguments and"):
        scene.edge("Q", "resistor", "a", nodes=["a", "ground"], resistance=1.0)
    for wrong in ("ab", 5, None):
        with pytest.raises(SceneError, match="nodes of edge 'Q' must be a list"):
            scene.edge("Q", "resistor", nodes=wrong, resistance=1.0)
