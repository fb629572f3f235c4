"""Generated C in other people's programs: an own loop, CMake, make, C++ and a microcontroller."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

import pytest
from c_programs import SANITIZE, STRICT, execute, need, printed, run

import cotree

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]

HERE = Path(__file__).with_name("drop_in")
#: What the loop loses at 2000 steps: by its order 1e-12, and by rounding in single precision 2000
#: units in the last place, most of which cancel.
LOST = {"double": 1e-10, "float": 2e-5}


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Write the model in both precisions."""
    model = cotree.load("slider-pendulum").compile(["L"])
    folder = tmp_path_factory.mktemp("drop-in")
    for real in LOST:
        model.write(folder / real, "dopri5,rodas5", real=real, cpp=True)
    return folder


@pytest.fixture(scope="module")
def known() -> dict[str, float]:
    """Return the state at two seconds with the rod of the program."""
    model = cotree.load("slider-pendulum").compile()
    settings = {"method": "dop853", "rtol": 1e-12, "atol": 1e-14, "parameters": {"L": 1.25}}
    result = model.simulate((0, 2), **settings)
    return {"s": result["j1.s"][-1], "theta": result["h2.theta"][-1]}


def own_loop(folder: Path, real: str) -> list[str]:
    """List the arguments that a compiler needs for the program."""
    model = folder / real
    return [f"-I{model}", str(HERE / "own_loop.c"), str(model / "slider_pendulum.c"), "-lm"]


@pytest.mark.parametrize("real", LOST)
def test_own_loop(folder, known, real, tmp_path):
    # Nothing is computed in double precision by the way.
    flags = ["-std=c99", *STRICT, *SANITIZE, *(["-Wdouble-promotion"] if real == "float" else [])]
    run([need("gcc"), *flags, "-o", "own", *own_loop(folder, real)], tmp_path)
    assert printed(run(["./own"], tmp_path)) == pytest.approx(known, abs=LOST[real])


@pytest.mark.slow
@pytest.mark.parametrize("real", LOST)
def test_microcontroller(folder, known, real, tmp_path):
    """Built for a Cortex-M4 with newlib, and run on a board of QEMU."""
    machine = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"]
    library = ["--specs=rdimon.specs", "-T", str(HERE / "cortex_m4.ld")]
    flags = ["-std=c99", "-O2", *STRICT, *machine, *library, str(HERE / "startup.c")]
    run([need("arm-none-eabi-gcc"), *flags, "-o", "own.elf", *own_loop(folder, real)], tmp_path)
    board = ["-machine", "mps2-an386", "-nographic", "-monitor", "none", "-serial", "none"]
    calls = ["-semihosting-config", "enable=on,target=native"]
    text = run([need("qemu-system-arm"), *board, *calls, "-kernel", "own.elf"], tmp_path)
    assert printed(text) == pytest.approx(known, abs=LOST[real])


@pytest.mark.slow
def test_arm_linux(folder, known, tmp_path):
    flags = ["-std=c99", "-O2", "-static", *STRICT]
    command = [need("aarch64-linux-gnu-gcc"), *flags, "-o", "own", *own_loop(folder, "double")]
    run(command, tmp_path)
    text = run([need("qemu-aarch64"), "./own"], tmp_path)
    assert printed(text) == pytest.approx(known, abs=LOST["double"])


@pytest.mark.slow
@pytest.mark.parametrize("shared", ["OFF", "ON"])
def test_cmake_finds_what_was_installed(folder, known, shared, tmp_path):
    cmake = need("cmake")
    prefix, library, consumer = (tmp_path / name for name in ("prefix", "library", "consumer"))
    options = [f"-DBUILD_SHARED_LIBS={shared}", f"-DCMAKE_INSTALL_PREFIX={tmp_path / 'other'}"]
    run([cmake, "-S", str(folder / "double"), "-B", str(library), *options], tmp_path)
    run([cmake, "--build", str(library)], tmp_path)
    run([cmake, "--install", str(library), "--prefix", str(prefix)], tmp_path)
    given = f"-DCMAKE_PREFIX_PATH={prefix}"
    run([cmake, "-S", str(HERE / "cmake"), "-B", str(consumer), given], tmp_path)
    run([cmake, "--build", str(consumer)], tmp_path)
    text = run([str(consumer / "consumer")], tmp_path)
    assert printed(text) == pytest.approx(known, abs=LOST["double"])
    found = next(prefix.rglob("slider_pendulum.pc"))
    flag = run([need("pkg-config"), "--cflags", str(found)], tmp_path).strip()
    header = Path(flag.removeprefix("-I"), "slider_pendulum.h").resolve(strict=True)
    assert header.is_relative_to(prefix.resolve())


