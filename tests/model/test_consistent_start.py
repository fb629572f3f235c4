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
    assert model.unreached == ()
