"""The start of C programs at other values of parameters is that of Python."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest
from c_programs import execute, printed, run

import cotree
from cotree import Scene

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]

#: Both take the same steps of least length to rounding; the end has the errors of two integrations
#: at 1e-12 besides, and what is printed has 12 digits.
START, END = 1e-9, 1e-9


def slider_crank() -> Scene:
    """Draw a crank that is given, and a rod and a slider that follow."""
    scene = Scene("slider-crank", gravity=[0, -9.81, 0])
    scene.parameter("r", 0.2)
    scene.parameter("l", 0.5)
    start = {"theta": 0.8, "theta_dot": "2*r"}
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial=start)
    scene.edge("p", "prismatic", "ground", "S", axis=[1, 0, 0])
    scene.edge("ca", "arm", "A", "P", vector=["r", 0, 0])
    scene.edge("cb", "rigid_body", "ground", "A", mass=0.0, inertia=0.03)
    scene.edge("sb", "rigid_body", "ground", "S", mass=0.7)
    scene.edge("rod", "distance", "P", "S", length="l")
    return scene


def loose_four_bar() -> Scene:
    """Draw a four-bar whose crank is not given: the start is the least of several moves."""
    scene = Scene("four-bar", gravity=[0, -9.81, 0])
    for name, value in {"a": 0.5, "b": 1.5, "c": 1.2}.items():
        scene.parameter(name, value)
    scene.edge("crank", "revolute", "ground", "A", axis=[0, 0, 1])
    scene.edge("bar1", "arm", "A", "B", vector=["a", 0, 0])
    scene.edge("coupler", "revolute", "B", "C", axis=[0, 0, 1])
    scene.edge("bar2", "arm", "C", "D", vector=["b", 0, 0])
    scene.edge("base", "arm", "ground", "E", vector=[1.6, 0, 0])
    scene.edge("rocker", "revolute", "E", "F", axis=[0, 0, 1], damping=0.1)
    scene.edge("bar3", "arm", "F", "G", vector=["c", 0, 0])
    scene.edge("close", "revolute", "D", "G", axis=[0, 0, 1])
    for node in "ACF":
        scene.edge(f"m{node}", "rigid_body", "ground", node, mass=1.1, inertia=0.2)
    return scene


def capacitors() -> Scene:
    """Draw capacitors whose charges are states, and whose voltages are given or guessed."""
    scene = Scene("capacitors")
    scene.parameter("R", 1e3)
    scene.parameter("c", 1e-6)
    for name, node, given in (("C1", "a", {"initial": {"v": 2.0}}), ("C2", "b", {})):
        law = f"c*(tanh({name}.v) + 0.2*{name}.v)"
        scene.edge(name, "nonlinear_capacitor", node, "ground", charge=law, **given)
    scene.edge("R1", "resistor", "a", "b", resistance="R")
    return scene


SCENES = {
    "capacitors": (capacitors, ["c"], {"c": 1.5e-6}),
    "slider-crank": (slider_crank, ["l"], {"l": 0.55, "r": 0.21}),
    "four-bar": (loose_four_bar, ["a"], {"a": 0.55, "c": 1.25}),
    "motor-linkage": (lambda: cotree.load("motor-linkage"), ["L"], {"L": 0.36}),
    "bridge-rectifier": (lambda: cotree.load("bridge-rectifier"), [], {}),
}


@pytest.mark.parametrize("name", SCENES)
def test_start_and_end_are_those_of_python(name, tmp_path: Path):
    make, wanted, values = SCENES[name]
    model = make().compile(wanted)
    project = model.write(tmp_path, integrator="dop853")
    run(project.command.split(), tmp_path)
    sets = [text for own, value in values.items() for text in ("--set", f"{own}={value!r}")]
    main = f"./{name.replace('-', '_')}"
    start = model.start(p=model.kernels.parameter_array(values))
    found = printed(run([main, *sets, "--t-end", "0"], tmp_path))
    names = [*model.states, *(f"d({x})/d({p})" for p in wanted for x in model.states)]
    for own, value in zip(names, start.z, strict=True):
        assert found[own] == pytest.approx(value, rel=START, abs=START), own
    settings = {"method": "dop853", "rtol": 1e-12, "atol": 1e-12}
    known = model.simulate((0, 0.1), parameters=values, **settings)
    options = ["--t-end", "0.1", "--rtol", "1e-12", "--atol", "1e-12"]
    found = printed(run([main, *sets, *options], tmp_path))
    for own in model.states:
        assert found[own] == pytest.approx(known[own][-1], rel=END, abs=END), own


def test_what_cannot_be_assembled_is_named(tmp_path: Path):
    project = slider_crank().compile().write(tmp_path)
    run(project.command.split(), tmp_path)
    done = execute(["./slider_crank", "--set", "l=0.1"], tmp_path)
    assert done.returncode == 1
    assert done.stderr == (
        "slider-crank: there is no start: the initial values violate the constraints, and given "
        "ones cannot be adjusted: rod.length.\n"
    )
