"""The Dataset of an ensemble, and what happens to members that fail."""

import json
import os
import signal
import sys
import threading

import numpy as np
import pandas as pd
import pytest
import xarray

import cotree
from cotree.ensemble import run as running
from cotree.errors import Error, SolveError

LENGTHS = [0.9, 1.0, 1.1]


@pytest.fixture(scope="module")
def model():
    return cotree.load("slider-pendulum").compile(["L", "k"])


@pytest.fixture(scope="module")
def runs(model):
    return model.ensemble((0, 2), {"L": LENGTHS, "j1.s": 0.4}, t_eval=5)


def test_every_value_is_that_of_a_single_run(model, runs):
    run = model.simulate(
        (0, 2), np.linspace(0, 2, 5), "dop853", parameters={"L": 1.1}, initial={"j1.s": 0.4}
    )
    # Lanes differ from a single run by rounding, which a run of ten steps enlarges a little.
    for name in (*model.states, *model.outputs):
        np.testing.assert_allclose(runs[name][2], run[name], rtol=1e-12, atol=1e-13)
        for parameter in model.sensitivities:
            np.testing.assert_allclose(
                runs[f"d({name})"].sel(member=2, parameter=parameter),
                run.sensitivity(name, parameter),
                rtol=1e-12,
                atol=1e-13,
            )
    assert runs["steps"][2] == run.statistics.n_steps


def test_names_dimensions_units_and_settings(model, runs):
    assert runs["j1.s"].dims == ("member", "time")
    assert runs["d(rod_x)"].dims == ("member", "time", "parameter")
    assert runs["j1.s_dot"].attrs["units"] == "m/s"
    assert runs["time"].attrs["units"] == "s"
    assert runs["L"].attrs == {"long_name": "length of the rod", "units": "m"}
    assert runs["initial(j1.s)"].values.tolist() == [0.4] * 3
    assert runs["parameter_unit"].values.tolist() == ["m", "N/m"]
    assert runs.attrs["method"] == "dop853"
    assert cotree.load("slider-pendulum").name == runs.attrs["scene"]
    assert json.loads(runs.attrs["settings"])["max_steps"] == 1_000_000
    # Enough to run it again.
    assert runs.attrs["scene_toml"].startswith('name = "slider-pendulum"')


def test_attributes_tell_why_members_do_not_run_in_lanes(model, runs):
    def told(model, n, **settings):
        members = {model.parameters[0]: np.full(n, model.default_parameters[0])}
        return model.ensemble((0, 1e-3), members, t_eval=2, **settings).attrs["lanes"]

    assert runs.attrs["lanes"] == (
        "members run one after another: lanes are not compiled for fewer than 100 members unless "
        "lanes= is given"
    )
    assert told(model, 2, lanes=4) == "members run side by side"
    assert told(model, 100, lanes=1) == "members run one after another: one lane is requested"
    assert told(cotree.load("bouncing-ball").compile(), 100) == (
        "members run one after another: there are events"
    )
    assert told(model, 2, method="LSODA") == (
        "members run one after another, in Python: 'LSODA' runs in Python"
    )


def test_a_grid_has_a_dimension_for_each_axis(model):
    runs = model.ensemble((0, 1), cotree.grid({"j1.s": [0.4, 0.5]}, L=LENGTHS), t_eval=[0.5, 1.0])
    assert runs["h2.theta"].dims == ("initial(j1.s)", "L", "time")
    one = model.ensemble((0, 1), {"j1.s": [0.5], "L": [0.9]}, t_eval=[0.5, 1.0])
    np.testing.assert_array_equal(runs["h2.theta"].values[1, 0], one["h2.theta"].values[0])


def test_names_that_mean_something_in_the_dataset_are_told_apart(tmp_path):
    scene = cotree.Scene("names")
    for name in ("time", "member", "status"):
        scene.parameter(name, 1.0)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], initial={"s": "time"})
    scene.edge("body", "rigid_body", "ground", "A", mass="member + status")
    for name in ("seconds", "message"):
        scene.output(name, "2*j.s")
    model = scene.compile(["time"])
    runs = model.ensemble((0, 1), cotree.grid(time=[1, 2], member=[1, 2]), t_eval=3)
    assert runs["j.s"].dims == ("parameter(time)", "parameter(member)", "time")
    np.testing.assert_array_equal(runs["value(seconds)"], 2 * runs["j.s"])
    assert runs["d(value(seconds))"].sel(parameter="time").values == pytest.approx(2.0)
    runs.to_netcdf(tmp_path / "runs.nc")
    listed = model.ensemble((0, 1), {"time": [1, 2], "member": [1, 2]}, t_eval=3)
    assert listed["parameter(member)"].dims == ("member",)


def test_variables_are_views_of_one_array(runs):
    """Memory of ten thousand members must not triple."""
    assert np.shares_memory(runs["j1.s"].values, runs["d(j1.s)"].values.base)


