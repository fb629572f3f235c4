"""A project in one header and one source: as clean as the folder, and with the same results."""

from __future__ import annotations

import sys

import pytest
from c_programs import execute, need, run

import cotree

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]

FLAGS = ["-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Werror"]
#: A smooth model, events, constraints, algebraic unknowns, inputs with kinks.
CASES = [
    ("slider-pendulum", ["L"], "dopri5", None),
    ("slider-pendulum", [], "rk4", 1e-3),
    ("bouncing-ball", ["e"], "dopri5,rodas5", None),
    ("motor-linkage", [], "rodas5", None),
    ("bridge-rectifier", [], "dop853", None),
    ("two-tanks", [], "dopri5", None),
]


@pytest.mark.parametrize(("name", "sensitivities", "integrator", "step"), CASES)
def test_same_end_as_the_folder(tmp_path, name, sensitivities, integrator, step):
    gcc, model = need("gcc"), cotree.load(name).compile(sensitivities)
    printed = []
    for is_single in (False, True):
        folder = tmp_path / str(is_single)
        project = model.write(folder, integrator, step, single_file=is_single)
        words = project.command.replace("cc -std=c99 -O2", "-O1").split()
        run([gcc, *FLAGS, *words], folder)
        program = words[words.index("-o") + 1]
        printed.append(execute([f"./{program}"], folder).stdout)
    assert printed[0] == printed[1] != ""
    assert {path.suffix for path in project.files} == {".h", ".c"}
    assert len(project.files) == 2


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("level", ["-O0", "-O1", "-O2", "-O3"])
def test_no_warning_at_any_level(tmp_path, compiler, level):
    model = cotree.load("slider-pendulum").compile(["L"])
    model.write(tmp_path, "dopri5,rodas5", single_file=True)
    for main in ([], ["-DSLIDER_PENDULUM_MAIN"]):
        run([need(compiler), *FLAGS, level, *main, "-c", "slider_pendulum.c"], tmp_path)


def test_two_models_in_one_program_and_headers_in_another_language(tmp_path):
    compiler = need("g++")
    for name in ("slider-pendulum", "bouncing-ball"):
        cotree.load(name).compile().write(tmp_path, single_file=True)
        run([need("gcc"), "-std=c99", "-c", f"{name.replace('-', '_')}.c"], tmp_path)
    (tmp_path / "own.cpp").write_text(
        '#include "slider_pendulum.h"\n#include "bouncing_ball.h"\n'
        "int main() {\n"
        "    return slider_pendulum_abi()->name == bouncing_ball_abi()->name;\n}\n"
    )
    flags = ["-std=c++11", "-Wall", "-Wextra", "-Wpedantic", "-Werror"]
    objects = ["slider_pendulum.o", "bouncing_ball.o"]
    run([compiler, *flags, "-o", "own", "own.cpp", *objects, "-lm"], tmp_path)
    run(["./own"], tmp_path)


def test_nothing_of_a_part_is_left_behind(tmp_path):
    """Macros end with their part, and no name of the runtime is without the prefix."""
    cotree.load("bouncing-ball").compile().write(tmp_path, "rodas5", single_file=True)
    for path in tmp_path.iterdir():
        code = [line for line in path.read_text().splitlines() if "cotree_" in line.lower()]
        # File names stay, in comments.
        assert [line for line in code if not any(e in line for e in (".h", ".c"))] == []
    defined = run([need("gcc"), "-std=c99", "-dM", "-E", "bouncing_ball.c"], tmp_path)
    names = {line.split()[1].split("(")[0] for line in defined.splitlines()}
    assert not names & {"N", "N_STATES", "ALL", "ZERO", "MODEL", "ENGINE", "STAGES"}
