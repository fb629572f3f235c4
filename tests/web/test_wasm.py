"""The program of a page computes what the same C code computes outside a browser."""

from __future__ import annotations

import io
import subprocess
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cotree import Scene, load
from cotree.web import export_web

pytest.importorskip("ziglang", reason="needs ziglang: pip install 'cotree[web]'")
pytest.importorskip("wasmtime", reason="needs wasmtime")

from page_data import data_of
from wasm_run import run_page

if TYPE_CHECKING:
    from pathlib import Path

    from cotree import Model

# The first compilation of a session also compiles zig's C library.
pytestmark = [pytest.mark.slow, pytest.mark.compiler]

POINTS = 201


def belt() -> Scene:
    """Return a block with dry friction on a belt, which sticks and slides."""
    scene = Scene("belt")
    scene.parameter("v", 0.2)
    scene.parameter("F", 2.0)
    scene.edge("mass", "translational_mass", "ground", "A", mass=1.0, initial={"v": "v"})
    scene.edge("spring", "translational_spring", "ground", "A", stiffness=10.0)
    scene.edge("drive", "velocity_source", "ground", "belt", velocity="v")
    scene.edge("rub", "translational_dry_friction", "belt", "A", force="F", breakaway=3.0)
    scene.output("force", "rub.f")
    scene.simulation(t_end=8.0)
    return scene


# For each scene: sensitivities, method, and the largest difference relative to the size of results.
# Both programs round the same operations, except in functions of their mathematics libraries. With
# algebraic unknowns or friction, iterations end elsewhere within their tolerances; rtol is 1e-8.
CASES = {
    "slider-pendulum": (["L", "m1", "k"], "dopri5", 1e-12),
    "motor-linkage": (["L"], "dopri5", 1e-12),  # a closed loop and networks
    "bouncing-ball": (["g", "e"], "dopri5", 1e-12),  # events
    "two-tanks": ([], "rodas5", 1e-12),  # no sensitivities, stiff
    "bridge-rectifier": (["C"], "dopri5", 1e-9),  # algebraic unknowns, kinks at known times
    "belt": (["F"], "dopri5", 1e-9),  # modes of dry friction
}


def native(model: Model, folder: Path, method: str, end: float) -> tuple[np.ndarray, list[str]]:
    """Return the table of the C project of a model, and its columns."""
    model.write(folder, method)
    subprocess.run(["make", "-s"], cwd=folder, check=True, capture_output=True)
    program = next(p for p in folder.iterdir() if p.suffix == "" and p.name != "Makefile")
    done = subprocess.run(
        [program, repr(end), str(POINTS)], capture_output=True, text=True, check=True
    )
    columns = done.stdout.split("\n", 1)[0].split(",")
    return np.genfromtxt(io.StringIO(done.stdout), delimiter=",", skip_header=1), columns


@pytest.mark.parametrize("name", CASES)
def test_program_agrees_with_native_results(name: str, tmp_path: Path) -> None:
    sensitivities, method, tolerance = CASES[name]
    scene = belt() if name == "belt" else load(name)
    model = scene.compile(sensitivities)
    data = data_of(export_web(model, tmp_path / "page.html").read_text())
    run = run_page(data, method, POINTS)
    assert not run.failed
    table, columns = native(model, tmp_path / "c", method, data["t_end"])
    pairs = [(x, p) for p in model.sensitivities for x in model.states]
    for found, names in (
        (run.states, model.states),
        (run.outputs, model.outputs),
        (run.slopes, [f"d({x})/d({p})" for x, p in pairs]),
    ):
        wanted = table[:, [columns.index(column) for column in names]]
        size = np.maximum(1.0, np.abs(wanted).max(axis=0, initial=0.0))
        np.testing.assert_array_less(np.abs(found - wanted) / size, tolerance)


def test_initial_values_and_parameters_are_those_of_the_request(tmp_path: Path) -> None:
    model = load("slider-pendulum").compile(["L"])
    data = data_of(export_web(model, tmp_path / "page.html").read_text())
    changed = {"parameters": {"L": 1.5}, "initial": {"h2.theta": 0.3}}
    run = run_page(data, "dopri5", POINTS, **changed)
    result = model.simulate((0, data["t_end"]), POINTS, method="dopri5", **changed)
    np.testing.assert_allclose(run.states, result.y.T, rtol=0, atol=1e-12)
    slopes = [result.sensitivity(name, "L") for name in model.states]
    np.testing.assert_allclose(run.slopes, np.transpose(slopes), rtol=0, atol=1e-12)


def test_start_of_a_closed_loop_follows_the_request(tmp_path: Path) -> None:
    model = load("motor-linkage").compile()
    data = data_of(export_web(model, tmp_path / "page.html").read_text())
    run = run_page(data, "dopri5", POINTS, initial={"crank.theta": 0.8})
    start = model.start(initial={"crank.theta": 0.8})
    np.testing.assert_allclose(run.states[0], start.y, rtol=0, atol=1e-12)


def test_failures_are_reported_in_the_words_of_the_runtime(tmp_path: Path) -> None:
    model = load("bouncing-ball").compile()
    data = data_of(export_web(model, tmp_path / "page.html").read_text())
    run = run_page(data, "dopri5", POINTS, parameters={"v": 0.0})
    assert run.failed
    assert "event 'hit' stops the integration" in run.message
    assert "accumulates at t =" in run.message
    # The rows up to the failure remain.
    assert 0.0 < run.t[-1] < data["t_end"]
    assert len(run.event_times) > 10
