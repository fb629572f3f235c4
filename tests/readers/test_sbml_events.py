"""Events and piecewise formulas of SBML against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sbml_texts import event_text, math_text, model_text, parts_text, species_text

import cotree

pytest.importorskip("libsbml")

from cotree.readers.sbml import read_sbml_text

A = species_text("A", initialConcentration=3)
DECAY = {"R": (["A"], [], "V*k*A")}


def scene_of(events, species=(A,), parameters=None, **rest):
    parts = parts_text(list(species), parameters or {"k": 0.5, "n": 0.0}, constant=False)
    text = model_text(parts, reactions=DECAY, events=events, **rest)
    return read_sbml_text(text, "m.xml", cotree.Scene).scene


def run(scene, t_end, wanted=()):
    return scene.compile(list(wanted)).simulate((0.0, t_end), [t_end], rtol=1e-11, atol=1e-13)


def test_an_event_sets_a_concentration_and_counts():
    result = run(scene_of(event_text("A < 1", {"A": "3", "n": "n + 1"})), 6.0, ["k", "A_0"])
    assert result.events["e"].t == pytest.approx([math.log(3.0) / 0.5, 2 * math.log(3.0) / 0.5])
    assert result["n"][-1] == 2.0
    # A = 3 (1/k) resets at each ln(3)/k: after two of them A = 3 * 9 exp(-k t).
    assert result["A"][-1] == pytest.approx(27.0 * math.exp(-3.0), rel=1e-9)
    assert result.sensitivity("A", "k")[-1] == pytest.approx(-6.0 * 27.0 * math.exp(-3.0), rel=1e-7)
    # The start decides when the events happen: A = A_0 exp(-k t) 9 as well.
    assert result.sensitivity("A", "A_0")[-1] == pytest.approx(9.0 * math.exp(-3.0), rel=1e-7)


def test_a_compartment_that_an_event_sets_keeps_amounts():
    events = event_text("time >= 1", {"V": "4"})
    species = [A, species_text("C", initialConcentration=1, constant="true")]
    result = run(scene_of(events, species), 2.0)
    # From 1 s on the same amount is in twice the volume; the law V k A takes k of it per second.
    assert result["A"][-1] == pytest.approx(1.5 * math.exp(-1.0), rel=1e-9)
    assert result["C"][-1] == pytest.approx(0.5)


def test_a_concentration_set_with_its_compartment_is_that_in_the_new_size():
    result = run(scene_of(event_text("time >= 1", {"V": "4", "A": "A + 1"})), 1.0 + 1e-9)
    assert result["A"][-1] == pytest.approx(3.0 * math.exp(-0.5) + 1.0)


def test_triggers_of_several_conditions():
    events = event_text("A < 2 && time > 1 || time > 9", {"n": "time"})
    result = run(scene_of(events), 4.0)
    assert result["n"][-1] == pytest.approx(1.0)  # A is below 2 from 0.81 s on
    events = event_text("time > 1 && not(A >= 1.5)", {"n": "time"})
    assert run(scene_of(events), 4.0)["n"][-1] == pytest.approx(2.0 * math.log(2.0))


def test_a_trigger_at_the_start_follows_its_initial_value():
    assert run(scene_of(event_text("time >= 0", {"n": "4"}, initial="false")), 1.0)["n"][-1] == 4.0
    assert run(scene_of(event_text("A > 1", {"n": "4"})), 4.0)["n"][-1] == 0.0
    for trigger, initial in (("A > 1", "false"), ("time >= 0", "true")):
        with pytest.raises(
            cotree.SceneError, match=r"m\.xml:\d+: the trigger of event 'e' holds at"
        ):
            scene_of(event_text(trigger, {"n": "4"}, initial=initial))


@pytest.mark.parametrize("word", ["delay", "priority"])
def test_delays_and_priorities_of_zero_are_none(word):
    def scene(value):
        more = f"<{word}>{math_text(value)}</{word}>"
        other = event_text("A < 2", {"n": "n + 1"}, id="f")
        return scene_of(event_text("A < 1", {"n": "n + 4"}, more=more) + other)

    assert run(scene("0"), 4.0)["n"][-1] == 5.0
    with pytest.raises(cotree.SceneError, match=rf"event 'e' has a {word}, which is not read: "):
        scene("1")


def test_piecewise_formulas_of_time_and_of_the_state():
    parts = parts_text([A], {"k": 0.5})
    law = "V*k*piecewise(A, time < 1, 2*A, A > 0.5, 0)"
    text = model_text(parts, reactions={"R": (["A"], [], law)})
    scene = read_sbml_text(text, "m.xml", cotree.Scene).scene
    at_one, rate = 3.0 * math.exp(-0.5), 1.0
    times = np.array([0.5, 1.5, 8.0])
    result = scene.compile(["k"]).simulate((0, 8), times, rtol=1e-11, atol=1e-13)
    exact = [3.0 * math.exp(-0.25), at_one * math.exp(-0.5 * rate), 0.5]
    np.testing.assert_allclose(result["A"], exact, rtol=1e-9)
    # A rests on the value at which its law jumps, whatever the constant.
    assert result.sensitivity("A", "k")[-1] == pytest.approx(0.0, abs=1e-9)
