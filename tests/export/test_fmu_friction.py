"""FMUs of scenes with dry friction: modes are chosen at the start, at events, and between steps."""

from __future__ import annotations

from itertools import pairwise
from math import sqrt

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from fmu_importer import Unit, simulated
from fmu_slopes import close, compare

from cotree import Scene


def _oscillator():
    scene = Scene("oscillator")
    for name, value in {"m": 1.0, "k": 40.0, "F": 2.0, "x0": 0.47}.items():
        scene.parameter(name, value)
    scene.edge("M", "translational_mass", "ground", "A", mass="m")
    scene.edge("K", "translational_spring", "ground", "A", stiffness="k", initial={"s": "x0"})
    scene.edge("R", "translational_dry_friction", "ground", "A", force="F")
    scene.output("force", "R.f")
    return scene


def _clutches():
    """Build two shafts with a clutch that engages, and a brake on one of them that slips again."""
    scene = Scene("clutches")
    scene.parameter("N", 4.0)
    scene.input("pressed", 1.0)
    turning = {"w": 10.0}
    scene.edge("J1", "rotational_inertia", "ground", "a", inertia=1.0, initial=turning)
    scene.edge("J2", "rotational_inertia", "ground", "b", inertia=2.0)
    pressed = {"friction": 0.5, "radius": 1.0, "peak": 1.2}
    scene.edge("C", "clutch", "a", "b", normal_force="N*(t - 1)", **pressed)
    scene.edge("B", "brake", "ground", "b", normal_force="pressed", **pressed)
    scene.edge("T", "torque_source", "ground", "a", torque="3*sin(0.5*t)")
    scene.output("passed", "C.tau")
    return scene


def _pendulum():
    """Build a double pendulum with friction in both hinges."""
    scene = Scene("pendulum", gravity=[0, -9.81, 0])
    hinge = {"axis": [0, 0, 1]}
    scene.parameter("T1", 2.0)
    scene.edge("h1", "revolute", "ground", "A", initial={"theta": 1.0}, **hinge)
    scene.edge("a1", "arm", "A", "B", vector=[0, -1, 0])
    scene.edge("b1", "rigid_body", "ground", "B", mass=1.0)
    scene.edge("h2", "revolute", "B", "C", initial={"theta": 0.5}, **hinge)
    scene.edge("a2", "arm", "C", "D", vector=[0, -1, 0])
    scene.edge("b2", "rigid_body", "ground", "D", mass=1.0)
    scene.edge("R1", "rotational_dry_friction", joint="h1", torque="T1")
    scene.edge("R2", "rotational_dry_friction", joint="h2", torque=0.7, breakaway=0.9)
    return scene


def _ball():
    """Build a ball that bounces on a table which is shaken, and is thrown off it again."""
    scene = Scene("ball")
    scene.parameter("e", 0.6)
    scene.edge("M", "translational_mass", "ground", "A", mass=2.0)
    scene.edge("G", "force_source", "ground", "A", force=-2.0 * 9.81)
    scene.edge("S", "velocity_source", "ground", "T", velocity="0.06*t**2*sin(7*t)")
    limits = {"lower": 0.0, "restitution": "e", "rest_speed": 0.05}
    scene.edge("F", "translational_rigid_stop", "T", "A", initial={"s": 0.3}, **limits)
    scene.output("pushed", "F.f")
    return scene


def _box():
    """Build a box that falls on a floor, slides and comes to rest."""
    scene = Scene("box", gravity=[0, -9.81, 0])
    scene.parameter("mu", 0.3)
    initial = {"y": 0.4, "theta": 0.3, "x_dot": 1.0}
    own = {"mass": 1.2, "inertia": [0.013] * 3, "initial": initial}
    scene.edge("b", "rigid_body", "ground", "P", **own)
    surface = {"restitution": 0.2, "rest_speed": 0.02, "friction": "mu"}
    size = [0.3, 0.2, 0]
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 1, 0], size=size, **surface)
    scene.output("force", "c.force")
    return scene


def _rod():
    """Build a rod that slides and turns in a bush until friction at its surface stops both."""
    scene = Scene("rod", gravity=[0, 0, -9.81])
    scene.parameter("mu", 0.3)
    start = {"s_dot": 1.2, "theta_dot": 25.0}
    scene.edge("h", "cylindrical", "ground", "A", axis=[1, 0, 0], initial=start)
    scene.edge("b", "rigid_body", "ground", "A", mass=1.5, inertia=[0.0012] * 3)
    own = {"force": "mu*sqrt(h.fy**2 + h.fz**2)", "radius": 0.04}
    scene.edge("F", "translational_dry_friction", joint="h", **own)
    scene.output("torque", "F.around.tau")
    return scene


