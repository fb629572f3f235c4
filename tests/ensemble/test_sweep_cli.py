"""The command that sweeps, as it is called at a prompt."""

import csv

import numpy as np
import pytest
import xarray

import cotree
from cotree.cli import main
from cotree.ensemble import run as running

SWEEP = ["sweep", "slider-pendulum", "--t-end", "1", "--points", "5"]


def test_a_grid_goes_into_a_file_of_netcdf_and_a_picture(tmp_path, capsys):
    to, picture = tmp_path / "out.nc", tmp_path / "out.png"
    grid = ["--grid", "L=0.8:1.2:3", "--grid", "k=40,50", "--grid", "j1.s=0.4"]
    assert main([*SWEEP, *grid, "-s", "L", "-o", str(to), "--plot", str(picture)]) == 0
    printed = capsys.readouterr().out
    assert "6 members, L (3) x k (2) x initial(j1.s) (1); 5 times, dop853" in printed
    assert "0 failed" in printed
    with xarray.open_dataset(to) as runs:
        assert dict(runs.sizes) == {"L": 3, "k": 2, "initial(j1.s)": 1, "time": 5, "parameter": 1}
        run = (
            cotree.load("slider-pendulum")
            .compile(["L"])
            .simulate(
                (0, 1), np.linspace(0, 1, 5), "dop853", parameters={"L": 1.2}, initial={"j1.s": 0.4}
            )
        )
        own = runs.sel(L=1.2, k=50).isel({"initial(j1.s)": 0})
        np.testing.assert_allclose(own["j1.s"], run["j1.s"], rtol=1e-12)
        np.testing.assert_allclose(
            own["d(j1.s)"][:, 0], run.sensitivity("j1.s", "L"), rtol=0, atol=1e-12
        )
    assert picture.stat().st_size > 1000


def test_samples_go_into_a_table_and_the_same_seed_draws_the_same(tmp_path):
    drawn = ["--sample", "L=uniform:0.9:1.1", "--sample", "k=relative:0.1", "--members", "8"]
    for name in ("a.csv", "b.csv"):
        to = ["--seed", "1", "--sampling", "latin", "-s", "L", "-o", str(tmp_path / name)]
        assert main([*SWEEP, *drawn, *to]) == 0
    text = (tmp_path / "a.csv").read_text()
    assert text == (tmp_path / "b.csv").read_text()
    title, *rows = csv.reader(text.splitlines())
    assert title[:5] == ["member", "L", "k", "time", "j1.s"]
    assert "d(rod_x)/d(L)" in title
    assert len(rows) == 8 * 5
    members = cotree.sample(
        cotree.load("slider-pendulum"),
        {"L": ("uniform", 0.9, 1.1), "k": ("relative", 0.1)},
        8,
        method="latin",
        seed=1,
    )
    assert float(rows[-1][1]) == members["L"][7]


def test_a_table_gives_members_with_labels(tmp_path, capsys):
    (tmp_path / "table.csv").write_text("member; L; j1.s\nshort; 0.9; 0.4\nlong; 1.1; 0.5\n")
    to = tmp_path / "out.zarr"
    for _ in range(2):  # the second one takes the place of the first
        assert main([*SWEEP, "--members", str(tmp_path / "table.csv"), "-o", str(to)]) == 0
    with xarray.open_zarr(to) as runs:
        assert runs["member"].values.tolist() == ["short", "long"]
        assert runs["initial(j1.s)"].values.tolist() == [0.4, 0.5]
    assert [path.name for path in tmp_path.iterdir() if path.name.startswith(".")] == []


def test_members_that_fail_are_listed_with_values_and_sentences(capsys):
    assert main([*SWEEP, "--grid", "m1=-1,1", "--grid", "L=1,2"]) == 0
    printed = capsys.readouterr()
    assert "2 failed" in printed.out
    assert "failed: m1 = -1, L = 2: mass of edge 'm5' is -1" in printed.out
    assert printed.err == ""
    assert main([*SWEEP, "--grid", "m1=-1,1", "--on-error", "raise"]) == 1
    assert "cotree: the member m1 = -1 failed: mass" in capsys.readouterr().err
    # Nothing came out of this one.
    assert main([*SWEEP, "--grid", "m1=-1,-2"]) == 1


def test_a_sweep_goes_on_from_its_store(tmp_path, capsys):
    arguments = [*SWEEP, "--grid", "L=0.9,1.1", "--store", str(tmp_path / "runs.zarr")]
    assert main(arguments) == 0
    first = capsys.readouterr().out.splitlines()
    assert main(arguments) == 0
    assert capsys.readouterr().out.splitlines()[3:] == first[3:]
    assert main([*SWEEP, "--grid", "k=40,50", "--store", str(tmp_path / "runs.zarr")]) == 2
    assert "contains another ensemble" in capsys.readouterr().err


def test_gains_of_inputs_are_swept(capsys):
    arguments = ["sweep", "cart-pole", "--t-end", "1", "--points", "3", "--input"]
    feedback = "push=-k*hinge.theta - 8*hinge.theta_dot"
    assert main([*arguments, feedback, "--grid", "k=30,40"]) == 0
    assert "2 members, k (2)" in capsys.readouterr().out


