"""Stores of ensembles: what a kill leaves, what is computed again, and what is refused."""

from __future__ import annotations

import json
import multiprocessing
import os
import pathlib
import random
import resource
import shutil
import signal
import subprocess
import sys
import time
from concurrent import futures

import numpy as np
import pytest
import xarray

import cotree
from cotree import SolveError, StoreError
from cotree.ensemble import executors, run
from cotree.ensemble import store as identity
from cotree.ensemble.store_backend import StoreBackend

pytestmark = pytest.mark.compiler

N = 35
LENGTHS = np.linspace(0.9, 1.1, N)
SETTINGS = {"t_eval": 5, "method": "dop853", "progress": False}

on_linux = pytest.mark.skipif(sys.platform != "linux", reason="processes are forked here")


@pytest.fixture(scope="module")
def model():
    return cotree.load("slider-pendulum").compile(["L"])


@pytest.fixture(scope="module")
def wanted(model):
    return model.ensemble((0, 2), {"L": LENGTHS, "k": 45.0}, **SETTINGS)


@pytest.fixture(autouse=True)
def _small_blocks(monkeypatch):
    monkeypatch.setattr(run, "timed_size", lambda *args: 7)


def into(model, store, members=None, **changed):
    members = {"L": LENGTHS, "k": 45.0} if members is None else members
    return model.ensemble((0, 2), members, store=store, **{**SETTINGS, **changed})


def assert_same(found, wanted):
    """Compare everything but the seconds; texts come from Zarr as another type of array."""
    assert set(found.data_vars) == set(wanted.data_vars)
    assert set(found.coords) == set(wanted.coords)
    for name in (*wanted.data_vars, *wanted.coords):
        if name != "seconds":
            assert found[name].dims == wanted[name].dims
            assert found[name].attrs == wanted[name].attrs
            values = wanted[name].values
            np.testing.assert_array_equal(found[name].values.astype(values.dtype), values)


def opened(store):
    """Open a store as anybody does."""
    return xarray.open_dataset(store, engine=StoreBackend)


def blocks_of(store):
    return sorted((store / "blocks").glob("*.npz"))


def test_a_store_is_the_dataset_of_a_call_without(model, wanted, tmp_path):
    store = tmp_path / "deep" / "runs.zarr"
    found = into(model, store)
    assert_same(found, wanted)
    assert list(found.data_vars) == list(wanted.data_vars)
    assert found.attrs.keys() == wanted.attrs.keys()
    assert found["j1.s"].chunks[0][0] == 7
    # Anyone else reads the same; nothing but the store is left.
    assert_same(opened(store), wanted)
    assert [path.name for path in store.parent.iterdir()] == ["runs.zarr"]
    found.to_netcdf(tmp_path / "runs.nc")


def test_grids_and_events_have_stores(tmp_path):
    ball = cotree.load("bouncing-ball").compile(["e"])
    grid = cotree.grid(e=[0.2, 0.5, 0.9], h=[1.0, 2.0, 3.0, 4.0, 5.0])
    settings = {"t_eval": 4, "method": "dopri5", "progress": False}
    wanted = ball.ensemble((0, 3), grid, **settings)
    found = ball.ensemble((0, 3), grid, store=tmp_path / "balls", **settings)
    assert_same(found, wanted)
    assert found["t(hit)"].sizes["occurrence"] > 1


def test_only_what_is_missing_is_computed(model, wanted, tmp_path, monkeypatch):
    store, ran = tmp_path / "runs.zarr", []
    whole = executors.run_block
    monkeypatch.setattr(
        executors,
        "run_block",
        lambda plan, rows, **more: ran.append(rows) or whole(plan, rows, **more),
    )
    first = into(model, store).load()
    assert sum(map(len, ran)) == N
    ran.clear()
    assert_same(into(model, store), wanted)
    assert not ran
    # A block that is lost, one that is cut, one with a flipped bit, and the start of another.
    lost, cut, flipped, *_ = blocks_of(store)
    lost.unlink()
    (store / "blocks" / f"{lost.name}.partial").write_bytes(b"killed")
    cut.write_bytes(cut.read_bytes()[:-3])
    data = bytearray(flipped.read_bytes())
    data[2000] ^= 4
    flipped.write_bytes(data)
    again = into(model, store)
    assert_same(again, wanted)
    assert sum(map(len, ran)) == 3 * 7
    assert not list(store.rglob("*.partial"))
    # What was not computed again keeps its times.
    same = np.flatnonzero(first["seconds"].values == again["seconds"].values)
    assert len(same) >= N - 3 * 7


