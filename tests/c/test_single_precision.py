"""C projects in single precision: they run where those in double precision do, to its rounding."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest
from c_programs import build, printed, run

from cotree import Scene, load

if TYPE_CHECKING:
    from pathlib import Path

    from cotree import Model

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]


def both(model: Model, method: str, compiler: str, folder: Path) -> list[dict[str, float]]:
    """Print the end of a run in double and in single precision."""
    ends = []
    for real in ("double", "float"):
        project = model.write(folder / real, method, real=real)
        ends.append(printed(run([build(project, compiler)], folder / real)))
    return ends


def test_polynomials_of_short_steps_tell_no_sizes(compiler: str, tmp_path: Path) -> None:
    """Those behind a restart gave 2e6 K, of which 1e-5 seemed to be the tolerance of a crossing."""
    names = list(load("heated-room").parameters)[:2]
    exact, found = both(load("heated-room").compile(names), "dopri5", compiler, tmp_path)
    happened = [key for key in exact if "[" in key]
    assert len(happened) > 1000
    for key in happened:
        # 460 events, each found to the rounding of its time, move the ones behind them.
        assert found[key] == pytest.approx(exact[key], rel=5e-4), key
    assert found["air.T"] == pytest.approx(exact["air.T"], rel=1e-3)


def test_forces_that_edges_share_are_solved_for(compiler: str, tmp_path: Path) -> None:
    """The constant that keeps rows of zeros from being divided by zero is a number of the type."""
    scene = Scene("ring")
    for node in "abc":
        scene.edge(f"J{node}", "rotational_inertia", "ground", node, inertia=1.0)
    for first, second in ("ab", "bc", "ca"):
        scene.edge(f"R{first}{second}", "rotational_dry_friction", first, second, torque=1.0)
    scene.edge("P", "torque_source", "ground", "a", torque="2*t")
    scene.simulation(t_end=3.0)
    exact, found = both(scene.compile(), "dopri5", compiler, tmp_path)
    speeds = [key for key in exact if key.endswith(".w")]
    assert len(speeds) == 3
    for key in speeds:
        # What sticks and slides changes once, at a time that is known to rounding.
        assert found[key] == pytest.approx(exact[key], rel=1e-4), key
