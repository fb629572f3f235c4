"""Models with constraints as C programs: held to them, from a consistent start."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
from c_programs import SANITIZE, build, execute, printed, run

from cotree import Scene
from cotree.codegen.statuses import NUMBERS, SENTENCES
from cotree.export.c_project import CProject, write_c_project

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree import Model

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]

# A program with its sanitizers is built for seconds; the other tests of this folder try both.
mostly_gcc = pytest.mark.parametrize(
    "compiler",
    ["gcc", pytest.param("clang", marks=pytest.mark.slow)],
    indirect=True,
    scope="module",
)

DOCUMENT = Path(__file__).parents[2] / "docs" / "c.md"
OK, PROJECTION_FAILED = NUMBERS["OK"], NUMBERS["PROJECTION_FAILED"]

# Numbers are printed with 12 digits, those of a turn or more with an error of 5e-12; residuals are
# sums of half a dozen of them times lengths of 1 m.
PRINTED = 3e-11


def case(driver: Path, *arguments: object) -> list[str]:
    return run(["./driver", *map(str, arguments)], driver).splitlines()


def four_bar(a: float = 0.5, **crank: object) -> Scene:
    """Draw a loop of four bars, which the rocker's end closes."""
    scene = Scene("four-bar", gravity=[0, -9.81, 0])
    for name, value in {"a": a, "b": 1.5, "c": 1.2, "m": 1.1}.items():
        scene.parameter(name, value)
    start = {"initial": {"theta": 1.0, "theta_dot": 2.0}}
    scene.edge("crank", "revolute", "ground", "A", axis=[0, 0, 1], **(crank or start))
    scene.edge("bar1", "arm", "A", "B", vector=["a", 0, 0])
    scene.edge("coupler", "revolute", "B", "C", axis=[0, 0, 1])
    scene.edge("bar2", "arm", "C", "D", vector=["b", 0, 0])
    scene.edge("base", "arm", "ground", "E", vector=[1.6, 0, 0])
    scene.edge("rocker", "revolute", "E", "F", axis=[0, 0, 1], damping=0.1)
    scene.edge("bar3", "arm", "F", "G", vector=["c", 0, 0])
    scene.edge("close", "revolute", "D", "G", axis=[0, 0, 1])
    for i, node in enumerate("ACF"):
        scene.edge(f"m{i + 1}", "rigid_body", "ground", node, mass="m", inertia=0.1 * (i + 1))
    scene.output("x", "D.x")
    return scene


def spherical_pendulum() -> Scene:
    """Draw a rod in a ball joint: a quaternion, and no loop."""
    scene = Scene("spherical-pendulum", gravity=[0, 0, -9.81])
    scene.parameter("L", 0.8)
    start = {"rotation": [0.6, 0, 0], "w1": 0.3, "w2": 1.7, "w3": 0.9}
    scene.edge("ball", "spherical", "ground", "P", initial=start)
    scene.edge("rod", "arm", "P", "Q", vector=[0, 0, "-L"])
    scene.edge("bob", "rigid_body", "ground", "Q", mass=2.0, inertia=[0.05, 0.06, 0.02])
    scene.output("z", "Q.z")
    return scene


def write(model: Model, folder: Path, tolerance: float = 1e-12) -> CProject:
    return write_c_project(model.kernels.program, folder, t_end=2.0, rtol=tolerance, atol=tolerance)


def simulated(model: Model, t: float) -> dict[str, float]:
    """Return states, outputs and their sensitivities by the names that the executable prints."""
    result = model.simulate(
        (0.0, t), t_eval=[t], method="dop853", rtol=1e-13, atol=1e-13, throw=True
    )
    found = {name: result[name][-1] for name in (*model.states, *model.outputs)}
    for name in tuple(found):
        for parameter in model.sensitivities:
            found[f"d({name})/d({parameter})"] = result.sensitivity(name, parameter)[-1]
    return found