def killed(model, store, n_files):
    """Run in a process that is killed before it renames a file, of many that it writes."""
    whole, count = pathlib.Path.replace, iter(range(10**6))

    def replace(path, target):
        if next(count) == n_files:
            os.kill(os.getpid(), signal.SIGKILL)
        return whole(path, target)

    pathlib.Path.replace = replace
    into(model, store)


@on_linux
def _damages(data, rng):
    """List what a full disk, a power cut or a bad sector makes of a file; None removes it."""
    places = rng.sample(range(len(data)), min(3, len(data)))
    flips = (bytes(b ^ (0x10 if i == at else 0) for i, b in enumerate(data)) for at in places)
    whole = (data[: len(data) // 2], b"", bytes(len(data)), b"\xff\xfe" + data, None)
    return [*flips, *whole, data + b"}", b"null", b"[" * 5000]


@pytest.mark.slow
def test_any_damage_is_repaired_or_told(tmp_path):
    """Every file of a store with events, damaged in eleven ways: the same results, or an error."""
    model, speeds = cotree.load("bouncing-ball").compile(), np.linspace(1, 2, 14)

    def run_again():
        call = model.ensemble((0, 2), {"j.s": speeds}, t_eval=5, progress=False, store=store)
        return call.load()

    store, rng, told = tmp_path / "runs.zarr", random.Random(1), []
    first = run_again()
    files = sorted(path for path in store.rglob("*") if path.is_file())
    count = 0
    for path in files:
        kept = path.read_bytes()
        for new in _damages(kept, rng):
            count += 1
            if new is None:
                path.unlink()
            else:
                path.write_bytes(new)
            try:
                assert_same(run_again(), first)
                continue
            except cotree.Error as error:
                told.append((path, str(error)))
            path.write_bytes(kept)
    assert count >= 40
    # Only the file that says whose results they are cannot be made again.
    assert {path.relative_to(store).as_posix() for path, _ in told} == {"manifest.json"}
    assert all("manifest.json" in text and "another folder" in text for _, text in told)
    assert_same(run_again(), first)


def test_damaged_coordinates_are_written_again(model, wanted, tmp_path):
    store = tmp_path / "runs"
    into(model, store)
    path = store / "coordinates.npz"
    path.write_bytes(path.read_bytes()[:-3])
    assert_same(into(model, store), wanted)
    assert_same(opened(store), wanted)


def test_killed_between_any_two_files(model, wanted, tmp_path):
    context, store = multiprocessing.get_context("fork"), tmp_path / "runs.zarr"
    moments = random.Random(21)
    # While it is made, at the first block, and further on.
    for n_files in (0, 1, 2, moments.randrange(1, 3), moments.randrange(1, 3)):
        child = context.Process(target=killed, args=(model, store, n_files))
        child.start()
        child.join()
        assert child.exitcode == -signal.SIGKILL
        if (store / "coordinates.npz").exists():
            # Whatever is there may be read, and its members are right or missing.
            there = opened(store)
            is_done = there["status"].values == 0
            np.testing.assert_array_equal(
                there["j1.s"].values[is_done], wanted["j1.s"].values[is_done]
            )
            assert np.all(there["status"].values[~is_done] == -3)
    assert_same(into(model, store), wanted)
    names = sorted(path.name for path in store.rglob("*") if path.suffix != ".lock")
    assert names == [f"{i:010}.npz" for i in range(0, N, 7)] + [
        "blocks",
        "coordinates.npz",
        "manifest.json",
    ]


_SCRIPT = """
import sys
import numpy as np
import dask.array, xarray
import cotree
from cotree.ensemble import executors, run
run.timed_size = lambda *args: 50
model = cotree.load("bouncing-ball").compile(["e"])
members = {"e": np.linspace(0.3, 0.9, 2000), "h": np.linspace(1.0, 3.0, 2000)}
settings = {"t_eval": 20, "method": "dopri5", "progress": False}
model.ensemble((0, 3), {"e": [0.5]}, **settings)
print("begun", flush=True)
model.ensemble((0, 3), members, store=sys.argv[1], **settings)
print("done", flush=True)
"""


@pytest.mark.slow
@on_linux
def test_kills_at_random_moments_change_nothing(tmp_path):
    def begin(name):
        return subprocess.Popen(
            [sys.executable, "-c", _SCRIPT, str(tmp_path / name)],
            stdout=subprocess.PIPE,
            text=True,
        )

    with begin("whole") as undisturbed:
        assert undisturbed.communicate()[0].split() == ["begun", "done"]
    moments = random.Random(7)
    for _ in range(3):
        with begin("killed") as process:
            assert process.stdout.readline() == "begun\n"
            time.sleep(moments.uniform(0.2, 1.5))
            process.kill()
    with begin("killed") as last:
        assert last.communicate()[0].split() == ["begun", "done"]
    whole, other = (opened(tmp_path / name) for name in ("whole", "killed"))
    for name in whole.variables:
        if name != "seconds":
            values, found = whole[name].values, other[name].values
            assert values.shape == found.shape
            assert np.array_equal(values, found) or values.tobytes() == found.tobytes()


def test_a_full_disk_ends_with_a_sentence_and_can_go_on(model, wanted, tmp_path, monkeypatch):
    store, whole, count = tmp_path / "runs.zarr", pathlib.Path.replace, iter(range(10**6))

    def replace(path, target):
        if next(count) == 4:
            raise OSError(28, "No space left on device")
        return whole(path, target)

    with monkeypatch.context() as full:
        full.setattr(pathlib.Path, "replace", replace)
        with pytest.raises(StoreError, match=r"No space left on device.*run the same call again"):
            into(model, store)
    there = opened(store)["status"].values
    assert 0 < (there == 0).sum() < N
    assert_same(into(model, store), wanted)


@on_linux
def test_a_limit_of_file_sizes_ends_with_a_sentence(model, tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    into(model, tmp_path / "runs.zarr")
    shutil.rmtree(tmp_path / "runs.zarr" / "blocks")
    resource.setrlimit(resource.RLIMIT_FSIZE, (100, hard))
    try:
        with pytest.raises(StoreError, match="File too large"):
            into(model, tmp_path / "runs.zarr")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"rtol": 1e-7}, r"rtol is 1e-08 there and 1e-07 here"),
        ({"t_eval": 6}, r"'time' has 5 values there and 6 here"),
        ({"method": "dopri5"}, r'method is "dop853" there and "dopri5" here'),
        ({"sensitivities": False}, r'sensitivities is \["L"\] there and \[\] here'),
        ({"outputs": []}, r"outputs is"),
        ({"parameters": {"zeta": 1.0}}, r"of parameters 'zeta' is 10.0 there and 1.0 here"),
        ({"initial": {"j1.s": 0.1}}, r"of initial 'j1.s' is not given there and 0.1 here"),
        ({"max_steps": 100}, r"max_steps is 1000000 there and 100 here"),
        ({"members": {"L": LENGTHS[1:], "k": 45.0}}, r"'member' has 35 values there and 34 here"),
        ({"members": {"L": LENGTHS}}, r"columns is"),
        ({"members": {"L": [*LENGTHS[:9], 2.0, *LENGTHS[10:]], "k": 45.0}}, r"'L' at place 9 is"),
    ],
)
def test_another_ensemble_is_refused(model, changed, said, begun):
    with pytest.raises(StoreError, match=f"contains another ensemble: {said}"):
        into(model, begun, **changed)


