"""Every command on the shipped scenes: what it prints, writes and returns."""

from __future__ import annotations

import csv
import os
import re
import subprocess
import sys
from typing import TYPE_CHECKING, Any

import pytest

import cotree
import cotree.model.loading
from cotree.cli import main
from cotree.cli.options import read_tree

if TYPE_CHECKING:
    from pathlib import Path

SCENES = ["slider-pendulum", "spring-mass-damper"]

# x'' = 100 x**3 from x = 1 leaves every bound before t = 1.
EXPLODING = """
[edges.m]
type = "rigid_body"
nodes = ["ground", "A"]
mass = 1
[edges.s]
type = "prismatic"
nodes = ["ground", "A"]
axis = [1, 0, 0]
force = "100*s.s**3"
initial = { s = 1 }
"""

FORCED = """
[parameters]
a = 2.0
idle = 1.0
[inputs]
F = 0
[edges.m]
type = "rigid_body"
nodes = ["ground", "A"]
mass = 1
[edges.s]
type = "prismatic"
nodes = ["ground", "A"]
axis = [1, 0, 0]
force = "a*F"
"""


@pytest.fixture
def forced(tmp_path: Path) -> str:
    path = tmp_path / "forced.toml"
    path.write_text(FORCED, encoding="utf-8")
    return str(path)


def value(text: str, name: str) -> float:
    """Read ``name = value`` from a report."""
    found = re.search(rf"^ *{re.escape(name)} *= *(\S+)", text, re.MULTILINE)
    assert found, text
    return float(found.group(1))


