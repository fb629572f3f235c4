"""Sensitivities that vanish are left out of what methods integrate, and zero for all who look."""

from __future__ import annotations

import numpy as np
import pytest
from cascades import (
    CASCADES,
    HEATER,
    ball_beside_pendulum,
    heater,
    ladders,
    pendulums,
    rectifier_with_heater,
    whole_pattern,
)

from cotree.errors import SolveError
from cotree.methods import METHODS
from cotree.program import lower as lowering
from cotree.solvers.native import is_available

pytestmark = pytest.mark.compiler

NAMES = {
    "heater": HEATER,
    "pendulums": ("L1", "L2"),
    "rectifier-with-heater": ("R", "Ca"),
    "loop-beside-circuit": ("a", "R"),
    "ball-beside-pendulum": ("L1", "e"),
}

RTOL, ATOL = 1e-9, 1e-11

# Both integrations are off by some hundred steps of the tolerance at most; those of multistep
# methods, which are tested by a mean of what is integrated, by a few times as much.
AGREE = {True: 1e-5, False: 1e-6}


@pytest.fixture(scope="module")
def both():
    """Each scene compiled as it is, and with all sensitivities integrated."""
    made = {}

    def get(name):
        if name not in made:
            packed = CASCADES[name]().compile(NAMES[name])
            with pytest.MonkeyPatch.context() as patch:
                patch.setattr(lowering, "reached_states", whole_pattern)
                made[name] = packed, CASCADES[name]().compile(NAMES[name])
        return made[name]

    return get


@pytest.mark.sampled(3)
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", CASCADES)
def test_every_method_agrees_with_the_whole_integration(name, method, both):
    if not is_available(method):
        pytest.skip("its library is not there")
    if METHODS[method].family in ("scipy", "correctors") and name.startswith("ball"):
        pytest.skip("it refuses events")
    packed, whole = both(name)
    if METHODS[method].family == "scipy" and (
        packed.kernels.layout.n_algebraic or packed.kernels.constraints
    ):
        with pytest.raises(SolveError, match=f"use '{METHODS[method].instead}', which runs in C"):
            packed.simulate((0.0, 1.0), method=method)
        return
    # More than a period of its source; the rectifier is slow where steps are taken in Python.
    end = 0.4 if name.startswith("rectifier") else 1.2
    times = np.linspace(0.0, end, 13)
    runs = [m.simulate((0.0, end), times, method, RTOL, ATOL, throw=True) for m in (packed, whole)]
    found, expected = (r.s for r in runs)
    assert found.shape == expected.shape == (len(packed.states), len(NAMES[name]), 13)
    assert not packed.kernels.structure.sensitivity_pattern.all()
    assert not found[~packed.kernels.structure.sensitivity_pattern].any()
    assert all("was used instead" not in r.message for r in runs)
    agree = AGREE[METHODS[method].multistep]
    scale = 1.0 + np.abs(expected).max(axis=2, keepdims=True)
    assert np.max(np.abs(found - expected) / scale) < agree
    size = 1.0 + np.abs(runs[1].y).max(axis=1, keepdims=True)
    assert np.max(np.abs(runs[0].y - runs[1].y) / size) < agree


@pytest.mark.slow
@pytest.mark.parametrize("method", ["cvode", "ida", "rodas5", "Radau"])
def test_where_matrices_are_sparse(method, monkeypatch):
    """States stand in another order within the band, and half a column is solved for."""
    packed = ladders().compile(["R1", "R2"])
    assert packed.kernels.structure.sensitivity_pattern.sum() == 50
    monkeypatch.setattr(lowering, "reached_states", whole_pattern)
    whole = ladders().compile(["R1", "R2"])
    runs = [m.simulate((0.0, 2.0), [1.0, 2.0], method, RTOL, ATOL) for m in (packed, whole)]
    assert all("was used instead" not in r.message for r in runs)
    assert not runs[0].s[~packed.kernels.structure.sensitivity_pattern].any()
    agree = AGREE[METHODS[method].multistep]
    np.testing.assert_allclose(runs[0].s, runs[1].s, atol=agree)
    # The ladders are alike: so are the sensitivities of each to its own resistance.
    np.testing.assert_allclose(runs[0].s[:25, 0], runs[0].s[25:, 1], atol=agree)


