"""The bench: errors against closed forms, methods that fail, and references that do not agree."""

from __future__ import annotations

import json
import math
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import cotree
from cotree import Model, ParameterError, Result, Scene, SceneError, SolveError, load
from cotree.cli import main
from cotree.studies.accuracy import Solution, find_reference

if TYPE_CHECKING:
    from pathlib import Path

    from cotree.studies.bench_report import BenchReport

OMEGA = 3.0


def swing() -> Scene:
    """A mass on a spring, x'' = -k x from x = 1: x = cos(sqrt(k) t)."""
    scene = Scene("swing")
    scene.parameter("k", OMEGA**2)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("s", "translational_spring", "ground", "A", stiffness="k", initial={"s": 1.0})
    return scene


@pytest.fixture(scope="module")
def report() -> BenchReport:
    return cotree.bench(swing(), ["k"], ["RK45", "DOP853"], [1e-4, 1e-7], repeats=2, t_end=1.0)


def test_errors_are_those_against_the_closed_form(report: BenchReport) -> None:
    model = swing().compile(["k"])
    t = np.linspace(0.0, 1.0, 101)
    exact = {
        "s.s": (np.cos(OMEGA * t), -t * np.sin(OMEGA * t) / (2.0 * OMEGA)),
        "m.v": (
            -OMEGA * np.sin(OMEGA * t),
            -np.sin(OMEGA * t) / (2.0 * OMEGA) - t * np.cos(OMEGA * t) / 2.0,
        ),
    }
    for row in report.rows:
        result = model.simulate((0, 1), t, method=row.method, rtol=row.rtol, atol=row.atol)
        found: list[list[float]] = [[], []]
        for name, values in exact.items():
            rows = (result[name], result.sensitivity(name, "k"))
            for errors, value, expected in zip(found, rows, values, strict=True):
                scale = max(1.0, np.max(np.abs(expected)))
                errors.append(np.max(np.abs(value - expected)) / scale)
        # The reference is as wrong as two methods differ, and rounding of the closed form.
        allowed = 2.0 * report.reference.agreement + 1e-14
        assert row.error_states == pytest.approx(max(found[0]), abs=allowed)
        assert row.error_sensitivities == pytest.approx(max(found[1]), abs=allowed)
    assert report.reference.agreement < 1e-11
    assert report.reference.solution.method != report.reference.other.method


def test_rows_and_recommendation(report: BenchReport) -> None:
    cells = [(row.method, row.rtol, row.n_runs, row.status) for row in report.rows]
    assert cells == [(m, tol, 2, 0) for m in ("RK45", "DOP853") for tol in (1e-4, 1e-7)]
    for target in (1e-3, 1e-6, 1e-9):
        able = [row for row in report.rows if max(row.error, row.own_error) <= target]
        best, tied = report.recommended(target), report.tied(target)
        assert tied[:1] == ((best,) if best else ())
        # The fastest is among those that tie, and no method is there twice.
        assert (min(able, key=lambda row: row.least) in tied) if able else not tied
        assert len({row.method for row in tied}) == len(tied)
    assert report.recommended(1e-15) is None  # the reference is not known that well
    assert all(row.statistics and row.statistics.nfev > 0 for row in report.rows)


def test_the_report_in_text_json_and_picture(report: BenchReport, tmp_path: Path) -> None:
    text = report.summary()
    assert "DOP853 at rtol 1e-13 and Radau at rtol 1e-12 agree to" in text
    assert "largest |y - ref| / max(1, max |ref|)" in text
    report.to_json(tmp_path / "bench.json")
    data = json.loads((tmp_path / "bench.json").read_text())
    assert [row["error_states"] for row in data["rows"]] == [r.error_states for r in report.rows]
    best = report.recommended(1e-3)
    assert best is not None
    assert data["recommended"]["1e-03"]["method"] == best.method
    with pytest.raises(SceneError, match="cannot write"):
        report.to_json(tmp_path / "nowhere" / "bench.json")
    axes = report.plot().axes
    assert [ax.get_xlabel() for ax in axes] == ["error of states", "error of sensitivities to k"]
    curves = {line.get_label(): line.get_xydata() for line in axes[1].lines}
    for method in ("RK45", "DOP853"):
        rows = [row for row in report.rows if row.method == method]
        least = report.reference.agreement_sensitivities
        assert curves[method].tolist() == [
            [max(r.error_sensitivities, least), r.seconds] for r in rows
        ]


