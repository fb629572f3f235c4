"""Models against d'Alembert's principle by another route, and that route against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from bare_models import compiled
from constrained_scenes import CONSTRAINED
from fast_and_slow import cases
from newton_euler import NewtonEuler
from random_scenes import CLOSING, random_loop, random_mechanism, random_scene, restarted
from scene_kinematics import COORDINATES, turn

import cotree
from cotree import Scene
from cotree.components import COMPONENTS
from cotree.scene.graphs import joint_branches

every_joint = pytest.mark.skipif("spherical" not in COMPONENTS, reason="needs spherical joints")
every_constraint = pytest.mark.skipif(
    not {"spherical", "distance", "knife_edge", "rolling_disc", "gear"} <= set(COMPONENTS),
    reason="needs joints and constraints of every type",
)

# Residuals are sums of a few hundred products, each rounded to 1e-16 of terms no larger than the
# scale; accelerations carry the same roundings times a mass matrix' few decades of condition.
RELATIVE = 1e-11


def check_model(scene, tree=None, state=None, t=0.3):
    """Residuals of a model's rates at a state, or at the closed state near a random one."""
    model = compiled(scene, tree)
    oracle = NewtonEuler(scene, states=model.states)
    assert model.states == oracle.states
    if state is None:
        size = np.random.default_rng(7).uniform(-0.3, 0.3, len(model.states))
        state = oracle.consistent(oracle.start + size, t)
    rates = model.rhs(t, state)
    assert oracle.kinematic(state, rates).relative <= RELATIVE
    assert oracle.virtual_work(t, state, rates).relative <= RELATIVE
    assert oracle.closing(t, state, rates).relative <= RELATIVE
    outputs, ours = model.output_values(t, state), oracle.outputs(t, state)
    assert np.allclose(outputs, ours, rtol=RELATIVE, atol=RELATIVE)
    return model, oracle, state, rates


def joints_and_arms(scene):
    return [n for n, e in scene.edges.items() if e.component.name in COORDINATES and n != "tie"]


def bodies_and_arms(scene):
    kinds = ("rigid_body", "arm", "weld")
    return [n for n, e in scene.edges.items() if e.component.name in kinds]


def loop_or_skip(seed, **kinds):
    tie = [*CLOSING][seed % len(CLOSING)]
    if not kinds and tie not in COMPONENTS:
        pytest.skip(f"needs edges of type {tie}")
    return random_loop(seed, **kinds)


# ---- models against the principle


@pytest.mark.sampled(2)
@pytest.mark.compiler
@pytest.mark.parametrize("seed", range(6))
def test_random_trees_obey_the_principle(seed):
    scene = random_scene(seed, is_planar=seed % 2 == 0)
    n_states = 2 * len(NewtonEuler(scene, joints_and_arms(scene)).rates)
    check_model(scene, state=np.random.default_rng(seed).uniform(-1.0, 1.0, n_states))


@pytest.mark.sampled(1)
@every_joint
@pytest.mark.compiler
@pytest.mark.parametrize("seed", range(10))
def test_trees_of_every_joint_obey_the_principle(seed):
    scene = random_mechanism(seed)
    tree = joints_and_arms(scene)
    start = NewtonEuler(scene, tree).start
    model, *_ = check_model(scene, tree, start)
    # Initial values are evaluated the same way twice, quaternions normalised once more at most.
    assert np.allclose(model.initial_state, start, rtol=1e-15, atol=1e-15)


@every_joint
@pytest.mark.compiler
@pytest.mark.parametrize("seed", [4, 7])
def test_the_length_of_a_quaternion_is_of_no_account(seed):
    scene = random_mechanism(seed, has_joint_laws=False)
    oracle = NewtonEuler(scene, joints_and_arms(scene))
    model, n = compiled(scene, oracle.branches), len(oracle.coordinates)
    longer = oracle.start
    for i, name in enumerate(model.states[:n]):
        if name.rpartition(".")[2] in ("q0", "q1", "q2", "q3"):
            longer[i] *= 1.25
    ours = model.rhs(0.3, oracle.start)[n:]
    # Rotations differ by a rounding, which the mass matrix' condition enlarges.
    assert np.allclose(model.rhs(0.3, longer)[n:], ours, rtol=1e-11, atol=1e-11)


