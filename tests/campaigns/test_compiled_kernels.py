"""Every kernel is the same from every compiler at every level, as its nodes and as differences.

A quick run takes two scenes, a slow one sixteen; the campaign takes 304, at every level. The C of
each is looked through for constant arrays with entries left out, as that of all shipped scenes is.
"""

from __future__ import annotations

import zipfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import compiled_kernels as kernels
import numpy as np
import pytest

import cotree
from cotree.codegen.lanes import Lanes, lanes_context, render_lanes
from cotree.errors import Error
from cotree.pipeline import formulate, generate

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.program.program import Program

pytestmark = [
    pytest.mark.compiler,
    # A random loop begins at random positions, whatever its parameters are.
    pytest.mark.filterwarnings("ignore:initial values change with parameters:RuntimeWarning"),
]

SCENES = sorted(path.stem for path in (Path(cotree.__file__).parent / "scenes").glob("*.toml"))
SLOW, ALL, BLOCK = 16, 304, 8
#: A circuit and tanks: bodies in space take longer, of which the two arms are taken.
QUICK = (2, 4)
#: Levels of a quick run and of a slow one, beginning with those that models have by default. Of
#: clang's levels each scene takes one, in turn.
FEW = ("-O1", "-Og", "-O2", "native")


def check(seed: int, folder: Path, *, is_whole: bool) -> bool:
    """Check a random scene; return whether it has equations at all."""
    try:
        program = kernels.formed(seed)
    except Error:
        return False  # a random loop that cannot begin as it is drawn, or names a chord's angle
    bad = list(kernels.unlike_differences(program, seed))
    levels = kernels.LEVELS if is_whole else FEW
    ways = [("gcc", level) for level in levels]
    clang = levels if is_whole else levels[seed % len(levels)]
    ways += [("clang", level) for level in levels if level in clang]
    for compiler, level in ways:
        if compiler in kernels.available():
            found = kernels.compiled(program, compiler, level)
            bad += [f"{compiler} {level}, {row}" for row in kernels.differing(program, found, seed)]
    for compiler in kernels.available():
        flags = "-O2" if compiler == "gcc" else "-O3 -march=native"
        found = kernels.made(program, compiler, flags, folder / f"{seed}-{compiler}")
        bad += [f"make {compiler}, {row}" for row in kernels.differing(program, found, seed)]
    files = folder / f"{seed}-{kernels.available()[0]}"
    texts = {path.name: path.read_text() for path in files.glob("*.[ch]")}
    bad += kernels.left_out(texts)
    assert not bad, (seed, program.layout.name, bad)
    return True


@pytest.fixture(autouse=True)
def _own_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "gcc")  # restored behind tests that choose another


@pytest.mark.parametrize(
    "seed", [pytest.param(i, marks=[] if i in QUICK else [pytest.mark.slow]) for i in range(SLOW)]
)
def test_kernels_are_the_same_at_every_level(seed: int, tmp_path: Path) -> None:
    check(seed, tmp_path, is_whole=False)


@pytest.mark.parametrize("level", ["-O2", pytest.param("native", marks=pytest.mark.slow)])
def test_columns_of_unit_vectors_are_no_zeros(level: str) -> None:
    program = generate(formulate(kernels.two_arms(), [], None)[1])[0]
    assert not list(kernels.unlike_differences(program, 1))
    assert not list(kernels.differing(program, kernels.compiled(program, "gcc", level), 1))


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("first", range(0, ALL, BLOCK))
def test_all_kernels_are_the_same_at_every_level(first: int, tmp_path: Path) -> None:
    has_run = [check(seed, tmp_path, is_whole=True) for seed in range(first, first + BLOCK)]
    assert sum(has_run) >= BLOCK - 2


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(len(kernels.FAMILIES)))
def test_lanes_are_the_same_as_members_by_themselves(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Lanes round sums and products once, and take steps of the same length."""
    scene, _, tree = kernels.make(seed + (8 if seed != 7 else 24))
    names = list(scene.parameters)[:1]
    for compiler in kernels.available():
        monkeypatch.setenv("CC", compiler)
        model = scene.compile(names, tree=tree)
        for method in ("dopri5", "rodas5"):
            changes = {next(iter(scene.parameters)): np.linspace(0.9, 1.1, 5)}
            found: list[Any] = []
            for lanes in (None, 1):
                settings: dict[str, Any] = {"rtol": 1e-8, "atol": 1e-10, "method": method}
                found.append(
                    model.ensemble((0, 0.2), changes, t_eval=3, threads=1, lanes=lanes, **settings)
                )
            for name in found[0].data_vars:
                one, other = (run[name].values for run in found)
                if name != "seconds" and np.issubdtype(one.dtype, np.floating):
                    # Ten times the tolerance: near a limit of the error test a step more is taken.
                    np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-8, err_msg=name)


def _texts(name: str, sensitivities: Iterable[str], folder: Path) -> dict[str, dict[str, str]]:
    """All C that is written of a shipped scene: projects, FMUs, lanes."""
    model = cotree.load(name).compile(list(sensitivities), optimize="-O0")
    program: Program = model.kernels.program
    found: dict[str, dict[str, str]] = {}
    for method, real in (("dopri5,rodas5", "double"), ("dop853", "float"), ("rk4", "double")):
        try:
            step = {"step": 1e-3} if method == "rk4" else {}
            to = model.write(folder / f"{method}-{real}", method, real=real, **step)
        except Error:
            continue
        found[f"{method} {real}"] = {path.name: path.read_text() for path in to.files}
    for version in (2, 3):
        try:
            made = model.export_fmu(folder / f"{version}.fmu", version=version, platforms=[])
        except Error:
            continue
        with zipfile.ZipFile(made.path) as files:
            names = [row for row in files.namelist() if row.endswith((".c", ".h"))]
            found[f"FMU {version}"] = {row: files.read(row).decode() for row in names}
    for method in ("dopri5", "rodas5"):
        try:
            context = lanes_context(
                program,
                method,
                Lanes(4, 1, "avx2,fma", True),
                has_sensitivities=bool(sensitivities),
            )
            found[f"lanes {method}"] = dict(render_lanes(context, method))
        except Error:
            continue
    return found


@pytest.mark.sampled(1)
@pytest.mark.parametrize("name", SCENES)
def test_no_constant_array_has_entries_left_out(name: str, tmp_path: Path) -> None:
    for sensitivities in ((), list(cotree.load(name).parameters)[:3]):
        texts = _texts(name, sensitivities, tmp_path / str(len(sensitivities)))
        assert len(texts) >= 3
        for what, files in texts.items():
            assert not kernels.left_out(files), (what, kernels.left_out(files))


def test_what_is_left_out_is_found() -> None:
    text = """
    #define SIZES \\
        {1.0, 2.0, 3.0}
    #define N 4
    static const double gaps[4] = {[0] = 1.0, [2] = 1.0};
    static const double ends[N] = {1.0, 2.0, /* , */ 3.0};
    static const double sizes[4] = SIZES;
    static const char *const names[2] = {"a, b", "c"};
    static const struct {
        int piece, direction;
    } corners[2] = {{1, 2}, {3, 4}};
    const double whole[3] = {f(1, 2), x[1], 0.0};
    double filled[3] = {0.0};
    """
    found = kernels.left_out({"model.c": text})
    assert found == ["model.c: gaps[4]", "model.c: ends[N]", "model.c: sizes[4]"]
