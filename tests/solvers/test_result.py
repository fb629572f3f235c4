from __future__ import annotations

import csv
import dataclasses
import stat
import sys

import numpy as np
import pytest

import cotree
from cotree.errors import Error, ModelError
from cotree.solvers import Drift, RunRecord, Statistics


@pytest.fixture
def result() -> RunRecord:
    t = np.array([0.0, 0.1, 1 / 3])
    return RunRecord(
        t=t,
        y=np.array([t, 2 * t]),
        s=np.array([[t + 1, t + 2], [t + 3, t + 4]]),
        states=("k.s", "k.s_dot"),
        outputs=("energy",),
        output_values=np.array([t + 5]),
        output_sensitivities=np.array([[t + 6, t + 7]]),
        inputs=("force",),
        input_values=np.array([t + 8]),
        parameters_of_sensitivity=("m", "c"),
        units={"k.s": "m", "k.s_dot": "m/s", "g": "m/s^2"},
        status=0,
        message="RK45 reached t = 0.3333333333.",
        statistics=Statistics("RK45", 10, 0, 0, 2, 0.5),
        times={"compile": 0.1, "integrate": 0.5},
    )


def test_access_by_name(result):
    assert np.array_equal(result["k.s_dot"], 2 * result.t)
    assert np.array_equal(result["energy"], result.t + 5)
    assert np.array_equal(result["force"], result.t + 8)
    assert result["t"] is result.t
    assert np.array_equal(result.sensitivity("k.s_dot", "c"), result.t + 4)
    assert np.array_equal(result.sensitivity("energy", "m"), result.t + 6)
    assert (result.unit("k.s"), result.unit("energy"), result.unit("t")) == ("m", "", "s")
    assert result.unit("g") == "m/s^2"
    assert result.success
    assert not dataclasses.replace(result, status=-1).success


@pytest.mark.parametrize(
    ("ask", "words"),
    [
        (lambda r: r["k.sdot"], "no state, output or input 'k.sdot'; did you mean 'k.s_dot'?"),
        (lambda r: r.sensitivity("enrgy", "m"), "no state or output 'enrgy'; did you mean"),
        (lambda r: r.sensitivity("force", "m"), "no state or output 'force'; known: energy"),
        (lambda r: r.sensitivity("k.s", "L"), "Sensitivities to 'L' were not requested; known"),
        (lambda r: r.unit("what"), "no quantity 'what'"),
    ],
)
def test_unknown_names(result, ask, words):
    for kind in (KeyError, ModelError):
        with pytest.raises(kind) as caught:
            ask(result)
        # KeyError alone would show the message in quotes.
        assert words in str(caught.value)
        assert not str(caught.value).startswith(("'", '"'))


def test_table(result):
    frame = result.to_dataframe()
    assert list(frame.columns) == [
        *("t", "k.s", "k.s_dot", "energy", "force"),
        *("d(k.s)/d(m)", "d(k.s)/d(c)", "d(k.s_dot)/d(m)", "d(k.s_dot)/d(c)"),
        *("d(energy)/d(m)", "d(energy)/d(c)"),
    ]
    assert np.array_equal(frame["d(energy)/d(c)"], result.t + 7)


def test_table_without_pandas_names_the_extra(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(Error, match=r"cotree\[data\]"):
        result.to_dataframe()


def test_csv_reads_back_equal(result, tmp_path):
    target = tmp_path / "result.csv"
    target.write_text("old")
    result.to_csv(target)
    with target.open(newline="") as file:
        titles, *rows = list(csv.reader(file))
    assert titles == list(result.columns())
    values = np.array(rows, dtype=float).T
    # 17 digits identify a double.
    assert np.array_equal(values, list(result.columns().values()))
    assert [path.name for path in tmp_path.iterdir()] == ["result.csv"]
    assert stat.S_IMODE(target.stat().st_mode) & 0o400


def test_csv_that_fails_leaves_the_old_file(result, tmp_path, monkeypatch):
    target = tmp_path / "result.csv"
    target.write_text("old")
    broken = dataclasses.replace(result, input_values=np.zeros((1, 2)))
    with pytest.raises(ValueError, match="shorter"):
        broken.to_csv(target)
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["result.csv"]


def test_csv_into_no_folder(result, tmp_path):
    with pytest.raises(Error, match=r"cannot write.*nowhere.*: No such file"):
        result.to_csv(tmp_path / "nowhere" / "result.csv")


def test_summary(result):
    text = result.summary()
    assert text.splitlines()[1].startswith("RK45 reached")
    assert "end: t = 0.3333333333 s" in text
    assert "0.6666666667 m/s" in text
    assert "RK45: 2 steps, 10 evaluations, 0 Jacobians." in text
    assert "compile 0.1 s, integrate 0.5 s" in text


def test_plot_asks_the_drawing_module(result, monkeypatch):
    calls = []

    def recorded(drawn, names, *, make):
        calls.append((drawn.t[-1], names))

    monkeypatch.setattr("cotree.plot.plot_result", recorded)
    cotree.Result(**vars(result)).plot(["energy"])
    assert calls == [(result.t[-1], ["energy"])]


def test_the_result_says_how_constraints_are_held():
    t = np.array([0.0, 1.0])
    result = RunRecord(
        t=t,
        y=np.array([t]),
        s=np.zeros((1, 0, 2)),
        states=("x",),
        outputs=(),
        output_values=np.zeros((0, 2)),
        output_sensitivities=np.zeros((0, 0, 2)),
        inputs=(),
        input_values=np.zeros((0, 2)),
        parameters_of_sensitivity=(),
        units={},
        status=0,
        message="DOP853 reached t = 1.",
        statistics=Statistics("DOP853", 10, 0, 0, 2, 0.5),
    )
    assert "onstraint" not in result.summary()
    residual = np.array([[1e-16, 0.0], [0.0, -2e-15]])
    held = dataclasses.replace(result, drift=Drift(("rod", "rod_dot"), residual, 3e-9))
    assert "\nConstraints held to 2e-15, largest correction 3e-09." in held.summary()
    assert list(held.columns()) == ["t", "x"]