@pytest.mark.sampled(1)
@every_joint
@pytest.mark.compiler
@pytest.mark.parametrize("seed", range(9))
def test_spatial_loops_obey_the_principle(seed):
    scene, tree = loop_or_skip(seed)
    if scene.edges["tie"].component.name == "screw":
        # Its translation needs the angle beyond half a turn, which a chord in space has not.
        with pytest.raises(cotree.FormulationError, match="joint 'tie'"):
            scene.compile(tree=tree)
        return
    start = NewtonEuler(scene, tree).start
    model, *_ = check_model(scene, tree, start)
    # The scene's start is closed to round-off, so that nothing is left to correct.
    assert np.allclose(model.initial_state, start, rtol=1e-12, atol=1e-12)


@pytest.mark.sampled(1)
@every_joint
@pytest.mark.compiler
@pytest.mark.parametrize("seed", range(3))
def test_planar_loops_obey_the_principle(seed):
    scene, tree = random_loop(seed, is_planar=True)
    check_model(scene, tree, NewtonEuler(scene, tree).start)


@pytest.mark.slow
@every_joint
@pytest.mark.compiler
@pytest.mark.parametrize("seed", cases([0, 27], [2, 3]))  # 27: its first joint is outside the loop
def test_loops_with_trees_of_least_weight_obey_the_principle(seed):
    scene, tree = random_loop(seed, has_joint_laws=False)
    taken = list(joint_branches(scene).branches)
    chosen = NewtonEuler(scene, taken)
    own = NewtonEuler(scene, tree)
    start = chosen.state_like(own, own.start)
    check_model(restarted(scene, chosen, start), taken, start)


@pytest.mark.slow
@every_joint
@pytest.mark.compiler
@pytest.mark.parametrize("seed", cases([0, 2], [3, 4]))
def test_absolute_coordinates_obey_the_principle(seed):
    scene = random_mechanism(seed, n_bodies=3, has_joint_laws=False)
    own = NewtonEuler(scene, joints_and_arms(scene))
    absolute = NewtonEuler(scene, bodies_and_arms(scene))
    start = absolute.state_like(own, own.start)
    check_model(restarted(scene, absolute, start), absolute.branches, start)


@pytest.mark.sampled(2)
@every_constraint
@pytest.mark.compiler
@pytest.mark.parametrize("name", CONSTRAINED)
def test_constrained_motions_obey_the_principle(name):
    case = CONSTRAINED[name]()
    oracle = NewtonEuler(case.scene, case.branches)
    check_model(case.scene, case.branches, state_of(oracle, case), case.t)


# ---- the oracle against closed forms


def state_of(oracle, case):
    return np.array([case.state.get(name, 0.0) for name in oracle.states])


@every_constraint
@pytest.mark.parametrize("name", CONSTRAINED)
def test_constrained_motions_are_those_of_the_closed_form(name):
    case = CONSTRAINED[name]()
    oracle = NewtonEuler(case.scene, case.branches)
    state = state_of(oracle, case)
    # The closed form's state is closed: lengths and rates of order one, a few roundings each.
    q, _ = oracle.split(state)
    assert np.abs(oracle.gaps(q, oracle.places(q), case.t)).max(initial=0.0) <= 1e-14
    assert np.abs(oracle.held_rates(state, case.t)).max() <= 1e-13
    rates = oracle.rhs(case.t, state)
    found = np.array([rates[oracle.states.index(name)] for name in case.accelerations])
    # Roundings over the square of the circle's radius, about a tenth: 1e-14 of terms of ten.
    assert np.allclose(found, list(case.accelerations.values()), rtol=0, atol=1e-12)


