"""The C of every shipped scene with every integrator gives no warning with any compiler.

What compilers warn of depends on what they inline: gcc 12 took the copies in a system that was
factorised without exchanges for uninitialised, from -O1 to -O3 only. Texts that are the same for
many projects are compiled once. With --campaign every text meets every compiler at every level.
With --slow every text meets gcc as projects call it, and each other compiler and level takes its
share of the texts; a quick run takes one text of each kind.
"""

from __future__ import annotations

import contextlib
import os
import re
import subprocess
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import filelock
import pytest
from c_programs import STRICT, build, execute, need, run

import cotree
from cotree.codegen.c_files import INTEGRATORS
from cotree.codegen.tableaus import FIXED
from cotree.errors import CodegenError
from cotree.export.c_checks import Evaluated
from cotree.export.c_project import Kit, write_c_project
from cotree.pipeline import formulate, generate

if TYPE_CHECKING:
    from collections.abc import Iterable

pytestmark = pytest.mark.compiler

RUN = {"t_end": 1.0, "rtol": 1e-6, "atol": 1e-8}
SCENES = sorted(path.stem for path in (Path(cotree.__file__).parent / "scenes").glob("*.toml"))
LEVELS = ("-O0", "-O1", "-O2", "-O3", "-Os")

#: What clang's -Weverything tells that is meant: structures have padding, numbers are compared with
#: the very number that they were set to, and C99 declares where a value is known.
MEANT = ["-Wno-padded", "-Wno-float-equal", "-Wno-declaration-after-statement"]
#: Warnings of newer versions: pointers are what C has for arrays, and switches need no default.
MEANT += ["-Wno-unknown-warning-option", "-Wno-unsafe-buffer-usage", "-Wno-switch-default"]

C99 = ["-std=c99", "-ffp-contract=off"]
CPP = ["-x", "c++", "-std=c++11"]
CORTEX = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
COMPILERS = {
    "gcc": ["gcc", *C99, *STRICT],
    "clang": ["clang", *C99, *STRICT],
    "everything": ["clang", *C99, "-Weverything", "-Werror", *MEANT],
    "g++": ["g++", *CPP, *STRICT],
    "clang++": ["clang++", *CPP, *STRICT],
    "cortex-m4": ["arm-none-eabi-gcc", *C99, *STRICT, *CORTEX],
    "aarch64": ["aarch64-linux-gnu-gcc", *C99, *STRICT],
}
#: At which levels each compiles: the warnings of some do not follow from optimisation, and cross
#: compilers are the gcc that all levels are tried with.
LEVELS_OF = {"gcc": LEVELS, "clang": LEVELS, "cortex-m4": ("-O2",), "aarch64": ("-O2",)}
CASES = [(name, level) for name in COMPILERS for level in LEVELS_OF.get(name, ("-O0",))]

#: Parts of C files, which define types or macros of theirs before they include them.
INCLUDED_IN_C = ("_vectors.h", "cotree_sines.h", "cotree_sine_polynomials.h")
INCLUDED_IN_C += ("cotree_interpolation.h", "cotree_systems.h")

#: Names of integrators in the headers and functions that a main program uses.
STEPPER = re.compile(rf"(?<=cotree_)({'|'.join(INTEGRATORS)})(?=_stepper\(\)|\.h)")

#: Without --campaign a compiler at a level takes every eighth text, of single precision as well.
SHARES = 8
EVERY_RUN = [(name, "sanitizers", "double") for name in SCENES]
EVERY_RUN += [("motor-linkage", "valgrind", "double"), ("bouncing-ball", "sanitizers", "float")]


def write_scene(folder: Path, name: str, methods: Iterable[str], reals: Iterable[str]) -> None:
    """Write the projects of a scene, in a folder of each number type."""
    scene = cotree.load(name)
    for sensitivities in ((), tuple(scene.parameters)):
        program = generate(formulate(scene, sensitivities, None)[1])[0]
        evaluated = Evaluated(program)
        for real, integrator in product(reals, methods):
            to = folder / real / f"{name}-{len(sensitivities)}-{integrator}"
            step = 1e-3 if integrator in FIXED else None
            # Events or loops that an integrator does not take are refused with a sentence.
            with contextlib.suppress(CodegenError):
                kit = Kit(integrator, real)
                write_c_project(program, to, kit, **RUN, step=step, evaluated=evaluated)


def different(folder: Path, real: str, *, by_method: bool = True) -> list[Path]:
    """Return one place of each C text below a folder, since many projects share theirs.

    Without ``by_method``, main programs that differ only in the name of the integrator are one.
    """
    found: dict[str, Path] = {}
    for file in sorted(folder.glob(f"*/{real}/*/*.[ch]")):
        text = file.read_text()
        if file.name == "main.c" and not by_method:
            text = STEPPER.sub("", text)
        found.setdefault(file.name + text, file)
    return list(found.values())


