"""Where the steps go on to the end with bodies in the tree, and where they say that they end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pytest

from cotree import Scene
from cotree.cli.app import main
from cotree.export.steps import formulation_steps
from cotree.formulation.first_graph import form_first_graph
from cotree.scene.graphs import choose_trees, joint_tree, linear_graphs

if TYPE_CHECKING:
    from collections.abc import Sequence

ROTATION = {"rotation": [0.1, 0, 0.2]}

#: Of each component type that is beyond the steps: what it needs.
JOINTS: dict[str, dict[str, Any]] = {
    "spherical": {},
    "free": {},
    "planar": {"normal": [0, 0, 1]},
    "universal": {"axis": [1, 0, 0], "axis2": [0, 1, 0]},
    "screw": {"axis": [1, 0, 0], "pitch": 0.1},
}
CONSTRAINTS: dict[str, dict[str, Any]] = {
    "distance": {"length": "L"},
    "slot": {"axis": [1, 0, 0]},
    "knife_edge": {"axis": [1, 0, 0]},
    "rolling_disc": {"normal": [0, 1, 0], "axis": [0, 0, 1], "radius": "L"},
    "gear": {"coordinate1": "j.theta", "coordinate2": "h.theta", "ratio": "L"},
    "constraint": {"expression": "C.x - L"},
}


def steps(scene: Scene, name: str | None, tree: Sequence[str]) -> str:
    graphs = linear_graphs(scene)
    trees = choose_trees(scene, graphs, tree)
    first = form_first_graph(scene, joint_tree(scene, trees))
    return formulation_steps(scene, graphs, trees, first, name)


def lines_of(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines()]


def ending(text: str) -> str:
    """Give the last paragraph, on one line."""
    return " ".join(text.rstrip().rpartition("\n\n")[2].split())


def two_bars() -> Scene:
    """Hang one bar on another, both turning about the same direction."""
    scene = Scene("two_bars", gravity=[0, "-L", 0])
    scene.parameter("L", 0.5)
    scene.edge("j", "revolute", "ground", "A", axis=[0, 0, 1])
    scene.edge("r", "arm", "A", "B", vector=["L", 0, 0])
    scene.edge("h", "revolute", "B", "C", axis=[0, 0, 1])
    scene.edge("q", "arm", "C", "D", vector=["L", 0, 0])
    scene.edge("b", "rigid_body", "ground", "D", mass=1, inertia=0.3)
    scene.edge("a", "rigid_body", "ground", "B", mass=1, inertia=0.3)
    return scene


@pytest.mark.parametrize(
    ("type_", "is_branch"),
    # A screw that closes a loop is refused before: its angle is known within half a turn only.
    [*((name, True) for name in JOINTS), *((name, False) for name in JOINTS if name != "screw")],
)
def test_joints_with_several_axes_end_the_text_before_the_terminal_equations(
    type_: str, is_branch: bool
):
    scene = two_bars()
    first, second = ("D", "E") if is_branch else ("ground", "D")
    scene.edge("new", type_, first, second, **JOINTS[type_])
    if is_branch:
        scene.edge("n", "rigid_body", "ground", "E", mass=1, inertia=[1, 2, 3])
    text = steps(scene, "L", ["j", "r", "h", "q", *(["new"] if is_branch else [])])
    assert "(2) f-circuit equations" in text
    assert "(3)" not in text
    assert ending(text).startswith(f"The steps end here: {type_} 'new' has a motion space of")
    assert "scene.equations()" in ending(text)


@pytest.mark.parametrize("type_", CONSTRAINTS)
def test_constraints_end_the_text_before_the_terminal_equations(type_: str):
    scene = two_bars()
    scene.edge("new", type_, "ground", "D", **CONSTRAINTS[type_])
    text = steps(scene, "L", ["j", "r", "h", "q"])
    assert "(2) f-circuit equations" in text
    assert "(3)" not in text
    assert ending(text).startswith(f"The steps end here: {type_} 'new' ")
    assert "scene.equations()" in ending(text)


@pytest.mark.parametrize(
    ("type_", "fields", "reason"),
    [
        ("arm", {"vector": [1, 0, 0], **ROTATION}, "turns the axes of its second node"),
        ("weld", ROTATION, "turns the axes of its second node"),
        ("revolute", {"axis": [0, 0, 1], "motion": "L*t"}, "has a prescribed motion"),
        ("prismatic", {"axis": [1, 0, 0], "motion": "L*t"}, "has a prescribed motion"),
    ],
)
def test_rotations_and_prescribed_motions_end_the_text(
    type_: str, fields: dict[str, Any], reason: str
):
    scene = two_bars()
    scene.edge("new", type_, "D", "E", **fields)
    scene.edge("n", "rigid_body", "ground", "E", mass=1, inertia=0.1)
    text = steps(scene, "L", ["j", "r", "h", "q", "new"])
    assert "(3)" not in text
    assert f"{type_} 'new' {reason}" in ending(text)


def test_a_free_body_in_the_tree_ends_the_text():
    scene = Scene("top", gravity=[1, 1, -9.81])  # no plane is kept
    scene.edge("b", "rigid_body", "ground", "A", mass=1, inertia=[1, 2, 3])
    text = steps(scene, "b.w1", ["b"])
    assert "F_w1(0)^b = 0" in text
    assert "(3)" not in text
    assert "rigid_body 'b' has a motion space of more than one axis" in ending(text)


def test_a_joint_that_closes_a_loop_ends_the_text_after_the_terminal_equations():
    scene = two_bars()
    scene.edge("new", "prismatic", "ground", "D", axis=[1, 0, 0], stiffness="L")
    text = steps(scene, "L", ["j", "r", "h", "q"])
    assert "new  prismatic   F^new·î = -L*(r^new·î), R^new = 1," in text
    assert "motion {k̂}" in text
    assert "(5)" not in text
    assert ending(text).startswith("The steps end here: prismatic 'new' closes a loop")
    bodies = steps(two_bars(), "L", ["a", "b", "r", "q"])
    assert "j  revolute    T^j·k̂ = 0, r^j = v^j = a^j = ω^j·î = ω^j·ĵ = 0" in lines_of(bodies)
    assert "revolute 'j' closes a loop" in ending(bodies)


def test_a_chord_that_is_driven_about_its_axis_ends_the_text():
    scene = two_bars()
    scene.edge("new", "revolute", "ground", "D", axis=[0, 0, 1], damping="L")
    text = steps(scene, "L", ["j", "r", "h", "q"])
    assert "(3)" not in text
    assert "revolute 'new' closes a loop and has a spring, damper or drive" in ending(text)


def test_the_command_ends_without_an_error(tmp_path: Any, capsys: pytest.CaptureFixture[str]):
    path = tmp_path / "top.toml"
    path.write_text(
        'name = "top"\n[edges.j]\ntype = "spherical"\nnodes = ["ground", "A"]\n'
        '[edges.b]\ntype = "rigid_body"\nnodes = ["ground", "A"]\nmass = 1\ninertia = [1, 2, 3]\n'
    )
    assert main(["equations", str(path), "--steps"]) == 0
    assert "spherical 'j'" in ending(capsys.readouterr().out)


def guided_pair() -> Scene:
    """Set two masses on one line, joined by guides with springs, one pointing backwards."""
    scene = Scene("pair")
    for name in ("m", "k", "c", "l"):
        scene.parameter(name, 0.5)
    scene.edge("m1", "rigid_body", "ground", "A", mass="m")
    scene.edge("m2", "rigid_body", "ground", "B", mass="m")
    scene.edge(
        "j1",
        "prismatic",
        "ground",
        "A",
        axis=[-1, 0, 0],
        stiffness="k",
        damping="c",
        free_length="l",
    )
    scene.edge("j2", "prismatic", "A", "B", axis=[1, 0, 0], stiffness="2*k", initial={"s": 0.3})
    return scene


def test_a_guide_that_is_a_chord_pulls_by_its_own_law():
    lines = lines_of(steps(guided_pair(), "l", ["m1", "m2"]))
    for expected in (
        "j2  prismatic   F^j2·î = -2*k*(r^j2·î), R^j2 = 1, r^j2·ĵ = r^j2·k̂ = ω^j2 = α^j2 = 0",
        "G1, x_m1: (-m a^m1 - k*(r^j1·u^j1 - l) u^j1 - c*(v^j1·u^j1) u^j1 + 2*k*(r^j2·î) î)·î = 0",
        "G1, x_m2: (-m a^m2 - 2*k*((-r^m1 + r^m2)·î) î)·î = 0",
        # By hand: s of j1 is -x of m1, s of j2 is x of m2 less x of m1.
        "G1, x_m1: m*x_m1_ddot + c*x_m1_dot + k*(l + x_m1) - 2*k*(x_m2 - x_m1) = 0",
        "G1, x_m2: m*x_m2_ddot + 2*k*(x_m2 - x_m1) = 0",
        "G2, x_m2: m*x_m2_ddot_l + 2*k*(x_m2_l - x_m1_l) = 0",
    ):
        assert expected in lines


def test_a_tree_may_hold_bodies_and_joints():
    lines = lines_of(steps(guided_pair(), "l", ["m1", "j2"]))
    assert "G1, s: -m*((a^m1 + a^j2)·î) - 2*k*s = 0" in lines
    assert "G1, s: m*x_ddot + m*s_ddot + 2*k*s = 0" in lines


def test_a_planar_body_turns_about_the_normal():
    scene = Scene("slab", gravity=[0, "-g", 0])
    for name in ("g", "m", "J", "c", "l", "f"):
        scene.parameter(name, 0.5)
    scene.edge("b", "rigid_body", "ground", "A", mass="m", inertia="J")
    scene.edge("p", "arm", "A", "P", vector=["l", 0, 0])
    scene.edge("F", "force", "ground", "P", force=["f", 0, 0])
    scene.edge("T", "torque", "ground", "A", torque=[0, 0, "-c*b.theta_dot"])
    lines = lines_of(steps(scene, "l", ["b", "p"]))
    for expected in (
        "b  translation: motion {î, ĵ}, reaction {k̂}; rotation: motion {k̂}, reaction {î, ĵ}",
        "G1, theta: (-J^b·α^b - ω^b × (J^b·ω^b) - c*b.theta_dot k̂ + f (r^p × î))·k̂ = 0",
        "G1, y: m*y_ddot + g*m = 0",
        # By hand: the force f along x at l (cos, sin) has the moment -l f sin.
        "G1, theta: J*theta_ddot + c*theta_dot + f*l*sin(theta) = 0",
    ):
        assert expected in lines


def test_an_input_that_depends_on_the_parameter_is_differentiated():
    scene = Scene("driven")
    scene.parameter("k", 2.0)
    scene.input("u", "k*sin(t)")
    scene.input("w", "cos(t)")
    scene.edge("b", "rigid_body", "ground", "A", mass=3)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="2*u + w")
    lines = lines_of(steps(scene, "k", ["j"]))
    assert "u_k: derivative of the input u" in lines
    assert "G2, s: -3*(a_k^b·î) + 2*u_k = 0" in lines
    assert "G2, s: 3*s_ddot_k - 2*sin(t) = 0" in lines


def test_a_particle_in_space_has_velocities_of_its_own_name():
    scene = Scene("stone", gravity=[0, 0, "-g"])
    scene.parameter("g", 9.81)
    scene.edge("b", "rigid_body", "ground", "A", mass=2, initial={"x": 1, "y": 1, "z": 1})
    lines = lines_of(steps(scene, "b.vz", ["b"]))
    assert any("a^b = vx_dot î + vy_dot ĵ + vz_dot k̂" in line for line in lines)
    assert "G1, z: 2*vz_dot + 2*g = 0" in lines
    assert "G2, z: 2*vz_dot_vz(0) = 0" in lines
