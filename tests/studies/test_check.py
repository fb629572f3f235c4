"""The check of sensitivities: it passes exact ones, and fails those that are a little wrong."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from cotree import Model, ParameterError, Result, Scene, check, load
from cotree.check import check_sensitivities


class Distorted(Model):
    """A model whose sensitivities are wrong by a factor."""

    factor = 1.0

    def simulate(self, *args: Any, **settings: Any) -> Result:
        result = super().simulate(*args, **settings)
        return replace(result, s=self.factor * result.s)


class WrongOutput(Model):
    """A model whose outputs have sensitivities that are a little wrong."""

    def simulate(self, *args: Any, **settings: Any) -> Result:
        result = super().simulate(*args, **settings)
        return replace(result, output_sensitivities=(1.0 + 1e-5) * result.output_sensitivities)


@pytest.fixture(scope="module")
def oscillator() -> Model:
    return load("spring-mass-damper").compile(["k", "x0", "s.s"])


def test_exact_sensitivities_pass(oscillator: Model) -> None:
    report = check_sensitivities(oscillator, t_end=2.0)
    assert report.passed
    assert [row.name for row in report.rows] == ["k", "x0", "s.s"]
    assert report.t_end == 2.0
    assert all(row.note == "" for row in report.rows)


def test_deviation_falls_with_the_square_of_the_step(oscillator: Model) -> None:
    (row,) = check_sensitivities(oscillator, ["k"], t_end=2.0).rows
    assert row.value == 50.0
    assert row.steps[0] == pytest.approx(5.0)
    assert row.steps[-1] == pytest.approx(5e-8)
    # A decade of h is a factor of 100 of truncation; the next order adds h**2, a percent, at
    # steps of a tenth.
    assert row.deviations[2] / row.deviations[4] == pytest.approx(100.0, rel=0.05)
    # Rounding and integration errors have taken over at the smallest step.
    assert row.deviations[-1] > 10.0 * row.deviation


def test_differences_of_a_model_without_sensitivities(oscillator: Model) -> None:
    plain = load("spring-mass-damper").compile()
    (row,) = check_sensitivities(oscillator, ["k"], t_end=2.0, plain=plain).rows
    (own,) = check_sensitivities(oscillator, ["k"], t_end=2.0).rows
    assert row.passed
    assert row.steps == own.steps
    # Truncation is the same; the runs differ by their tolerance of 1e-12, over the step.
    assert row.deviations[:6] == pytest.approx(own.deviations[:6], rel=1e-3)


def test_linear_dependence_has_no_truncation(oscillator: Model) -> None:
    (row,) = check_sensitivities(oscillator, ["x0"], t_end=2.0).rows
    # The state depends on x0 linearly: only integration errors of 1e-12 over the step remain.
    assert row.deviations[0] < 1e-9


# A factor of 1 + 1e-6 is far above what tolerances of 1e-12 leave of a central difference, about
# 1e-8 at the best step.
@pytest.mark.parametrize("factor", [1.0 + 1e-6, 0.0, -1.0])
def test_wrong_sensitivities_fail(factor: float) -> None:
    # A model of its own: two that share kernels would change each other's parameters.
    exact = load("spring-mass-damper").compile(["k"])
    wrong = Distorted(exact.kernels, exact.spec, exact.times)
    wrong.factor = factor
    report = check_sensitivities(wrong, t_end=2.0)
    assert not report.passed
    assert "FAIL  k" in report.summary()


def test_values_are_the_point_of_comparison(oscillator: Model) -> None:
    (row,) = check_sensitivities(oscillator, ["k"], t_end=1.0, parameters={"k": 20.0}).rows
    assert row.value == 20.0
    assert row.passed


def pendulum() -> Scene:
    scene = Scene("pendulum", gravity=[0, "-g", 0])
    for name, value in {"g": 9.81, "L": 0.5, "extra": 0.0, "idle": 3.0}.items():
        scene.parameter(name, value)
    scene.edge("h", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 1.0})
    scene.edge("rod", "arm", "A", "B", vector=[0, "-L", 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass="2 + extra")
    scene.edge("load", "rigid_body", "ground", "B", mass="extra")
    scene.output("height", "B.y")
    return scene


def test_outputs_are_compared_too() -> None:
    model = pendulum().compile(["L"])
    assert check_sensitivities(model, t_end=1.0).passed
    (row,) = check_sensitivities(
        WrongOutput(model.kernels, model.spec, model.times), t_end=1.0
    ).rows
    assert not row.passed
    assert row.closest == "height"


def test_parameter_that_reaches_nothing_is_noted() -> None:
    with pytest.warns(RuntimeWarning, match="idle"):
        model = pendulum().compile(["idle"])
    (row,) = check_sensitivities(model, t_end=0.5).rows
    assert row.passed
    assert "reaches no state" in row.note
    assert row.note in row.summary()


def test_sensitivity_without_differences_does_not_pass() -> None:
    (row,) = check_sensitivities(pendulum().compile(["extra"]), t_end=0.5).rows
    # A mass of zero cannot be made smaller, so there are no central differences.
    assert not row.passed
    assert np.all(np.isnan(row.deviations))
    assert "load" in row.note
    assert "not available" in row.summary()


def test_names_are_checked(oscillator: Model) -> None:
    with pytest.raises(ParameterError, match="no sensitivity to 'c'"):
        check_sensitivities(oscillator, ["c"])
    with pytest.raises(ParameterError, match="no sensitivity to check"):
        check_sensitivities(oscillator, [])


def test_each_parameter_is_told_as_soon_as_it_is_known(oscillator: Model, monkeypatch) -> None:
    told: list[str] = []
    order: list[str] = []
    whole = check._check

    def noted(runs: Any, name: str) -> Any:
        order.append(f"{name} after {len(told)}")
        return whole(runs, name)

    monkeypatch.setattr(check, "_check", noted)
    report = check_sensitivities(oscillator, ["k", "x0"], t_end=0.5, report=told.append)
    assert order == ["k after 1", "x0 after 2"]
    assert "\n".join(told) == report.summary()
    assert told[-1].strip() == report.verdict == "all sensitivities passed: 2"


@pytest.mark.parametrize(("method", "rtol"), [("DOP853", 1e-9), ("RK45", 1e-8)])
def test_method_and_tolerance_are_those_asked_for(
    oscillator: Model, method: str, rtol: float
) -> None:
    report = check_sensitivities(oscillator, ["k"], t_end=1.0, method=method, rtol=rtol)
    assert report.passed
    assert report.heading.endswith(f"to t = 1 s, {method}, rtol {rtol:g}")
    # Integration errors of 1e-9 and more over the best step hide what 1e-12 shows.
    tight = check_sensitivities(oscillator, ["k"], t_end=1.0)
    assert report.rows[0].tolerance > 10.0 * tight.rows[0].tolerance


def test_failures_are_named_together(oscillator: Model) -> None:
    rows = check_sensitivities(oscillator, t_end=0.5).rows
    failed = replace(rows[1], deviation=1.0)
    report = check.CheckReport((rows[0], failed, rows[2]), 0.5, "dop853", 1e-12)
    assert report.verdict == "1 of 3 sensitivities failed: x0"


def test_a_model_checks_itself(oscillator):
    """Sensitivities that it was not compiled with are compiled for the check."""
    assert [row.name for row in oscillator.check(t_end=0.5).rows] == list(oscillator.sensitivities)
    plain = pendulum().compile()
    report = plain.check(["L"], t_end=0.5)
    assert report.passed
    assert [row.name for row in report.rows] == ["L"]