def test_the_error_is_scaled_by_each_quantity_and_absolute_below_one() -> None:
    reference = Solution("a", 1e-12, np.array([[0.0, 100.0], [1e-6, 0.0]]), np.zeros((2, 0, 2)))
    result = SimpleNamespace(y=reference.y + np.array([[0.1, 0.0], [0.0, 0.0]]), s=reference.s)
    states, sensitivities = reference.distance(result)  # type: ignore[arg-type]
    assert states == pytest.approx(0.1 / 100.0)
    assert math.isnan(sensitivities)
    result.y = reference.y + np.array([[0.0, 0.0], [0.0, 1e-2]])
    assert reference.distance(result)[0] == pytest.approx(1e-2)  # type: ignore[arg-type]
    result.y = reference.y + np.nan
    assert reference.distance(result)[0] == math.inf  # type: ignore[arg-type]


def solved(value: float) -> Any:
    return SimpleNamespace(
        success=True, message="", y=np.full((1, 2), value), s=np.zeros((1, 0, 2))
    )


def test_the_reference_is_that_of_the_two_that_agree_best() -> None:
    values = {"DOP853": 0.5, "Radau": 1.0, "LSODA": 1.0 + 1e-8, "cvode": 1.0 - 5e-8}
    values |= {"dop853": 2.0, "rodas5": 3.0}
    pair = find_reference(lambda method, rtol: solved(values[method]), is_stiff=False)
    assert (pair.solution.method, pair.other.method) == ("Radau", "LSODA")
    assert pair.agreement == pytest.approx(1e-8, rel=1e-6)


def test_without_an_agreement_there_is_a_sentence() -> None:
    def run(method: str, rtol: float) -> Any:
        if method == "Radau":
            raise SolveError("out of order")
        return solved(float(ord(method[0])))

    with pytest.raises(SolveError, match=r"no two methods agree to 1e-06.*Radau: out of order"):
        find_reference(run, is_stiff=False)


class Refusing(Model):
    """A model that one method cannot take."""

    def simulate(self, *args: Any, **settings: Any) -> Result:
        if settings.get("method") == "RK23":
            raise SolveError("this is not for RK23")
        return super().simulate(*args, **settings)


@pytest.mark.slow
def test_methods_that_fail_or_are_too_slow_are_rows_with_their_reason() -> None:
    """A decay within 1e-6 s keeps RK45 at steps of 3e-6 s: three hundred thousand of them."""
    scene = Scene("fast")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1e-6, initial={"v": 1.0})
    scene.edge("R", "resistor", "a", "ground", resistance=1.0)
    compiled = scene.compile()
    model = Refusing(compiled.kernels, compiled.spec, compiled.times)
    report = cotree.bench(
        model, methods=["RK23", "RK45", "LSODA"], tolerances=[1e-4, 1e-5], repeats=1, time_limit=0.2
    )
    assert report.reference.solution.method != "DOP853"  # the scene is seen to be stiff
    refused, _, slow, slower, *good = report.rows
    assert (refused.status, refused.message) == (-1, "this is not for RK23")
    assert slow.status == slower.status == -2
    assert "time limit of 0.2 s" in slow.message
    assert slower.message == "not run: a run at rtol 1e-04 exceeded the time limit"
    assert math.isnan(slow.seconds)
    assert math.isnan(slow.error)
    assert all(row.success for row in good)
    assert "this is not for RK23" in report.summary()
    assert "RK45: no run" in report.plot().axes[0].get_legend_handles_labels()[1]
    assert json.dumps(report.to_dict(), allow_nan=False)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"methods": ["RK54"]}, "no method 'RK54'"),
        ({"repeats": 0}, "repeats is 0"),
        ({"tolerances": [-1e-3]}, "rtol"),
        ({"tolerances": [(1e-3, 1e-5, 1e-7)]}, r"give rtol, or \(rtol, atol\)"),
        ({"time_limit": 0.0}, "time_limit"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(cotree.Error, match=message):
        cotree.bench(swing(), **settings)


def test_a_compiled_model_has_its_own_sensitivities() -> None:
    with pytest.raises(ParameterError, match="compiled with"):
        cotree.bench(load("spring-mass-damper").compile(["k"]), ["c"])


def test_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = "bench spring-mass-damper -s k --method RK45 --tolerance 1e-4 --tolerance 1e-6,1e-6"
    files = ["--json", str(tmp_path / "b.json"), "--plot", str(tmp_path / "b.svg")]
    assert main([*arguments.split(), "--t-end", "0.5", "--repeats", "1", *files]) == 0
    text = capsys.readouterr().out
    assert "recommended, the fastest whose error is at most" in text
    rows = json.loads((tmp_path / "b.json").read_text())["rows"]
    assert [(row["rtol"], row["atol"]) for row in rows] == [(1e-4, 1e-6), (1e-6, 1e-6)]
    assert (tmp_path / "b.svg").stat().st_size > 1000
    assert main(["bench", "spring-mass-damper", "--tolerance", "tight"]) == 2
    assert "--tolerance 'tight'" in capsys.readouterr().err
