"""Wrong scenes and arguments: one sentence that names the culprit, and exit code 2."""

from __future__ import annotations

from importlib import resources
from typing import TYPE_CHECKING

import pytest

from cotree.cli import main

if TYPE_CHECKING:
    from pathlib import Path

TEXT = (resources.files("cotree") / "scenes" / "slider-pendulum.toml").read_text(encoding="utf-8")

INERTIA = 'inertia = ["m2*(r**2/4 + L**2/12)", "m2*r**2/2", "m2*(r**2/4 + L**2/12)"]\n'
NEW = "[outputs]\n"

# What is replaced in the shipped scene, by what, and what the sentence has to name.
WRONG: dict[str, tuple[str, str, list[str]]] = {
    "edge to a node that nothing else connects": (
        'nodes = ["ground", "A"]\naxis = [1, 0, 0] #',
        'nodes = ["ground", "Z"]\naxis = [1, 0, 0] #',
        ["'Z'", "floating", "edge k"],
    ),
    "body at a node that nothing else connects": (
        'nodes = ["ground", "C"]',
        'nodes = ["ground", "Z"]',
        ["'h2'", "nothing beyond"],  # the body itself may be free; the rod has lost its mass
    ),
    "floating nodes": (
        NEW,
        f'[edges.x]\ntype = "spring"\nnodes = ["P", "Q"]\nstiffness = 1\n{NEW}',
        ["'P'", "'Q'", "floating", "edge x"],
    ),
    "missing parameter": (
        'k = { value = 50.0, unit = "N/m", doc = "stiffness of the spring" }\n',
        "",
        ["stiffness of edge 'k'", "unknown name 'k'"],
    ),
    "parameter named as C": ("m1 = {", '"x; int system()" = {', ["'x; int system()'"]),
    "edge named as C": ("[edges.m5]", '[edges."x; int system()"]', ["'x; int system()'"]),
    "reserved word as a name": ("r = {", "lambda = {", ["'lambda'"]),
    "call of Python": (
        'mass = "m1"',
        "mass = \"__import__('os')\"",
        ["mass of edge 'm5'", "__import__"],
    ),
    "attributes of Python": (
        'mass = "m1"',
        'mass = "m1.__class__.__bases__"',
        ["mass of edge 'm5'", "__bases__"],
    ),
    "TOML syntax": ('type = "prismatic"', "type = prismatic", ["line 27"]),
    "duplicated edge": ("[edges.m6]", "[edges.m5]", ["'m5'", "twice", "line"]),
    "duplicated parameter": ("r = {", "L = {", ["line 9"]),
    "input named as a parameter": ("[edges.m5]", "[inputs]\nL = 1\n[edges.m5]", ["'L'", "taken"]),
    "joint that carries no inertia": (
        f'mass = "m2"\n{INERTIA}',
        "mass = 0\n",
        ["singular", "joint 'h2'", "'h2.theta'"],
    ),
    "body whose mass parameter is zero": ("value = 5.0", "value = 0.0", ["singular", "'h2.theta'"]),
    "parameter that is not a number": ("m1 = { value = 1.0", "m1 = { value = nan", ["'m1'", "nan"]),
    "infinite parameter": ("m1 = { value = 1.0", "m1 = { value = inf", ["'m1'", "inf"]),
    "parameter in quotes": ("r = { value = 0.03", 'r = { value = "0.03"', ["'r'", "number"]),
    "tunable in quotes": ("r = { value", 'r = { tunable = "no", value', ["'r'", "true or false"]),
    "negative mass": ("m1 = { value = 1.0", "m1 = { value = -1.0", ["mass of edge 'm5'", "-1"]),
    "unknown field": ('mass = "m1"', 'masse = "m1"', ["'m5'", "'masse'", "'mass'"]),
    "unknown component type": (
        '"prismatic"',
        '"prismatik"',
        ["'j1'", "'prismatik'", "'prismatic'"],
    ),
    "unknown section": ("[simulation]", "[simulations]", ["'simulations'", "'simulation'"]),
    "unknown setting": ("t_end = 10.0", "t_stop = 10.0", ["'t_stop'", "t_end"]),
    "wrong vector length": ("axis = [0, 0, 1]", "axis = [0, 1]", ["axis of edge 'h2'", "three"]),
    "axis without a direction": ("axis = [0, 0, 1]", "axis = [0, 0, 0]", ["axis of edge 'h2'"]),
    "gravity of text": ('gravity = [0, "-g", 0]', 'gravity = "down"', ["gravity", "three"]),
    "loop": (
        NEW,
        f'[edges.x]\ntype = "revolute"\nnodes = ["ground", "C"]\naxis = [0, 0, 1]\n{NEW}',
        [
            "x_dot = ",
            "violate",
        ],  # a dead point, but the block is told to move
    ),
    "edge from a node to itself": ('["A", "D"]', '["A", "A"]', ["'r3'", "'A'"]),
    "unknown coordinate": ("{ s = 0.5", "{ x = 0.5", ["'j1'", "'x'"]),
    "unknown name in an output": ('"C.x"', '"Q.x"', ["'rod_x'", "'Q.x'"]),
    "unknown variable of a node": ('"C.x"', '"C.q"', ["'rod_x'", "'C'", "'q'"]),
    "open parentheses": ('mass = "m1"', f'mass = "{"(" * 3000}"', ["mass of edge 'm5'"]),
    "nested signs": ('mass = "m1"', f'mass = "{"-" * 3900}1"', ["mass of edge 'm5'"]),
    "tower of powers": ('mass = "m1"', 'mass = "9**9**9**9"', ["mass of edge 'm5'", "9**9"]),
    "long number": ('mass = "m1"', f'mass = "{"9" * 3900}"', ["mass of edge 'm5'", "finite"]),
    "long expression": ('mass = "m1"', f'mass = "{"1+" * 5000}1"', ["mass of edge 'm5'", "longer"]),
    "division by zero": ('mass = "m1"', 'mass = "1/0"', ["mass of edge 'm5'", "zero"]),
    "unknown method": ("t_end = 10.0", 'method = "RK54"', ["'RK54'"]),
}


