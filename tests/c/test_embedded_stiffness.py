"""C projects say where a problem became stiff."""

from __future__ import annotations

import math
import sys
from typing import TYPE_CHECKING

import pytest
from c_programs import build, execute, printed

from cotree import Scene, load

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]


@pytest.mark.sampled(2)
@pytest.mark.parametrize("has_events", [False, True])
@pytest.mark.parametrize("integrator", ["dopri5", "rkf45", "dop853"])
def test_stiffness_is_reported(
    compiler: str, tmp_path: Path, integrator: str, has_events: bool
) -> None:
    """A mass in what thickens as exp(t), pushed so that v = sin(t)."""
    scene = Scene("thickening")
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("d", "translational_damper", "ground", "A", damping="exp(t)")
    scene.edge("F", "force_source", "ground", "A", force="exp(t)*sin(t) + cos(t)")
    if has_events:
        scene.event("up", "m.v - 0.5", direction=1)
    project = scene.compile().write(tmp_path, integrator)
    done = execute([build(project, compiler), "11"], tmp_path)
    assert done.returncode == 0
    assert "thickening: the problem is stiff from t = " in done.stderr
    assert done.stderr.endswith("on: rodas5 may take far fewer steps.\n")
    # The scene's rtol of 1e-8; what is stiff forgets its errors.
    assert printed(done.stdout)["m.v"] == pytest.approx(math.sin(11.0), abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("integrator", ["dopri5", "rkf45", "dop853"])
def test_nothing_is_reported_of_a_slider(compiler: str, tmp_path: Path, integrator: str) -> None:
    project = load("slider-pendulum").compile(["L"]).write(tmp_path, integrator)
    done = execute([build(project, compiler)], tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