def residuals_of_sensitivities(model: Model, t: float, values: dict[str, float]) -> np.ndarray:
    """Evaluate the differentiated constraints where the executable ended."""
    y = np.array([values[name] for name in model.states])
    s = [values[f"d({name})/d({seed})"] for seed in model.sensitivities for name in model.states]
    kernel = model.kernels.bound("constraint_sensitivity", model.default_parameters)
    return kernel(t, y, np.array(s), None).copy()


@pytest.mark.sampled(1)
@mostly_gcc
@pytest.mark.parametrize(
    ("scene", "sensitivities"),
    [
        (four_bar, ("a", "m")),
        (four_bar, ()),
        (spherical_pendulum, ("L",)),
        (spherical_pendulum, ()),
    ],
)
def test_a_constrained_motion_ends_as_in_python(
    compiler: str, tmp_path: Path, scene: Callable[[], Scene], sensitivities: tuple[str, ...]
) -> None:
    model = scene().compile(sensitivities)
    executable = build(write(model, tmp_path), compiler)
    values = printed(run([executable], tmp_path))
    expected = simulated(model, 2.0)
    assert values.keys() == expected.keys()
    # A thousand or so steps may each err by the tolerance of 1e-12, which the motion enlarges some
    # tens of times; what is asked for is eight digits.
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, abs=1e-8 * max(1.0, abs(value))), name
    y = [values[name] for name in model.states]
    assert np.max(np.abs(model.kernels.constraint_values(2.0, y))) < PRINTED
    if sensitivities:
        # They reach some hundreds, with the same number of digits.
        assert np.max(np.abs(residuals_of_sensitivities(model, 2.0, values))) < 100 * PRINTED


@pytest.mark.slow
@mostly_gcc
@pytest.mark.parametrize("scene", [four_bar, spherical_pendulum])
def test_the_start_is_consistent_where_initial_is_not(
    compiler: str, tmp_path: Path, scene: Callable[[], Scene]
) -> None:
    model = scene().compile(["m" if scene is four_bar else "L"])
    values = printed(run([build(write(model, tmp_path), compiler), "0"], tmp_path))
    start = model.start()
    for i, name in enumerate(model.states):
        # 12 digits.
        assert values[name] == pytest.approx(start.y[i], rel=1e-11, abs=1e-12)
        sensitivity = values[f"d({name})/d({model.sensitivities[0]})"]
        assert sensitivity == pytest.approx(start.s[i, 0], rel=1e-11, abs=1e-12)
    assert "cotree_start_once" in (tmp_path / "main.c").read_text()


@pytest.mark.slow
@mostly_gcc
def test_a_loose_tolerance_leaves_no_residual(compiler: str, tmp_path: Path) -> None:
    """Left to itself the motion drifts by about the tolerance."""
    model = four_bar().compile()
    project = write(model, tmp_path, 1e-4)
    main = tmp_path / "main.c"
    residuals = []
    own = main.read_text()
    for text in (own, own.replace("job.is_held = 1;", "job.is_held = 0;")):
        main.write_text(text)
        values = printed(run([build(project, compiler)], tmp_path))
        y = [values[name] for name in model.states]
        residuals.append(float(np.max(np.abs(model.kernels.constraint_values(2.0, y)))))
    assert residuals[0] < PRINTED
    assert residuals[1] > 1e-7


@pytest.mark.slow
@mostly_gcc
def test_a_loop_that_cannot_close_is_reported(compiler: str, tmp_path: Path) -> None:
    """The crank is driven away until coupler and rocker are one line, at infinite rates."""
    model = four_bar(a=2.0, motion="1 + t").compile()
    done = execute([build(write(model, tmp_path, 1e-8), compiler)], tmp_path)
    assert done.returncode != 0
    assert done.stdout == ""
    found = re.fullmatch(r"four-bar: the integration stops at t = (\S+): (.*)\.\n", done.stderr)
    assert found is not None, done.stderr
    # The end of the crank is then 1.5 + 1.2 from the rocker's foot; t is printed with six digits.
    last = math.acos((2.0**2 + 1.6**2 - 2.7**2) / (2 * 2.0 * 1.6)) - 1.0
    assert float(found[1]) == pytest.approx(last, abs=1e-5)
    assert found[2] in (SENTENCES["PROJECTION_FAILED"], SENTENCES["STEP_TOO_SMALL"])


