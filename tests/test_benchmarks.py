"""The command that runs all benchmarks: what it keeps, and what it says where one cannot run."""

from __future__ import annotations

import ast
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SCRIPTS = {path.stem for path in (ROOT / "benchmarks").glob("*.py")}


def benchmarks(*arguments, cwd=ROOT):
    path = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]))
    return subprocess.run(
        [sys.executable, str(ROOT / "benchmarks"), *arguments],
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize("name", sorted(SCRIPTS))
def test_imported_names_of_the_package_exist(name):
    for node in ast.walk(ast.parse((ROOT / "benchmarks" / f"{name}.py").read_text())):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] == "cotree":
            module = importlib.import_module(str(node.module))
            missing = [row.name for row in node.names if not hasattr(module, row.name)]
            assert not missing, f"{node.module} has no {missing}"


def test_without_a_name_they_are_listed():
    """As a module from the clone's folder, and nothing is run or written."""
    path = os.pathsep.join(filter(None, [str(ROOT / "src"), os.environ.get("PYTHONPATH", "")]))
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks"],
        cwd=ROOT,
        env={**os.environ, "PYTHONPATH": path},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "  operations: operations of the slider-pendulum" in done.stdout
    assert len(done.stdout.splitlines()) > 13


@pytest.mark.slow
@pytest.mark.compiler
def test_a_quick_one_prints_its_table_and_says_where_it_is(tmp_path):
    """From any folder."""
    done = benchmarks("operations", "--quick", "--out", "kept", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("# operations")
    assert "| " in done.stdout
    assert f"written to {Path('kept') / 'README.md'}" in done.stderr
    kept = json.loads((tmp_path / "kept" / "operations.json").read_text("utf-8"))
    assert kept["command"] == ["python", "benchmarks/operations.py", "5"]


@pytest.mark.slow
@pytest.mark.compiler
def test_tables_are_kept_with_what_they_were_measured_with(tmp_path):
    done = benchmarks("real_time", "--out", str(tmp_path / "kept"))
    assert done.returncode == 0, done.stderr
    numbers = json.loads((tmp_path / "kept" / "real_time.json").read_text("utf-8"))
    assert {"machine", "processor", "compiler", "python", "cotree"} <= set(numbers["about"])
    assert numbers["problem"] == ""
    for table in numbers["tables"]:
        assert table["rows"]
        assert all(len(row) == len(table["head"]) for row in table["rows"])
    text = (tmp_path / "kept" / "real_time.md").read_text("utf-8")
    assert "- compiler: " in text
    assert "[real_time](real_time.md)" in (tmp_path / "kept" / "README.md").read_text("utf-8")


def test_an_unknown_name_is_told(tmp_path):
    done = benchmarks("kernel", cwd=tmp_path)
    assert done.returncode == 2
    assert "there is no benchmark 'kernel'; the known ones: " in done.stderr
    assert not list(tmp_path.iterdir())


def test_every_script_that_measures_is_listed():
    helpers = {"__main__", "ensemble_peers", "kernel_peers", "kernel_pydy", "peer_equations"}
    done = benchmarks("--help")
    for name in SCRIPTS - helpers - {"robots_mujoco", "timing"}:
        assert f"{name}: " in done.stdout.replace("\n", " "), name
