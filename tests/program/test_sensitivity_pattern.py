"""Sensitivities that vanish at all times: no path leads from the parameter to the state."""

from __future__ import annotations

import numpy as np
import pytest
from cascades import (
    CASCADES,
    HEATER,
    HEATER_PATTERN,
    ball_beside_pendulum,
    heater,
    loop_beside_circuit,
    pendulums,
    whole_pattern,
)
from rod_chain import rod_chain

from cotree import load
from cotree.program import lower as lowering

SHIPPED = (
    "battery-cell",
    "bouncing-ball",
    "bridge-rectifier",
    "crane",
    "motor-linkage",
    "slider-pendulum",
    "spring-mass-damper",
)


def wanted(scene):
    """All tunable parameters, and the initial value of the first state."""
    plain = scene.compile()
    has_rate = [
        s for s, z in zip(plain.states, plain.kernels.layout.algebraic, strict=True) if not z
    ]
    return [*plain.parameters, has_rate[0]]


def scene_named(name):
    return CASCADES[name]() if name in CASCADES else load(name)


def test_a_cascade_goes_one_way():
    model = heater().compile(HEATER)
    assert model.states == ("L1.i", "W.T")
    assert model.kernels.structure.sensitivity_pattern.tolist() == HEATER_PATTERN
    assert "sensitivities: 6 of 10 are integrated" in model.summary()


def test_parts_that_do_not_act_on_each_other():
    model = pendulums().compile(["L1", "L2", "h2.theta"])
    assert model.states == ("h1.theta", "h2.theta", "h1.theta_dot", "h2.theta_dot")
    first, second = [True, False, True, False], [False, True, False, True]
    assert model.kernels.structure.sensitivity_pattern.T.tolist() == [first, second, second]


def test_constraints_move_what_is_mechanical():
    model = loop_beside_circuit().compile(["a", "R"])
    *mechanical, last = model.kernels.structure.sensitivity_pattern.tolist()
    assert all(row == [True, False] for row in mechanical)
    assert last == [False, True]


def test_events_move_what_they_set_and_what_follows():
    model = ball_beside_pendulum().compile(["L1", "e"])
    assert model.states == ("h1.theta", "j.s", "h1.theta_dot", "j.s_dot")
    assert (
        model.kernels.structure.sensitivity_pattern.tolist() == [[True, False], [False, True]] * 2
    )


def test_an_event_that_depends_on_a_parameter_fills_what_it_sets():
    scene = pendulums()
    # The kick of the second pendulum waits for the first one, whose length decides when.
    scene.event("kick", "h1.theta", set={"h2.theta_dot": "h2.theta_dot + 1"})
    assert scene.compile(["L1", "L2"]).kernels.structure.sensitivity_pattern.tolist() == [
        [True, False],
        [True, True],
        [True, False],
        [True, True],
    ]


def test_an_event_made_by_another_happens_at_its_time():
    scene = pendulums()
    scene.mode("on", 0.0)
    scene.event("first", "h1.theta", set={"on": 1})
    # It looks at nothing that depends on L1, but what it sets happens at a time that does.
    scene.event("second", "on - 0.5", set={"h2.theta_dot": "0"})
    assert scene.compile(["L1"]).kernels.structure.sensitivity_pattern.T.tolist() == [
        [True, True, True, True, False]
    ]


# Long enough for all parts to act: pulses of the battery begin after a minute.
ENDS = {"battery-cell": 120.0, "bridge-rectifier": 0.02, "bouncing-ball": 2.0}

# Temperatures are above T0: where the motor starts with it, the linkage does not depend on it,
# which numbers know and no structure does.
BY_CHANCE = {("motor-linkage", "T0")}


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize("name", [*SHIPPED, *CASCADES])
def test_pattern_is_that_of_numbers(name, monkeypatch):
    scene = scene_named(name)
    names = wanted(scene)
    pattern = scene.compile(names).kernels.structure.sensitivity_pattern
    monkeypatch.setattr(lowering, "reached_states", whole_pattern)
    whole = scene_named(name).compile(names)
    assert whole.kernels.structure.sensitivity_pattern.all()
    end = ENDS.get(name, 1.0)
    found = whole.simulate((0.0, end), np.linspace(0.0, end, 21), rtol=1e-6, atol=1e-8, throw=True)
    is_nonzero = (found.s != 0.0).any(axis=2)
    assert not (is_nonzero & ~pattern).any()
    for j in (j for j, parameter in enumerate(names) if (name, parameter) not in BY_CHANCE):
        assert (is_nonzero[:, j] == pattern[:, j]).all(), names[j]


@pytest.mark.parametrize("make", [heater, pendulums])
def test_nothing_is_computed_that_vanishes(make, monkeypatch):
    names = HEATER if make is heater else ("L1", "L2")
    kernels = make().compile(names).kernels.program.kernels
    monkeypatch.setattr(lowering, "reached_states", whole_pattern)
    before = make().compile(names).kernels.program.kernels
    lengths = {heater: (8, 12), pendulums: (8, 12)}[make]
    assert tuple(len(k["augmented_rhs"].results) for k in (kernels, before)) == lengths
    less = {heater: 22, pendulums: 6}[make]
    counts = [k["augmented_rhs"].operations.total for k in (kernels, before)]
    assert counts[1] - counts[0] == less, counts


@pytest.mark.slow
def test_a_map_of_many_columns_leaves_them_out(monkeypatch):
    """Two chains of rods, whose sensitivities are computed several at a time."""

    def chains():
        scene, names = rod_chain(4)
        end = "ground"
        for i in range(4):
            scene.parameter(f"l{i}", 1.0)
            scene.edge(f"g{i}", "revolute", end, f"F{i}", axis=[0, 0, 1], initial={"theta": 0.2})
            scene.edge(f"a{i}", "arm", f"F{i}", f"G{i}", vector=[f"l{i}", 0, 0])
            scene.edge(f"p{i}", "rigid_body", "ground", f"G{i}", mass=1.0, inertia=0.1)
            end = f"G{i}"
        return scene, [*names, *(f"l{i}" for i in range(4))]

    scene, names = chains()
    model = scene.compile(names)
    monkeypatch.setattr(lowering, "reached_states", whole_pattern)
    whole = chains()[0].compile(names)
    pattern = model.kernels.structure.sensitivity_pattern
    assert pattern.sum() == pattern.size // 2
    rng = np.random.default_rng(1)
    y = rng.normal(size=len(model.states))
    s = np.where(pattern, rng.normal(size=pattern.shape), 0.0)
    found, expected = (m.sensitivity_rhs(0.0, y, s) for m in (model, whole))
    assert not found[~pattern].any()
    # Both are sums of the same terms, in another order.
    np.testing.assert_allclose(found, expected, rtol=1e-10, atol=1e-10)
