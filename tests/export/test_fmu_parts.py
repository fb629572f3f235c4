"""FMUs of scenes with parts: a sampled controller with events at its samples, and an array."""

from __future__ import annotations

import numpy as np
import pytest
from fmpy.validation import validate_fmu
from fmu_importer import Unit, simulated

from cotree import Scene


def _sampled():
    """Build a cart whose speed a sampled PI controller brings to one."""
    scene = Scene("sampled")
    scene.add("C", "sampled-pi", u="1 - x.v", T=0.25, Kp=1.5, Ki=0.8)
    scene.edge("x", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("F", "force_source", "ground", "A", force="C.y")
    return scene


def _pack():
    """Build a battery pack with a load."""
    scene = Scene("pack")
    scene.edge("room", "temperature_source", "ground", "air", temperature=298.15)
    scene.add("pack", "battery-pack", plus="a", minus="ground", air="air")
    scene.edge("load", "resistor", "a", "ground", resistance=4.0)
    scene.output("voltage", "load.v")
    return scene


SCENES = {"sampled": (_sampled, 2.1), "pack": (_pack, 100.0)}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "version"), [("sampled", 3), ("sampled", 2), ("pack", 3)])
def test_fmpy_simulates_what_the_model_does(tmp_path, name, version):
    make, t_end = SCENES[name]
    model = make().compile()
    path = tmp_path / "x.fmu"
    model.export_fmu(path, version)
    assert validate_fmu(str(path)) == []
    names = [*model.states, *model.outputs]
    times = np.linspace(0.0, t_end, 51)
    wanted = model.simulate((0.0, t_end), times, rtol=1e-11, atol=1e-13)
    for kind in ("ModelExchange", "CoSimulation"):
        found = simulated(path, kind, t_end, t_end / 50, names, 1e-10)
        places = np.searchsorted(times, np.asarray(found["time"]) - 1e-9 * t_end)
        for one in names:
            values = np.asarray(wanted[one])[places]
            # CVode errs by thousands of its tolerance over many steps.
            scale = max(1.0, float(np.max(np.abs(values))))
            assert np.max(np.abs(np.asarray(found[one]) - values)) <= 1e-6 * scale, (kind, one)


@pytest.mark.slow
def test_the_first_sample_is_taken_at_the_end_of_the_initialization(tmp_path):
    path = tmp_path / "x.fmu"
    _sampled().compile(["C.Kp"]).export_fmu(path, kinds=["CoSimulation"])
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-10)
        # u = 1, y = Kp u + Ki T u.
        assert unit.get("C.held", "d(C.held)/d(C.Kp)").tolist() == pytest.approx([1.7, 1.0])
        unit.step(0.0, 0.25)
        # The speed is 0.25 times what was held; the error is summed.
        speed = 0.25 * 1.7
        held = 1.5 * (1 - speed) + 0.2 * (2 - speed)
        slope = (1 - speed) - (1.5 + 0.2) * 0.25
        assert unit.get("C.held")[0] == pytest.approx(held, rel=1e-9)
        assert unit.get("d(C.held)/d(C.Kp)")[0] == pytest.approx(slope, rel=1e-9)
