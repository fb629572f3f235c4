"""Rooms import downwards only."""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import cotree

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_import_layers():
    command = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    if command is None:
        pytest.skip("import-linter is not installed")
    done = subprocess.run([command], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


def modules_after(code):
    """Name the modules that a new process has imported after some code."""
    code = f"import sys\n{code}\nprint(*sys.modules, file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stderr.split())


def test_importing_cotree_imports_nothing_else():
    """Each public name imports what it needs at its first use."""
    modules = modules_after("import cotree")
    assert {name for name in modules if name.startswith("cotree")} == {"cotree"}
    assert not modules & {"numpy", "scipy", "sympy", "jinja2", "cffi"}


def test_public_names_are_found_at_their_first_use():
    found = {name: getattr(cotree, name) for name in cotree.__all__}
    assert found["load"].__module__ == "cotree.api"
    assert set(dir(cotree)) >= found.keys()
    with pytest.raises(AttributeError, match="no attribute 'lode'"):
        cotree.lode  # noqa: B018


@pytest.mark.parametrize("name", ["slider-pendulum", "battery-cell", "two-tanks"])
def test_a_cold_run_imports_no_sympy(name, tmp_path, monkeypatch):
    """Laws of components are nodes; SymPy prints equations and reads laws of users."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    modules = modules_after(
        f"import cotree\nscene = cotree.load({name!r})\n"
        "scene.compile(list(scene.parameters)[:1]).simulate((0, 0.01))"
    )
    assert "cotree.formulation" in modules
    assert "sympy" not in modules
    # A mechanism needs no networks.
    assert ("cotree.formulation.networks.network" in modules) == (name != "slider-pendulum")


@pytest.mark.compiler
def test_a_run_imports_few_modules(tmp_path, monkeypatch):
    """A mechanism needs no contacts, tables, events or maps; a second run forms no nodes."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    code = (
        "import cotree\n"
        "model = cotree.load('slider-pendulum').compile(['L', 'k'])\n"
        "model.simulate((0, 10), rtol=1e-8)"
    )
    for most_modules, most_lines in ((135, 34_000), (70, 15_000)):
        names = [name for name in modules_after(code) if name.split(".")[0] == "cotree"]
        paths = [Path(importlib.util.find_spec(name).origin) for name in names]
        assert len(names) <= most_modules
        assert sum(path.read_text(encoding="utf-8").count("\n") for path in paths) <= most_lines


def test_a_command_imports_what_it_needs():
    """A run draws nothing, reads no files of other tools and compares no methods."""
    modules = modules_after(
        "from cotree.cli import main\n"
        "assert main(['run', 'slider-pendulum', '--t-end', '0.1']) == 0"
    )
    assert not modules & {
        "matplotlib",
        "networkx",
        "pandas",
        "PIL",
        "rich.console",
        "scipy.integrate",
        "cotree.export.symbolic",
        "cotree.readers.spice.scene",
        "cotree.readers.urdf.scene",
        "cotree.studies.bench",
        "cotree.watch.animation",
    }


def test_modules_stay_small():
    long = {
        str(path.relative_to(ROOT)): n
        for path in (ROOT / "src").rglob("*.py")
        if (n := len(path.read_text(encoding="utf-8").splitlines())) > 700
    }
    assert long == {}


def test_test_files_have_names_of_their_own():
    # Of two files with one name pytest collects the first, and reports the other as an error.
    names = [path.name for path in (ROOT / "tests").rglob("test_*.py")]
    assert sorted({name for name in names if names.count(name) > 1}) == []
