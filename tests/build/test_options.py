from __future__ import annotations

import platform

import pytest

from cotree.build import (
    BuildOptions,
    Toolchain,
    build_library,
    compiler_flags,
    find_toolchain,
    loop_flags,
)
from cotree.build.compile import cpu_features
from cotree.errors import BuildError

GCC = Toolchain(("/usr/bin/gcc",), "gcc (GCC) 12.2.0", "cc")
CLANG = Toolchain(("/usr/bin/clang",), "clang version 14.0.6", "cc")
ZIG = Toolchain(("/usr/bin/zig", "cc"), "clang version 22.1.8", "zig")


@pytest.mark.parametrize(
    ("toolchain", "n_operations", "level"),
    [
        (GCC, 4_000, "-O1"),
        (GCC, 4_001, "-O0"),
        (CLANG, 20_000, "-O1"),
        (CLANG, 20_001, "-O0"),
        (ZIG, 20_000, "-O1"),
    ],
)
def test_level_follows_the_longest_function(toolchain, n_operations, level):
    assert level in compiler_flags(toolchain, BuildOptions(), n_operations)


def test_gcc_does_less_where_there_is_much():
    long, short = ({"n_operations": 100, "n_all": n} for n in (501, 500))
    for toolchain, options, size, level in [
        (GCC, BuildOptions(), long, "-Og"),
        (GCC, BuildOptions(), short, "-O1"),
        (GCC, BuildOptions(native=True), long, "-O2"),
        (CLANG, BuildOptions(), long, "-O1"),  # -Og is no less there
    ]:
        assert level in compiler_flags(toolchain, options, **size)


def test_chosen_level_is_kept():
    flags = compiler_flags(GCC, BuildOptions(optimize="-O2"), n_operations=1_000_000)
    assert "-O2" in flags
    assert "-O0" not in flags


@pytest.mark.parametrize("toolchain", [GCC, CLANG, ZIG])
@pytest.mark.parametrize("native", [False, True])
def test_digits_do_not_depend_on_hidden_defaults(toolchain, native):
    flags = compiler_flags(toolchain, BuildOptions(native=native), 10)
    contract = "fast" if native else "off"  # the machine's own code may fuse products and sums
    assert {"-std=c99", "-shared", f"-ffp-contract={contract}", "-fno-math-errno"} <= set(flags)
    assert "-ffast-math" not in flags


def test_zig_is_told_what_others_do_by_default():
    flags = compiler_flags(ZIG, BuildOptions(), 10)
    assert {"-g0", "-fno-sanitize=all", "-mcpu=baseline"} <= set(flags)


def test_native_is_opted_into(monkeypatch):
    monkeypatch.setattr(platform, "machine", lambda: "x86_64")
    assert "-march=native" not in compiler_flags(GCC, BuildOptions(), 10)
    assert "-march=native" in compiler_flags(GCC, BuildOptions(native=True), 10)
    assert "-mcpu=baseline" not in compiler_flags(ZIG, BuildOptions(native=True), 10)
    monkeypatch.setattr(platform, "machine", lambda: "arm64")
    assert "-mcpu=native" in compiler_flags(CLANG, BuildOptions(native=True), 10)


def test_cpu_features_are_stable():
    assert cpu_features() == cpu_features()


@pytest.mark.parametrize("optimize", ["-Ofast", "O1", "", "-O1 -ffast-math"])
def test_unknown_level_is_refused(optimize):
    with pytest.raises(BuildError, match="optimize is"):
        BuildOptions(optimize=optimize)


@pytest.mark.parametrize("time_limit", [0.0, -1.0, float("nan")])
def test_time_limit_is_positive(time_limit):
    with pytest.raises(BuildError, match="time_limit"):
        BuildOptions(time_limit=time_limit)


def test_loops_become_vectors_in_less_than_the_highest_level():
    """The highest level takes gcc longer; other compilers know other names of its parts."""
    assert loop_flags(GCC).startswith("-O1 ")
    assert "-ftree-loop-vectorize" in loop_flags(GCC).split()
    assert loop_flags(CLANG).split()[0] == loop_flags(ZIG) == "-O3"


@pytest.mark.parametrize("toolchain", [GCC, CLANG])
def test_loops_use_the_vectors_of_this_processor(toolchain, monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    assert "-march=native" in loop_flags(toolchain).split()
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert "native" not in loop_flags(toolchain)


def test_key_of_a_library_with_vectors_of_this_processor_contains_its_features(monkeypatch):
    toolchain = find_toolchain()
    if toolchain is None:
        pytest.skip("no C compiler")
    files = {"one.c": "int one(void) { return 1; }"}

    def built(level):
        options = {"abi_version": 1, "n_operations": 1, "options": BuildOptions()}
        levels = {"one.c": level}
        return build_library(files, toolchain=toolchain, levels=levels, **options).path

    paths = [built("-O1"), built("-O1 -march=native")]
    monkeypatch.setattr("cotree.build.compile.cpu_features", lambda: "another processor")
    assert built("-O1") == paths[0]
    assert built("-O1 -march=native") != paths[1]
