"""Robots against Pinocchio itself: forward dynamics, its derivatives, joints that mimic."""

from __future__ import annotations

import numpy as np
import pytest
from robot_files import (
    INERTIAL,
    array_of,
    follow,
    inertia_of,
    installed_file,
    read,
    sensitivities_to,
)

pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install cotree[robots]")

from pinocchio_states import Peer, inertial_columns

ROBOTS = {
    "ur5": ("ur_description/urdf/ur5_robot.urdf", "fixed", "forearm_link"),
    "panda": ("panda_description/urdf/panda.urdf", "fixed", "panda_hand"),
    "kinova": ("kinova_description/robots/kinova.urdf", "fixed", "j2s6s200_link_2"),
    "allegro": ("allegro_hand_description/urdf/allegro_right_hand.urdf", "fixed", "link_2_0"),
    "solo12": ("solo_description/robots/solo12.urdf", "free", "base_link"),
    "anymal": ("anymal_b_simple_description/robots/anymal.urdf", "free", "base"),
    "talos": ("talos_data/robots/talos_reduced.urdf", "free", "torso_2_link"),
}
SLOW = ("allegro", "anymal", "talos")
# Their files give inertias that no body has; Pinocchio takes them too.
pytestmark = pytest.mark.filterwarnings("ignore:.*is that of no body:RuntimeWarning")

N_STATES = 100
# Of the largest component: rounding, times condition numbers of up to 1e5 of the mass matrix.
CLOSE, CLOSE_SLOPES = 1e-11, 1e-10

each_robot = pytest.mark.parametrize(
    "name", [pytest.param(n, marks=[pytest.mark.slow] * (n in SLOW)) for n in ROBOTS]
)


def compared(name, sensitivities=()):
    file, base, _ = ROBOTS[name]
    path = installed_file(file)
    scene = read(path, base)
    return scene.compile(sensitivities, tunable=[]), Peer(path, scene, base), scene


def states_of(peer, model, n, seed):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        state, inputs = peer.random(rng)
        yield state, inputs, array_of(model.states, state), array_of(model.inputs, inputs)


def rates_of(model, y, u):
    return dict(zip(model.states, model.rhs(0.0, y, u=u), strict=True))


def apart(found, expected):
    return np.max(np.abs(np.asarray(found) - expected)) / np.max(np.abs(expected))


@pytest.mark.compiler
@each_robot
def test_forward_dynamics(name):
    model, peer, _ = compared(name)
    for state, inputs, y, u in states_of(peer, model, N_STATES, seed=1):
        found, expected = rates_of(model, y, u), peer.forward(state, inputs)
        assert apart([found[key] for key in expected], list(expected.values())) < CLOSE


@pytest.mark.compiler
@each_robot
def test_jacobians(name):
    model, peer, _ = compared(name)
    for state, inputs, y, u in states_of(peer, model, 10, seed=2):
        jacobian, rates = model.jacobian(0.0, y, u=u), rates_of(model, y, u)
        found = peer.in_own_tangents(state, model, jacobian, rates)
        for mine, expected in zip(found, peer.derivatives(state, inputs), strict=True):
            assert apart(mine, expected) < CLOSE_SLOPES


@pytest.mark.compiler
@each_robot
def test_sensitivities_to_inertia(name):
    link = ROBOTS[name][2]
    model, peer, scene = compared(name, sensitivities_to(link))
    nothing = np.zeros((len(model.states), len(INERTIAL)))
    columns = inertial_columns(*inertia_of(scene, link))
    for state, inputs, y, u in states_of(peer, model, 10, seed=3):
        found = model.sensitivity_rhs(0.0, y, nothing, u=u)
        for column, expected in zip(
            found.T, peer.to_inertia(state, inputs, link, columns), strict=True
        ):
            rates = dict(zip(model.states, column, strict=True))
            ours = [rates[key] for key in expected]
            assert apart(ours, list(expected.values())) < CLOSE_SLOPES


def check_mimic(path, n_states):
    scene = read(path, mimic=True)
    model, peer = scene.compile(tunable=[]), Peer(path, scene, mimic=True)
    for state, inputs, _, u in states_of(peer, model, n_states, seed=4):
        y = array_of(model.states, follow(scene, state))
        found, expected = rates_of(model, y, u), peer.forward(state, inputs)
        assert apart([found[key] for key in expected], list(expected.values())) < CLOSE
        for edge in scene.edges.values():
            if edge.component.name == "gear":
                one, other = (edge.fields[f"coordinate{i}"].text for i in (1, 2))
                ratio = edge.fields["ratio"].number
                expected_rate = ratio * found[f"{other}_dot"]
                assert found[f"{one}_dot"] == pytest.approx(expected_rate, rel=1e-11, abs=1e-11)
    return peer


@pytest.mark.compiler
def test_the_fingers_of_panda_mimic():
    peer = check_mimic(installed_file(ROBOTS["panda"][0]), N_STATES)
    assert peer.model.nv == 8


LINK = (
    '<link name="{name}"><inertial><origin xyz="{xyz}" rpy="0.3 -0.2 0.5"/><mass value="{mass}"/>'
    '<inertia ixx="0.03" ixy="0.001" ixz="-0.002" iyy="0.02" iyz="0.003" izz="0.025"/>'
    "</inertial></link>"
)


def written(tmp_path, joints):
    """Write a robot of as many links as joints, in a row, with inertial frames that are turned."""
    links = [
        LINK.format(name=f"l{i}", xyz=f"0.1 {0.05 * i} -0.2", mass=1.0 + 0.3 * i)
        for i in range(len(joints) + 1)
    ]
    rows = [
        f'<joint name="j{i}" type="{kind}"><parent link="l{i}"/><child link="l{i + 1}"/>'
        f'<origin xyz="0.2 -0.1 0.{i + 1}" rpy="0.4 {0.3 * i} -0.7"/><axis xyz="{axis}"/>{more}'
        '<limit effort="1" velocity="1" lower="-1" upper="1"/></joint>'
        for i, (kind, axis, more) in enumerate(joints)
    ]
    path = tmp_path / "robot.urdf"
    path.write_text(f'<robot name="r">{"".join(links + rows)}</robot>')
    return path


@pytest.mark.compiler
def test_mimics_of_mimics_with_offsets(tmp_path):
    joints = [
        ("revolute", "0 0 1", ""),
        ("continuous", "0 1 1", ""),
        ("prismatic", "1 0 0", '<mimic joint="j0" multiplier="-0.4" offset="0.3"/>'),
        ("revolute", "1 2 -1", ""),
        ("revolute", "0 1 0", '<mimic joint="j3" multiplier="2.5" offset="-1"/>'),
    ]
    check_mimic(written(tmp_path, joints), 20)


@pytest.mark.compiler
@pytest.mark.parametrize("base", ["fixed", "free"])
def test_joints_of_every_type(tmp_path, base):
    joints = [
        ("planar", "0 0 1", ""),
        ("revolute", "1 2 2", ""),
        ("floating", "1 0 0", ""),
        ("prismatic", "0 -1 0.5", ""),
        ("fixed", "1 0 0", ""),
        ("continuous", "0 0 -1", ""),
    ]
    path = written(tmp_path, joints)
    scene = read(path, base)
    model, peer = scene.compile(tunable=[]), Peer(path, scene, base)
    for state, inputs, y, u in states_of(peer, model, 20, seed=5):
        found, expected = rates_of(model, y, u), peer.forward(state, inputs)
        assert apart([found[key] for key in expected], list(expected.values())) < CLOSE