SCENES = {
    "rod": (_rod, 1.0),
    "box": (_box, 1.5),
    "ball": (_ball, 5.0),
    "oscillator": (_oscillator, 4.0),
    "clutches": (_clutches, 9.0),
    "pendulum": (_pendulum, 8.0),
}


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    made = {}

    def make(name, version=3):
        if name not in made:
            made[name] = SCENES[name][0]().compile()
        path = tmp_path_factory.getbasetemp() / f"{name}-{version}.fmu"
        if not path.exists():
            made[name].export_fmu(path, version)
        return made[name], path

    return make


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
@pytest.mark.parametrize(
    ("name", "version"),
    [
        ("oscillator", 3),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("ball", 3),
                ("rod", 3),
                ("box", 3),
                ("oscillator", 2),
                ("clutches", 3),
                ("pendulum", 3),
            )
        ),
    ],
)
def test_fmpy_simulates_what_the_model_does(exported, name, version, kind):
    model, path = exported(name, version)
    assert validate_fmu(str(path)) == []
    # The reference direction of a slip does not affect the motion, and may be another one.
    t_end = SCENES[name][1]
    names = [n for n in (*model.states, *model.outputs) if not n.endswith(".direction")]
    found = simulated(path, kind, t_end, t_end / 100, names, 1e-10)
    times = np.linspace(0.0, t_end, 101)
    wanted = model.simulate((0.0, t_end), times, rtol=1e-11, atol=1e-13)
    places = np.searchsorted(times, np.asarray(found["time"]) - 1e-9 * t_end)
    for one in names:
        values = np.asarray(wanted[one])[places]
        # CVode errs by thousands of its tolerance over many steps.
        scale = max(1.0, float(np.max(np.abs(values))))
        assert np.max(np.abs(np.asarray(found[one]) - values)) <= 1e-6 * scale, one


def test_modes_are_chosen_while_the_start_is_found(exported):
    _, path = exported("oscillator")
    with Unit(path) as unit:
        unit.begin()
        # The spring pulls with 18.8 N, friction holds 2 N.
        assert unit.get("R.mode", "force", "der(M.v)").tolist() == pytest.approx(
            [-1.0, -2.0, -16.8]
        )
    with Unit(path) as unit:
        unit.begin(values={"K.s": 0.04})
        assert unit.get("R.mode", "force").tolist() == pytest.approx([0.0, -1.6])
    with Unit(path) as unit:
        unit.begin(values={"M.v": 0.3})
        assert unit.get("R.mode")[0] == 1.0


@pytest.mark.slow
def test_a_one_way_clutch_that_turns_the_wrong_way_is_refused(tmp_path, capfd):
    scene = Scene("way")
    scene.edge("a", "rotational_inertia", "ground", "A", inertia=1.0, initial={"w": 1.0})
    scene.edge("b", "rotational_inertia", "ground", "B", inertia=1.0)
    scene.edge("C", "one_way_clutch", "A", "B", normal_force=0, friction=0.1, radius=1.0)
    with pytest.warns(RuntimeWarning, match="no expected results, since .*'C' turns at t = 0"):
        scene.compile().export_fmu(tmp_path / "x.fmu")
    with (
        Unit(tmp_path / "x.fmu") as unit,
        pytest.raises(Exception, match="failed with status 3"),
    ):
        unit.initialize()
    said = "event 'C stops' stops the initialization at t = 0: a one-way clutch turns in its locked"
    assert said in "".join(capfd.readouterr())


def test_steps_of_any_size_go_through_stops(exported):
    model, path = exported("oscillator")
    wanted = model.simulate((0.0, 2.0), rtol=1e-11, atol=1e-13).y[:, -1]
    with Unit(path, "CoSimulation") as unit:
        for n in (7, 400, 400):
            unit.initialize(1e-10, stop=2.0)
            for k in range(n):
                unit.step(2.0 * k / n, 2.0 / n)
            # Each step begins anew, so that there are some hundred integrations.
            np.testing.assert_allclose(unit.get(*model.states), wanted, atol=1e-8)
            unit.fmu.reset()


