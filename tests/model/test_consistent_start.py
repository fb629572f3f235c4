"""The consistent start where little is given, or nearly enough."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree import Scene


def rod(length, **initial) -> Scene:
    scene = Scene("rod", gravity=[0, -9.81, 0])
    scene.edge("b", "rigid_body", "ground", "C", mass=1.0, initial=initial)
    scene.edge("d", "distance", "ground", "C", length=length)
    return scene


def test_a_gradient_that_vanishes_at_first_is_found_aside():
    y = rod(1.4, x=0.5).compile().start().y
    assert y[0] == 0.5
    assert abs(y[1]) == pytest.approx(np.sqrt(1.4**2 - 0.25), rel=1e-12)


def test_nearly_consistent_values_are_mended_and_said():
    with pytest.warns(RuntimeWarning, match=r"'b\.y' from -1\.3 to"):
        model = rod(1.4, x=0.5, y=-1.3).compile()
    with pytest.warns(RuntimeWarning, match="changed"):
        y = model.start().y
    assert np.hypot(y[0], y[1]) == pytest.approx(1.4, rel=1e-12)


def test_contradictions_are_refused_with_their_residuals():
    with pytest.raises(cotree.ParameterError, match=r"d\.length = -0\.8"):
        rod(1.4, x=0.3, y=0.5).compile()


def test_a_scene_that_starts_later_compiles():
    result = rod("t").compile().simulate((1, 2), rtol=1e-9, atol=1e-9)
    assert np.allclose(np.hypot(result["b.x"], result["b.y"]), result.t, rtol=1e-12)


def skate() -> tuple[cotree.Model, str]:
    scene = Scene("skate", gravity=[1.0, 0, 0])
    scene.parameter("w", 1.0)
    initial = {"theta": "w/3", "theta_dot": "w"}
    scene.edge("b", "rigid_body", "ground", "C", mass=1.5, inertia=0.3, initial=initial)
    scene.edge("ar", "arm", "C", "K", vector=[-0.4, 0.1, 0])
    scene.edge("e", "knife_edge", "ground", "K", axis=[0, 1, 0])
    return scene.compile(["w"]), "w"


def wheels() -> tuple[cotree.Model, str]:
    scene = Scene("wheels")
    scene.parameter("r", 0.3)
    for name in ("p", "k"):
        scene.edge(name, "revolute", "ground", name.upper(), axis=[0, 0, 1])
        scene.edge(f"m{name}", "rigid_body", "ground", name.upper(), mass=1, inertia=1.0)
    pair = {"coordinate1": "k.theta", "coordinate2": "p.theta"}
    scene.edge("g", "gear", "P", "K", ratio="r", phase=0.1, **pair)
    return scene.compile(["r"]), "r"


@pytest.mark.parametrize("make", [skate, wheels])
def test_sensitivities_of_the_least_move(make):
    model, name = make()
    h, p = 1e-6, model.default_parameters
    ends = [model.start(p=p + sign * h).y for sign in (1, -1)]
    differences = (ends[0] - ends[1]) / (2 * h)
    # Central differences: the third derivative times h^2, and rounding over h.
    assert np.allclose(model.start().s[:, 0], differences, atol=1e-8)
    assert name in model.sensitivities


def test_what_only_the_constraints_depend_on_is_no_idle_parameter():
    model, _ = wheels()
    assert model.kernels.unreached == ()


def slider_crank(*order: str, l_of_slider: bool = False) -> Scene:
    """Place a crank and a slider such that only a rod of half a metre fits."""
    scene = Scene("slider-crank")
    scene.parameter("l", 0.5)
    at, root = 0.2 * float(np.cos(0.8)), 0.04 * float(np.sin(0.8)) ** 2
    place = f"{at!r} + sqrt(l**2 - {root!r})" if l_of_slider else float(at + np.sqrt(0.25 - root))
    for name in order:
        if name == "h":
            start = {"theta": 0.8}
            scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial=start)
        else:
            scene.edge("p", "prismatic", "ground", "S", axis=[1, 0, 0], initial={"s": place})
    scene.edge("ca", "arm", "A", "P", vector=[0.2, 0, 0])
    scene.edge("cb", "rigid_body", "ground", "A", mass=0.0, inertia=0.03)
    scene.edge("sb", "rigid_body", "ground", "S", mass=0.7)
    scene.edge("rod", "distance", "P", "S", length="l")
    return scene


@pytest.mark.parametrize("order", ["hp", "ph"])
def test_of_two_given_numbers_the_first_is_kept_and_the_other_is_said_to_move(order):
    kept, moved = {"h": "h.theta", "p": "p.s"}[order[0]], {"h": "h.theta", "p": "p.s"}[order[1]]
    with pytest.warns(RuntimeWarning, match=rf"'{moved}' with 'l'"):
        model = slider_crank(*order).compile(["l"])
    with pytest.warns(RuntimeWarning, match=rf"'{moved}' with 'l'"):
        result = model.simulate((0, 0.1), method="dopri5")
    assert result.sensitivity(kept, "l")[0] == pytest.approx(0.0, abs=1e-14)
    q, root = 0.8, np.sqrt(0.25 - (0.2 * np.sin(0.8)) ** 2)
    # x = r cos q + sqrt(l^2 - r^2 sin^2 q)
    by_l, by_q = 0.5 / root, -0.2 * np.sin(q) - 0.04 * np.sin(q) * np.cos(q) / root
    slope = by_l if moved == "p.s" else -by_l / by_q
    assert result.sensitivity(moved, "l")[0] == pytest.approx(slope, rel=1e-9)
    assert f"'{moved}' with 'l'" in result.message


def test_values_that_move_as_they_should_need_no_word():
    model = slider_crank("h", "p", l_of_slider=True).compile(["l"])
    result = model.simulate((0, 0.1), method="dopri5")
    assert result.sensitivity("h.theta", "l")[0] == pytest.approx(0.0, abs=1e-12)
    assert "given initial values" not in result.message.lower()


def test_the_numbers_of_a_run_come_first_and_its_message_says_what_moves():
    model = slider_crank("h", "p", l_of_slider=True).compile(["l"])
    start = dict(zip(model.states, model.start().y, strict=True))
    for first, second in (("h.theta", "p.s"), ("p.s", "h.theta")):
        given = {first: start[first], second: start[second]}
        result = model.simulate((0, 0.1), initial=given, method="dopri5")
        assert result.sensitivity(first, "l")[0] == pytest.approx(0.0, abs=1e-14)
        assert f"'{second}' with 'l'" in result.message


def test_derivatives_by_an_initial_value_let_the_others_follow():
    """Two angles of a crank and a slider are given: along one of them the other moves."""
    for name, other in (("h.theta", "p.s"), ("p.s", "h.theta")):
        start = slider_crank("h", "p").compile([name]).start()
        slopes = dict(zip(("h.theta", "p.s"), start.s[:2, 0], strict=True))
        assert slopes[name] == pytest.approx(1.0, abs=1e-14)
        root = np.sqrt(0.25 - (0.2 * np.sin(0.8)) ** 2)
        by_q = -0.2 * np.sin(0.8) - 0.04 * np.sin(0.8) * np.cos(0.8) / root
        assert slopes[other] == pytest.approx(by_q if other == "p.s" else 1 / by_q, rel=1e-9)


def test_of_values_that_nearly_fit_the_last_one_moves():
    with pytest.warns(RuntimeWarning, match=r"changed .*: 'b\.y' from -1\.3 to"):
        model = rod(1.4, x=0.5, y=-1.3).compile()
    with pytest.warns(RuntimeWarning, match="changed"):
        assert model.start().y[0] == 0.5