def test_wrong_accelerations_show():
    scene = random_scene(1)
    oracle = NewtonEuler(scene, joints_and_arms(scene))
    state = np.random.default_rng(1).uniform(-1.0, 1.0, len(oracle.states))
    rates = oracle.rhs(0.3, state)
    assert oracle.virtual_work(0.3, state, rates).relative <= 1e-13
    for i in range(len(oracle.coordinates), len(state)):
        wrong = rates.copy()
        wrong[i] += 1e-6 * np.abs(rates).max()
        # An eighth of the bodies' inertia at least answers to each acceleration.
        assert oracle.virtual_work(0.3, state, wrong).relative > 1e-8


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_on_the_circle_are_those_of_the_complex_step(seed):
    scene = random_mechanism(seed) if "spherical" in COMPONENTS else random_scene(seed)
    oracle = NewtonEuler(scene, joints_and_arms(scene))
    q, u = oracle.split(oracle.start)
    slopes = oracle._slopes(q)
    turns, origins = oracle.velocities(oracle.start)
    # Positions reach ten; the circle's radius of some hundredths divides their roundings.
    assert np.allclose(turns, np.tensordot(u, slopes.turns, 1), rtol=0, atol=1e-12)
    assert np.allclose(origins, np.tensordot(u, slopes.origins, 1), rtol=0, atol=1e-12)


def energy_rate(oracle, state, rates):
    """By central differences of fourth order."""
    h = 1e-4
    ahead = [sum(oracle.energy(0.3, state + k * h * rates)) for k in (-2, -1, 1, 2)]
    return float(np.dot([1, -8, 8, -1], ahead) / (12 * h)), max(map(abs, ahead))


def check_energy(oracle, state):
    rates = oracle.rhs(0.3, state)
    rate, size = energy_rate(oracle, state, rates)
    # Differences divide roundings of 1e-16 of the energy by 1e-4; their own error is of 1e-16
    # times fifth derivatives, which reach 1e5.
    assert rate == pytest.approx(oracle.power(0.3, state), abs=1e-9 * max(1.0, size))


@pytest.mark.parametrize("seed", range(4))
def test_energy_changes_by_the_power_of_drives_and_dampers(seed):
    scene = random_scene(seed)
    oracle = NewtonEuler(scene, joints_and_arms(scene))
    check_energy(oracle, oracle.start)


@every_joint
@pytest.mark.parametrize("seed", range(10))
def test_energy_of_every_joint_changes_by_the_power_of_drives_and_dampers(seed):
    scene = random_mechanism(seed)
    oracle = NewtonEuler(scene, joints_and_arms(scene))
    check_energy(oracle, oracle.start)


@pytest.mark.sampled(2)
@every_joint
@pytest.mark.parametrize("seed", range(9))
def test_energy_of_loops_changes_by_the_power_of_drives_and_dampers(seed):
    scene, tree = loop_or_skip(seed)
    oracle = NewtonEuler(scene, tree)
    check_energy(oracle, oracle.start)


@pytest.mark.sampled(3)
@every_joint
@pytest.mark.parametrize("seed", range(10))
def test_bodies_as_branches_move_as_joints_move_them(seed):
    """All joints are then chords: their gaps forbid what their coordinates do not allow."""
    scene = random_mechanism(seed, n_bodies=3, has_joint_laws=False)
    own = NewtonEuler(scene, joints_and_arms(scene))
    absolute = NewtonEuler(scene, bodies_and_arms(scene))
    check_same_motion(own, absolute, own.start)


@pytest.mark.sampled(2)
@every_joint
@pytest.mark.parametrize("seed", [0, 2, 3, 4, 5, 6])
def test_a_loop_moves_the_same_wherever_its_tree_is_cut(seed):
    scene, tree = loop_or_skip(seed)
    own, start = NewtonEuler(scene, tree), NewtonEuler(scene, tree).start
    joints = [name for name in tree if name.startswith("j")]
    other = NewtonEuler(scene, [name for name in tree if name != joints[-1]] + ["tie"])
    check_same_motion(own, other, start)


