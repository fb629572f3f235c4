from __future__ import annotations

import concurrent.futures
import ctypes
import dataclasses
import multiprocessing
import os
import sys
import time
from pathlib import Path

import pytest

from cotree.build import (
    BuildOptions,
    BuiltLibrary,
    Toolchain,
    build_library,
    clear_cache,
    find_toolchain,
    load_library,
)
from cotree.build import compile as compile_module
from cotree.errors import BuildError


def build(files, toolchain, **options) -> BuiltLibrary:
    return build_library(
        files,
        abi_version=1,
        n_operations=10,
        options=BuildOptions(**options),
        toolchain=toolchain,
    )


def scripted(command: str) -> Toolchain:
    return Toolchain((command,), "scripted 1.0", "cc")


@pytest.mark.compiler
def test_second_build_is_a_hit(files, cdef, toolchain, cache: Path):
    first = build(files, toolchain)
    second = build(dict(reversed(files.items())), toolchain)
    assert (first.cached, second.cached) == (False, True)
    assert first.path == second.path
    assert first.path.parent == cache
    assert first.seconds > 0.0
    library = load_library(second.path, cdef)
    # Both are exact in binary arithmetic.
    assert library.lib.twice(1.5) == 3.0
    assert library.lib.abi_version() == 1


@pytest.mark.compiler
def test_same_text_gives_the_same_bytes(files, toolchain):
    first = build(files, toolchain).path.read_bytes()
    clear_cache()
    assert build(files, toolchain).path.read_bytes() == first


@pytest.mark.compiler
def test_several_c_files_are_compiled_together(files, toolchain):
    files["extra.c"] = '#include "model.h"\ndouble four_times(double x);\n'
    files["extra.c"] += "double four_times(double x) { return twice(twice(x)); }\n"
    built = build(files, toolchain)
    library = load_library(built.path, "double four_times(double x);")
    assert library.lib.four_times(0.25) == 1.0


@pytest.mark.compiler
def test_command_shows_what_was_run(files, toolchain):
    command = build(files, toolchain, optimize="-O2").command
    assert toolchain.command[0] in command
    assert "-ffp-contract=off" in command
    assert "-O2" in command
    assert command.endswith("-lm")


@pytest.mark.compiler
def test_native_is_another_library(files, cdef, toolchain):
    plain, native = build(files, toolchain), build(files, toolchain, native=True)
    assert plain.path != native.path
    assert load_library(native.path, cdef).lib.twice(2.0) == 4.0


@pytest.mark.compiler
def test_native_library_is_not_shared_between_processors(files, toolchain, monkeypatch):
    first = build(files, toolchain, native=True)
    monkeypatch.setattr(compile_module, "cpu_features", lambda: "another processor")
    assert build(files, toolchain, native=True).path != first.path


@pytest.mark.compiler
@pytest.mark.parametrize("damage", ["truncated", "changed", "no checksum"])
def test_damaged_library_is_built_again(files, cdef, toolchain, damage):
    path = build(files, toolchain).path
    content = path.read_bytes()
    if damage == "truncated":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "changed":
        path.write_bytes(content[:-1] + bytes([content[-1] ^ 1]))
    else:
        path.with_suffix(".sha256").unlink()
    again = build(files, toolchain)
    assert not again.cached
    assert again.path == path
    assert build(files, toolchain).cached
    assert load_library(path, cdef).lib.twice(1.0) == 2.0


_barrier = None


def _start_worker(barrier) -> None:
    global _barrier
    _barrier = barrier


def _build_at_once(files, cdef) -> tuple[str, float]:
    toolchain = find_toolchain()
    _barrier.wait(timeout=60)
    path = build(files, toolchain).path
    return str(path), load_library(path, cdef).lib.twice(1.5)


