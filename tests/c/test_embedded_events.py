"""Models with events as C programs: the same times, states and sensitivities as in Python."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import numpy as np
import pytest
from c_programs import build, execute, printed, run
from loop_with_network import four_bar

from cotree import Scene, load
from cotree.export.c_project import CProject, write_c_project

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from cotree import Model

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]


def driven() -> Scene:
    """Draw a mass between a floor and a switch, under gates that open and close."""
    scene = Scene("driven", gravity=[0, 0, "-g"])
    for name, value in {"g": 9.81, "e": 0.7, "h": 0.5}.items():
        scene.parameter(name, value)
    scene.mode("n", 0)
    scene.mode("on", 1)
    scene.input("gate", "sign(t - 0.3) - 2*sign(t - 0.9)")
    scene.input("wave", "sin(2*pi*3*t)")
    force = "4*on + 2*gate"
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], force=force, initial={"s": "h"})
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    scene.output("height", "j.s")
    scene.event("floor", "j.s", direction=-1, impact={"restitution": "e"})
    scene.event("open", "gate", direction=1, set={"n": "n + 1"})
    scene.event("tick", "wave", direction=1, set={"on": "1 - on"})
    return scene


def loop() -> Scene:
    """Draw a loop of four bars that strikes a wall, and counts how often it passes a place."""
    scene = four_bar("c", rocker={"damping": 0.1})
    for name, value in {"c": 1.2, "e": 0.7}.items():
        scene.parameter(name, value)
    scene.mode("n", 0)
    scene.event("wall", "D.x - 1.1", direction=1, impact={"restitution": "e"})
    back = {"crank.theta_dot": "-0.9*crank.theta_dot", "n": "n + 1"}
    scene.event("back", "crank.theta - 1.3", direction=1, set=back)
    return scene


def turning() -> Scene:
    """Draw a rod in a ball joint that strikes a wall: a quaternion."""
    scene = Scene("turning", gravity=[0, 0, -9.81])
    scene.parameter("L", 0.8)
    scene.mode("n", 0)
    start = {"rotation": [0.6, 0, 0], "w1": 0.3, "w2": 1.7, "w3": 0.9}
    scene.edge("ball", "spherical", "ground", "P", initial=start)
    scene.edge("rod", "arm", "P", "Q", vector=[0, 0, "-L"])
    scene.edge("bob", "rigid_body", "ground", "Q", mass=2.0, inertia=[0.05, 0.06, 0.02])
    scene.event("wall", "Q.x + 0.1", direction=-1, impact={"restitution": 0.6})
    scene.event("across", "Q.y", set={"n": "n + 1"})
    return scene


def relaxation() -> Scene:
    """Draw a capacitor that discharges through k r i, and is charged where the current is low."""
    scene = Scene("relaxation")
    scene.parameter("r", 1.5)
    scene.mode("k", 1)
    scene.edge("c", "capacitor", "a", "ground", capacitance=2.0, initial={"v": 4.0})
    scene.edge("R", "resistor", "a", "ground", resistance="k*r*abs(R.i)")
    scene.event("low", "R.i - 0.5", direction=-1, set={"c.v": "4*k", "k": "3 - k"})
    return scene


CASES = {
    "driven": (driven, ("g", "e", "h"), 2.0),
    "loop": (loop, ("a", "e"), 2.0),
    "turning": (turning, ("L",), 2.0),
    "relaxation": (relaxation, ("r",), 15.0),
}


def write(model: Model, folder: Path, integrator: str = "dopri5", t_end: float = 2.0) -> CProject:
    tight = {"rtol": 1e-11, "atol": 1e-12}
    return write_c_project(model.kernels.program, folder, integrator, t_end=t_end, **tight)


def simulated(model: Model, t: float) -> dict[str, float]:
    """Return what the executable prints, computed from Python with another method."""
    result = model.simulate((0.0, t), [t], "dop853", rtol=1e-12, atol=1e-13, throw=True)
    found = {}
    for event, row in result.events.items():
        for i, at in enumerate(row.t):
            found[f"{event}[{i}]"] = at
            for k, parameter in enumerate(model.sensitivities):
                found[f"d({event}[{i}])/d({parameter})"] = row.s[k, i]
    names = (*model.states, *model.outputs)
    found |= {"t": result.t[-1], **{name: result[name][-1] for name in names}}
    for name in names:
        for parameter in model.sensitivities:
            found[f"d({name})/d({parameter})"] = result.sensitivity(name, parameter)[-1]
    return found


@pytest.mark.sampled(2)
@pytest.mark.parametrize("case", CASES)
def test_ends_as_in_python(compiler: str, tmp_path: Path, case: str) -> None:
    scene, sensitivities, t_end = CASES[case]
    model = scene().compile(sensitivities)
    executable = build(write(model, tmp_path, t_end=t_end), compiler)
    values = printed(run([executable], tmp_path))
    expected = simulated(model, t_end)
    assert values.keys() == expected.keys()
    assert sum("[" in name for name in values) >= 2
    found, exact = (np.array([row[name] for name in values]) for row in (values, expected))
    # The tolerance of 1e-11, through up to a thousand steps and a motion that enlarges errors, of
    # sensitivities a hundred times.
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=1e-8)
    states = [list(values).index(name) for name in model.states]
    np.testing.assert_allclose(found[states], exact[states], rtol=1e-8, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", [pytest.param("rodas4", marks=pytest.mark.slow), "rodas5"])
@pytest.mark.parametrize("case", [pytest.param("loop", marks=pytest.mark.slow), "relaxation"])
def test_integrators_with_algebraic_unknowns_of_their_own(
    compiler: str, tmp_path: Path, integrator: str, case: str
) -> None:
    scene, sensitivities, t_end = CASES[case]
    model = scene().compile(sensitivities)
    executable = build(write(model, tmp_path, integrator, t_end), compiler)
    values, expected = printed(run([executable], tmp_path)), simulated(model, t_end)
    assert values.keys() == expected.keys()
    found, exact = (np.array([row[name] for name in values]) for row in (values, expected))
    # As above.
    np.testing.assert_allclose(found, exact, rtol=1e-6, atol=1e-8)


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    "integrator",
    [
        pytest.param("rkf45", marks=pytest.mark.slow),
        pytest.param("dop853", marks=pytest.mark.slow),
        "rodas4",
    ],
)
def test_other_integrators(compiler: str, tmp_path: Path, integrator: str) -> None:
    model = load("bouncing-ball").compile(["e", "h"])
    executable = build(write(model, tmp_path, integrator, 6.0), compiler)
    values, expected = printed(run([executable], tmp_path)), simulated(model, 6.0)
    assert values.keys() == expected.keys()
    found, exact = (np.array([row[name] for name in values]) for row in (values, expected))
    # Parabolas, but for rounding; what is left of the speed decides when the ball stays.
    np.testing.assert_allclose(found, exact, rtol=1e-8, atol=1e-9)


def ball(**event: object) -> Scene:
    scene = Scene("ball", gravity=[0, 0, -9.81])
    scene.parameter("v", float(np.sqrt(2 * 9.81)))
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": 0.0, "s_dot": "v"})
    scene.edge("b", "rigid_body", "ground", "B", mass=1.0)
    scene.event("hit", **event)
    return scene


@pytest.mark.slow
def test_a_stop_ends_the_run(compiler: str, tmp_path: Path) -> None:
    model = ball(when="j.s - 0.5", direction=1, stop=True).compile()
    text = run([build(write(model, tmp_path), compiler)], tmp_path)
    values = printed(text)
    time = (np.sqrt(2 * 9.81) - np.sqrt(9.81)) / 9.81
    # Printed with twelve digits.
    assert values["t"] == values["hit[0]"] == pytest.approx(time, abs=1e-11)
    assert values["j.s"] == pytest.approx(0.5, abs=1e-11)


def grazing() -> Model:
    return ball(when="1 - j.s", direction=-1, set={"j.s_dot": "-j.s_dot"}).compile(["v"])


def bouncing() -> Model:
    return ball(when="j.s", direction=-1, set={"j.s_dot": "-0.5*j.s_dot"}).compile()


@pytest.mark.parametrize(
    ("model", "message"),
    [
        (grazing, "'hit' stops the integration at t = 0.451524: its function only touches zero"),
        (bouncing, "it recurs ever faster and accumulates at t = 1.80609"),
    ],
)
def test_what_ends_a_run_is_said(
    compiler: str, tmp_path: Path, model: Callable[[], Model], message: str
) -> None:
    # A ball thrown up to 1 m, which grazes there; one that bounces for three times its flight.
    executable = build(write(model(), tmp_path), compiler)
    done = execute([executable], tmp_path)
    assert done.returncode == 1
    assert message in done.stderr
    done = execute([executable, "-1"], tmp_path)
    assert "events are located in forward time only" in done.stderr
