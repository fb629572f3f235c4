"""Impossible requests are refused by name, before or in place of a wrong number."""

from __future__ import annotations

import math

import numpy as np
import pytest

import cotree
from cotree.errors import Error, ParameterError, SceneError


def pendulum(**fields):
    scene = cotree.Scene("pendulum", gravity=[0, -9.81, 0])
    scene.parameter("c", 1.0)
    scene.input("tau", 0.0)
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], torque="tau", **fields)
    scene.edge("r", "arm", "A", "B", vector=[1.0, 0, 0])
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    return scene


def test_a_line_between_coinciding_nodes():
    scene = pendulum()
    scene.edge("k", "spring", "ground", "A", stiffness=1.0)
    with pytest.raises(ParameterError, match="nodes of edge 'k' coincide"):
        scene.compile()


def test_an_axis_that_parameters_take_the_direction_from():
    scene = cotree.Scene("slide")
    scene.parameter("c", 0.0)
    scene.edge("p", "prismatic", "ground", "A", axis=["c", 0, 0])
    scene.edge("b", "rigid_body", "ground", "A", mass=1.0)
    with pytest.raises(ParameterError, match="axis of edge 'p' is 0"):
        scene.compile()


def test_an_input_that_is_undefined_fails_as_a_value():
    model = pendulum().compile()
    with pytest.warns(RuntimeWarning):
        result = model.simulate((0, 1), inputs={"tau": "log(t - 1)"}, method="dop853")
    assert not result.success


@pytest.mark.parametrize("name", ["t", "tau"])
def test_output_names_that_a_table_needs_for_something_else(name):
    with pytest.raises(SceneError, match=f"'{name}'"):
        pendulum().output(name, "h.theta")


def test_a_result_without_anything_to_plot():
    scene = cotree.Scene("weld")
    scene.edge("w", "weld", "ground", "A")
    with pytest.raises(SceneError, match="neither states nor outputs"):
        scene.compile().simulate((0, 1)).plot()


@pytest.mark.parametrize(
    "settings",
    [
        {"t_eval": ["a"]},
        {"rtol": "x"},
        {"method": 3},
        {"max_steps": "a"},
        {"parameters": 1},
        {"inputs": 3},
    ],
    ids=str,
)
def test_settings_of_the_wrong_kind(settings):
    model = pendulum().compile()
    with pytest.raises(Error):
        model.simulate((0, 1), **settings)


@pytest.mark.parametrize("arguments", [{"sensitivities": [3]}, {"tree": 5}], ids=str)
def test_arguments_of_compile_of_the_wrong_kind(arguments):
    with pytest.raises(Error):
        pendulum().compile(**arguments)


def test_numpy_values_are_taken_as_numbers_and_lists():
    scene = cotree.Scene("numpy", gravity=np.array([0, -9.81, 0]))
    scene.input("tau", np.float32(0.5))
    scene.edge("h", "revolute", "ground", "A", axis=np.array([0, 0, 1]), torque="tau")
    scene.edge("r", "arm", "A", "B", vector=np.array([1.0, 0, 0]))
    scene.edge("b", "rigid_body", "ground", "B", mass=np.int64(1), inertia=np.eye(3))
    model = scene.compile()
    # (m L^2 + J) theta'' = tau - m g L cos(theta)
    assert model.rhs(0.0, model.initial_state)[1] == pytest.approx((0.5 - 9.81) / 2.0, rel=1e-15)


def test_an_inertia_that_no_body_has():
    scene = pendulum()
    tensor = [[1, 5, 0], [5, 1, 0], [0, 0, 1]]
    scene.edge("b2", "rigid_body", "ground", "B", mass=1.0, inertia=tensor)
    with pytest.warns(
        RuntimeWarning, match="inertia of edge 'b2' is physically impossible: .* negative"
    ):
        model = scene.compile()
    # The plane reads one moment of it: (2 m L^2 + J) theta'' = -2 m g L
    assert model.rhs(0.0, model.initial_state)[1] == pytest.approx(-2.0 * 9.81 / 3.0, rel=1e-15)