def check_same_motion(own, other, start):
    state = other.state_like(own, start)
    # The reactions of chords may leave a few decades of condition in the accelerations.
    for theirs, ours in zip(accelerated(other, state), accelerated(own, start), strict=True):
        assert np.allclose(theirs, ours, rtol=0, atol=1e-9 * max(1.0, np.abs(ours).max()))


def accelerated(oracle, state):
    """Second derivatives of all places, which belong to no tree."""
    return oracle.accelerations(state, oracle.rhs(0.3, state))


@every_joint
def test_a_free_body_obeys_eulers_equations():
    scene = Scene("free", gravity=[0.3, -9.81, 0.2])
    scene.edge("j", "free", "ground", "C")
    scene.edge("m", "rigid_body", "ground", "C", mass=1.7, inertia=[0.4, 0.9, 1.1])
    oracle = NewtonEuler(scene, ["j"])
    w, inertia = np.array([0.7, -1.3, 0.4]), np.array([0.4, 0.9, 1.1])
    state = np.concatenate([[0.1, 0.2, 0.3, 0.1, 0.7, -0.5, 0.2], [1.0, 2.0, 3.0], w])
    rates = oracle.rhs(0.0, state)
    # Roundings of places of order one, over the square of the circle's radius of an eighth.
    assert np.allclose(rates[7:10], [0.3, -9.81, 0.2], rtol=0, atol=1e-13)
    assert np.allclose(rates[10:], np.cross(inertia * w, w) / inertia, rtol=0, atol=1e-13)


@every_joint
def test_a_heavy_top_precesses_steadily():
    """At I3 w3 W - I1 W^2 cos(nutation) = m g l (Goldstein, section 5.7)."""
    across, along, mass, length, g = 0.05, 0.3, 2.0, 0.25, 9.81
    scene = Scene("top", gravity=[0, 0, -g])
    scene.edge("j", "spherical", "ground", "B")
    scene.edge("c", "arm", "B", "C", vector=[0, 0, length])
    scene.edge("m", "rigid_body", "ground", "C", mass=mass, inertia=[across, across, along])
    oracle = NewtonEuler(scene, ["j", "c"])
    precession, nutation, spin_angle = 1.9, 0.6, 0.8
    about_pivot = across + mass * length**2
    w3 = (mass * g * length / precession + about_pivot * precession * np.cos(nutation)) / along
    sine, cosine = np.sin(nutation) * np.sin(spin_angle), np.sin(nutation) * np.cos(spin_angle)
    spin = w3 - precession * np.cos(nutation)
    # R = Rz(0.4) Rx(nutation) Rz(spin_angle): half angles as quaternions
    half, sides = nutation / 2, np.array([0.4 + spin_angle, 0.4 - spin_angle]) / 2
    q = np.array(
        [
            np.cos(half) * np.cos(sides[0]),
            np.sin(half) * np.cos(sides[1]),
            np.sin(half) * np.sin(sides[1]),
            np.cos(half) * np.sin(sides[0]),
        ]
    )
    expected = turn([0, 0, 1], 0.4) @ turn([1, 0, 0], nutation) @ turn([0, 0, 1], spin_angle)
    assert np.allclose(oracle.places(q).turns[1], expected, rtol=0, atol=1e-15)
    rates = oracle.rhs(0.0, np.array([*q, precession * sine, precession * cosine, w3]))
    # A few roundings of terms of order thirty.
    assert np.allclose(rates[4:6], precession * spin * np.array([cosine, -sine]), atol=1e-13)
    assert abs(rates[6]) <= 1e-13