def test_files_give_back_what_was_written(runs, tmp_path):
    runs.to_netcdf(tmp_path / "runs.nc")
    with xarray.open_dataset(tmp_path / "runs.nc") as read:
        xarray.testing.assert_equal(read.load(), runs)
        assert read.attrs["scene_toml"] == runs.attrs["scene_toml"]
    # Without consolidation, of which Zarr warns.
    runs.to_zarr(tmp_path / "runs.zarr", consolidated=False)
    with xarray.open_zarr(tmp_path / "runs.zarr", consolidated=False) as read:
        np.testing.assert_array_equal(read["d(j1.s)"], runs["d(j1.s)"])


def test_a_file_holds_what_it_takes_to_run_the_members_again(tmp_path):
    model = cotree.load("cart-pole").compile()
    feedback = {"push": "-kp*hinge.theta - kd*hinge.theta_dot"}
    members = {"kp": np.linspace(30, 40, 24), "hinge.theta": 0.1}
    shared = {"parameters": {"kd": 8.0}, "initial": {"rail.s": 0.5}, "outputs": []}
    first = model.ensemble((0, 1), members, t_eval=4, rtol=1e-6, inputs=feedback, **shared)
    first.to_netcdf(tmp_path / "runs.nc")
    with xarray.open_dataset(tmp_path / "runs.nc") as kept:
        (tmp_path / "again.toml").write_text(kept.attrs["scene_toml"])
        other = cotree.load(tmp_path / "again.toml").compile()
        again = other.ensemble(
            members={"kp": kept["kp"].values, "hinge.theta": kept["initial(hinge.theta)"].values},
            t_eval=kept["time"].values,
            **json.loads(kept.attrs["settings"]),
        )
    for name in (*model.states, "status", "steps"):
        np.testing.assert_array_equal(again[name], first[name])


def test_tables_of_pandas(runs):
    table = runs[["j1.s", "h2.theta"]].to_dataframe()
    assert table.index.names == ["member", "time"]
    assert table.loc[(1, 2.0), "j1.s"] == float(runs["j1.s"][1, -1])


def test_what_is_left_out_is_not_there(model):
    runs = model.ensemble((0, 1), {"L": [1.0]}, t_eval=3, sensitivities=False, outputs=[])
    assert "parameter" not in runs.dims
    assert "rod_x" not in runs
    assert "d(j1.s)" not in runs


def test_labels_of_a_table_are_coordinates(model, tmp_path):
    table = pd.DataFrame({"L": [0.9, 1.1]}, index=["short", "long"])
    runs = model.ensemble((0, 1), table, t_eval=3)
    assert float(runs["L"].sel(member="long")) == 1.1
    runs.to_netcdf(tmp_path / "runs.nc")


def test_events_are_padded_and_their_times_have_sensitivities():
    """Free fall from h: the n-th bounce is at sqrt(2h/g) (1 + 2e + ... + 2e^(n-1))."""
    scene = cotree.Scene("ball", gravity=[0, 0, -9.81])
    scene.parameter("e", 0.8)
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": 2.0})
    scene.edge("body", "rigid_body", "ground", "B", mass=1.0)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-e*j.s_dot"})
    e = np.array([0.5, 0.9])
    runs = scene.compile(["e"]).ensemble((0, 1.5), {"e": e}, t_eval=3, rtol=1e-10, atol=1e-12)
    fall = np.sqrt(4 / 9.81)
    assert runs["n(hit)"].values.tolist() == [2, 1]
    np.testing.assert_allclose(runs["t(hit)"][:, 0], fall, atol=1e-9)
    np.testing.assert_allclose(runs["t(hit)"][0, 1], fall * (1 + 2 * 0.5), atol=1e-9)
    np.testing.assert_allclose(runs["d(t(hit))"][0, 1, 0], 2 * fall, atol=1e-8)
    assert np.isnan(runs["t(hit)"][1, 1])


def test_a_member_that_fails_is_nan_and_the_warning_counts(model):
    with pytest.warns(RuntimeWarning, match=r"2 of 4 members failed and are nan: .*m1"):
        runs = model.ensemble((0, 1), {"m1": [1.0, -1.0, 2.0, -2.0]}, t_eval=3)
    assert runs["status"].values.tolist() == [0, -1, 0, -1]
    assert "m1" in str(runs["message"][1].item())
    assert np.isnan(runs["j1.s"][1]).all()
    assert np.isfinite(runs["j1.s"][2]).all()
    with pytest.raises(SolveError, match=r"member 1 \(m1 = -1\) failed: .*m1"):
        model.ensemble((0, 1), {"m1": [1.0, -1.0]}, t_eval=3, on_error="raise")


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({"method": "dop85"}, "no method 'dop85'"),
        ({"method": 3}, "give a name in quotes"),
        ({"t_eval": 1}, "at least 2 points"),
        ({"t_eval": 10**9}, "at most 10000000 points"),
        ({"t_eval": [0.0, 5.0]}, "outside the time span"),
        ({"t_eval": "many"}, "t_eval is 'many'"),
        ({"t_eval": True}, "t_eval is True"),
        ({"t_eval": 5.0}, "give a whole number of points, or times"),
        ({"t_eval": ["a"]}, "sequence of numbers"),
        ({"outputs": 3}, "give a list of names"),
        ({"sensitivities": ["L"]}, "give True or False"),
        ({"rtol": -1.0}, "rtol"),
        ({"outputs": ["rodx"]}, "did you mean 'rod_x'"),
        ({"outputs": "j1.s"}, "results have all states"),
        ({"threads": 0}, "threads is 0"),
        ({"threads": 1.5}, "threads is 1.5"),
        ({"lanes": True}, "lanes is True"),
        ({"on_error": "stop"}, "give 'keep' or 'raise'"),
        ({"parameters": {"LL": 1.0}}, "no tunable parameter 'LL'"),
        ({"parameters": [1.0]}, "array of shape"),
        ({"initial": {"j1.x": 1.0}}, "no state 'j1.x'"),
        ({"inputs": {"push": 1.0}}, "no input 'push'"),
        ({"scales": {"m1": 1.0}}, "to which no sensitivity was asked for"),
        ({"max_steps": 0}, "max_steps is 0"),
    ],
)
def test_wrong_settings_are_refused_before_any_member_runs(model, settings, told):
    with pytest.raises(Error, match=told):
        model.ensemble((0, 1), {"L": [0.9, 1.1]}, **settings)


