"""Storages by content as C programs: tolerances of charges are those of voltages there, too."""

from __future__ import annotations

import sys

import pytest
from c_programs import build, printed, run

from cotree import Scene

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]


def driven(has_kink):
    """Charge two picofarads in a loop with a source."""
    scene = Scene("contents")
    for name, value in (("R", 1e3), ("c", 1e-12), ("v1", 0.4)):
        scene.parameter(name, value)
    kink = " + where(C.v > v1, c*(C.v - v1), 0)" if has_kink else ""
    scene.edge("V", "voltage_source", "a", "ground", voltage="1 + 0.1*sin(1e9*t)")
    scene.edge("R", "resistor", "a", "b", resistance="R")
    law = f"c*(C.v + C.v**3){kink}"
    scene.edge("C", "nonlinear_capacitor", "b", "ground", charge=law, initial={"v": 0.1})
    scene.edge("C2", "capacitor", "a", "b", capacitance="0.5*c")
    scene.simulation(t_end=2e-9, rtol=1e-9)
    return scene


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("integrator", "has_kink", "sensitivities"),
    [
        ("dopri5", False, ["c"]),
        ("rodas5", False, []),
        pytest.param("rodas5", True, ["c"], marks=pytest.mark.slow),
        pytest.param("dopri5", True, [], marks=pytest.mark.slow),
    ],
)
def test_c_projects_keep_charges(tmp_path, compiler, integrator, has_kink, sensitivities):
    scene = driven(has_kink)
    project = scene.compile(sensitivities).write(tmp_path, integrator)
    found = printed(run([build(project, compiler)], tmp_path))
    model = scene.compile(["c"])
    settings = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13, "t_eval": [2e-9]}
    result = model.simulate((0, 2e-9), **settings)
    for i, name in enumerate(model.states[-2:], len(model.states) - 2):
        # Errors of some tens of steps at 1e-9.
        assert found[name] == pytest.approx(result.y[i, -1], rel=1e-7)
        if sensitivities:
            assert found[f"d({name})/d(c)"] == pytest.approx(result.s[i, 0, -1], rel=1e-6)