@mostly_gcc
def test_constraints_that_cannot_be_satisfied_are_reported(compiler: str, tmp_path: Path) -> None:
    """Somebody gives a bar another length, with which the loop does not close."""
    project = write(four_bar().compile(), tmp_path)
    done = execute([build(project, compiler), "--set", "a=50"], tmp_path)
    assert done.returncode != 0
    assert done.stdout == ""
    expected = "the initial values violate the constraints, and given ones cannot be adjusted"
    assert done.stderr == f"four-bar: there is no start: {expected}: close.y.\n"


def test_projection_as_the_document_shows(compiler: str, tmp_path: Path) -> None:
    model = four_bar().compile()
    write(model, tmp_path)
    snippet = re.findall(r"```c\n(for .*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)[0]
    start = ", ".join(repr(float(x) + 1e-4) for x in model.initial_state)
    (tmp_path / "use.c").write_text(
        f"""#include "four_bar.h"
#include <stdio.h>
int main(void)
{{
    const cotree_model *const model = four_bar_abi();
    const double *const p = model->parameter_values, *const u = NULL, t = 0.0;
    double k[FOUR_BAR_N_PREPARED + 1], step[6], residual[4], x[6] = {{ {start} }};
    int i, j;
    if (model->prepare(p, k) != 0) return 1;
{snippet}
    model->constraints(t, x, u, p, k, residual);
    for (i = 0; i < model->n_constraints; ++i) printf("%.17g\\n", residual[i]);
    return 0;
}}
"""
    )
    flags = ["-std=c99", *SANITIZE, "-Wall", "-Werror", "-Wno-empty-body", "-o", "use"]
    run([compiler, *flags, "use.c", "four_bar.c", "-lm"], tmp_path)
    residuals = [float(line) for line in run(["./use"], tmp_path).splitlines()]
    # Steps square the error of 1e-4, those of speeds one step later; what remains is rounding of
    # sums of a few terms up to 5.
    assert len(residuals) == 4
    assert np.max(np.abs(residuals)) < 1e-14


def test_a_projected_integration(driver: Path) -> None:
    lines = [float(line) for line in case(driver, "project", 1)]
    status, drift, gap, slope, error, steps, rejected, projections, evaluations = lines
    assert status == OK
    assert drift < 4.5e-16  # two units in the last place: y is divided by its length
    # The polynomial ends at the projected point: sums of a few numbers of size one.
    assert gap < 1e-14
    assert slope == 0.0  # the rate is that of the projected point
    # Errors along the circle stay: some dozens of steps of 1e-5.
    assert error < 1e-3
    assert projections == 1 + steps
    # As without a projection, and one for each accepted step.
    assert evaluations == 2 + 6 * (steps + rejected) + steps


def test_without_a_projection_nothing_is_added(driver: Path) -> None:
    lines = [float(line) for line in case(driver, "project", 0)]
    status, drift, _, _, _, steps, rejected, projections, evaluations = lines
    assert (status, projections) == (OK, 0)
    assert drift > 0.05  # the start lies off the circle
    assert evaluations == 2 + 6 * (steps + rejected)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("result", [0, 1])
def test_a_failing_projection_gives_its_code(driver: Path, result: int) -> None:
    """The steps shorten up to the time beyond which it fails, or gives no number."""
    code, end, length, again, message = case(driver, "fail_to_project", 0.0, result)
    assert int(code) == int(again) == PROJECTION_FAILED
    assert float(end) == pytest.approx(0.25, rel=1e-13)  # a few units in the last place
    assert abs(float(length) - 1.0) < 4.5e-16  # the last good point was projected
    assert message == SENTENCES["PROJECTION_FAILED"]
    code, end, length, again, _ = case(driver, "fail_to_project", 0.5, result)
    assert int(code) == int(again) == PROJECTION_FAILED
    assert (float(end), float(length)) == (0.5, 1.0)  # the start, as it was given