def test_wrong_spans_are_refused(model):
    for span in ((0, 0), (0, np.inf), 3):
        with pytest.raises(Error, match="span"):
            model.ensemble(span, {"L": [0.9]})


def test_results_beyond_the_memory_are_refused(model):
    with pytest.raises(SolveError, match="GiB of memory"):
        model.ensemble((0, 1), {"L": np.ones(10**6)}, t_eval=20_000)


def test_auto_is_decided_once_whatever_the_order():
    """A decay is stiff where the span is millions of its time constants."""
    scene = cotree.Scene("decay")
    scene.parameter("C", 1.0)
    scene.edge("body", "heat_capacitor", "body", "ground", capacity="C", initial={"T": 350.0})
    scene.edge("film", "thermal_resistor", "body", "ground", resistance=1.0)
    model = scene.compile()
    sizes = [1.0, 2.0, 1e-6, 1.5]
    stiff = [model.ensemble((0, 1), {"C": order}, t_eval=3) for order in (sizes, sizes[::-1])]
    assert {runs.attrs["method"] for runs in stiff} == {"rodas5"}
    np.testing.assert_array_equal(stiff[0]["body.T"], stiff[1]["body.T"][::-1])
    assert model.ensemble((0, 1), {"C": [1.0]}, t_eval=3).attrs["method"] == "dop853"


def _interrupting(monkeypatch, times):
    """Press Ctrl-C so many times after the first block."""
    blocks = running.run_blocks

    def run_blocks(*args, **kwargs):
        for row in blocks(*args, **kwargs):
            yield row
            for _ in range(times):
                os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(running, "run_blocks", run_blocks)


def test_the_first_interrupt_gives_what_is_done_and_the_second_one_raises(model, monkeypatch):
    lengths = np.linspace(0.9, 1.1, 200)
    _interrupting(monkeypatch, 1)
    with pytest.warns(RuntimeWarning, match="stopped after 8 of 200 members"):
        runs = model.ensemble((0, 1), {"L": lengths}, t_eval=3, threads=1, lanes=8)
    assert (runs["status"][:8] == 0).all()
    assert (runs["status"][8:] == -3).all()
    assert np.isnan(runs["j1.s"][8:]).all()
    assert "not run" in str(runs["message"][8].item())
    _interrupting(monkeypatch, 2)
    with pytest.raises(KeyboardInterrupt):
        model.ensemble((0, 1), {"L": lengths}, t_eval=3, threads=1, lanes=8)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_the_numbers_do_not_depend_on_the_sizes_of_blocks(model, runs):
    lanes = [
        model.ensemble((0, 2), {"L": LENGTHS, "j1.s": 0.4}, t_eval=5, threads=1, lanes=n)
        for n in (2, 4)
    ]
    np.testing.assert_array_equal(lanes[0]["d(j1.s)"], lanes[1]["d(j1.s)"])
    # Fewer than 100 members run one after another: equal to rounding, enlarged by the step lengths.
    np.testing.assert_allclose(lanes[0]["d(j1.s)"], runs["d(j1.s)"], rtol=1e-9, atol=1e-12)
    one = model.ensemble((0, 2), {"L": LENGTHS, "j1.s": 0.4}, t_eval=5, threads=1, lanes=1)
    np.testing.assert_array_equal(one["d(j1.s)"], runs["d(j1.s)"])


def test_threads_of_a_program_may_run_ensembles(model):
    found = []
    thread = threading.Thread(
        target=lambda: found.append(model.ensemble((0, 1), {"L": [1.0]}, t_eval=3))
    )
    thread.start()
    thread.join()
    assert found[0]["status"].values.tolist() == [0]


def test_an_error_names_the_extra_that_is_missing(model, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(Error, match=r"cotree\[ensembles\]"):
        model.ensemble((0, 1), {"L": [1.0]})
