"""Times of a bench: rounds, noise, ties, and rows that another method computed."""

from __future__ import annotations

import dataclasses
import json
import math
import random
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

import cotree
from cotree import Model, ParameterError, Result, load
from cotree.cli import main
from cotree.studies.accuracy import BenchRow, Reference, Solution, fastest
from cotree.studies.bench import time_in_rounds

if TYPE_CHECKING:
    from pathlib import Path


class Clock:
    """Time that passes only where a task says so."""

    def __init__(self) -> None:
        self.now = 0.0

    def __call__(self) -> float:
        return self.now


class Task:
    """A task of a length that varies as the machine disturbs it."""

    def __init__(self, clock: Clock, name: str, lengths: Any) -> None:
        self.clock, self.name, self.lengths = clock, name, iter(lengths)
        self.times: list[float] = []
        self.log: list[str] = []

    def run(self) -> bool:
        self.log.append(self.name)
        self.clock.now += next(self.lengths)
        return True


def test_rounds_begin_with_another_task_each() -> None:
    clock, log = Clock(), []
    tasks = [Task(clock, name, [1.0] * 9) for name in "abc"]
    for task in tasks:
        task.log = log
    time_in_rounds(tasks, Task.run, 3, longest=99.0, until=99.0, clock=clock, spent=clock)
    assert "".join(log) == "abcbcacab"
    assert [task.times for task in tasks] == [[1.0] * 3] * 3


def test_slow_tasks_leave_the_rounds_and_all_end_with_the_budget() -> None:
    clock = Clock()
    slow, quick = Task(clock, "slow", [4.0] * 99), Task(clock, "quick", [1.0] * 99)
    time_in_rounds([slow, quick], Task.run, 99, longest=7.0, until=20.0, clock=clock, spent=clock)
    assert len(slow.times) == 2  # eight seconds are more than seven
    assert clock.now == 16.0  # of quick as many as sum to more than seven
    late = Task(clock, "late", [1.0] * 99)
    time_in_rounds([late], Task.run, 99, longest=99.0, until=18.0, clock=clock, spent=clock)
    assert len(late.times) == 3  # the last one begins at 18


def timed(method: str, seconds: list[float]) -> BenchRow:
    return BenchRow(method, 1e-6, 1e-8, times=seconds, status=0)


def test_a_method_is_alone_only_where_its_gain_exceeds_the_noise() -> None:
    steady, slower = timed("a", [1.0] * 8), timed("b", [1.2] * 8)
    assert fastest([slower, steady]) == (steady,)
    near = timed("c", [1.09] * 8)
    assert fastest([near, steady, slower]) == (near, steady)  # in the order of the rows
    noisy = timed("d", [1.2, 1.2, 1.6, 1.7, 1.7, 1.8, 1.8, 1.9])  # its lower quartile: 1.6
    assert noisy.noise == pytest.approx(1.6 / 1.2 - 1.0)
    assert fastest([steady, noisy]) == (steady, noisy)
    assert fastest([]) == ()


def test_the_fastest_row_of_a_method_stands_for_it() -> None:
    tight, loose = timed("a", [1.0, 1.0]), timed("a", [1.05, 1.05])
    assert fastest([loose, tight]) == (tight,)


@pytest.mark.parametrize("seed", range(5))
def test_benches_on_a_disturbed_machine_agree_or_tell_a_tie(seed: int) -> None:
    """A third of all runs takes up to twice as long, as beside another process on the same core."""
    chance, clock = random.Random(seed), Clock()
    lengths = {"a": 1.0, "b": 1.04, "c": 1.5}

    def disturbed(length: float) -> Any:
        while True:
            late = chance.random() if chance.random() < 1.0 / 3.0 else 0.0
            yield length * (1.0 + 0.01 * chance.random() + late)

    tasks = [Task(clock, name, disturbed(length)) for name, length in lengths.items()]
    time_in_rounds(tasks, Task.run, 25, longest=math.inf, until=math.inf, clock=clock, spent=clock)
    rows = [timed(task.name, task.times) for task in tasks]
    assert [row.method for row in fastest(rows)] == ["a", "b"]


def test_small_quantities_are_judged_by_their_own_size_where_that_is_known() -> None:
    y = np.array([[1.0, 2.0], [1e-6, 2e-6], [1e-17, 0.0]])
    none = np.zeros((3, 0, 2))
    # The third is rounding: both references differ by all of it.
    other = Solution("b", 1e-12, y + np.array([[0.0], [1e-15], [1e-17]]), none)
    reference = Reference(Solution("a", 1e-12, y, none), other, 1e-15, math.nan)
    found = dataclasses.replace(other, y=y + np.array([[1e-6], [2e-8], [1e-9]]))
    states, sensitivities = reference.own_distance(found)
    assert states == pytest.approx(2e-8 / 2e-6)  # the second, of a largest value of 2e-6
    assert math.isnan(sensitivities)
    assert reference.own_agreement == pytest.approx(1e-15 / 2e-6, rel=1e-3)


class Replaced(Model):
    """A model whose dop853 is computed by another method."""

    def simulate(self, *args: Any, **settings: Any) -> Result:
        if settings.get("method") != "dop853":
            return super().simulate(*args, **settings)
        return super().simulate(*args, **{**settings, "method": "DOP853"})


@pytest.fixture(scope="module")
def model() -> Model:
    compiled = load("spring-mass-damper").compile()
    return Replaced(compiled.kernels, compiled.spec, compiled.times)


@pytest.fixture(scope="module")
def report(model: Model) -> Any:
    return cotree.bench(model, (), ["dop853", "RK45"], [1e-4], repeats=1, t_end=0.5)


def test_a_row_that_another_method_computed_is_marked_and_not_recommended(report: Any) -> None:
    replaced, own = report.rows
    assert (replaced.substitute, replaced.n_runs, own.substitute) == ("DOP853", 0, "")
    assert report.recommended(1e-3).method == "RK45"
    assert "replaced by DOP853: not timed" in report.summary()
    assert "replaced by DOP853: not timed" in report._repr_html_()
    assert [row["substitute"] for row in report.to_dict()["rows"]] == ["DOP853", ""]


def test_text_and_json_name_the_machine_and_both_errors(report: Any) -> None:
    data, text = json.loads(json.dumps(report.to_dict(), allow_nan=False)), report.summary()
    named = {"processor", "compiler", "cotree", "sundials", "numpy", "scipy", "python"}
    assert named | {"load_at_start", "load_at_end"} <= data["machine"].keys()
    assert all(data["machine"][key] in text for key in named)
    assert data["own_error"] == "largest |y - ref| / max |ref|"
    assert data["own_error"] in text
    assert data["rows"][1]["own_error_states"] == report.rows[1].own_error_states
    assert data["recommended"]["1e-03"]["tied"] == []


def test_a_quick_bench_has_three_tolerances(tmp_path: Path) -> None:
    file = tmp_path / "b.json"
    arguments = ["--quick", "--method", "RK45", "--t-end", "0.5", "--repeats", "2"]
    assert main(["bench", "spring-mass-damper", *arguments, "--json", str(file)]) == 0
    rows = json.loads(file.read_text(encoding="utf-8"))["rows"]
    assert [row["rtol"] for row in rows] == [1e-3, 1e-6, 1e-9]


def test_a_bench_ends_with_its_budget(model: Model) -> None:
    left = cotree.bench(model, (), ["RK45"], [1e-4], budget=1e-9, t_end=0.5)
    assert left.rows[0].message == "not run: the budget of the bench is exceeded"
    with pytest.raises(ParameterError, match="budget is 0"):
        cotree.bench(model, budget=0.0)
