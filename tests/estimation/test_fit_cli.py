"""The command ``cotree fit``: printed table, written files, and error messages."""

from __future__ import annotations

import json

import numpy as np
import pytest

import cotree
from cotree.cli import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a scene file and two records of a discharge: R = 3, and v(0) = 5 and 4."""
    folder = tmp_path_factory.mktemp("fit")
    scene = cotree.Scene("discharge")
    scene.parameter("R", 2.0, unit="ohm")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 4.0})
    scene.edge("R", "resistor", "a", "ground", resistance="R")
    scene.save(folder / "discharge.toml")
    t = np.linspace(0.0, 5.0, 21)
    for name, v0, seed in (("run1", 5.0, 1), ("run2", 4.0, 2)):
        v = v0 * np.exp(-t / 3.0) + 0.05 * np.random.default_rng(seed).standard_normal(21)
        rows = [f"{a},{1e3 * b:.6g}" for a, b in zip(t, v, strict=True)]
        (folder / f"{name}.csv").write_text("\n".join(["time,v [mV]", *rows]))
    return folder


def fit(folder, *options, data=("run1.csv", "run2.csv")):
    given = [part for name in data for part in ("--data", str(folder / name))]
    return main(["fit", str(folder / "discharge.toml"), *options, *given])


def test_estimates_are_printed_plotted_and_written(folder, capsys):
    ranges = ["--estimate", "R=0.1:100:log", "C.v=0:10", "--per-experiment", "C.v"]
    files = ["--plot", str(folder / "fit.png"), "-o", str(folder / "fit.json")]
    code = fit(folder, *ranges, "--observe", "v=C.v", "--starts", "3", *files)
    text = capsys.readouterr().out
    assert code == 0
    for name in ("R", "C.v[run1]", "C.v[run2]", "noise[v]"):
        assert f"\n{name} " in text
    assert (folder / "fit.png").read_bytes()[:4] == b"\x89PNG"
    found = json.loads((folder / "fit.json").read_text())
    rows = {row["parameter"]: row for row in found["parameters"]}
    # R must lie within four standard errors. The noise of 0.05 V is estimated from 42 values with
    # a relative standard error of 1 / sqrt(84), about 11 %.
    assert abs(rows["R"]["estimate"] - 3.0) < 4 * rows["R"]["error"]
    assert rows["noise[v]"]["estimate"] == pytest.approx(0.05, rel=0.5)


def test_names_have_default_bounds_and_noise_has_the_unit_of_its_column(folder, capsys):
    options = ["-e", "R", "--observe", "v=C.v", "--noise", "50", "--initial", "C.v=5"]
    assert fit(folder, *options, "--starts", "2", data=["run1.csv"]) == 0
    assert "\nR " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([], "a fit needs something to estimate: give --estimate k=10:100:log"),
        (["-e", "R=1"], "--estimate R=1 is not of the form NAME=LOW:HIGH"),
        (["-e", "R=1:2:log:3"], "--estimate R=1:2:log:3 is not of the form NAME=LOW:HIGH"),
        (["-e", "R=2:1"], "'R' has the bounds 2 and 1"),
        (["-e", "R", "R"], "--estimate names 'R' twice"),
        (["-e", "zeta"], "'zeta' is to be estimated, but the scene 'discharge' has no such"),
        (["-e", "R", "--noise", "1", "--noise", "v=2"], "--noise 1 is that of all columns"),
        (["-e", "R", "--observe", "w=C.v"], "run1.csv has no column 'w'"),
        (["-e", "R", "--observe", "v=R.i"], "column 'v' of run1.csv is given in 'mV', but is in"),
        (["-e", "R", "--plot", "fit.xyz"], "cannot draw 'fit.xyz'"),
    ],
)
def test_invalid_arguments_are_refused(folder, capsys, options, message):
    defaults = [] if "--observe" in options else ["--observe", "v=C.v"]
    assert fit(folder, *options, *defaults, data=["run1.csv"]) == 2
    assert message in capsys.readouterr().err


def test_a_fit_without_data_is_refused(folder, capsys):
    assert fit(folder, "-e", "R", data=[]) == 2
    assert "give --data run1.csv" in capsys.readouterr().err
