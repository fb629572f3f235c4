"""The published motor on a rigid gear: two inertias share one state through an ideal gear."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from cotree import Scene

FILE = Path(__file__).parents[1] / "references" / "dc_motor_rigid_gear.json"


def geared_motor(parameters: dict[str, float]) -> Scene:
    """Build the reference from its components; its motor has one constant, Kt = Ke."""
    scene = Scene("geared-motor")
    for name, value in parameters.items():
        scene.parameter(name, value)
    winding = {"resistance": "R", "inductance": "L", "constant": "Kt"}
    scene.edge("Vs", "voltage_source", "a", "ground", voltage="V")
    scene.edge("M", "dc_motor", electrical=["a", "ground"], shaft=["ground", "m"], **winding)
    scene.edge("Im", "rotational_inertia", "ground", "m", inertia="Jm")
    scene.edge("Bm", "rotational_damper", "ground", "m", damping="bm")
    scene.edge("G", "ideal_gear", input=["ground", "m"], output=["ground", "l"], ratio="N")
    scene.edge("Il", "rotational_inertia", "ground", "l", inertia="Jl")
    scene.edge("Bl", "rotational_damper", "ground", "l", damping="bl")
    scene.edge("Load", "torque_source", "ground", "l", torque="-TL")
    scene.output("i", "M.i")
    scene.output("wm", "m.w")
    return scene


def test_the_motor_on_a_rigid_gear():
    reference = json.loads(FILE.read_text(encoding="utf-8"))
    # Where torque and voltage have one constant, the file's separate ones are no parameters.
    known = [name for name in reference["sensitivities"]["values"] if name not in ("Kt", "Ke")]
    model = geared_motor(reference["parameters"]).compile(known)
    times = [row["t"] for row in reference["reference"]]
    result = model.simulate((0, times[-1]), t_eval=times, rtol=1e-11, atol=1e-13)
    for name in ("i", "wm"):
        expected = np.array([row["values"][name] for row in reference["reference"]])
        np.testing.assert_allclose(result[name], expected, rtol=1e-10)
        for parameter in known:
            rows = reference["sensitivities"]["values"][parameter]
            slope = np.array([row["values"][name] for row in rows])
            # Of the largest: sensitivities to inertias decay by eight orders.
            found = result.sensitivity(name, parameter)
            np.testing.assert_allclose(found, slope, atol=1e-9 * np.max(np.abs(slope)), rtol=0)
