"""Inertias that rounding loses beside others: right results, or errors that name the cause."""

from __future__ import annotations

import math
import warnings

import pytest

import cotree


@pytest.mark.parametrize("small", [1e-12, 1e-16, 1e-20])
def test_a_body_of_a_tiny_mass_carries_another(small):
    scene = cotree.Scene("slides")
    scene.prismatic("p", "ground", "A", axis=[1, 0, 0])
    scene.prismatic("q", "A", "B", axis=[1, 0, 0], initial={"s": 1.0, "s_dot": 0.3})
    scene.rigid_body("light", "ground", "A", mass=small)
    scene.rigid_body("heavy", "ground", "B", mass=1.0)
    scene.force("F", "ground", "B", force=["sin(t)", 0, 0])
    result = scene.compile().simulate((0, 1), rtol=1e-10, atol=1e-12)
    # The light body moves on, as no force acts on it: q.s = 1 + 0.3 t + t - sin(t). The run is to
    # 1e-10.
    assert abs(result["q.s"][-1] - (2.3 - math.sin(1.0))) < 1e-9


def test_an_inertia_within_rounding_errors_of_an_arm_is_named():
    scene = cotree.Scene("arm")
    scene.spherical("h", "ground", "A")
    scene.arm("r", "A", "B", vector=[0, -1e9, 0])
    scene.rigid_body("b", "ground", "B", mass=1.0, inertia=[1, 1, 1])
    said = r"'h\.w2' moves no inertia beyond rounding errors of the 2e\+18 that its joint carries"
    with pytest.raises(cotree.errors.SingularSystemError, match=said):
        scene.compile()


def test_rates_beyond_the_squares_of_doubles_warn_of_nothing_else():
    scene = cotree.Scene("damped")
    scene.parameter("K", 1e200)
    scene.translational_mass("M", "ground", "x", mass=1.0, initial={"v": 1.0})
    scene.force_source("F", "x", "ground", force="K*M.v")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert scene.compile().rhs(0.0, [1.0])[-1] in (1e200, -1e200)
        assert scene.compile().simulate((0, 1e-203), method="auto").success
