"""Models with algebraic unknowns as C programs: solved for at each evaluation."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from c_programs import build, printed, run
from hand_made import Made, model_of
from loop_with_network import four_bar, with_a_network

from cotree import load
from cotree.export.c_project import write_c_project
from cotree.pipeline import formulate

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]


def bridge() -> Made:
    """Four diodes, a capacitor and a load; the pivot of the first unknown is zero at first."""

    def rates(v):
        dag = v["t"].dag
        source = v["E"] * dag.function("sin", 300.0 * v["t"]) * (1.0 + v["e"])

        def diode(voltage):
            return v["Is"] * (dag.function("exp", voltage / 0.05) - 1.0)

        top, bottom = v["a"], v["b"]
        i1, i2 = diode(top - v["C.v"] - v["low"]), diode(v["low"] - bottom)
        i3, i4 = diode(bottom - v["C.v"] - v["low"]), diode(v["low"] - top)
        return [
            (i1 + i3 - v["C.v"] / v["R"]) / v["C"],
            top - bottom + 10.0 * v["i"] - source,
            v["i"] - i1 + i4,
            i1 + i3 - i2 - i4 - 1e-9 * v["low"],
            i2 - i3 - v["i"] + 1e-6 * bottom,
        ]

    return Made(
        "bridge",
        {"C.v": 0.1},
        {"i": 0.0, "a": 0.0, "b": 0.0, "low": 0.0},
        {"E": 3.0, "R": 500.0, "C": 1e-5, "Is": 1e-6},
        rates,
        lambda v: {"power": v["i"] * (v["a"] - v["b"])},
        {"e": lambda p: 0.1 * p["t"]},
    )


# rodas5 has sensitivities of unknowns in its error test, here up to 1e5: with an absolute tolerance
# below 1e-10 its steps shrink to nothing.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "sensitivities"),
    [
        ("dopri5", ()),
        ("rodas5", ()),
        pytest.param("dopri5", ("R", "Is"), marks=pytest.mark.slow),
    ],
)
def test_ends_as_in_python(
    compiler: str, tmp_path: Path, sensitivities: tuple[str, ...], method: str
) -> None:
    model = bridge().model(sensitivities)
    # That of sensitivities is this by the size of a parameter, here 500: less is below rounding.
    atol = 5e-11 if sensitivities else 1e-13
    project = write_c_project(
        model.kernels.program, tmp_path, method, t_end=0.017, rtol=1e-11, atol=atol
    )
    values = printed(run([build(project, compiler)], tmp_path))
    result = model.simulate((0.0, 0.017), [0.017], "rodas5", 1e-10, atol, throw=True)
    # Two methods with errors of 1e-10 in each of some thousand steps, which the capacitor mends.
    for name in (*model.states, *model.outputs):
        expected = float(result[name][-1])
        assert values[name] == pytest.approx(expected, rel=1e-7, abs=1e-10), name
        for parameter in sensitivities:
            expected = float(result.sensitivity(name, parameter)[-1])
            size = float(abs(result.s[:, sensitivities.index(parameter)]).max())
            key = f"d({name})/d({parameter})"
            assert values[key] == pytest.approx(expected, rel=1e-6, abs=1e-8 * size), name


@pytest.mark.slow
@pytest.mark.parametrize("method", [pytest.param("dopri5", marks=pytest.mark.slow), "rodas5"])
@pytest.mark.parametrize("sensitivities", [(), ("a",)])
def test_with_constraints(
    compiler: str, tmp_path: Path, sensitivities: tuple[str, ...], method: str
) -> None:
    model = model_of(with_a_network(formulate(four_bar(), sensitivities, None)[1]))
    project = write_c_project(
        model.kernels.program, tmp_path, method, t_end=1.0, rtol=1e-11, atol=1e-12
    )
    values = printed(run([build(project, compiler)], tmp_path))
    result = model.simulate((0.0, 1.0), [1.0], "dop853", 1e-12, 1e-13, throw=True)
    # As for constraints alone: some hundred steps at 1e-11, enlarged by the motion.
    for name in model.states:
        assert values[name] == pytest.approx(float(result[name][-1]), abs=1e-7), name
        for parameter in sensitivities:
            expected = float(result.sensitivity(name, parameter)[-1])
            found = values[f"d({name})/d({parameter})"]
            assert found == pytest.approx(expected, abs=1e-6), name


@pytest.mark.slow
@pytest.mark.parametrize("sensitivities", [(), pytest.param(("Rs", "Is"), marks=pytest.mark.slow)])
def test_shipped_rectifier_runs_to_its_end(
    compiler: str, tmp_path: Path, sensitivities: tuple[str, ...]
) -> None:
    """Steps that reach far into another diode's turn leave guesses that lead nowhere."""
    model = load("bridge-rectifier").compile(list(sensitivities))
    project = write_c_project(model.kernels.program, tmp_path, t_end=0.1, rtol=1e-8, atol=1e-10)
    values = printed(run([build(project, compiler)], tmp_path))
    result = model.simulate((0.0, 0.1), [0.1], "dop853", 1e-11, 1e-13, throw=True)
    # Some hundred steps with errors of 1e-8, which the load mends.
    for name in model.states:
        assert values[name] == pytest.approx(float(result[name][-1]), rel=1e-7), name
        for parameter in sensitivities:
            expected = float(result.sensitivity(name, parameter)[-1])
            assert values[f"d({name})/d({parameter})"] == pytest.approx(expected, rel=1e-6), name


@pytest.mark.parametrize("rtol", ["1e-3", "1e-4", "1e-6"])
@pytest.mark.parametrize(("real", "spacing"), [("double", 2.0**-52), ("float", 2.0**-23)])
def test_accepted_points_solve_their_equations(
    compiler: str, tmp_path: Path, real: str, spacing: float, rtol: str
) -> None:
    """Unknowns were up to 15 mV off, where currents of diodes are doubled, and the run stopped."""
    model = load("bridge-rectifier").compile(["RL"])
    project = model.write(tmp_path, "rodas5", real=real)
    driver = Path(__file__).with_name("accepted_driver.c").read_text()
    (tmp_path / "main.c").write_text(f"#define REAL {real}\n{driver}")
    words = run([build(project, compiler), rtol], tmp_path).split()
    status, t, of_states, of_sensitivities = int(words[0]), *map(float, words[2:])
    assert (status, t) == (0, pytest.approx(0.05))
    # Diodes enlarge the rounding of 12 V by 12 V / U; it meets 24 A, what the winding could drive.
    rounding = 24.0 * 12.0 / 0.02585 * spacing
    assert of_states < rounding
    # Their derivatives contain currents by U, times dv/dRL: a millivolt for an ohm of a hundred.
    assert of_sensitivities < 1e-3 / 0.02585 * rounding
