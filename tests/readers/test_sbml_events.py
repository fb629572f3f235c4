"""Events and piecewise formulas of SBML against closed forms."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sbml_texts import event_text, math_text, model_text, parts_text, species_text

import cotree

pytest.importorskip("libsbml")

from cotree.readers.sbml.scene import read_sbml_text

A = species_text("A", initialConcentration=3)
DECAY = {"R": (["A"], [], "V*k*A")}


def scene_of(events, species=(A,), parameters=None, size=2.0, **rest):
    values = parameters or {"k": 0.5, "n": 0.0}
    parts = parts_text(list(species), values, compartments={"V": size}, constant=False)
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


def test_a_concentration_set_with_its_compartment_means_an_amount_in_the_size_before():
    """Case 01779 of the SBML test suite: 0.2 in a size of 0.5, which becomes 0.2, is 0.5 then."""
    events = event_text("time >= 1", {"V": "4", "A": "A + 1"})
    result = run(scene_of(events), 1.0 + 1e-9)
    # The size was 2: its double halves the concentration. The run goes on for a nanosecond.
    assert result["A"][-1] == pytest.approx(0.5 * (3.0 * math.exp(-0.5) + 1.0), rel=1e-8)
    boundary = species_text("C", initialConcentration=2, boundaryCondition="true")
    events = event_text("time >= 0.45", {"V": "0.2", "C": "0.2"})
    result = run(scene_of(events, [A, boundary], size=0.5), 1.0)
    assert result["C"][-1] == pytest.approx(0.5)


def test_a_concentration_of_a_rate_rule_is_diluted_when_its_compartment_is_set():
    species = [A, species_text("C", initialConcentration=1, boundaryCondition="true")]
    rates = {"C": "1"}
    result = run(scene_of(event_text("time >= 1", {"V": "8"}), species, rates=rates), 2.0)
    # C rises to 2 in a size of 2, and is a quarter of that in one of 8.
    assert result["C"][-1] == pytest.approx(0.25 * 2.0 + 1.0, rel=1e-9)
    events = event_text("time >= 1", {"V": "8", "C": "C + 2"})
    result = run(scene_of(events, species, rates=rates), 2.0)
    assert result["C"][-1] == pytest.approx(0.25 * 4.0 + 1.0, rel=1e-9)


def test_a_concentration_of_a_rate_rule_that_a_rule_would_dilute_is_refused():
    species = [A, species_text("C", initialConcentration=1, boundaryCondition="true")]
    events = event_text("time >= 1", {"n": "2"})
    with pytest.raises(
        cotree.SceneError, match="rate rule of 'C' determines a concentration in 'V'"
    ):
        scene_of(events, species, rates={"C": "1"}, assignments={"V": "n + 1"})


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
            cotree.SceneError, match=r"m\.xml:\d+: the trigger of event 'e' is true at"
        ):
            scene_of(event_text(trigger, {"n": "4"}, initial=initial))


def test_a_delay_of_zero_is_none():
    def scene(value):
        more = f"<delay>{math_text(value)}</delay>"
        other = event_text("A < 2", {"n": "n + 1"}, id="f")
        return scene_of(event_text("A < 1", {"n": "n + 4"}, more=more) + other)

    assert run(scene("0"), 4.0)["n"][-1] == 5.0
    with pytest.raises(cotree.SceneError, match=r"event 'e' has a delay, which is not supported: "):
        scene("1")


def pair(trigger, first, second, priorities=(0, 0), other=None, **given):
    """Write two events, the second with a trigger of its own where one is given."""
    texts = [
        event_text(t, sets, id=id, more=f"<priority>{math_text(str(p))}</priority>", **given)
        for id, t, sets, p in (
            ("e", trigger, first, priorities[0]),
            ("f", other or trigger, second, priorities[1]),
        )
    ]
    return "".join(texts)


def test_events_with_one_trigger_use_the_values_before_both():
    # A = 3 exp(-k t) reaches 1; without the rule the second would see n = 7.
    scene = scene_of(pair("A < 1", {"n": "A + 6"}, {"k": "n + 0.25"}))
    result = run(scene, 3.0)
    assert (result["n"][-1], result["k"][-1]) == pytest.approx((7.0, 0.25))
    assert any("'e' includes 'f'" in note for note in scene.origin.notes)


def test_events_that_use_the_values_left_by_others_act_in_turn():
    scene = scene_of(pair("time > 1", {"n": "6"}, {"k": "n + 0.25"}, at_trigger="false"))
    assert run(scene, 1.5)["k"][-1] == pytest.approx(6.25)
    # The second acts first, and leaves k = 0.25.
    scene = scene_of(pair("time > 1", {"n": "4*k"}, {"k": "n + 0.25"}, (1, 2), at_trigger="false"))
    assert run(scene, 1.5)["n"][-1] == pytest.approx(1.0)


def test_of_events_that_set_one_quantity_the_lowest_priority_has_the_last_say():
    for priorities, value in (((1, 2), 4.0), ((2, 1), 5.0), ((-1, -2), 5.0)):
        scene = scene_of(pair("time > 1", {"n": "4"}, {"n": "5"}, priorities))
        assert run(scene, 1.5)["n"][-1] == value


def test_an_event_that_happens_although_its_trigger_no_longer_holds():
    scene = scene_of(pair("A < 1", {"A": "3"}, {"n": "A"}))
    assert run(scene, 2.5)["n"][-1] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("events", "message"),
    [
        (pair("A < 1", {"n": "1"}, {"n": "2"}), "events 'e' and 'f' both set 'n' at the same time"),
        (pair("A < 1", {"A": "3"}, {"n": "1"}, persistent="false"), "event 'f' is not persistent"),
        (
            pair("A < 1", {"A": "3"}, {"n": "A"}, at_trigger="false"),
            "event 'f' has the same trigger as others",
        ),
        (
            pair("time > 1", {"n": "1"}, {"k": "n"}, other="time > k + 0.5"),
            None,
        ),
        (pair("A < 1", {"n": "1"}, {"k": "n"}, ("k", 1)), "a priority that is a formula"),
    ],
)
def test_events_at_the_same_time_whose_outcome_is_open_are_refused(events, message):
    if message is None:  # times that may coincide, but are no constants of the model
        scene_of(events)
        return
    with pytest.raises(cotree.SceneError, match=rf"m\.xml:\d+: .*{message}"):
        scene_of(events)


def test_events_at_equal_constant_times_with_different_triggers_are_refused():
    parts = parts_text([A], {"k": 0.5, "n": 0.0}, constant=False)
    parts = parts.replace(
        "</listOfParameters>", '<parameter id="T" value="2" constant="true"/></listOfParameters>'
    )
    events = pair("time > T", {"n": "1"}, {"k": "n"}, other="time > 2")
    with pytest.raises(cotree.SceneError, match="'e' and 'f' occur at the same time"):
        read_sbml_text(model_text(parts, reactions=DECAY, events=events), "m.xml", cotree.Scene)


def test_an_event_sets_a_stoichiometry():
    text = model_text(
        parts_text([A], {"k": 0.5}), reactions=DECAY, events=event_text("time > 1", {"s": "2"})
    )
    text = text.replace(
        'species="A" stoichiometry="1" constant="true"',
        'id="s" species="A" stoichiometry="1" constant="false"',
    )
    result = run(read_sbml_text(text, "m.xml", cotree.Scene).scene, 2.0)
    # A decays with k up to 1 s, and with 2 k from there.
    assert result["A"][-1] == pytest.approx(3.0 * math.exp(-0.5 - 1.0), rel=1e-9)


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


def test_a_model_of_events_only_runs():
    """Modes alone are states, whose rates vanish: the second event sees what the first one left."""
    once = event_text("time >= 1", {"n": "n + k"}, id="first")
    twice = event_text("n > 2", {"n": "2*n"}, id="second")
    parts = parts_text([], {"k": 2.5, "n": 0.0}, constant=False)
    scene = read_sbml_text(model_text(parts, events=once + twice), "m.xml", cotree.Scene).scene
    assert not scene.edges
    for method in ("auto", "dopri5", "rodas5", "cvode", "ida"):
        result = scene.compile().simulate((0.0, 3.0), method=method, throw=True)
        assert result["n"][-1] == 5.0, method
