from __future__ import annotations

import dataclasses
import json
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from c_programs import SANITIZE, STRICT, build, execute, need, printed, run

from cotree import Scene, load
from cotree.codegen.c_files import method_files
from cotree.codegen.render import with_runtime
from cotree.export.c_project import CProject, write_c_project
from cotree.pipeline import formulate, generate
from cotree.scene.description import SceneDescription
from cotree.scene.toml_file import load_scene

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]

REFERENCES = Path(__file__).parents[1] / "references"

OK, BAD_ARGUMENT, TOO_MANY_STEPS, STEP_TOO_SMALL, FAILED, NOT_FINITE, STOPPED = range(7)


def case(driver: Path, *arguments: object) -> list[str]:
    return run(["./driver", *map(str, arguments)], driver).splitlines()


def write(
    folder: Path, scene: str, *sensitivities: str, parameters: dict[str, float] | None = None
) -> CProject:
    _, equations, _ = formulate(load_scene(scene, SceneDescription), sensitivities, None)
    program, _ = generate(equations)
    values = [
        (parameters or {}).get(row.name, value)
        for row, value in zip(
            program.layout.parameters, program.layout.parameter_values, strict=True
        )
    ]
    layout = dataclasses.replace(program.layout, parameter_values=tuple(values))
    program = dataclasses.replace(program, layout=layout)
    return write_c_project(program, folder, t_end=10.0, rtol=1e-10, atol=1e-10)


def reference(name: str, states: dict[str, str], t: float, *parameters: str) -> dict[str, float]:
    """Return the reference values by the names that the executable prints."""
    data = json.loads((REFERENCES / f"{name}.json").read_text())
    tables = {"": data["reference"], **data["sensitivities"]["values"]}
    found = {}
    for parameter in ("", *parameters):
        values = next(row["values"] for row in tables[parameter] if row["t"] == t)
        for state, key in states.items():
            found[f"d({state})/d({parameter})" if parameter else state] = values[key]
    return found


def assert_close(values: dict[str, float], expected: dict[str, float]) -> None:
    # A step may err by 1e-10 (1 + |y|), and a few hundred steps by as many times that if their
    # errors had one sign. But the estimate is that of order 4 and the solution that of order 5,
    # errors turn with the oscillation and decay with it: up to ten tolerances are what remains of
    # them here, in rates, which an oscillation at 5 rad/s errs most in; fifty are allowed.
    for name, value in expected.items():
        assert values[name] == pytest.approx(value, abs=5e-9 * max(1.0, abs(value))), name


SLIDER = {"j1.s": "s", "h2.theta": "theta", "j1.s_dot": "sdot", "h2.theta_dot": "thetadot"}
DAMPER = {"s.s": "x", "s.s_dot": "v"}