@pytest.mark.slow
def test_make_installs_for_pkg_config(folder, known, tmp_path):
    source = shutil.copytree(folder / "double", tmp_path / "source")
    run([need("make"), "install", f"PREFIX={tmp_path / 'prefix'}"], source)
    path = tmp_path / "prefix" / "lib" / "pkgconfig" / "slider_pendulum.pc"
    flags = run([need("pkg-config"), "--cflags", "--libs", str(path)], tmp_path).split()
    program = [str(HERE / "own_loop.c"), "-std=c99", *flags]
    run([need("cc"), "-o", "own", *program], tmp_path)
    assert printed(run(["./own"], tmp_path)) == pytest.approx(known, abs=LOST["double"])


@pytest.mark.slow
@pytest.mark.parametrize("standard", ["c++11", "c++20"])
@pytest.mark.parametrize("compiler", ["g++", "clang++"])
def test_wrapper_for_cpp(folder, compiler, standard, tmp_path):
    model = folder / "double"
    run([need("gcc"), "-std=c99", "-c", str(model / "slider_pendulum.c")], tmp_path)
    source = [f"-I{model}", str(HERE / "wrapper.cpp"), "slider_pendulum.o", "-lm"]
    run([need(compiler), f"-std={standard}", *STRICT, "-o", "wrapper", *source], tmp_path)
    found = printed(run(["./wrapper"], tmp_path))
    known = cotree.load("slider-pendulum").compile()
    rates = known.rhs(0.0, known.initial_state, {"L": 1.25})
    assert [found[f"dx{i}"] for i in range(4)] == pytest.approx(rates, rel=1e-14)
    assert found["refused"] == 3


@pytest.fixture(scope="module")
def program(folder) -> Path:
    """Build the main program, with both methods."""
    project = cotree.load("slider-pendulum").compile(["L"]).write(folder / "main", "dopri5,rodas5")
    run(project.command.split(), project.directory)
    return project.directory


def test_main_program_takes_parameters_and_writes_a_table(program, tmp_path):
    model = cotree.load("slider-pendulum").compile()
    settings = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13, "parameters": {"L": 1.1, "k": 40}}
    result = model.simulate((0, 5), **settings)
    for method in ("dopri5", "rodas5"):
        table = tmp_path / f"{method}.csv"
        options = ["--set", "L=1.1", "--set", "k=40", "--t-end", "5", "--rtol", "1e-10"]
        options += ["--method", method, "--csv", str(table), "--points", "11"]
        assert run(["./slider_pendulum", *options], program) == ""
        head, *rows = table.read_text().splitlines()
        assert head.startswith("t,j1.s,")
        assert len(rows) == 11
        last = dict(zip(head.split(","), map(float, rows[-1].split(",")), strict=True))
        # Some hundred steps at 1e-10.
        assert last["j1.s"] == pytest.approx(result["j1.s"][-1], abs=1e-8)


@pytest.mark.parametrize(
    ("arguments", "message", "code"),
    [
        ("--set Q=1", "Q=1: there is no such parameter; --help lists them", 2),
        ("--set L", "L: write --set NAME=VALUE", 2),
        ("--set L=nan", "L=nan: the value is not a finite number", 2),
        ("--set m1=-1", "mass of edge 'm5' must not be negative (parameter 'm1')", 1),
        ("--method rk9", "rk9: this method is not compiled in; choose one of dopri5, rodas5", 2),
        ("--unknown 1", "--unknown: there is no such option; --help lists them", 2),
        ("--csv", "--csv: its value is missing", 2),
        ("--csv /none/x", "/none/x: the file cannot be written", 2),
        ("--rtol 2", "2: the relative tolerance must be between 0 and 1", 2),
        ("1 2 3", "3: only the end time and the number of points have no option", 2),
    ],
)
def test_main_program_refuses_bad_arguments_in_a_sentence(program, arguments, message, code):
    done = execute(["./slider_pendulum", *arguments.split()], program)
    assert (done.returncode, done.stdout) == (code, "")
    assert done.stderr == f"slider-pendulum: {message}.\n"


def test_main_program_lists_its_parameters(program):
    text = run(["./slider_pendulum", "--help"], program)
    assert "  L = 1 m\n" in text
    assert "--method NAME     dopri5, rodas5\n" in text


def test_main_program_keeps_parameters_that_its_numbers_were_computed_for(tmp_path):
    """The time of a pulse is a number of the program; the start is not."""
    scene = cotree.Scene("pushed")
    scene.parameter("t1", 0.5)
    scene.edge("p", "prismatic", "ground", "A", axis=[1, 0, 0], initial={"s": 1.0})
    scene.edge("m", "rigid_body", "ground", "A", mass=2.0)
    scene.edge("f", "force", "ground", "A", force=["where(t > t1, 1, 0)", 0, 0])
    project = scene.compile().write(tmp_path)
    run(project.command.split(), tmp_path)
    assert execute(["./pushed", "--set", "t1=0.6"], tmp_path).stderr == (
        "pushed: t1=0.6: a time or the start of this model is computed for the value in the scene, "
        "so change it there and generate the project again.\n"
    )