@pytest.fixture
def scene_file(tmp_path: Path) -> Path:
    return tmp_path / "scene.toml"


def error_sentence(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    """Run, demand exit code 2 and one line on stderr below what lint finds, and give that line."""
    code = main(arguments)
    error = capsys.readouterr().err
    assert code == 2, error
    lines = error.splitlines(keepends=True)
    error = "".join(line for line in lines if ": warning [" not in line)
    assert error.startswith("cotree: ")
    assert error.count("\n") == 1, error
    assert len(error) < 500
    return error


@pytest.mark.sampled(25)
@pytest.mark.parametrize("name", WRONG)
def test_wrong_scene(name: str, scene_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old, new, culprits = WRONG[name]
    assert TEXT.count(old) >= 1
    scene_file.write_text(TEXT.replace(old, new, 1), encoding="utf-8")
    sentence = error_sentence(["run", str(scene_file), "--t-end", "0.1"], capsys)
    for culprit in culprits:
        assert culprit in sentence


@pytest.mark.parametrize("text", ["name=" + "[" * 100_000, "a=" + "[" * 5000 + "]" * 5000])
def test_nested_toml(text: str, scene_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene_file.write_text(text, encoding="utf-8")
    assert "nested" in error_sentence(["run", str(scene_file)], capsys)


def test_byte_order_mark_is_no_error(scene_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene_file.write_text(TEXT, encoding="utf-8-sig")
    assert main(["graph", str(scene_file)]) == 0


def test_binary_file(scene_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene_file.write_bytes(bytes(range(256)))
    assert "UTF-8" in error_sentence(["run", str(scene_file)], capsys)


@pytest.mark.parametrize("name", ["slider-pendulun", "", "no/such.toml", "a" * 5000])
def test_missing_scene(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    code = main(["run", name])
    error = capsys.readouterr().err
    assert code == 2
    assert "neither a file nor a shipped scene" in error
    assert "slider-pendulum" in error


def test_folder_as_scene(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert str(tmp_path) in error_sentence(["run", str(tmp_path)], capsys)


ARGUMENTS: list[tuple[list[str], list[str]]] = [
    (["--sensitivity", "Q"], ["'Q'", "parameter"]),
    (["--sensitivity", "L", "--sensitivity", "L"], ["'L'", "twice"]),
    (["--set", "L=long"], ["L", "'long'", "number"]),
    (["--set", "L"], ["'L'", "name=value"]),
    (["--set", "=1"], ["'=1'", "name=value"]),
    (["--set", "L=1", "--set", "L=2"], ["'L'", "twice"]),
    (["--set", "L=nan"], ["'L'", "nan"]),
    (["--set", "Q=1"], ["'Q'"]),
    (["--set", "m1=-1"], ["mass of edge 'm5'", "-1"]),
    (["--set", "m2=0"], ["'h2'", "0"]),
    (["--initial", "j9.s=1"], ["'j9.s'", "'j1.s'"]),
    (["--initial", "j1.s=here"], ["j1.s", "'here'"]),
    (["--input", "F=1"], ["'F'", "input"]),
    (["--method", "RK54"], ["'RK54'"]),
    (["--rtol", "0"], ["rtol"]),
    (["--rtol", "nan"], ["rtol"]),
    (["--atol", "-1"], ["atol"]),
    (["--t-end", "nan"], ["nan"]),
    (["--t-end", "0"], ["time span"]),
    (["--tree", "j1,r3,h2,zz"], ["'zz'"]),
    (["--tree", "j1,r3"], ["floating", "'B'"]),
    (["--tree", "j1", "--tree", "rotation=j1"], ["'j1'", "domain"]),
    (["--tree", "rotation=j1", "--tree", "rotation=j1"], ["'rotation'", "twice"]),
    (["--tree", "rotations=j1"], ["'rotations'"]),
    (["--csv", "no-such-folder/x.csv"], ["'no-such-folder'", "x.csv"]),
    (["--plot", "no-such-folder/x.svg"], ["'no-such-folder'", "x.svg"]),
    (["--csv", "."], ["'.'", "folder"]),
]


@pytest.mark.sampled(3)
@pytest.mark.parametrize(
    ("arguments", "culprits"), ARGUMENTS, ids=[" ".join(a) for a, _ in ARGUMENTS]
)
def test_wrong_argument(
    arguments: list[str], culprits: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    sentence = error_sentence(["run", "slider-pendulum", *arguments], capsys)
    for culprit in culprits:
        assert culprit in sentence


def test_unknown_suffix_of_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = tmp_path / "graph.docx"
    assert "'.docx'" in error_sentence(["graph", "slider-pendulum", "-o", str(target)], capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "arguments",
    [
        ["run"],
        ["runs", "slider-pendulum"],
        ["run", "slider-pendulum", "--points", "1"],
        ["run", "slider-pendulum", "--t-end", "x"],
        ["generate", "slider-pendulum"],
        ["equations", "slider-pendulum", "--latex", "--steps"],
    ],
)
def test_wrong_usage(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(arguments) == 2
    assert "Traceback" not in capsys.readouterr().err