@pytest.fixture(scope="module")
def slider(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the slider-pendulum with its sensitivity to L."""
    folder = tmp_path_factory.mktemp("slider")
    assert build(write(folder, "slider-pendulum", "L"), compiler) == "./slider_pendulum"
    return folder


def test_slider_pendulum_agrees_with_its_reference(slider: Path) -> None:
    for end in ("1.0", "10.0"):
        text = run(["./slider_pendulum", end], slider)
        values = printed(text)
        expected = reference("slider_pendulum", SLIDER, float(end), "L")
        assert_close(values, expected)
        assert list(values) == [*expected, "rod_x", "d(rod_x)/d(L)"]
    assert run(["./slider_pendulum"], slider) == text  # the scene's own end time is 10
    # x = s + L/2 sin(theta); sums of numbers of 12 digits
    s, theta = values["j1.s"], values["h2.theta"]
    ds, dtheta = values["d(j1.s)/d(L)"], values["d(h2.theta)/d(L)"]
    assert values["rod_x"] == pytest.approx(s + 0.5 * math.sin(theta), abs=3e-12)
    slope = ds + 0.5 * math.sin(theta) + 0.5 * math.cos(theta) * dtheta
    assert values["d(rod_x)/d(L)"] == pytest.approx(slope, abs=3e-12)


def test_values_have_twelve_digits(slider: Path) -> None:
    lines = run(["./slider_pendulum", "0"], slider).splitlines()
    assert lines[0] == "j1.s = 0.500000000000"  # at the start of the run


def test_time_dependent_force_with_and_without_sensitivities(compiler: str, tmp_path: Path) -> None:
    """Without sensitivities the kernels of sensitivities are empty and are not called."""
    for parameters in ((), ("m", "w")):
        folder = tmp_path / str(len(parameters))
        executable = build(write(folder, "spring-mass-damper", *parameters), compiler)
        values = printed(run([executable], folder))
        expected = reference("spring_mass_damper", DAMPER, 10.0, *parameters)
        assert_close(values, expected)
        assert list(values)[: len(expected)] == list(expected)
        assert values["x"] == values["s.s"]


def test_scene_with_input_and_without_parameters_or_outputs(compiler: str, tmp_path: Path) -> None:
    """Arrays of length zero do not exist in C99."""
    scene = SceneDescription("bare")
    scene.input("F", "2*t", unit="N")
    scene.edge("m", "rigid_body", "ground", "A", mass=2.0)
    scene.edge("F", "force", "ground", "A", force=["F", 0, 0])
    scene.edge("s", "prismatic", "ground", "A", axis=[1, 0, 0])
    program, _ = generate(formulate(scene, (), None)[1])
    project = write_c_project(program, tmp_path, t_end=3.0, rtol=1e-8, atol=1e-8)
    values = printed(run([build(project, compiler)], tmp_path))
    # s'' = t: the method is exact for it, up to 12 printed digits.
    assert values == pytest.approx({"s.s": 4.5, "s.s_dot": 4.5}, abs=1e-11)


def test_refused_parameters_are_named(compiler: str, tmp_path: Path) -> None:
    executable = build(write(tmp_path, "slider-pendulum", "L", parameters={"m2": -5.0}), compiler)
    done = execute([executable], tmp_path)
    assert done.returncode != 0
    assert done.stdout == ""
    assert (
        done.stderr == "slider-pendulum: mass of edge 'm6' must not be negative (parameter 'm2').\n"
    )


@pytest.mark.parametrize("argument", ["", "soon", "1s", "nan", "inf"])
def test_end_time_that_is_none(slider: Path, argument: str) -> None:
    done = execute(["./slider_pendulum", argument], slider)
    assert done.returncode == 2
    assert done.stderr == f"slider-pendulum: {argument}: the end time is not a finite number.\n"


def test_integration_that_fails_says_where(compiler: str, tmp_path: Path) -> None:
    project = write(tmp_path, "spring-mass-damper", parameters={"c": -1e200, "x0": 1e200})
    done = execute([build(project, compiler)], tmp_path)
    assert done.returncode != 0
    assert done.stdout == ""
    assert done.stderr.startswith("spring-mass-damper: the integration stops at t = ")
    assert done.stderr.count("\n") == 1


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="needs the GNU linker's options")
@pytest.mark.parametrize("source", ["slider_pendulum.c", "cotree_dopri5.c"])
def test_nothing_but_the_mathematics_library_is_needed(
    compiler: str, tmp_path: Path, source: str
) -> None:
    """The C library is left out, so a call of malloc or printf would not link."""
    write(tmp_path, "slider-pendulum", "L")
    link = ["-shared", "-fPIC", "-nostdlib", "-Wl,--no-undefined", "-o", "x.so", source, "-lm"]
    run([compiler, "-std=c99", "-O1", *link], tmp_path)


@pytest.mark.parametrize("name", ["g++", "clang++"])
def test_headers_serve_c_plus_plus(tmp_path: Path, name: str) -> None:
    write(tmp_path, "slider-pendulum", "L")
    text = '#include "cotree_dopri5.h"\n#include "slider_pendulum.h"\n'
    (tmp_path / "use.cpp").write_text(text * 2)
    run([need(name), "-std=c++11", *STRICT, "-fsyntax-only", "use.cpp"], tmp_path)


def test_orders_of_convergence(driver: Path) -> None:
    """Halved steps divide errors by 2^5: order 5 at steps, and a polynomial of degree 4 between."""
    coarse, fine = ([float(x) for x in case(driver, "order", n)] for n in (20, 40))
    assert (coarse[0], fine[0]) == (20, 40)  # each call took one step of the size asked for
    # The next term of the error changes the ratio by a factor 1 + O(h): 2^4.8 to 2^5.2 at h = 0.2.
    for large, small in zip(coarse[1:], fine[1:], strict=True):
        assert 4.8 < math.log2(large / small) < 5.2


@pytest.mark.parametrize("rtol", [1e-4, 1e-7, 1e-10])
def test_error_follows_tolerance(driver: Path, rtol: float) -> None:
    status, n_points, between, at_end, *work = map(float, case(driver, "control", rtol))
    steps, rejected, evaluations = work
    assert status == OK
    assert n_points == 1001
    # Root mean square of error / (rtol (1 + |y|)) below 1 at each of some dozens to hundreds of
    # steps of an oscillator, which keeps errors as they are: their sum is a few tens of rtol. The
    # polynomial's own error is of the order of the tolerance of one step.
    assert at_end < 50 * rtol
    assert between < 50 * rtol
    # One evaluation at the start, one to choose the first step, then six for each attempt: dense
    # output costs none.
    assert evaluations == 2 + 6 * (steps + rejected)


def test_goals_are_met_exactly_and_cost_little(driver: Path) -> None:
    t, error, steps, other_steps, t_back, error_back = map(float, case(driver, "goals"))
    assert t == 10.0
    assert t_back == 0.0
    # As in the test above: a few tens of the tolerance, 1e-9, each way.
    assert error < 5e-8
    assert error_back < 1e-7
    # Nine goals on the way shorten nine steps, and restart none.
    assert steps <= other_steps + 9


@pytest.mark.parametrize(
    ("t", "result", "status"),
    [
        (0.25, -1, STOPPED),
        (0.25, 1, FAILED),
        (0.25, 0, NOT_FINITE),
        (-1.0, -1, STOPPED),
        (-1.0, 1, FAILED),
        (-1.0, 0, NOT_FINITE),
    ],
)
def test_failing_rate_gives_its_code(driver: Path, t: float, result: int, status: int) -> None:
    code, end, error, at_end, beyond, again, message = case(driver, "fail", t, result, 0, 0)
    assert int(code) == int(again) == status
    if result == -1 or t < 0.0:
        assert 0.0 <= float(end) <= 0.25
    else:  # steps shorten until they end where the rate does: a few units in the last place
        assert float(end) == pytest.approx(0.25, rel=1e-13)
    # The last good point is good: the solution decays, and so do the errors made before.
    assert float(error) < 1e-5
    assert int(at_end) == OK
    assert int(beyond) == BAD_ARGUMENT
    assert message


def test_smaller_step_cures_a_recoverable_failure(driver: Path) -> None:
    """A first step of 1 throws the stages far beyond 1.5, where the rate refuses."""
    code, end, error, *_ = case(driver, "fail", 2.0, 1, 1.5, 1.0)
    assert (int(code), float(end)) == (OK, 1.0)
    assert float(error) < 1e-5  # ten times the tolerance; the solution itself has died out


def test_limits(driver: Path) -> None:
    lines = case(driver, "limits")
    # n, t, rtol below zero and of one, atol, y
    assert [int(x) for x in lines[:6]] == [BAD_ARGUMENT] * 6
    lines = lines[1:]
    assert int(lines[5]) == OK  # no absolute tolerance, with a zero among the initial values
    assert [int(x) for x in lines[6:8]] == [BAD_ARGUMENT] * 2  # end times
    assert [int(x) for x in lines[8:11]] == [OK, OK, 0]  # nothing to do, nothing evaluated
    assert [int(x) for x in lines[11:13]] == [TOO_MANY_STEPS, 5]
    assert int(lines[13]) == OK
    assert float(lines[14]) < 1e-4  # a hundred times the tolerance, for it went on as before
    assert [int(x) for x in lines[15:]] == [OK, 80]  # of an eighth, over ten seconds


def test_extremes(driver: Path) -> None:
    status, t, blown, end = case(driver, "extremes")
    assert (int(status), float(t)) == (OK, 10.0)
    assert int(blown) == STEP_TOO_SMALL
    assert float(end) == pytest.approx(1.0, abs=1e-5)  # y = 1/(1 - t), to the tolerance of 1e-6


@pytest.mark.slow
def test_a_short_pulse_of_an_input_table_is_not_stepped_over(compiler: str, tmp_path: Path) -> None:
    """1 kg at rest, 200 N for 5 ms in a triangle of 10 ms: 1 m/s from then on."""
    scene = SceneDescription("pulse")
    scene.input("f", [[0.0, 5.0, 5.005, 5.01, 10.0], [0.0, 0.0, 200.0, 0.0, 0.0]])
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="f")
    scene.edge("b", "rigid_body", "ground", "A", mass=1.0)
    program, _ = generate(formulate(scene, [], None)[1])
    project = write_c_project(program, tmp_path, t_end=10.0, rtol=1e-8, atol=1e-10)
    found = printed(run([build(project, compiler)], tmp_path))
    # The pulse is piecewise linear between stops, where order 5 is exact but for rounding.
    assert found["j.s_dot"] == pytest.approx(1.0, abs=1e-9)
    assert found["j.s"] == pytest.approx(10.0 - 5.005, abs=1e-9)


@pytest.mark.slow
def test_a_short_pulse_of_every_period_is_not_stepped_over(compiler: str, tmp_path: Path) -> None:
    """1 kg at rest, a blow of 1 N s within a microsecond at 0.1, 0.35, 0.6 and 0.85 s."""
    scene = SceneDescription("blows")
    scene.parameter("period", 0.25)
    scene.parameter("width", 1e-6)
    force = "max(0, 1 - abs(mod(t - 0.1, period) - width)/width)/width"
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force=force)
    scene.edge("b", "rigid_body", "ground", "A", mass=1.0)
    program, _ = generate(formulate(scene, [], None)[1])
    project = write_c_project(program, tmp_path, t_end=1.0, rtol=1e-8, atol=1e-10)
    found = printed(run([build(project, compiler)], tmp_path))
    # Times have a rounding of 1e-16, which the width of 1e-6 makes 1e-10 of a blow.
    assert found["j.s_dot"] == pytest.approx(4.0, abs=1e-8)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("integrator", ["rkf45", "dop853", "rodas4", "rodas5"])
def test_other_integrators_end_as_in_python(compiler: str, tmp_path: Path, integrator: str) -> None:
    model = load("slider-pendulum").compile(["L"])
    project = model.write(tmp_path, integrator)
    values = printed(run([build(project, compiler)], tmp_path))
    result = model.simulate((0.0, 10.0), [10.0], "dop853", 1e-12, 1e-13)
    # The scene's rtol of 1e-8, through hundreds of steps.
    assert values["j1.s"] == pytest.approx(result["j1.s"][-1], abs=1e-7)
    assert values["d(j1.s)/d(L)"] == pytest.approx(result.sensitivity("j1.s", "L")[-1], abs=1e-6)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ["rodas4", "rodas5"])
def test_points_between_steps_of_stiff_methods(compiler: str, tmp_path: Path, method: str) -> None:
    for name, text in with_runtime(method_files(method)).items():
        (tmp_path / name).write_text(text)
    driver = Path(__file__).with_name("rodas4_driver.c").read_text()
    for old in ("rodas4", "RODAS4"):
        driver = driver.replace(old, method if old.islower() else method.upper())
    (tmp_path / "driver.c").write_text(driver)
    sources = ["driver.c", f"cotree_{method}.c", "cotree_integrator.c", "-lm"]
    run([compiler, "-std=c99", "-O1", *STRICT, *SANITIZE, "-o", "driver", *sources], tmp_path)
    for rtol in (1e-5, 1e-8):
        lines = run(["./driver", str(rtol)], tmp_path).splitlines()
        status, at_ends, between = (float(word) for word in lines[0].split())
        assert status == OK
        # The tolerance, through tens to hundreds of steps, of a sensitivity that grows to 2.5.
        assert at_ends < 50 * rtol
        # The polynomial is of the order of the error estimate, and as good.
        assert between < 100 * rtol
        assert int(lines[1]) == BAD_ARGUMENT


@pytest.mark.sampled(2)
@pytest.mark.parametrize("integrator", ["dopri5", "rodas5"])
def test_pieces_that_end_at_a_time_end_a_step(tmp_path, compiler, integrator):
    scene = Scene("falling-steps")
    scene.edge("V", "voltage_source", "a", "ground", voltage="floor(max(3 - 2*t, 0))")
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    scene.simulation(t_end=2.0, rtol=1e-6)
    project = scene.compile().write(tmp_path, integrator)
    found = printed(run([build(project, compiler)], tmp_path))["C.v"]
    expected = 0.0
    for level in (2.0, 1.0, 0.0, 0.0):  # for half a time constant each
        expected = level + (expected - level) * math.exp(-0.5)
    # Steps over the breakpoints at 0.5 s and 1 s left 2e-6 and more; smooth pieces leave 1e-8.
    assert found == pytest.approx(expected, abs=1e-7)


@pytest.mark.sampled(2)
def test_more_time_events_than_can_be_listed_are_refused(tmp_path, compiler):
    scene = Scene("sawtooth")
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("F", "force_source", "ground", "A", force="4*t - floor(4*t)")
    scene.simulation(t_end=3.0)
    program = build(scene.compile().write(tmp_path), compiler)
    # The mean force is one half.
    assert printed(run([program], tmp_path))["M.v"] == pytest.approx(1.5, abs=1e-7)
    # 4e10 exceeds the range of int, and 4e7 the limit of a series.
    for t_end in ("1e10", "1e7"):
        done = execute([program, t_end], tmp_path)
        assert done.returncode == 1
        assert "too many time events to list: the shortest period is 0.25 s" in done.stderr


def rows_of(text: str) -> tuple[list[str], np.ndarray]:
    head, *rows = text.splitlines()
    return head.split(","), np.array([[float(cell) for cell in row.split(",")] for row in rows]).T


@pytest.mark.parametrize("integrator", ["dopri5", "rk4"])
def test_the_way_is_printed_as_python_has_it(tmp_path, compiler, integrator):
    scene = load("slider-pendulum")
    model = scene.compile(["L", "k"])
    step = 0.001 if integrator == "rk4" else None
    program = build(model.write(tmp_path, integrator, step), compiler)
    head, values = rows_of(run([program, "2.0", "21"], tmp_path))
    result = model.simulate((0, 2), np.linspace(0, 2, 21), method="dopri5")
    assert head == list(result.columns())
    # The same method takes the same steps; 1 ms are a thousandth of a period for the other one, and
    # Python's run has its own tolerance of 1e-8.
    for title, row in zip(head, values, strict=True):
        expected = result.columns()[title]
        allowed = (1e-12 if integrator == "dopri5" else 1e-7) * max(1.0, np.max(np.abs(expected)))
        np.testing.assert_allclose(row, expected, rtol=0, atol=allowed, err_msg=title)


def test_the_way_of_a_ball_leaves_events_to_the_other_stream(tmp_path, compiler):
    model = load("bouncing-ball").compile()
    program = build(model.write(tmp_path), compiler)
    done = execute([program, "2.0", "11"], tmp_path)
    head, values = rows_of(done.stdout)
    assert done.returncode == 0
    assert done.stderr.startswith("hit[0] = 0.638550856814")
    assert head[:2] == ["t", "j.s"]
    # Free fall from 2 m until the first hit; values are known to the tolerance of the scene.
    assert values[1, :4] == pytest.approx(2 - 0.5 * 9.81 * values[0, :4] ** 2, abs=1e-7)


@pytest.mark.parametrize(
    ("arguments", "why"),
    [
        (["1", "1"], "the number of points must be an integer of at least 2"),
        (["1", "2.5"], "the number of points must be"),
        (["0", "3"], "points need an end time other than 0"),
        (["1", "3", "4"], "only the end time and the number of points have no option"),
        (["x"], "the end time is not a finite number"),
    ],
)
def test_wrong_arguments_are_told(tmp_path_factory, compiler, arguments, why):
    folder = tmp_path_factory.getbasetemp() / "arguments"
    if not folder.exists():
        build(load("spring-mass-damper").compile().write(folder), compiler)
    done = execute(["./spring_mass_damper", *arguments], folder)
    assert done.returncode == 2
    assert why in done.stderr
    assert not done.stdout