@pytest.mark.sampled(7)
@pytest.mark.parametrize("method", [m for m in METHODS if not m.startswith(("cvodes", "idas"))])
@pytest.mark.parametrize("is_tested", [True, False])
def test_a_parameter_of_outputs_alone_costs_nothing(method, is_tested):
    """The same steps, bit for bit, as without it."""
    runs = [
        heater()
        .compile(names)
        .simulate(
            (0.0, 1.0), method=method, rtol=1e-7, atol=1e-9, error_test_sensitivities=is_tested
        )
        for names in (["R"], ["R", "k"])
    ]
    np.testing.assert_array_equal(runs[0].t, runs[1].t)
    np.testing.assert_array_equal(runs[0].y, runs[1].y)
    np.testing.assert_array_equal(runs[0].s[:, 0], runs[1].s[:, 0])
    assert not runs[1].s[:, 1].any()
    # felt = k T
    np.testing.assert_allclose(runs[1].sensitivity("felt", "k"), runs[1]["W.T"], rtol=1e-14)


# cvode is not among them: where sensitivities may follow, its steps have matrices of their own.
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "ida", "Radau"])
def test_nothing_is_left_where_only_outputs_depend(method):
    """Not one sensitivity is integrated."""
    alone = heater().compile().simulate((0.0, 1.0), method=method)
    found = heater().compile(["k"]).simulate((0.0, 1.0), method=method, throw=True)
    np.testing.assert_array_equal(alone.y, found.y)
    assert not found.s.any()
    np.testing.assert_allclose(found.sensitivity("felt", "k"), found["W.T"], rtol=1e-14)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("method", ["dopri5", "dop853", "rodas5", "cvode", "ida"])
def test_events_with_algebraic_unknowns(method, both, monkeypatch):
    """Unknowns are solved for at each point, not integrated; the event's time depends on R."""

    def scene():
        made = rectifier_with_heater()
        made.event("warm", "C1.v - 1", set={"W.T": "2*W.T"})
        return made.compile(["R", "Ca"])

    packed = scene()
    monkeypatch.setattr(lowering, "reached_states", whole_pattern)
    whole = scene()
    assert packed.kernels.structure.sensitivity_pattern.T.tolist() == [
        [True, True, True],
        [False, True, False],
    ]
    times = np.linspace(0.0, 0.5, 6)
    found, expected = (m.simulate((0.0, 0.5), times, method, RTOL, ATOL) for m in (packed, whole))
    assert len(found.events["warm"].t) == len(expected.events["warm"].t) > 0
    np.testing.assert_allclose(found.s, expected.s, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        found.event_sensitivity("warm", "R"), expected.event_sensitivity("warm", "R"), rtol=1e-5
    )
    assert not found.event_sensitivity("warm", "Ca").any()


@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_what_is_not_finite_is_named_by_its_own_name(method):
    """Places of what is integrated are not those of all."""
    scene = pendulums()
    scene.parameter("c", 3.0)
    # The derivative by c has a logarithm, which the swing takes below zero.
    scene.edge("t2", "torque", "ground", "A2", torque=[0, 0, "-h2.theta**c"])
    model = scene.compile(["L1", "c"])
    assert model.kernels.structure.sensitivity_pattern.sum() == 4
    with pytest.warns(RuntimeWarning):
        result = model.simulate((0.0, 3.0), method=method)
    assert result.status != 0
    assert "the sensitivity of 'h2.theta" in result.message
    assert "to 'c'" in result.message


def test_ball_beside_pendulum_has_its_closed_form():
    """The second bounce of a ball that falls from 1 m: t = sqrt(2/g) (1 + 2 e)."""
    result = ball_beside_pendulum().compile(["L1", "e"]).simulate((0.0, 1.5), rtol=1e-10)
    fall = np.sqrt(2.0 / 9.81)
    hits = result.events["hit"]
    # Times are as accurate as steps are.
    np.testing.assert_allclose(hits.t, [fall, fall * 2.6], rtol=1e-9)
    np.testing.assert_allclose(result.event_sensitivity("hit", "e"), [0.0, 2.0 * fall], rtol=1e-8)
    assert not result.event_sensitivity("hit", "L1").any()