@pytest.mark.compiler
def test_racing_processes_are_all_right(files, cdef, toolchain, cache: Path):
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(2)
    with concurrent.futures.ProcessPoolExecutor(
        2, mp_context=context, initializer=_start_worker, initargs=(barrier,)
    ) as pool:
        futures = [pool.submit(_build_at_once, files, cdef) for _ in range(2)]
        results = [future.result(timeout=120) for future in futures]
    assert results[0] == results[1]
    assert results[0][1] == 3.0
    built = build(files, toolchain)
    assert built.cached
    # A library and its parsed declarations, each with its hash.
    assert sorted(path.suffix for path in cache.iterdir()) == [
        ".sha256",
        ".sha256",
        ".so",
        ".text",
    ]


@pytest.mark.compiler
def test_refused_text_is_explained_and_kept(files, toolchain, cache: Path):
    files["model.c"] += "double broken(void) { return undeclared_name; }\n"
    with pytest.raises(BuildError) as caught:
        build(files, toolchain)
    error = caught.value
    assert toolchain.command[0] in error.command
    assert "undeclared_name" in error.output
    assert "undeclared_name" in str(error)
    kept = Path(error.source)
    assert kept.name == "model.c"
    assert str(kept) in str(error)
    assert kept.parent.parent == cache / "failed"
    assert {path.name: path.read_text() for path in kept.parent.iterdir()} == files
    assert {path.name for path in cache.iterdir()} == {"failed"}


@pytest.mark.compiler
def test_current_directory_stays_empty(files, toolchain, tmp_path: Path, monkeypatch):
    folder = tmp_path / "current"
    folder.mkdir()
    monkeypatch.chdir(folder)
    build(files, toolchain)
    assert list(folder.iterdir()) == []


def is_running(pid: int) -> bool:
    """Return whether a process is alive, not ended or a zombie."""
    try:
        os.kill(pid, 0)
        status = Path(f"/proc/{pid}/stat").read_text()
    except (ProcessLookupError, FileNotFoundError):
        return False
    return status.rpartition(")")[2].split()[0] != "Z"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc")
def test_time_limit_stops_the_compiler_and_its_passes(files, make_script, tmp_path: Path):
    # The pass outlives any patience of this test, and holds the output open.
    pid_file = tmp_path / "pid"
    compiler = make_script(f"echo working; sleep 600 & echo $! > '{pid_file}'; wait")
    start = time.perf_counter()
    with pytest.raises(BuildError, match=r"stopped after 1 s .*time_limit") as caught:
        build(files, scripted(compiler), time_limit=1.0)
    # Far below the 600 s of the pass, far above a slow machine's delays.
    assert time.perf_counter() - start < 60.0
    assert caught.value.output == "working\n"
    assert Path(caught.value.source).is_file()
    pid = int(pid_file.read_text())
    deadline = time.perf_counter() + 30.0
    while is_running(pid) and time.perf_counter() < deadline:
        time.sleep(0.01)
    assert not is_running(pid)


@pytest.mark.skipif(sys.platform != "linux", reason="other systems may refuse the limit")
def test_memory_is_limited(files, make_script):
    with pytest.raises(BuildError) as caught:
        build(files, scripted(make_script("ulimit -S -v; exit 1")))
    assert int(caught.value.output) == 8 * 1024 * 1024


def test_compiler_reads_nothing_and_leaves_no_temporary_files(files, make_script, cache: Path):
    body = 'cat; mktemp > /dev/null; echo "LC_ALL is $LC_ALL, in $TMPDIR"; exit 1'
    with pytest.raises(BuildError) as caught:
        build(files, scripted(make_script(body)))
    assert caught.value.output.startswith(f"LC_ALL is C, in {cache}")
    assert {path.name for path in cache.iterdir()} == {"failed"}


@pytest.mark.parametrize("others", [{}, {"cotree_own.c": "int other;\n"}])
def test_compiler_that_says_and_writes_nothing(make_script, others):
    with pytest.raises(BuildError, match=r"ended without an error on .*, but wrote no file"):
        build_library(
            {"own.c": "int own;\n", **others},
            abi_version=1,
            n_operations=1,
            options=BuildOptions("-O0"),
            toolchain=scripted(make_script("exit 0")),
        )