def test_an_importer_that_goes_a_little_too_far_finds_friction_sticking(exported):
    _, path = exported("oscillator")
    with Unit(path) as unit:
        unit.initialize(values={"K.s": 0.04, "M.v": 0.1})
        unit.update()
        unit.fmu.enterContinuousTimeMode()
        assert unit.get("R.mode")[0] == 1.0
        # Behind where it stops: the spring pulls with 1.6 N there, less than friction holds.
        states = {"R.mode": 1.0, "M.v": -1e-6, "K.s": 0.04}
        unit.go(0.03, np.array([states[name] for name in unit.states]))
        unit.fmu.enterEventMode()
        unit.update()
        assert unit.get("R.mode", "force", "der(M.v)").tolist() == pytest.approx([0.0, -1.6, 0.0])


def test_an_input_that_lets_a_brake_go(exported):
    model, path = exported("clutches")
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-10, stop=9.0, values={"N": 0.0, "pressed": 2.0})
        unit.step(0.0, 1.0)
        assert unit.get("B.mode", "C.mode").tolist() == [0.0, 2.0]
        unit.set(pressed=-1.0)
        unit.step(1.0, 1.0)
        assert unit.get("B.mode", "C.mode").tolist() == [2.0, 2.0]
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-10, stop=9.0)
        unit.step(0.0, 3.0)
        wanted = model.simulate((0.0, 3.0), rtol=1e-10).y[:, -1]
        np.testing.assert_allclose(unit.get(*model.states), wanted, atol=1e-8)


def test_sensitivities_go_through_stops(tmp_path):
    path = tmp_path / "x.fmu"
    _oscillator().compile(["F", "x0"]).export_fmu(path, kinds=["CoSimulation"])
    # Each half period takes 2 F/k from the amplitude, until F/k holds what is left.
    left, n, sign = 0.47, 0, 1
    while left > 2.0 / 40.0:
        left, n, sign = left - 2 * 2.0 / 40.0, n + 1, -sign
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-11, stop=4.0)
        for k in range(40):
            unit.step(0.1 * k, 0.1)
        assert unit.get("K.s")[0] == pytest.approx(sign * left, abs=1e-9)
        found = unit.get("d(K.s)/d(F)", "d(K.s)/d(x0)")
        np.testing.assert_allclose(found, [-sign * 2 * n / 40.0, sign], atol=1e-8)


def test_the_time_of_the_first_stop_is_that_of_half_a_period(exported):
    _, path = exported("oscillator")
    with Unit(path, "CoSimulation", earlyReturnAllowed=True) as unit:
        unit.initialize(1e-11, stop=4.0)
        reached = unit.step(0.0, 1.0)[3]
        assert reached == pytest.approx(np.pi / sqrt(40.0), abs=1e-9)


def _compare(unit, model, t):
    """Compare derivatives by states, parameters and inputs, at the present states."""
    y = unit.get(*model.states)
    compare(unit, model, t, y)
    if not model.inputs:
        return
    inputs, outputs = list(model.inputs), unit.list("output")
    linear = model.linearize(t, y, u=unit.get(*inputs))
    # Modes, whose rates are zero, are no states of a linear system.
    of_inputs = np.zeros((len(unit.rates), len(inputs)))
    of_inputs[[unit.states.index(name) for name in linear.states]] = linear.B
    close(unit.slopes(unit.rates, inputs), of_inputs)
    close(unit.slopes(outputs, inputs), linear.D)
    close(unit.adjoints(unit.rates, inputs), of_inputs)


@pytest.mark.parametrize(
    ("name", "times"),
    [
        # Modes of the oscillator: -1, 1, 0.
        ("oscillator", [0.2, 0.7, 3.0]),
        # Of clutch and brake: lifted and stuck, -1 and stuck, both sliding, stuck and sliding.
        pytest.param("clutches", [0.5, 1.1, 2.0, 6.0], marks=pytest.mark.slow),
    ],
)
def test_derivatives_are_exact_whether_friction_sticks_or_slides(exported, name, times):
    _, path = exported(name)
    scene = SCENES[name][0]()
    model = scene.compile(list(scene.parameters))
    seen = set()
    with Unit(path) as unit, Unit(path, "CoSimulation") as steps:
        unit.initialize()
        _compare(unit, model, 0.0)
        unit.update()
        unit.fmu.enterContinuousTimeMode()
        steps.initialize(1e-10, stop=times[-1])
        for begin, end in pairwise([0.0, *times]):
            steps.step(begin, end - begin)
            _compare(steps, model, end)
            unit.go(end, steps.get(*unit.states))
            _compare(unit, model, end)
            unit.fmu.enterEventMode()
            _compare(unit, model, end)
            unit.fmu.enterContinuousTimeMode()
            seen.add(tuple(steps.get(*(s for s in unit.states if s.endswith(".mode")))))
    assert len(seen) == len(times)
    assert {0.0} < {mode for modes in seen for mode in modes}