@pytest.fixture(scope="module")
def begun(model, tmp_path_factory):
    store = tmp_path_factory.mktemp("begun") / "runs.zarr"
    into(model, store)
    return store


def test_another_model_or_version_is_refused(begun, model, monkeypatch):
    scene = cotree.load("slider-pendulum")
    scene.output("extra", "2*j1.s")
    for other, said in (
        (scene.compile(["L"]), "outputs is"),
        (cotree.load("slider-pendulum").compile(["L"], baumgarte=0.0), ""),
        (cotree.load("slider-pendulum").compile(["L"], tunable=["k", "L"]), "parameters"),
    ):
        if said:
            with pytest.raises(StoreError, match=f"another ensemble: .*{said}"):
                into(other, begun)
        else:
            into(other, begun)  # the same in all but name
    monkeypatch.setattr(identity, "VERSION", "9.9.9")
    with pytest.raises(StoreError, match=r'cotree is "[0-9.]+" there and "9\.9\.9" here'):
        into(model, begun)


def test_what_is_no_store_is_refused(model, tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    for store, said in (
        (tmp_path / "runs.nc", r"to_netcdf\('runs.nc'\)"),
        ("s3://bucket/runs.zarr", "is not on this machine"),
        (tmp_path / "notes.txt", "is a file"),
        (tmp_path, "is not a store of an ensemble"),
        (7, "give a folder"),
    ):
        with pytest.raises(StoreError, match=said):
            into(model, store)
    assert [path.name for path in tmp_path.iterdir()] == ["notes.txt"]


def test_functions_of_python_are_refused(tmp_path):
    cart = cotree.load("cart-pole").compile()
    one, inputs = {cart.parameters[0]: [1.0]}, {cart.inputs[0]: lambda t: 0.0}
    with pytest.raises(SolveError, match="is a function of Python, which cannot be compared"):
        cart.ensemble((0, 1), one, store=tmp_path / "runs.zarr", inputs=inputs, **SETTINGS)


def test_a_folder_that_cannot_be_written_is_told(model, tmp_path, monkeypatch):
    store, mkdir = tmp_path / "runs.zarr", pathlib.Path.mkdir

    def refuse(path, *args, **kwargs):
        # A thread may create the cache folder for the engine meanwhile.
        if path.is_relative_to(store):
            raise PermissionError(13, "Permission denied")
        mkdir(path, *args, **kwargs)

    monkeypatch.setattr(pathlib.Path, "mkdir", refuse)
    with pytest.raises(StoreError, match=r"Permission denied.*correct its permissions"):
        into(model, store)


def test_a_block_that_another_process_runs_is_waited_for(model, wanted, tmp_path, monkeypatch):
    import filelock

    store, ran, whole = tmp_path / "runs", [], executors.run_block
    into(model, store)
    first, second, *_ = blocks_of(store)
    kept = first.read_bytes()
    first.unlink()
    second.unlink()
    lock = filelock.FileLock(first.with_suffix(".lock"))
    lock.acquire()

    def finish(plan, rows, **more):
        """Write the other block, as the process that has locked it does, once ours runs."""
        ran.append(rows)
        first.write_bytes(kept)
        lock.release()
        return whole(plan, rows, **more)

    monkeypatch.setattr(executors, "run_block", finish)
    assert_same(into(model, store), wanted)
    assert [len(rows) for rows in ran] == [7]


@on_linux
def test_two_processes_write_one_store(model, wanted, tmp_path, monkeypatch):
    """Each runs blocks that the other has not locked, and both return all results."""
    context, counts, whole = multiprocessing.get_context("fork"), [], executors.run_block

    def slow(plan, rows, **more):
        counts.append(len(rows))
        time.sleep(0.1)
        return whole(plan, rows, **more)

    def call(pipe):
        # Threads of dask, which read values, do not survive a fork.
        found = into(model, tmp_path / "runs")
        pipe.send((sum(counts), found["message"].values.tolist()))

    monkeypatch.setattr(executors, "run_block", slow)
    pipes = [context.Pipe(duplex=False) for _ in range(2)]
    children = [context.Process(target=call, args=(end,)) for _, end in pipes]
    for child in children:
        child.start()
    for child in children:
        child.join(60)
        assert child.exitcode == 0
    each = [receiver.recv() for receiver, _ in pipes]
    assert [messages for _, messages in each] == [[""] * N] * 2
    assert sum(n for n, _ in each) == N
    assert min(n for n, _ in each) > 0
    assert_same(opened(tmp_path / "runs"), wanted)


def test_failed_members_are_kept_and_told_again(model, tmp_path):
    members = {"m1": [1.0, -1.0, 2.0, -3.0] * 5}
    for _ in range(2):
        with pytest.warns(RuntimeWarning, match="10 of 20 members failed and are nan"):
            runs = into(model, tmp_path / "runs.zarr", members)
    assert runs["status"].values.tolist() == [0, -1, 0, -1] * 5
    assert "m1" in str(runs["message"].values[1])
    with pytest.raises(SolveError, match=r"member 1 \(m1 = -1\) failed"):
        into(model, tmp_path / "runs.zarr", members, on_error="raise")


@on_linux
def test_executors_write_the_same_store(model, wanted, tmp_path):
    context = multiprocessing.get_context("fork")
    with futures.ProcessPoolExecutor(2, mp_context=context) as pool:
        assert_same(into(model, tmp_path / "runs.zarr", executor=pool), wanted)


def test_slow_members_are_written_one_by_one(model, wanted, tmp_path, monkeypatch):
    """Threads then take a block each, so that a quick member does not wait for a slow one."""
    monkeypatch.setattr(run, "timed_size", lambda *args: 1)
    found = into(model, tmp_path / "runs.zarr", {"L": LENGTHS[:6], "k": 45.0}, threads=2)
    np.testing.assert_array_equal(found["j1.s"].values, wanted["j1.s"].values[:6])
    assert len(blocks_of(tmp_path / "runs.zarr")) == 6


def test_an_interrupted_ensemble_is_continued(model, wanted, tmp_path, monkeypatch):
    whole, blocks = executors.run_block, []

    def interrupted(plan, rows, *, threads, stop):
        blocks.append(rows)
        if len(blocks) == 4:
            stop.set()
        return whole(plan, rows, threads=threads, stop=stop)

    monkeypatch.setattr(executors, "run_block", interrupted)
    with pytest.warns(RuntimeWarning, match="stopped after"):
        part = into(model, tmp_path / "runs.zarr")
    n_done = int((part["status"] == 0).sum())
    assert n_done in (21, 28)
    assert np.isnan(part["j1.s"].values[n_done:]).all()
    assert_same(into(model, tmp_path / "runs.zarr"), wanted)


def test_a_manifest_is_json(begun):
    there = json.loads((begun / "manifest.json").read_text())["store"]
    assert there["identity"]["method"] == "dop853"
    assert there["identity"]["columns"] == ["L", "k"]


def test_blocks_are_archives_of_numpy(model, wanted, tmp_path):
    into(model, tmp_path / "runs")
    with np.load(blocks_of(tmp_path / "runs")[1]) as archive:
        np.testing.assert_array_equal(archive["d(rod_x)"], wanted["d(rod_x)"].values[7:14])


def test_parts_of_a_grid_are_read(tmp_path):
    """Any index of a lazy array gives what it gives of an array in memory."""
    ball = cotree.load("bouncing-ball").compile(["e"])
    grid = cotree.grid(e=[0.2, 0.5, 0.9], h=[1.0, 2.0, 3.0, 4.0, 5.0])
    settings = {"t_eval": 4, "method": "dopri5", "progress": False}
    wanted = ball.ensemble((0, 3), grid, **settings)
    ball.ensemble((0, 3), grid, store=tmp_path / "balls", **settings)
    there = opened(tmp_path / "balls")
    for name in ("j.s", "t(hit)", "d(t(hit))", "status"):
        for index in (
            {"e": 1},
            {"h": [4, 0]},
            {"e": [2, 1], "h": slice(1, 4, 2)},
            {"e": 0, "h": 3},
        ):
            found, expected = there[name].isel(index), wanted[name].isel(index)
            np.testing.assert_array_equal(found.values, expected.values)
            last = dict.fromkeys(set(found.dims) - {"e", "h"}, -1)
            np.testing.assert_array_equal(found.isel(last).values, expected.isel(last).values)