def test_compiler_that_vanished(files, make_script):
    toolchain = dataclasses.replace(scripted(make_script("exit 0")), command=("/nowhere/cc",))
    with pytest.raises(BuildError, match="/nowhere/cc"):
        build(files, toolchain)


@pytest.mark.parametrize("name", ["../model.c", "a/b.c", "-o.c", "model.py", "a b.c", "m\n.c"])
def test_file_names_stay_in_their_folder(name, fake_gcc):
    with pytest.raises(BuildError, match="file name"):
        build({name: ""}, fake_gcc)


def test_header_alone_is_refused(fake_gcc):
    with pytest.raises(BuildError, match="no C file"):
        build({"model.h": ""}, fake_gcc)


def test_unwritable_cache_is_named(files, fake_gcc, monkeypatch, cache: Path):
    def refuse(*arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(compile_module, "write_files", refuse)
    with pytest.raises(BuildError, match="No space left on device") as caught:
        build(files, fake_gcc)
    assert str(cache) in str(caught.value)


@pytest.mark.compiler
def test_files_are_compiled_apart_each_at_its_level(toolchain):
    files = {
        "one.h": "int two(void);\n",
        "one.c": '#include "one.h"\nint one(void) { return two() - 1; }\n',
        "two.c": "int two(void) {\n#ifdef __OPTIMIZE__\nreturn 20;\n#else\nreturn 2;\n#endif\n}\n",
    }
    values = []
    for levels in ({}, {"two.c": "-O1"}, {"one.c": "-O1"}):
        built = build_library(
            files,
            abi_version=1,
            n_operations=1,
            options=BuildOptions("-O0"),
            toolchain=toolchain,
            levels=levels,
        )
        values.append(ctypes.CDLL(str(built.path)).one())
        assert built.command.count("-c ") == 2
        assert built.command.endswith("one.c.o two.c.o -o library.so -lm")
    assert values == [1, 19, 1]


@pytest.mark.compiler
def test_objects_of_the_runtime_serve_other_libraries(toolchain, cache: Path, monkeypatch):
    shared = {
        "cotree_a.h": "int two(void);\n",
        "cotree_b.h": '#include "cotree_a.h"\n',
        "cotree_c.c": '#include "cotree_b.h"\nint two(void) { return 2; }\n',
        "cotree_d.h": "",
    }
    compiled: list[str] = []

    def counted(command, *others):
        compiled.extend(word for word in command if word.endswith(".c") and "-c" in command)
        return run_limited(command, *others)

    run_limited = compile_module.run_limited
    monkeypatch.setattr(compile_module, "run_limited", counted)

    def value(number: int, **texts: str) -> int:
        own = f'#include "cotree_a.h"\nint own(void) {{ return two() + {number}; }}\n'
        built = build_library(
            {**shared, "own.c": own, **texts},
            abi_version=1,
            n_operations=1,
            options=BuildOptions("-O0"),
            toolchain=toolchain,
        )
        return ctypes.CDLL(str(built.path)).own()

    assert [value(1), value(2)] == [3, 4]
    assert compiled.count("cotree_c.c") == 1
    # Another text of an included header, or a damaged object, is compiled again.
    assert value(3, **{"cotree_d.h": "int unused(void);\n"}) == 5
    assert compiled.count("cotree_c.c") == 1
    assert value(3, **{"cotree_a.h": "int two(void);  \n"}) == 5
    assert compiled.count("cotree_c.c") == 2
    for kept in cache.glob("*.o"):
        kept.write_bytes(b"damaged")
    assert value(4) == 6
    assert compiled.count("cotree_c.c") == 3
    assert clear_cache() > 0
    assert not list(cache.glob("*.o"))


@pytest.mark.compiler
def test_the_first_file_that_fails_is_named(toolchain):
    files = {"a.c": "int a;\n", "b.c": "int b\n= ;\n", "c.c": "nothing\n"}
    with pytest.raises(BuildError, match=r"b\.c' with exit status 1: b\.c:2") as caught:
        build(files, toolchain)
    assert "-c b.c" in caught.value.command
    assert Path(caught.value.source).name == "b.c"
