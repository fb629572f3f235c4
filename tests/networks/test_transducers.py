"""Networks that act on multibody systems, against hand-written equations and equivalent scenes."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cotree import Scene
from cotree.errors import SceneError

G = 9.81

# Integration at this tolerance leaves errors of about 1e-10 in scenes of this length.
TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def pendulum(scene: Scene) -> None:
    """A rod on a hinge with a little damping."""
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], damping=0.1)
    scene.edge("r", "arm", "A", "B", vector=[0.3, 0, 0])
    scene.edge("m", "rigid_body", "ground", "B", mass=0.5, inertia="J")


def motor_on_a_joint() -> Scene:
    scene = Scene("motor", gravity=[0, -G, 0])
    scene.parameter("K", 0.3)
    scene.parameter("J", 0.02)
    scene.edge("V", "voltage_source", "a", "ground", voltage="10 + sin(t)")
    scene.edge(
        "M",
        "dc_motor",
        electrical=["a", "ground"],
        joint="h",
        resistance=1.0,
        inductance=0.05,
        constant="K",
    )
    pendulum(scene)
    return scene


def by_hand(t: float, y: np.ndarray, K: float = 0.3, J: float = 0.02) -> list[float]:
    angle, speed, current = y
    about = J + 0.5 * 0.3**2
    torque = K * current - 0.1 * speed - 0.5 * G * 0.3 * np.cos(angle)
    return [speed, torque / about, (10 + np.sin(t) - current - K * speed) / 0.05]


def integrated(**parameters: float) -> np.ndarray:
    settings = {"method": "DOP853", "rtol": 1e-12, "atol": 1e-14}
    return solve_ivp(lambda t, y: by_hand(t, y, **parameters), (0, 1), [0, 0, 0], **settings).y[
        :, -1
    ]


def test_a_motor_on_a_joint_moves_as_its_equations_say():
    model = motor_on_a_joint().compile(["K", "J"])
    assert model.states == ("h.theta", "h.theta_dot", "M.i")
    state = np.array([0.3, 1.2, 4.0])
    assert model.rhs(0.4, state) == pytest.approx(by_hand(0.4, state), rel=1e-14)
    result = model.simulate((0, 1), **TIGHT)
    assert result.y[:, -1] == pytest.approx(integrated(), rel=1e-9)
    for name, value in (("K", 0.3), ("J", 0.02)):
        # Fourth-order differences with this step lose about 1e-8 of the derivative.
        h = 1e-3 * value
        around = [integrated(**{name: value + k * h}) for k in (-2, -1, 1, 2)]
        slope = (around[0] - 8 * around[1] + 8 * around[2] - around[3]) / (12 * h)
        found = [result.sensitivity(state, name)[-1] for state in model.states]
        assert found == pytest.approx(slope, rel=1e-6)


def test_a_motor_without_inductance_has_no_current_to_integrate():
    scene = Scene("motor", gravity=[0, -G, 0])
    scene.parameter("J", 0.02)
    scene.edge("V", "voltage_source", "a", "ground", voltage=10)
    scene.edge("R", "resistor", "a", "b", resistance=0.5)
    scene.edge("M", "dc_motor", electrical=["b", "ground"], joint="h", resistance=1.0, constant=0.3)
    pendulum(scene)
    scene.output("i", "M.i")
    model = scene.compile()
    assert model.states == ("h.theta", "h.theta_dot")
    state = np.array([0.3, 1.2])
    current = (10 - 0.3 * 1.2) / 1.5
    torque = 0.3 * current - 0.1 * 1.2 - 0.5 * G * 0.3 * np.cos(0.3)
    assert model.rhs(0.0, state) == pytest.approx([1.2, torque / (0.02 + 0.045)], rel=1e-14)
    assert model.output_values(0.0, state)[0] == pytest.approx(current, rel=1e-14)


def four_bar() -> Scene:
    """A linkage driven at one joint, with a resistance that follows its crank."""
    scene = Scene("driven-linkage", gravity=[0, -G, 0])
    for name, value in (("L", 2.0), ("R", 1.5), ("K", 0.4)):
        scene.parameter(name, value)
    hinge = {"axis": [0, 0, 1]}
    scene.edge("j1", "revolute", "ground", "A", **hinge, initial={"theta": 1.2})
    scene.edge("a", "arm", "A", "B", vector=[1, 0, 0])
    scene.edge("j2", "revolute", "B", "C", **hinge)
    scene.edge("b", "arm", "C", "E", vector=["L", 0, 0])
    scene.edge("base", "arm", "ground", "D", vector=[2, 0, 0])
    scene.edge("j3", "revolute", "D", "F", **hinge)
    scene.edge("c", "arm", "F", "H", vector=[1.1, 0, 0])
    scene.edge("j4", "revolute", "E", "H", **hinge)
    for name, node in (("m1", "A"), ("m2", "C"), ("m3", "F")):
        scene.edge(name, "rigid_body", "ground", node, mass=1.0, inertia=0.1)
    scene.edge("V", "voltage_source", "p", "ground", voltage=20)
    scene.edge("Rs", "resistor", "p", "q", resistance="R*(1 + 0.2*B.x)")
    scene.edge(
        "M",
        "dc_motor",
        electrical=["q", "ground"],
        joint="j4",
        resistance=0.3,
        inductance=0.02,
        constant="K",
    )
    scene.output("tau", "M.shaft.tau")
    return scene


def test_a_motor_acts_on_a_chord_as_on_a_branch():
    """The joint that the motor drives closes the loop, or belongs to the tree."""
    runs = []
    for joints in (["j1", "j2", "j3"], ["j1", "j2", "j4"]):
        tree = [*joints, "a", "b", "c", "base"]
        model = four_bar().compile(["L", "R", "K"], tree=tree)
        runs.append(model.simulate((0, 0.5), **TIGHT))
    for name in ("j1.theta", "M.i", "tau"):
        assert runs[0][name][-1] == pytest.approx(runs[1][name][-1], rel=1e-9)
        for parameter in ("L", "R", "K"):
            first, second = (run.sensitivity(name, parameter)[-1] for run in runs)
            assert first == pytest.approx(second, rel=1e-8)


def geared(rotor: bool) -> Scene:
    """A rod driven through a gear of 20, its rotor in the network or as a body of like effect."""
    scene = Scene("geared", gravity=[0, -G, 0])
    scene.parameter("J", 0.02)
    scene.parameter("Jr", 1e-3)
    pendulum(scene)
    if rotor:
        scene.edge("rotor", "rotational_inertia", "ground", "s", inertia="Jr")
        scene.edge("drag", "rotational_damper", "ground", "s", damping=1e-4)
        scene.edge("push", "torque_source", "ground", "s", torque="0.05*sin(3*t)")
        scene.edge("gear", "ideal_gear", input=["ground", "s"], joint="h", ratio=20)
    else:
        scene.edge("rotor", "rigid_body", "ground", "A", mass=0, inertia="400*Jr")
        pull = "20*0.05*sin(3*t) - 400*1e-4*h.theta_dot"
        scene.edge("push", "torque", "ground", "A", torque=[0, 0, pull])
    return scene


def test_a_rotor_geared_to_a_joint_adds_to_its_inertia():
    """The rotor has no state of its own: its share of the mass matrix is ratio^2 times Jr."""
    runs = []
    for rotor in (True, False):
        model = geared(rotor).compile(["Jr", "J"])
        assert model.states == ("h.theta", "h.theta_dot")
        runs.append(model.simulate((0, 2), **TIGHT))
    assert runs[0].y[:, -1] == pytest.approx(runs[1].y[:, -1], rel=1e-10)
    for parameter in ("Jr", "J"):
        first, second = (run.sensitivity("h.theta", parameter)[-1] for run in runs)
        assert first == pytest.approx(second, rel=1e-9)


def test_a_cylinder_pushes_along_the_line_of_its_nodes():
    """Volume flows in as the line grows, and the force on the arm is pressure times area."""
    scene = Scene("crane", gravity=[0, -G, 0])
    scene.parameter("A", 2e-3)
    scene.edge("h", "revolute", "ground", "P", axis=[0, 0, 1], initial={"theta": 0.5})
    scene.edge("r", "arm", "P", "T", vector=[2, 0, 0])
    scene.edge("k", "arm", "P", "K", vector=[0.6, 0, 0])
    scene.edge("b", "arm", "ground", "F", vector=[0, -0.8, 0])
    scene.edge("m", "rigid_body", "ground", "T", mass=50, inertia=5)
    scene.edge("line", "inertance", "s", "c", inertance=1e7)
    scene.edge("pump", "pressure_source", "s", "ground", pressure=1.5e6)
    scene.edge("acc", "accumulator", "c", "ground", capacity=1e-11)
    scene.edge("cyl", "hydraulic_cylinder", chamber=["c", "ground"], line=["F", "K"], area="A")
    scene.output("q", "cyl.q")
    scene.output("p", "c.p")
    model = scene.compile()
    assert model.states == ("h.theta", "h.theta_dot", "line.q", "acc.p")
    angle, speed, flow, pressure = state = np.array([0.5, 0.3, 1e-4, 8e5])
    tip = 0.6 * np.array([np.cos(angle), np.sin(angle)])
    reach = tip - [0, -0.8]
    direction = reach / np.linalg.norm(reach)
    velocity = 0.6 * speed * np.array([-np.sin(angle), np.cos(angle)])
    growth = direction @ velocity
    force = pressure * 2e-3 * direction
    torque = tip[0] * force[1] - tip[1] * force[0] - 50 * G * 2 * np.cos(angle)
    expected = [
        speed,
        torque / (5 + 50 * 4),
        (1.5e6 - pressure) / 1e7,
        (flow - 2e-3 * growth) / 1e-11,
    ]
    assert model.rhs(0.0, state) == pytest.approx(expected, rel=1e-13)


def test_a_solenoid_pulls_with_the_slope_of_its_inductance():
    """Force and induced voltage come from one energy, so that power balances."""
    scene = Scene("valve")
    scene.edge("V", "voltage_source", "a", "ground", voltage=12)
    coil = {"resistance": 4.0, "inductance": 0.05, "gap": 1e-3, "leakage": 0.01}
    scene.edge("S", "solenoid", electrical=["a", "ground"], plunger=["ground", "x"], **coil)
    scene.edge("m", "translational_mass", "ground", "x", mass=0.02, initial={"s": 2e-3})
    scene.output("s", "S.s")
    model = scene.compile()
    names = dict(zip(model.states, range(len(model.states)), strict=True))
    state = np.zeros(len(names))
    state[names["S.i"]], state[names["m.v"]], state[names["m.s"]] = 1.5, -0.2, 1.5e-3
    inductance = 0.01 + 0.05 / (1 + 1.5)
    slope = -0.05 / (1e-3 * 2.5**2)
    rates = model.rhs(0.0, state)
    assert rates[names["m.v"]] == pytest.approx(0.5 * 1.5**2 * slope / 0.02, rel=1e-14)
    induced = slope * -0.2 * 1.5
    assert rates[names["S.i"]] == pytest.approx((12 - 6.0 - induced) / inductance, rel=1e-14)


def test_losses_heat_what_the_scene_says():
    """All that the source gives is stored in the capacitor or ends as heat."""
    scene = Scene("heater")
    scene.edge("V", "voltage_source", "a", "ground", voltage=10)
    scene.edge("R", "resistor", "a", "b", resistance="2*(1 + 0.004*H.T)", heat="N")
    scene.edge("C", "capacitor", "b", "ground", capacitance=0.5)
    scene.edge("H", "heat_capacitor", "N", "ground", capacity=3.0)
    model = scene.compile()
    result = model.simulate((0, 20), **TIGHT)
    voltage = result["C.v"][-1]
    given = 10 * 0.5 * voltage  # charge times voltage of the source
    assert 3.0 * result["H.T"][-1] == pytest.approx(given - 0.25 * voltage**2, rel=1e-9)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"joint": "k"}, "acts on the unknown joint 'k'"),
        ({"joint": "m"}, "acts on the unknown joint 'm'"),
        ({"joint": "s"}, "type 'prismatic' has no angle to act on: use a voice_coil"),
        ({"joint": "u"}, 'has 2 angles: name one, joint = "u.theta1" or joint = "u.theta2"'),
        ({"joint": "u.theta3"}, "is no angle of joint 'u'"),
        ({"line": ["A", "B"]}, "rotates, so that it cannot act along a line"),
        ({}, "shaft of edge 'M' needs two nodes"),
    ],
)
def test_what_a_motor_cannot_act_on_is_refused(wrong, message):
    scene = Scene("wrong")
    scene.parameter("J", 0.1)
    scene.edge("V", "voltage_source", "a", "ground", voltage=10)
    pendulum(scene)
    scene.edge("s", "prismatic", "B", "C", axis=[1, 0, 0])
    scene.edge("m2", "rigid_body", "ground", "C", mass=1.0, inertia=0.1)
    scene.edge("u", "universal", "C", "D", axis=[1, 0, 0], axis2=[0, 1, 0])
    scene.edge("m3", "rigid_body", "ground", "D", mass=1.0, inertia=[0.1, 0.1, 0.1])
    motor = {"electrical": ["a", "ground"], "resistance": 1.0, "constant": 0.1, **wrong}

    def build() -> None:
        scene.edge("M", "dc_motor", **motor)
        scene.compile()

    with pytest.raises(SceneError, match=message):
        build()


def test_a_component_without_losses_heats_nothing():
    scene = Scene("wrong")
    with pytest.raises(SceneError, match="type 'capacitor' dissipates no heat"):
        scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, heat="N")
