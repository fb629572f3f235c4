"""One cache and several processes: builders, killers, cleaners, full disks and foreign files."""

from __future__ import annotations

import concurrent.futures
import ctypes
import hashlib
import multiprocessing
import os
import shutil
import time
from pathlib import Path

import filelock
import pytest

from cotree.build import (
    BuildOptions,
    Toolchain,
    build_library,
    clear_cache,
    load_library,
    obtain_library,
)
from cotree.build import compile as compile_module
from cotree.errors import BuildError

ARGUMENTS = {"abi_version": 1, "n_operations": 10}


def build(files: dict[str, str], command: str, time_limit: float = 60.0) -> str:
    """Build with a script in a compiler's place; give the library's path."""
    toolchain = Toolchain((command,), "scripted 1.0", "cc")
    options = BuildOptions(time_limit=time_limit)
    return str(build_library(files, options=options, toolchain=toolchain, **ARGUMENTS).path)


@pytest.fixture
def counting(make_script, tmp_path: Path) -> tuple[str, Path]:
    """Return a slow compiler, and the file that has a line for each of its calls."""
    calls = tmp_path / "calls"
    calls.touch()
    # The sleep is what a second process would build in; its length decides nothing else.
    return make_script(f"echo called >> {calls}; sleep 0.3; echo library > library.so"), calls


@pytest.mark.slow
def test_of_many_processes_one_compiles(files, counting) -> None:
    command, calls = counting
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(4, mp_context=context) as pool:
        paths = {done.result() for done in [pool.submit(build, files, command) for _ in range(12)]}
    assert calls.read_text() == "called\n"
    assert len(paths) == 1


def test_of_many_threads_one_compiles(files, counting, cache: Path) -> None:
    command, calls = counting
    with concurrent.futures.ThreadPoolExecutor(8) as pool:
        paths = set(pool.map(lambda _: build(files, command), range(20)))
    assert calls.read_text() == "called\n"
    assert {path.name for path in cache.iterdir()} == {
        Path(path).with_suffix(suffix).name for path in paths for suffix in (".so", ".sha256")
    }


def test_a_lock_that_is_never_given_back_does_not_stop_anyone(files, counting, cache: Path) -> None:
    command, calls = counting
    path = Path(build(files, command))
    path.unlink()
    with filelock.FileLock(path.with_suffix(".lock")):
        # Shorter than the compiler, which has a limit of its own to keep.
        assert build(files, command, time_limit=0.5) == str(path)
    assert len(calls.read_text().splitlines()) == 2


def test_a_file_system_without_locks_builds_all_the_same(files, counting, monkeypatch) -> None:
    def refuse(self, *arguments, **named):
        raise NotImplementedError("FileSystem does not appear to support flock")

    monkeypatch.setattr(filelock.FileLock, "acquire", refuse)
    assert Path(build(files, counting[0])).exists()


def test_what_a_killed_build_left_is_removed_when_it_is_old(files, counting, cache: Path) -> None:
    cache.mkdir(mode=0o700)
    old, young = cache / "cotree-build-old", cache / "cotree-build-young"
    for folder in (old, young):
        folder.mkdir()
        (folder / "model.c").touch()
    yesterday = time.time() - 25.0 * 3600.0
    os.utime(old, (yesterday, yesterday))
    build(files, counting[0])
    assert not old.exists()
    assert young.exists()  # its process may be alive


def test_a_build_begins_again_where_the_cache_was_cleared(
    files, make_script, tmp_path: Path
) -> None:
    # Another process clears the cache while the compiler works for the first time.
    mark = tmp_path / "second"
    body = f'if [ ! -e {mark} ]; then touch {mark}; rm -r "$PWD"; exit 1; fi; echo > library.so'
    assert Path(build(files, make_script(body))).exists()


def test_a_library_that_is_cleared_at_once_is_built_again(
    files, make_script, tmp_path: Path
) -> None:
    mark = tmp_path / "second"
    body = (
        f'if [ ! -e {mark} ]; then touch {mark}; rm "$PWD"/model.c; fi; echo > library.so; exit 0'
    )
    assert Path(build(files, make_script(body))).exists()


def test_endless_clearing_is_not_blamed_on_the_compiler(files, make_script) -> None:
    with pytest.raises(BuildError, match="another process keeps removing"):
        build(files, make_script('rm -r "$PWD"; exit 1'))


@pytest.mark.compiler
def test_what_is_cleared_between_building_and_loading_is_built_again(
    files, cdef, toolchain, monkeypatch
) -> None:
    from cotree.build import compile as obtain

    builds = []

    def build_and_clear(*arguments, **options):
        built = build_library(*arguments, **options)
        builds.append(built)
        if len(builds) == 1:
            clear_cache()
        return built

    monkeypatch.setattr(obtain, "build_library", build_and_clear)
    options = {"options": BuildOptions(), "toolchain": toolchain, **ARGUMENTS}
    built, loaded = obtain_library(files, cdef, **options)
    assert loaded.lib.twice(1.5) == 3.0
    assert len(builds) == 2
    assert built.path.exists()


@pytest.mark.parametrize(
    "says", ["as: model.o: No space left on device", "ld: cannot write: Disk quota exceeded"]
)
def test_a_full_disk_is_not_blamed_on_the_compiler(files, make_script, cache, says) -> None:
    with pytest.raises(BuildError, match="make room there") as caught:
        build(files, make_script(f"echo '{says}'; exit 1"))
    assert str(cache) in str(caught.value)


def test_a_compiler_that_dies_on_a_full_disk(files, make_script, monkeypatch) -> None:
    usage = shutil.disk_usage("/")
    monkeypatch.setattr(compile_module.shutil, "disk_usage", lambda path: usage._replace(free=1000))
    with pytest.raises(BuildError, match="No space left on device"):
        build(files, make_script("kill -BUS $$"))


@pytest.mark.compiler
def test_a_foreign_library_with_a_fitting_checksum_is_refused(files, cdef, toolchain) -> None:
    options = {"options": BuildOptions(), "toolchain": toolchain, **ARGUMENTS}
    path = build_library(files, **options).path
    foreign = build_library({"other.c": "int other(void) { return 1; }\n"}, **options).path
    assert ctypes.CDLL(str(foreign)).other() == 1
    path.unlink()
    shutil.copy(foreign, path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    path.with_suffix(".sha256").write_text(digest)
    with pytest.raises(BuildError, match=r"has no '(twice|abi_version)'.*clear_cache"):
        load_library(build_library(files, **options).path, cdef)
