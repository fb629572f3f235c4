"""Absolute tolerances of sensitivities go by the sizes of their parameters."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree.errors import ParameterError

SMALL = 2.0**-40  # a picofarad or so; a power of two, by which products are exact


def filter_with(unit: float) -> cotree.Scene:
    """Draw a diode that charges a capacitor, whose capacity is a parameter in some unit."""
    scene = cotree.Scene("detector")
    scene.parameter("c", 3.0 * SMALL / unit)
    scene.parameter("R", 1e9)
    scene.edge("V", "voltage_source", "a", "ground", voltage="2*sin(500*t)")
    scene.edge("S", "resistor", "a", "b", resistance=1e6)
    scene.edge("D", "diode", "b", "k", saturation_current=1e-9, junction_capacitance=f"c*{unit!r}")
    scene.edge("C", "capacitor", "k", "ground", capacitance=f"c*{unit!r}", initial={"v": 0.1})
    scene.edge("L", "resistor", "k", "ground", resistance="R")
    return scene


@pytest.mark.slow
@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode", "ida", "dopri5"])
def test_the_unit_of_a_parameter_changes_no_step(method):
    settings = {"method": method, "rtol": 1e-7, "atol": 1e-9}
    small, large = (
        filter_with(unit).compile(["c", "R"]).simulate((0, 0.02), **settings)
        for unit in (2.0**-20, SMALL)
    )
    assert small.success
    assert small.statistics.n_steps == large.statistics.n_steps
    assert small.sensitivity("C.v", "c")[-1] != 0.0
    # Products with powers of two are exact.
    np.testing.assert_array_equal(small.y, large.y)
    np.testing.assert_array_equal(
        small.sensitivity("C.v", "c") * 2.0**-20, large.sensitivity("C.v", "c")
    )


def test_a_picofarad_takes_hardly_more_steps_than_none():
    """Sensitivities of 1e12 V/F and an absolute tolerance of a voltage would take millions."""
    settings = {"method": "rodas5", "rtol": 1e-9, "atol": 1e-12}
    scene = filter_with(1.0)
    plain, result = (scene.compile(names).simulate((0, 0.02), **settings) for names in ((), ["c"]))
    assert np.abs(result.sensitivity("C.v", "c")).max() > 1e9
    assert result.statistics.n_steps < 3 * plain.statistics.n_steps


def test_sizes_may_be_given_and_zero_counts_as_one():
    scene = cotree.Scene("fall", gravity=[0, 0, "-g"])
    scene.parameter("g", 0.0)
    scene.parameter("c", 1e-6)
    start = {"s": 1.0, "s_dot": 3.0}
    force = "-c*j.s_dot**3"
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial=start, force=force)
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    model = scene.compile(["g", "c", "j.s_dot"])
    steps = [
        model.simulate((0, 3), method="dopri5", scales=scales).statistics.n_steps
        for scales in ({}, {"g": 1.0, "c": 1e-6, "j.s_dot": 1.0}, {"c": 1.0}, {"g": 1e6})
    ]
    assert steps[0] == steps[1]  # those that are taken where none are given
    assert steps[2] > steps[0]
    assert steps[3] > steps[0]


@pytest.mark.parametrize(
    ("scales", "said"),
    [
        ({"d": 1.0}, "'d', to which no sensitivity was asked for"),
        ({"c": 0.0}, "the scale of 'c' is 0: give a positive number"),
        ({"c": "1"}, "the scale of 'c' is '1': give a number"),
        ([1.0], "scales is .*mapping"),
    ],
)
def test_wrong_sizes_are_named(scales, said):
    model = filter_with(1.0).compile(["c"])
    with pytest.raises(ParameterError, match=said):
        model.simulate((0, 1e-3), scales=scales)
