"""Models as bytes: another process needs no forming, no scene and no components of a user."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from unittest.mock import patch

import numpy as np
import pytest

import cotree
from cotree import BuildError, ModelError, pipeline
from cotree.components import COMPONENTS
from cotree.model import loading

pytestmark = pytest.mark.compiler

#: A process that has nothing but the bytes; it prints the last point of a run exactly.
_WORKER = """
import pickle, sys
model = pickle.load(open(sys.argv[1], "rb"))
run = model.simulate((0.0, 0.5), method="dopri5")
print(model.kernels.digest)
print(*(value.hex() for value in [*run.y[:, -1].tolist(), *run.s[:, :, -1].ravel().tolist()]))
print([room for room in ("sympy", "cotree.formulation", "cotree.pipeline") if room in sys.modules])
"""


def in_another_process(model, tmp_path):
    """Return digest, last point and imported modules, as reported by another process."""
    path = tmp_path / "model.pickle"
    path.write_bytes(pickle.dumps(model))
    done = subprocess.run(
        [sys.executable, "-c", _WORKER, str(path)],
        env={**os.environ, "PYTHONHASHSEED": "4711"},
        capture_output=True,
        text=True,
        check=True,
    )
    digest, values, imported = done.stdout.splitlines()
    return digest, [float.fromhex(value) for value in values.split()], imported


def resting(voltage=2.0):
    """A divider that charges a capacitor, begins at rest, and is then driven."""
    scene = cotree.Scene("resting")
    scene.parameter("R", 3.0, unit="ohm")
    scene.parameter("U", voltage, unit="V")
    scene.voltage_source("V", "a", "ground", voltage="U*(1 + 0.5*sin(8*t))")
    scene.resistor("R1", "a", "b", resistance="R")
    scene.resistor("R2", "b", "ground", resistance=1.0)
    scene.capacitor("C", "b", "ground", capacitance=0.25)
    scene.simulation(start="operating point")
    return scene


@pytest.fixture
def formed(monkeypatch):
    """Count how often equations are formed."""
    made = []
    whole = pipeline.form_text
    monkeypatch.setattr(pipeline, "form_text", lambda *args: made.append(args) or whole(*args))
    return made


def test_a_model_at_rest_runs_where_nothing_is_formed(tmp_path):
    model = resting().compile(["R"])
    digest, values, imported = in_another_process(model, tmp_path)
    run = model.simulate((0.0, 0.5), method="dopri5")
    assert digest == model.kernels.digest
    assert values == [*run.y[:, -1].tolist(), *run.s[:, :, -1].ravel().tolist()]
    assert imported == "[]"
    # At rest no current flows into the capacitor: a divider, whose voltage is U / (1 + R).
    again = pickle.loads(pickle.dumps(model))
    np.testing.assert_allclose(again.start().y, [0.5], rtol=1e-15)
    np.testing.assert_allclose(again.start().s, [[-2.0 / 16.0]], rtol=1e-15)


def test_components_of_a_user_stay_at_home(tmp_path):
    with patch.dict(COMPONENTS):
        cotree.register_component(
            "spring_of_a_user", lambda across, k: k * across**3, domain="translational"
        )
        scene = cotree.Scene("own")
        scene.translational_mass("m", "ground", "A", mass=1.0, initial={"v": 1.0})
        scene.edge("s", "spring_of_a_user", "ground", "A", k=2.0)
        model = scene.compile(optimize="-O0")
        data = pickle.dumps(model)
        _, values, imported = in_another_process(model, tmp_path)
        assert values == model.simulate((0.0, 0.5), method="dopri5").y[:, -1].tolist()
        assert imported == "[]"
        known = pickle.loads(data)
        assert known.summary() == model.summary()
    stranger = pickle.loads(data)
    runs = stranger.ensemble((0, 0.5), {"m.v": [1.0]}, t_eval=2, progress=False)
    assert runs["status"].values.tolist() == [0]
    assert stranger.kernels.digest == model.kernels.digest
    with pytest.raises(ModelError, match=r"needs its scene.*'spring_of_a_user'.*register"):
        stranger.linearize()


def test_what_needs_the_scene_forms_it_again(formed):
    scene = cotree.load("slider-pendulum")
    model = pickle.loads(pickle.dumps(scene.compile(["L"])))
    formed.clear()
    model.simulate((0, 0.1), method="dopri5")
    assert not formed
    own = scene.compile(["L"])
    assert np.array_equal(model.linearize().A, own.linearize().A)
    assert model.spec.formed.first.system.trees == own.spec.formed.first.system.trees
    cart = pickle.loads(pickle.dumps(cotree.load("cart-pole").compile()))
    name = cart.inputs[0]
    run = cart.simulate((0, 0.1), inputs={name: f"-c*{cart.states[0]}"}, parameters={"c": 3.0})
    assert run.status == 0


def test_equal_models_have_equal_digests_and_others_do_not():
    def digest(length=1.0, names=("L",), **options):
        scene = cotree.load("slider-pendulum")
        scene.set("L", length)
        return scene.compile(list(names), **options).kernels.digest

    assert digest() == digest()
    assert len({digest(), digest(1.5), digest(names=()), digest(baumgarte=1.0)}) >= 3
    one, other = (resting(voltage).compile() for voltage in (2.0, 3.0))
    assert one.kernels.digest != other.kernels.digest
    again = pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(one))))
    assert again.kernels.digest == one.kernels.digest


def test_another_version_is_refused(monkeypatch):
    data = pickle.dumps(cotree.load("slider-pendulum").compile())
    monkeypatch.setattr(loading, "VERSION", "9.9.9")
    with pytest.raises(BuildError, match=r"pickled by cotree .* this is cotree 9\.9\.9 .*install"):
        pickle.loads(data)


def test_a_model_is_small():
    # The C text and the program; a scene alone has 2.5 kB.
    assert len(pickle.dumps(cotree.load("slider-pendulum").compile(["L"]))) < 20_000
    assert len(pickle.dumps(cotree.load("robot-arm").compile())) < 30_000