def test_an_interrupted_sweep_writes_what_is_done(tmp_path, monkeypatch, capsys):
    blocks = running.run_blocks

    def run_blocks(*args, stop, **kwargs):
        for row in blocks(*args, stop=stop, **kwargs):
            yield row
            stop.set()

    monkeypatch.setattr(running, "run_blocks", run_blocks)
    to = tmp_path / "out.nc"
    more = ["--grid", "L=0.9:1.1:50", "--threads", "1", "--lanes", "1", "-o", str(to)]
    assert main([*SWEEP, *more]) == 130
    printed = capsys.readouterr()
    assert "stopped after 1 of 50 members" in printed.err
    assert "1 run in" in printed.out
    with xarray.open_dataset(to) as runs:
        assert (runs["status"] == -3).sum() == 49


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ([], "a sweep needs members"),
        (["--grid", "L"], "--grid 'L' is not of the form name=value"),
        (["--grid", "L=a,b"], "--grid L=a,b is not a range or a list"),
        (["--grid", "L=1:2"], "--grid L=1:2 is not a range"),
        (["--grid", "L=1:2:2.5"], "--grid L=1:2:2.5 is not a range"),
        (["--grid", "L=1:2:3:cubic"], "ends in 'cubic'"),
        (["--grid", "L=-1:2:3:log"], "is logarithmic"),
        (["--grid", "L=1:2:0"], "has 0 values"),
        (["--grid", "L=1,1"], "axis 'L' of the grid has 1 twice"),
        (["--grid", "L=1,nan"], "axis 'L' of the grid, row 1, is nan"),
        (["--grid", "L=1", "--grid", "L=2"], "--grid gives 'L' twice"),
        (["--grid", "LL=1,2"], "the column 'LL'"),
        (["--grid", "L=1,2", "--set", "L=3"], "'L' is a column of members and in parameters="),
        (["--grid", "L=1,2", "--members", "8"], "leave out --members 8"),
        (["--grid", "L=1,2", "--seed", "8"], "--seed sets how members are drawn"),
        (["--grid", "L=1,2", "--sample", "k=relative:0.1"], "exclude each other"),
        (["--members", "8"], "--members 8 is the number of samples"),
        (["--members", "no.csv"], "'no.csv' is not a file"),
        (["--members", "-3"], "'-3' is not a file"),
        (["--sample", "k=relative:0.1"], "give --members 200"),
        (["--sample", "k=relative:x", "--members", "8"], "--sample k=relative:x is no"),
        (["--sample", "k=normal:1", "--members", "8"], "--sample: the distribution of 'k'"),
        (["--sample", "k=gauss:1:2", "--members", "8"], "unknown kind 'gauss'"),
        (["--sample", "k=relative:0.1", "--members", "0"], "number of members is 0"),
        (["--sample", "k=relative:0.1", "--members", "8", "--sampling", "x"], "drawing is 'x'"),
        (["--grid", "L=1", "-o", "out.txt"], "unknown suffix '.txt'"),
        (["--grid", "L=1", "-o", "no/out.nc"], "there is no folder 'no'"),
        (["--grid", "L=1", "-o", "folder.nc"], "folder of other files"),
        (["--grid", "L=1", "--plot", "out.gif"], "unknown suffix '.gif'"),
        (["--grid", "L=1", "--show", "L"], "also give --plot FILE"),
        (["--grid", "L=1", "--plot", "p.png", "--show", "j1.z"], "cannot plot 'j1.z'"),
        (["--grid", "L=1", "--output", "rodx"], "did you mean 'rod_x'"),
        (["--grid", "L=1", "--of", "sum"], "--of is 'sum'"),
        (["--grid", "L=1", "--on-error", "stop"], "give 'keep' or 'raise'"),
        (["--grid", "L=1", "--method", "dop85"], "no method 'dop85'"),
        (["--grid", "L=1", "--threads", "0"], "--threads"),
        (["--grid", "L=1", "--rtol", "-1"], "rtol"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(arguments, told, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder.nc").mkdir()
    assert main([*SWEEP, *arguments]) == 2
    printed = capsys.readouterr().err
    assert told in " ".join(printed.replace("│", " ").split())
    assert "Traceback" not in printed
    assert [path.name for path in tmp_path.iterdir()] == ["folder.nc"]


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "is not a table"),
        ("L\n", "members are empty"),
        ("L\nx\n", "'L' of members, row 0, is 'x'"),
        ("L,k\n1,2\n1\n", "'k' of members, row 1, is nan"),
        ("L,L\n1,2\n", "'L.1'"),
        ("m,L\n1,2\n", "the column 'm'"),
        ("member,L\na,1\na,2\n", "has a 2 times"),
    ],
)
def test_wrong_tables_are_refused(text, told, tmp_path, capsys):
    table = tmp_path / "table.csv"
    table.write_text(text)
    assert main([*SWEEP, "--members", str(table)]) == 2
    assert told in capsys.readouterr().err