@pytest.fixture(scope="session")
def every_text(
    tmp_path_factory: pytest.TempPathFactory, pytestconfig: pytest.Config
) -> dict[str, list[Path]]:
    """Return the texts of all projects by number type, which workers write together."""
    folder, reals = tmp_path_factory.getbasetemp(), ("double", "float")
    worker = os.environ.get("PYTEST_XDIST_WORKER", "gw0")
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent
    folder /= "every_text"
    methods = (*INTEGRATORS, *FIXED, "dopri5,rodas5")
    # Each second worker begins at the other end.
    for name in SCENES[:: -1 if int(worker[2:]) % 2 else 1]:
        own = folder / name
        own.mkdir(parents=True, exist_ok=True)
        with filelock.FileLock(own / "lock"):
            if not (own / "complete").exists():
                write_scene(own, name, methods, reals)
                (own / "complete").touch()
    by_method = bool(pytestconfig.getoption("--campaign"))
    return {real: different(folder, real, by_method=by_method) for real in reals}


@pytest.fixture(scope="module")
def some_texts(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """One scene with loops and one with events, with an explicit method; once each file."""
    folder = tmp_path_factory.mktemp("some")
    for name in ("motor-linkage", "bouncing-ball"):
        write_scene(folder / name, name, ("dopri5",), ("double",))
    return list({path.name: path for path in different(folder, "double")}.values())


def compiler_output(command: list[str], files: Iterable[Path]) -> list[str]:
    is_cpp = "c++" in command

    def compiled(file: Path) -> str:
        # The assembler, which -S leaves out, warns of nothing.
        line = [*command, "-S", "-o", os.devnull, "-" if is_cpp else file.name]
        text = f'#include "{file.name}"\n' if is_cpp else None
        done = subprocess.run(
            line, cwd=file.parent, input=text, capture_output=True, text=True, timeout=300
        )
        return done.stderr or ("" if done.returncode == 0 else f"{line} failed")

    need(command[0])
    # Programs in C++ include the headers, and are linked with objects of C.
    suffix = ".h" if is_cpp else ".c"
    wanted = (f for f in files if f.suffix == suffix and not f.name.endswith(INCLUDED_IN_C))
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return [text for text in pool.map(compiled, wanted) if text]


@pytest.mark.slow
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize(("compiler", "level"), CASES)
def test_no_text_is_complained_of(
    every_text: dict[str, list[Path]],
    compiler: str,
    level: str,
    real: str,
    pytestconfig: pytest.Config,
) -> None:
    files = every_text[real]
    scenes = {file.parent.name.rsplit("-", 2)[0] for file in files}
    assert scenes == set(SCENES)
    is_default = (compiler, level, real) == ("gcc", "-O2", "double")
    if not is_default and not pytestconfig.getoption("--campaign"):
        files = files[CASES.index((compiler, level)) % SHARES :: SHARES]
    own = [level]
    if real == "float":
        # The main program prints, and functions that print take doubles.
        own += ["-Wno-double-promotion"] if compiler == "everything" else []
    texts = compiler_output([*COMPILERS[compiler], *own], files)
    assert not texts, "\n".join(texts)


@pytest.mark.slow
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
def test_single_precision_computes_nothing_in_double(
    every_text: dict[str, list[Path]], compiler: str
) -> None:
    files = [file for file in every_text["float"] if file.name != "main.c"]
    # The front end warns of conversions.
    flags = ["-Wdouble-promotion", "-fsyntax-only"]
    texts = compiler_output([*COMPILERS[compiler], *flags], files)
    assert not texts, "\n".join(texts)


@pytest.mark.sampled(2)
@pytest.mark.parametrize("compiler", COMPILERS)
def test_no_common_text_is_complained_of(some_texts: list[Path], compiler: str) -> None:
    texts = compiler_output([*COMPILERS[compiler], "-O0"], some_texts)
    assert not texts, "\n".join(texts)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "checker", "real"),
    [
        # Single precision runs the same statements, and valgrind finds what sanitizers do.
        pytest.param(*case, marks=[] if case in EVERY_RUN else [pytest.mark.campaign])
        for case in product(SCENES, ("sanitizers", "valgrind"), ("double", "float"))
    ],
)
def test_runs_touch_no_foreign_memory(name: str, checker: str, real: str, tmp_path: Path) -> None:
    """A run may be refused; memory and arithmetic are clean in any case."""
    model = cotree.load(name).compile(list(cotree.load(name).parameters)[:2])
    for integrator in ("dopri5", "rodas5"):
        project = model.write(tmp_path / integrator, integrator, real=real)
        if checker == "valgrind":
            need("valgrind")
            command = project.command.replace("-O2", "-O1 -g").split()
            calls = ["valgrind", "--quiet", "--error-exitcode=99", "--leak-check=full"]
            run(command, project.directory)
            program = f"./{command[command.index('-o') + 1]}"
        else:
            calls, program = [], build(project, "gcc")
        # A tenth of the run, in which all that there is happens once at least.
        defaults = model.spec.scene.defaults
        done = execute([*calls, program, "--t-end", repr(0.1 * defaults.t_end)], project.directory)
        assert done.returncode in (0, 1), done.stderr
        assert "runtime error" not in done.stderr, done.stderr