@every_joint
def test_cardans_shafts_turn_unevenly():
    """tan(theta2) = tan(theta1) cos(bend); the second shaft is carried by a loop."""
    bend, first, second = 0.7, 0.3, 0.8
    along = [0.0, -np.sin(bend), np.cos(bend)]
    scene = Scene("cardan")
    scene.edge("j1", "revolute", "ground", "A", axis=[0, 0, 1])
    scene.edge(
        "cross", "universal", "A", "B", axis=[1, 0, 0], axis2=[0, np.cos(bend), np.sin(bend)]
    )
    scene.edge("j2", "revolute", "ground", "B", axis=along)
    scene.edge("m1", "rigid_body", "ground", "A", mass=1.0, inertia=first)
    scene.edge("m2", "rigid_body", "ground", "B", mass=1.0, inertia=second)
    oracle = NewtonEuler(scene, ["j1", "cross"])
    start = oracle.consistent(np.array([0.9, 0.1, 0.1, 2.0, 0.0, 0.0]))
    theta, rate = start[0], start[3]
    uneven = 1 - (np.sin(bend) * np.sin(theta)) ** 2
    ratio = np.cos(bend) / uneven
    slope = np.cos(bend) * np.sin(bend) ** 2 * np.sin(2 * theta) / uneven**2
    other = NewtonEuler(scene, ["j1", "j2"]).state_like(oracle, start)
    # Ten roundings of Newton's method.
    assert np.tan(other[1]) == pytest.approx(np.tan(theta) * np.cos(bend), abs=1e-13)
    assert other[3] == pytest.approx(ratio * rate, abs=1e-13)
    acceleration = -second * ratio * slope * rate**2 / (first + second * ratio**2)
    for tree, state in ((["j1", "cross"], start), (["j1", "j2"], other)):
        found = NewtonEuler(scene, tree).rhs(0.0, state)[len(state) // 2]
        assert found == pytest.approx(acceleration, rel=1e-12)


@every_joint
def test_a_nut_falls_along_its_screw():
    scene = Scene("nut", gravity=[0, 0, -9.81])
    scene.edge("j", "screw", "ground", "C", axis=[0, 0, 2], pitch=0.3, damping=0.2)
    scene.edge("m", "rigid_body", "ground", "C", mass=1.7, inertia=[5.0, 6.0, 0.4])
    falling = (-1.7 * 9.81 * 0.3 - 0.2 * 1.5) / (0.4 + 1.7 * 0.3**2)
    found = NewtonEuler(scene, ["j"]).rhs(0.0, np.array([0.7, 1.5]))
    assert np.allclose(found, [1.5, falling], rtol=1e-14)


@every_joint
def test_a_pendulum_in_absolute_coordinates():
    """With the hinge as a chord that holds a spring."""
    mass, length, inertia, g, stiffness = 1.3, 0.8, 0.2, 9.81, 2.5
    scene = Scene("pendulum", gravity=[0, -g, 0])
    scene.edge("hinge", "revolute", "ground", "A", axis=[0, 0, 1], stiffness=stiffness)
    scene.edge("rod", "arm", "A", "B", vector=[0, -length, 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass=mass, inertia=inertia)
    theta, rate = 0.9, -1.1
    swing = -(mass * g * length * np.sin(theta) + stiffness * theta)
    swing /= inertia + mass * length**2
    state = [length * np.sin(theta), -length * np.cos(theta), theta]
    state += [length * np.cos(theta) * rate, length * np.sin(theta) * rate, rate]
    names = [f"bob.{name}" for name in ("x", "y", "theta", "x_dot", "y_dot", "theta_dot")]
    oracle = NewtonEuler(scene, states=names)
    assert oracle.states == tuple(names)
    found = oracle.rhs(0.0, np.array(state))
    assert np.allclose(found[:3], state[3:], rtol=0, atol=1e-15)
    # A dozen roundings of terms of order ten.
    assert found[5] == pytest.approx(swing, abs=1e-13)