def test_the_inertia_of_a_thin_rod_in_oblique_axes():
    """Its minors are zero but for rounding: accepted."""
    direction = np.array([0.3, 0.5, 0.81])
    direction /= np.linalg.norm(direction)
    scene = pendulum()
    tensor = np.eye(3) - np.outer(direction, direction)
    tensor = (tensor + tensor.T) / 2.0
    scene.edge("b2", "rigid_body", "ground", "B", mass=1.0, inertia=tensor)
    assert scene.compile().states


def top(inertia, **parameters):
    """A body on a ball joint, in space."""
    scene = cotree.Scene("top", gravity=[0, 0, -9.81])
    for name, value in parameters.items():
        scene.parameter(name, value)
    scene.edge("ball", "spherical", "ground", "P")
    scene.edge("axle", "arm", "P", "C", vector=[0, 0, 0.3])
    scene.edge("b", "rigid_body", "ground", "C", mass=1.0, inertia=inertia)
    return scene


def turned(principal):
    """A tensor in oblique axes, symmetric to the last bit."""
    axes, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    tensor = axes @ np.diag(principal) @ axes.T
    return (tensor + tensor.T) / 2.0


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("inertia", "parameters"),
    [
        ([0.1, 0.2, 0.5], {}),
        ([0.5, 0.1, 0.2], {}),
        (turned([0.1, 0.2, 0.5]), {}),
        (["A", "2*A", "5*A"], {"A": 0.1}),
        # Its minors of two rows are positive, its determinant is not.
        ([[1, 0.9, -0.9], [0.9, 1, 0.9], [-0.9, 0.9, 1]], {}),
    ],
    ids=["numbers", "permuted", "oblique", "parameters", "negative"],
)
def test_moments_of_inertia_that_break_the_triangle_rule_are_named(inertia, parameters):
    with pytest.warns(RuntimeWarning, match="inertia of edge 'b' is physically impossible") as said:
        top(inertia, **parameters).compile()
    assert [warning.filename for warning in said] == [__file__]


def test_a_given_value_that_follows_a_parameter_is_named_at_the_users_line():
    """Both coordinates of a slider crank are given as numbers, which agree for one length only."""
    scene = cotree.Scene("slider-crank")
    scene.parameter("l", 0.5)
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 0.8})
    scene.edge("crank", "rigid_body", "ground", "A", mass=0.0, inertia=[0.1, 0.1, 0.1])
    scene.edge("arm", "arm", "A", "P", vector=[0.2, 0, 0])
    s0 = 0.2 * math.cos(0.8) + math.sqrt(0.25 - (0.2 * math.sin(0.8)) ** 2)
    scene.edge("p", "prismatic", "ground", "S", axis=[1, 0, 0], initial={"s": s0})
    scene.edge("slider", "rigid_body", "ground", "S", mass=1.0)
    scene.edge("rod", "distance", "P", "S", length="l")
    with pytest.warns(RuntimeWarning, match=r"given before them are kept: 'p\.s' with 'l'") as said:
        scene.compile(["l"], optimize="-O0").simulate((0, 0.1))
    assert {warning.filename for warning in said} == {__file__}


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "inertia",
    [
        0.3,
        [0.1, 0.2, 0.3],  # a plate
        [0.333333, 0.333333, 0.666667],  # a plate's, written with six digits
        turned([0.1, 0.2, 0.3]),
        [0.2, 0.2, 0],  # a rod
        turned([0.2, 0.2, 0]),
        [0, 0, 0],
    ],
    ids=str,
)
def test_rods_plates_and_points_keep_the_triangle_rule(inertia):
    scene = top(inertia)
    scene.edge("rest", "rigid_body", "ground", "C", mass=0.1, inertia=0.1)
    assert scene.compile().states  # warnings are errors here


def test_moments_about_one_axis_alone_are_no_tensor():
    """A moment about the axis of a joint in space, and what a plane scene never reads."""
    wheel = cotree.Scene("wheel", gravity=[1, 2, 3])
    wheel.edge("h", "revolute", "ground", "A", axis=[0, 0, 1])
    wheel.edge("b", "rigid_body", "ground", "A", mass=1.0, inertia=[0, 0, 0.2])
    plane = pendulum()
    plane.edge("b2", "rigid_body", "ground", "B", mass=1.0, inertia=[0.1, 0, 0.5])
    assert wheel.compile().states
    assert plane.compile().states