@pytest.mark.parametrize("scene", SCENES)
def test_run_prints_the_end_state(scene: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", scene, "--t-end", "1"]) == 0
    printed = capsys.readouterr()
    result = cotree.load(scene).compile().simulate((0, 1))
    for name in (*result.states, *result.outputs):
        # The same run; the text has 10 significant digits.
        assert value(printed.out, name) == pytest.approx(result[name][-1], rel=1e-9, abs=1e-300)
    for stage in ("formulate", "generate", "compile", "integrate"):
        assert stage in printed.out
    assert printed.err == ""


def test_run_prints_sensitivities_with_units(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "slider-pendulum", "-s", "L", "--sensitivity", "k", "--t-end", "1"]
    assert main(arguments) == 0
    text = capsys.readouterr().out
    result = cotree.load("slider-pendulum").compile(["L", "k"]).simulate((0, 1))
    assert value(text, "d(rod_x)/d(k)") == pytest.approx(
        result.sensitivity("rod_x", "k")[-1], rel=1e-9
    )
    assert re.search(r"d\(h2\.theta\)/d\(L\) .* rad/m$", text, re.MULTILINE)
    assert re.search(r"d\(j1\.s\)/d\(k\) .* m/\(N/m\)$", text, re.MULTILINE)


def test_run_takes_values_in_place_of_the_scenes(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "spring-mass-damper", "--t-end", "1", "--set", "k=20", "--set", "c = 3"]
    assert main([*arguments, "--initial", "s.s=0.1", "--method", "RK45", "--rtol", "1e-6"]) == 0
    text = capsys.readouterr().out
    result = (
        cotree.load("spring-mass-damper")
        .compile()
        .simulate(
            (0, 1),
            parameters={"k": 20.0, "c": 3.0},
            initial={"s.s": 0.1},
            method="RK45",
            rtol=1e-6,
        )
    )
    assert value(text, "s.s") == pytest.approx(result["s.s"][-1], rel=1e-9)
    assert "RK45" in text


def test_run_takes_an_input(forced: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", forced, "--t-end", "1", "--input", "F=3*t", "-s", "a"]) == 0
    text = capsys.readouterr().out
    # x'' = a F = 6 t gives x = t**3; DOP853 integrates cubics exactly, but for the start's atol.
    assert value(text, "s.s") == pytest.approx(1.0, abs=1e-8)
    assert value(text, "d(s.s)/d(a)") == pytest.approx(0.5, abs=1e-8)


def test_run_warns_of_a_parameter_that_reaches_nothing(
    forced: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["run", forced, "--t-end", "1", "--input", "F=1", "-s", "idle", "-s", "a"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("cotree: warning: no state or output depends on parameter 'idle'")


def test_run_ends_where_there_is_no_compiler(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(cotree.model.loading, "find_toolchain", lambda: None)
    assert main(["run", "spring-mass-damper", "--t-end", "0.1", "-s", "k"]) == 2
    printed = capsys.readouterr()
    assert printed.err.startswith("cotree: warning: no C compiler")
    assert "pip install ziglang" in printed.err.splitlines()[-1]


def test_run_takes_budgets(capsys: pytest.CaptureFixture[str]) -> None:
    command = ["run", "spring-mass-damper"]
    assert main([*command, "--max-steps", "5"]) == 1
    assert "the limit of 5 steps is reached" in capsys.readouterr().err
    assert main([*command, "--max-steps", "inf", "--time-limit", "inf", "--max-events", "7"]) == 0
    assert main([*command, "--max-steps", "2.5"]) == 2
    assert "give a whole number" in capsys.readouterr().err


def test_failed_integration_shows_the_last_good_point(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "exploding.toml"
    path.write_text(EXPLODING, encoding="utf-8")
    table = tmp_path / "table.csv"
    assert main(["run", str(path), "--t-end", "1", "--csv", str(table)]) == 1
    printed = capsys.readouterr()
    assert "last good point" in printed.out
    assert len(printed.err.splitlines()) == 1
    assert "stopped at t = " in printed.err
    assert table.exists()


def test_run_writes_a_table(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "table.csv"
    arguments = ["run", "slider-pendulum", "-s", "L", "--t-end", "1", "--points", "11"]
    assert main([*arguments, "--csv", str(path)]) == 0
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0][:2] == ["t", "j1.s"]
    assert "d(rod_x)/d(L)" in rows[0]
    assert [float(row[0]) for row in rows[1:]] == pytest.approx([i / 10 for i in range(11)])
    assert [file.name for file in tmp_path.iterdir()] == ["table.csv"]


def test_run_draws_finite_differences_over_sensitivities(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import cotree.cli.run_picture as picture

    seen: dict[str, Any] = {}

    def spy(result: Any, names: Any, overlay: Any) -> Any:
        seen.update(result=result, overlay=overlay)
        return plot_result(result, names, overlay)

    plot_result = picture.plot_result
    monkeypatch.setattr(picture, "plot_result", spy)
    path = tmp_path / "run.svg"
    arguments = ["run", "slider-pendulum", "-s", "L", "-s", "h2.theta", "--t-end", "2"]
    assert main([*arguments, "--set", "k=40", "--plot", str(path)]) == 0
    assert path.read_text(encoding="utf-8").startswith("<?xml")
    assert set(seen["overlay"]) == {
        (name, parameter) for name in ("j1.s", "h2.theta") for parameter in ("L", "h2.theta")
    }
    for (name, parameter), (times, values) in seen["overlay"].items():
        curve = seen["result"].sensitivity(name, parameter)
        # Both grids are even, and the ends are in both: steps of 1e-4 with runs at 1e-10.
        assert values[-1] == pytest.approx(curve[-1], abs=1e-5)
        assert len(times) == 40


def test_run_draws_what_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    import cotree.cli.run_picture as picture

    drawn: list[Any] = []
    monkeypatch.setattr(
        picture, "save_figure", lambda figure, _: drawn.extend(figure.axes) or figure
    )
    path = tmp_path / "run.svg"
    run = ["run", "slider-pendulum", "-s", "L", "--t-end", "1", "--plot", str(path)]
    assert main([*run, "--show", "h2.theta", "--show", "d(rod_x)/d(L)"]) == 0
    assert [ax.get_ylabel() for ax in drawn] == ["h2.theta [rad]", "∂ rod_x / ∂ L [m/m]"]
    assert len(drawn[1].lines) == 3  # the curve, circles, and those of the legend
    capsys.readouterr()
    assert main([*run, "--show", "h2.thata"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""  # refused before it ran
    assert (
        "cannot plot 'h2.thata', which is not a state, output or input; did you mean 'h2.theta'"
        in (printed.err)
    )
    assert main([*run[:-2], "--show", "h2.theta"]) == 2
    assert "also give --plot FILE" in capsys.readouterr().err


def test_picture_leaves_out_what_cannot_be_differenced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = tmp_path / "light.toml"
    scene.write_text(
        FORCED.replace("idle = 1.0", "m0 = 0.0")
        + '[edges.b]\ntype = "rigid_body"\nnodes = ["ground", "A"]\nmass = "m0"\n',
        encoding="utf-8",
    )
    path = tmp_path / "run.png"
    arguments = ["run", str(scene), "--input", "F=1", "-s", "m0", "--t-end", "1"]
    assert main([*arguments, "--plot", str(path)]) == 0
    # A mass below zero is refused, so there is no central difference around zero.
    assert "no finite differences of 'm0'" in capsys.readouterr().err
    assert path.stat().st_size > 0


@pytest.mark.parametrize("scene", SCENES)
def test_generate_names_files_and_command(
    scene: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "made" / "here"
    assert main(["generate", scene, "-o", str(folder)]) == 0
    text = capsys.readouterr().out
    written = {
        line.removeprefix("wrote ") for line in text.splitlines() if line.startswith("wrote")
    }
    assert written == {str(path) for path in folder.iterdir()}
    assert "main.c" in text.splitlines()[-1]


def test_equations_as_text_latex_and_steps(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["equations", "spring-mass-damper", "-s", "k"]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 2
    assert main(["equations", "spring-mass-damper", "-s", "k", "--latex"]) == 0
    assert capsys.readouterr().out.startswith(r"\begin{align}")
    assert main(["equations", "spring-mass-damper", "-s", "k", "--steps"]) == 0
    text = capsys.readouterr().out
    assert all(f"({number})" in text for number in (1, 2, 3, 4, 5, 7))


def test_steps_of_a_tree_with_a_body_go_to_the_end(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["equations", "spring-mass-damper", "--steps", "--tree", "m"]) == 0
    text = capsys.readouterr().out
    assert "(4)" not in text  # there is no G2
    assert "G1: m*x_ddot + c*x_dot + k*(x - l0) - F0*sin(t*w) = 0" in text


def test_steps_of_different_trees_show_both(capsys: pytest.CaptureFixture[str]) -> None:
    trees = ["--tree", "translation=m", "--tree", "rotation=s"]
    assert main(["equations", "spring-mass-damper", "--steps", *trees]) == 0
    text = capsys.readouterr().out
    assert "translation tree: branches m; chords k, c, F, s\n" in text
    assert "rotation tree: branches s; chords m\n" in text
    assert "G1: m*x_ddot + c*x_dot + k*(x - l0) - F0*sin(t*w) = 0" in text


@pytest.mark.parametrize("scene", SCENES)
def test_graph_is_printed_or_drawn(
    scene: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["graph", scene]) == 0
    assert "f-cutsets" in capsys.readouterr().out
    path = tmp_path / "graph.svg"
    assert main(["graph", scene, "-o", str(path)]) == 0
    assert path.exists()


def test_graph_takes_a_tree(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["graph", "spring-mass-damper", "--tree", "m"]) == 0
    assert "translation tree: branches m; chords k, c, F, s" in capsys.readouterr().out


def test_check_passes_and_fails(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["check", "spring-mass-damper", "-s", "k", "--t-end", "0.5", "--set", "c=2"]
    assert main(arguments) == 0
    assert "PASS  k" in capsys.readouterr().out
    from cotree import check

    # A tolerance that nothing meets.
    monkeypatch.setattr(check, "_ROUNDING", -1.0)
    assert main(arguments) == 1
    assert "FAIL  k" in capsys.readouterr().out


@pytest.mark.slow
def test_check_takes_a_tree_a_method_and_a_tolerance(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["check", "slider-pendulum", "-s", "L", "--t-end", "0.2", "--rtol", "1e-9"]
    assert main([*arguments, "--tree", "m5,m6,r3,r4", "--method", "rkf45"]) == 0
    out = capsys.readouterr().out
    assert "rkf45, rtol 1e-09" in out
    assert "m6" in out.partition("closest is ")[2]  # coordinates of bodies, not of joints
    assert out.endswith("all sensitivities passed: 1\n")


def test_scenes_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scenes"]) == 0
    names = [line.partition(":")[0] for line in capsys.readouterr().out.splitlines()]
    assert set(names) >= set(SCENES)


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"cotree {cotree.__version__}\n"


def test_interruption_is_exit_code_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("cotree.api.load", interrupted)
    assert main(["run", "slider-pendulum"]) == 130
    assert "Traceback" not in capsys.readouterr().err


@pytest.mark.slow
def test_letters_that_a_pipe_lacks_are_replaced(tmp_path: Path) -> None:
    code = "import sys; from cotree.cli import main; sys.exit(main())"
    done = subprocess.run(
        [
            sys.executable,
            "-X",
            "utf8",
            "-c",
            code,
            "graph",
            SCENES[0],
            "-o",
            "\N{GREEK SMALL LETTER MU}.svg",
        ],
        env={"PYTHONIOENCODING": "latin-1", "PYTHONPATH": os.pathsep.join(sys.path)},
        cwd=tmp_path,
        capture_output=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == [b"wrote", b"?.svg"]


def test_help_needs_no_heavy_package() -> None:
    code = (
        "import sys; from cotree.cli import main; main(['--help']); "
        "print([n for n in ('scipy.integrate', 'sympy', 'matplotlib', 'networkx', 'sksundae') "
        "if n in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env={"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    assert done.stdout.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("texts", "tree"),
    [
        ([], None),
        (["j1, h2"], ["j1", "h2"]),
        (["j1", "h2"], ["j1", "h2"]),
        (["translation=m,k", "rotation = s"], {"translation": ["m", "k"], "rotation": ["s"]}),
    ],
)
def test_trees_are_read(texts: list[str], tree: object) -> None:
    assert read_tree(texts) == tree


def test_optimise_prints_the_design_and_writes_its_run(tmp_path, capsys):
    target = tmp_path / "best.csv"
    goal, over = "integral(j1.s**2)", "zeta=0.1:5"
    arguments = ["optimise", "slider-pendulum", "--minimise", goal, "--over", over, "--t-end", "4"]
    assert main([*arguments, "--csv", str(target)]) == 0
    assert "Converged" in capsys.readouterr().out
    assert target.read_text(encoding="utf-8").startswith("t,j1.s,")
    assert main([*arguments[:5], "zeta=0.1"]) == 2
    assert "is not of the form NAME=LOW:HIGH" in capsys.readouterr().err


def test_run_prints_what_is_suspicious(tmp_path, capsys):
    path = tmp_path / "open.toml"
    path.write_text(
        """
[edges.V]
type = "voltage_source"
nodes = ["a", "ground"]
voltage = 1.0
[edges.R]
type = "resistor"
nodes = ["a", "b"]
resistance = 1.0
[edges.C]
type = "capacitor"
nodes = ["b", "ground"]
capacitance = 1.0
[edges.D]
type = "resistor"
nodes = ["b", "gnd"]
resistance = 1.0
""",
        encoding="utf-8",
    )
    assert main(["run", str(path), "--t-end", "1"]) == 0
    told = capsys.readouterr().err
    assert "dangling-node:gnd" in told
    assert "did you mean 'ground'?" in told
