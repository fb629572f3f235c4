"""The steps of the formulation as text: the paper's two scenes, and every kind of component."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest

from cotree.errors import FormulationError, ParameterError
from cotree.export.steps import formulation_steps
from cotree.formulation.first_graph import form_first_graph
from cotree.graph import f_circuit, f_cutset
from cotree.scene.description import SceneDescription
from cotree.scene.graphs import choose_trees, joint_tree, linear_graphs
from cotree.scene.toml_file import load_scene

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

GOLDEN = "../tests/export/golden"


def steps(
    scene: str | SceneDescription, name: str | None, tree: Sequence[str] | None = None
) -> str:
    if isinstance(scene, str):
        scene = load_scene(scene, SceneDescription)
    graphs = linear_graphs(scene)
    trees = choose_trees(scene, graphs, tree)
    try:
        first = form_first_graph(scene, joint_tree(scene, trees))
    except FormulationError:
        first = None
    return formulation_steps(scene, graphs, trees, first, name)


def lines_of(text: str) -> list[str]:
    return [line.strip() for line in text.splitlines()]


@pytest.mark.parametrize(
    ("scene", "name", "tree", "file"),
    [
        ("spring-mass-damper", "k", None, "steps-spring-mass-damper.txt"),
        ("spring-mass-damper", "k", ["m"], "steps-spring-mass-damper-tree-m.txt"),
        ("slider-pendulum", "L", None, "steps-slider-pendulum.txt"),
    ],
)
def test_the_text_is_the_golden_one(
    golden: Callable[[str, str], None],
    scene: str,
    name: str,
    tree: Sequence[str] | None,
    file: str,
):
    golden(f"{GOLDEN}/{file}", steps(scene, name, tree))


def test_spring_mass_damper_goes_the_papers_way():
    lines = lines_of(steps("spring-mass-damper", "k"))
    for expected in (
        "translation  G1  through  F^m  F^k  F^c  F^F  F^s",
        "translation  G2  across   r_k^m  r_k^k  r_k^c  r_k^F  r_k^s",
        "F^m + F^k + F^c + F^F + F^s = 0",
        "F_k^m + F_k^k + F_k^c + F_k^F + F_k^s = 0",
        "r^k - r^s = 0",
        "k  spring      F^k = -k*(r^k·î - l0) î",
        "k  spring      F_k^k = -(r^k·î - l0) î - k*(r_k^k·î) î",
        "F  force       F_k^F = 0",
        "s  translation: motion {î}, reaction {ĵ, k̂}; rotation: motion {}, reaction {î, ĵ, k̂}",
        "G1, s: (-m a^m - k*(r^k·î - l0) î - c*(v^c·î) î + F0*sin(w*t) î)·î = 0",
        "G2, s: (-m a_k^m - (r^k·î - l0) î - k*(r_k^k·î) î - c*(v_k^c·î) î)·î = 0",
        "G1, s: (-m a^s - k*(r^s·î - l0) î - c*(v^s·î) î + F0*sin(w*t) î)·î = 0",
        "G2, s: (-m a_k^s - (r^s·î - l0) î - k*(r_k^s·î) î - c*(v_k^s·î) î)·î = 0",
        "G1, s: m*s_ddot + c*s_dot + k*(s - l0) - F0*sin(t*w) = 0",
        "G2, s: m*s_ddot_k + c*s_dot_k + k*s_k + s - l0 = 0",
    ):
        assert expected in lines


def test_tree_of_the_mass_has_the_papers_matrices():
    scene = load_scene("spring-mass-damper", SceneDescription)
    tree = choose_trees(scene, linear_graphs(scene), ["m"])["translation"]
    cutset, circuit = f_cutset(tree), f_circuit(tree)
    assert cutset.columns == circuit.columns == ("m", "k", "c", "F", "s")
    np.testing.assert_array_equal(cutset.matrix, [[1, 1, 1, 1, 1]])
    assert circuit.rows == ("k", "c", "F", "s")
    np.testing.assert_array_equal(
        circuit.matrix,
        [[-1, 1, 0, 0, 0], [-1, 0, 1, 0, 0], [-1, 0, 0, 1, 0], [-1, 0, 0, 0, 1]],
    )


def test_tree_of_the_mass_goes_to_the_end_in_its_absolute_coordinate():
    lines = lines_of(steps("spring-mass-damper", "k", ["m"]))
    assert lines.count("F^m + F^k + F^c + F^F + F^s = 0") == 1
    for chord in "kcFs":
        assert f"r^{chord} - r^m = 0" in lines
        assert f"r_k^{chord} - r_k^m = 0" in lines
    for expected in (
        "m  rigid_body  F^m = -m a^m, T^m = 0, r^m = x î, v^m = x_dot î, a^m = x_ddot î, R^m = 1,",
        "s  prismatic   F^s·î = 0, R^s = 1, r^s·ĵ = r^s·k̂ = ω^s = α^s = 0",
        "m  translation: motion {î}, reaction {ĵ, k̂}; rotation: motion {}, reaction {î, ĵ, k̂}",
        "G1, x: (-m a^m - k*(r^k·î - l0) î - c*(v^c·î) î + F0*sin(w*t) î)·î = 0",
        "G2, x: (-m a_k^m - (r^k·î - l0) î - k*(r_k^k·î) î - c*(v_k^c·î) î)·î = 0",
        "G1, x: (-m a^m - k*(r^m·î - l0) î - c*(v^m·î) î + F0*sin(w*t) î)·î = 0",
        "G2, x: (-m a_k^m - (r^m·î - l0) î - k*(r_k^m·î) î - c*(v_k^m·î) î)·î = 0",
        "G1, x: m*x_ddot + c*x_dot + k*(x - l0) - F0*sin(t*w) = 0",
        "G2, x: m*x_ddot_k + c*x_dot_k + k*x_k + x - l0 = 0",
    ):
        assert expected in lines


def test_moments_follow_the_arms_in_any_tree():
    lines = lines_of(steps("slider-pendulum", "L"))
    assert "T^m6 + T^h2 + r^r4 × F^m6 = 0" in lines
    assert "T_L^m6 + T_L^h2 + r_L^r4 × F^m6 + r^r4 × F_L^m6 = 0" in lines
    bodies = lines_of(steps("slider-pendulum", "L", ["m5", "m6", "r3", "r4"]))
    # The hinge pulls at B, which the arm r4 leads away from.
    assert "T^m6 + T^h2 - r^r4 × F^h2 = 0" in bodies


def test_without_a_sensitivity_only_the_first_graph_is_shown():
    text = steps("spring-mass-damper", None)
    assert "G2" not in text
    assert "(4)" not in text
    assert "G1, s: m*s_ddot + c*s_dot + k*(s - l0) - F0*sin(t*w) = 0" in text


def test_the_initial_value_of_a_state_changes_no_field():
    lines = lines_of(steps("spring-mass-damper", "s.s"))
    assert "k  spring      F_s(0)^k = -k*(r_s(0)^k·î) î" in lines
    assert "G2, s: m*s_ddot_s(0) + c*s_dot_s(0) + k*s_s(0) = 0" in lines


def odd_scene() -> SceneDescription:
    """Use every component, turned axes, and a joint that points to the ground."""
    scene = SceneDescription("odd", gravity=[0, 0, "-g*cos(b)"])
    for name in ("g", "b", "m", "J", "k", "c", "l"):
        scene.parameter(name, 0.5)
    scene.input("u", "sin(t)")
    scene.edge("j", "revolute", "ground", "A", axis=[0, 1, 0], stiffness="k", free_angle="-b")
    scene.edge("arm", "arm", "A", "B", vector=["l", "-l/3", 0])
    scene.edge("w", "weld", "B", "W")
    scene.edge("p", "prismatic", "P", "W", axis=[1, "b", 0], damping="c*(1 + p.s**2)")
    scene.edge("body", "rigid_body", "ground", "P", mass="m + 1", inertia=["J", "b*J", 1])
    scene.edge("central", "spring", "A", "P", stiffness="k", free_length="l", damping="c")
    scene.edge("axial", "spring", "B", "P", axis=[0, 0, -1], stiffness="2*k", damping=1)
    scene.edge("motor", "torque", "A", "P", torque=["u", 0, "-c*j.theta_dot"])
    scene.edge("wind", "force", "ground", "P", force=["u", 0, 1])
    return scene


def test_components_of_every_kind_with_turning_axes():
    lines = lines_of(steps(odd_scene(), "b"))
    for expected in (
        # a reversed joint leaves its cut the other way
        "F^p - F^body - F^central - F^axial - F^wind = 0",
        "r^body - r^j - r^arm - r^w + r^p = 0",
        # fields as written; signs in front
        "arm      arm         r^arm = l î(A) - l/3 ĵ(A), v^arm = ω(A) × r^arm,",
        "body     rigid_body  F^body = -(m + 1) (a^body - γ),",
        "central  spring      F^central = -k*(|r^central| - l) e^central",
        "- c*(v^central·e^central) e^central",
        "γ = -g*cos(b) k̂, the acceleration of free fall",
        "u^p: unit vector along î(P) + b ĵ(P)",
        "J^body = diag(J, b*J, 1) in the axes of P",
        # derivatives along b: own, of turning axes, of coordinates in a field
        "γ_b = g*sin(b) k̂",
        "u_b^p: derivative of the unit vector u^p",
        "J_b^body = diag(0, J, 0) in the axes of P, plus φ_b(P) × J^body - J^body × φ_b(P)",
        "e_b^central = (r_b^central - (r_b^central·e^central) e^central)/|r^central|",
        "motor    torque      T_b^motor = u (φ_b(A) × î(A)) - c*j.theta_dot_b k̂(A)",
        "wind     force       F_b^wind = 0",
    ):
        assert expected in lines


def test_an_unknown_sensitivity_is_refused_with_the_nearest_name():
    with pytest.raises(ParameterError, match="'kk' is neither a tunable parameter nor a state"):
        steps("spring-mass-damper", "kk")
    with pytest.raises(ParameterError, match="neither"):
        steps("spring-mass-damper", "kk", ["m"])
