"""Constraints that no motion changes: met, they cost nothing; not met, they are refused by name."""

from __future__ import annotations

import pytest

from cotree import Scene
from cotree.errors import ParameterError


def four_bar(height: float | str, lift: str = "0") -> Scene:
    """A planar parallelogram, one of whose pins on the ground stands at a height."""
    scene = Scene("bars", gravity=[0, -9.81, 0])
    scene.parameter("h", 0.0)
    scene.edge("base", "arm", "ground", "D", vector=[2, 0, height])
    scene.edge("j1", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 1.5})
    scene.edge("a", "arm", "A", "B", vector=[1, 0, 0])
    scene.edge("j2", "revolute", "B", "C", axis=[0, 0, 1], initial={"theta": -1.5})
    scene.edge("b", "arm", "C", "E", vector=[2, 0, 0])
    scene.edge("j3", "revolute", "D", "F", axis=[0, 0, 1], initial={"theta": 1.5})
    scene.edge("c", "arm", "F", "H", vector=[1, 0, 0])
    scene.edge("j4", "revolute", "E", "H", axis=[0, 0, 1])
    for name, node in (("m1", "A"), ("m2", "C"), ("m3", "F")):
        scene.edge(name, "rigid_body", "ground", node, mass=1.0, inertia=0.1)
    return scene


def test_pins_at_one_height_ask_for_nothing():
    model = four_bar(0.0).compile()
    assert model.kernels.constraints == ("j4.x", "j4.y", "j4.x_dot", "j4.y_dot")


def test_pins_at_different_heights_are_refused():
    with pytest.raises(ParameterError, match=r"constraint 'j4\.z' is violated, and no motion"):
        four_bar(0.1).compile()


@pytest.mark.slow
def test_a_height_that_is_a_parameter_is_guarded():
    model = four_bar("h").compile()
    model.simulate((0, 0.01), parameters={"h": 1e-12})  # less than rounding of a metre's scene
    with pytest.raises(ParameterError, match=r"constraint 'j4\.z' is violated"):
        model.simulate((0, 0.01), parameters={"h": 0.2})


@pytest.mark.slow
def test_the_exported_program_says_the_same(tmp_path):
    project = four_bar("h").compile().write(tmp_path)
    model = next(path for path in project.files if path.name == "bars.c").read_text()
    assert "constraint 'j4.z' is violated, and no motion changes it" in model


def test_a_prescribed_motion_that_nothing_follows_is_refused():
    scene = Scene("held")
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0, inertia=0.1)
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1])
    scene.edge("up", "prismatic", "ground", "A", axis=[0, 0, 1], motion="0.1*t")
    with pytest.raises(ParameterError, match=r"constraint 'up\.\w+' is violated"):
        scene.compile(tree=["h"])
