"""The published motor on a rigid gear: two inertias share one state through an ideal gear."""

from __future__ import annotations

import numpy as np
from domain_scenes import scene_of_domain
from reference_scenes import read_reference


def test_the_motor_on_a_rigid_gear():
    reference = read_reference("dc_motor_rigid_gear")
    # Where torque and voltage have one constant, the file's separate ones are no parameters.
    known = [name for name in reference["sensitivities"]["values"] if name not in ("Kt", "Ke")]
    model = scene_of_domain("dc_motor_rigid_gear").compile(known)
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
