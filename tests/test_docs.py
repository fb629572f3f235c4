"""What the documents say holds: examples run, tables are complete."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest

from cotree import Scene
from cotree.components import COMPONENTS
from cotree.scene.expressions import FUNCTIONS
from cotree.scene.toml_file import read_scene

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")
SCENES = (ROOT / "docs" / "scenes.md").read_text(encoding="utf-8")


def blocks(text, language):
    return re.findall(rf"```{language}\n(.*?)```", text, re.DOTALL)


def test_the_readme_example_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    exec(compile(blocks(README, "python")[0], "README.md", "exec"), {})
    assert (tmp_path / "slider_pendulum_c" / "main.c").is_file()


def test_the_scene_page_says_the_same_in_toml_and_python():
    from_toml = read_scene(blocks(SCENES, "toml")[0], "pendulum.toml", Scene)
    names: dict = {}
    exec(compile(f"import cotree\n{blocks(SCENES, 'python')[0]}", "scenes.md", "exec"), names)
    from_python = names["scene"]
    states = [scene.compile().states for scene in (from_toml, from_python)]
    assert states[0] == states[1]
    first, second = (scene.compile() for scene in (from_toml, from_python))
    y = first.initial_state + 0.2
    assert (first.rhs(0.3, y) == second.rhs(0.3, y)).all()


@pytest.mark.parametrize("component", COMPONENTS.values(), ids=lambda c: c.name)
def test_every_component_and_field_is_documented(component):
    row = re.search(rf"^\| `{component.name}` .*$", SCENES, re.MULTILINE)
    assert row is not None
    for field in component.fields:
        assert f"`{field.name}`" in row.group()


def test_every_function_of_expressions_is_documented():
    for name in FUNCTIONS:
        assert re.search(rf"\b{name}\b", SCENES)


def test_operation_counts_of_the_readme_are_those_of_the_model():
    from cotree import load

    operations = load("slider-pendulum").compile(["L"]).operations
    table = "\n".join(line for line in README.splitlines() if line.startswith("| cotree"))
    expected = [
        operations["rhs"].total,
        operations["augmented_rhs"].total,
        operations["rhs"].kernel,
        operations["augmented_rhs"].kernel,
    ]
    assert [int(n) for n in re.findall(r"\| (\d+) ", table)] == expected


@pytest.mark.compiler
def test_the_c_example_compiles(tmp_path):
    from cotree import load

    load("slider-pendulum").compile().write(tmp_path)
    text = blocks((ROOT / "docs" / "c.md").read_text(encoding="utf-8"), "c")[0]
    include, _, body = text.partition("\n")
    lines = body.strip().splitlines()
    program = "\n".join(
        [include, "#include <stddef.h>", "int main(void)", "{", *lines, "return 0;", "}"]
    )
    (tmp_path / "example.c").write_text(program, encoding="utf-8")
    command = "cc -std=c99 -Wall -c example.c -o example.o"
    done = subprocess.run(
        shlex.split(command), cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
