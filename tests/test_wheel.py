"""The wheel works away from the source tree: templates and scenes are in it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

_ROOT = Path(__file__).resolve().parents[1]

pytestmark = [pytest.mark.slow, pytest.mark.compiler]


def _run(command, folder, **environment):
    done = subprocess.run(
        [sys.executable, *command],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, **environment},
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Build from a copy, so that nothing is left in the source tree."""
    pytest.importorskip("hatchling")
    copy = tmp_path_factory.mktemp("source")
    ignored = shutil.ignore_patterns(".*", "dist", "__pycache__", "tests", "docs", "generated")
    shutil.copytree(_ROOT, copy, ignore=ignored, dirs_exist_ok=True)
    _run(["-m", "hatchling", "build", "-t", "wheel", "-d", str(copy / "dist")], copy)
    (built,) = (copy / "dist").glob("*.whl")
    return built


def test_templates_and_scenes_are_in_the_wheel(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    sources = {
        f"cotree/{path.relative_to(_ROOT / 'src' / 'cotree').as_posix()}"
        for path in (_ROOT / "src" / "cotree").rglob("*")
        if path.suffix in (".py", ".pyi", ".toml", ".typed")
    }
    templates = {
        f"cotree/_templates/{path.relative_to(_ROOT / 'templates').as_posix()}"
        for path in (_ROOT / "templates").rglob("*")
        if path.is_file() and not path.name.startswith(".")
    }
    assert len(templates) > 3
    assert sources | templates <= names
    assert {"cotree/py.typed", "cotree/scene/component_methods.pyi"} <= sources


def test_the_wheel_is_for_every_platform_and_describes_itself(wheel):
    assert wheel.name.endswith("-py3-none-any.whl")
    with zipfile.ZipFile(wheel) as files:
        folder = next(name.partition("/")[0] for name in files.namelist() if ".dist-info/" in name)
        metadata = files.read(f"{folder}/METADATA").decode()
        assert "Root-Is-Purelib: true" in files.read(f"{folder}/WHEEL").decode()
        assert "cotree = cotree.cli:main" in files.read(f"{folder}/entry_points.txt").decode()
    head, _, description = metadata.partition("\n\n")
    for line in ("License-Expression: BSD-3-Clause", "Description-Content-Type: text/markdown"):
        assert line in head
    assert "Requires-Python: >=3.11" in head
    # Markdown, whose only demands are whole blocks of code.
    assert description.lstrip().startswith("# cotree")
    assert description.count("```") % 2 == 0


def test_the_command_runs_from_an_installed_wheel(wheel, tmp_path):
    site, elsewhere = tmp_path / "site", tmp_path / "elsewhere"
    elsewhere.mkdir()
    # A wheel of pure Python is installed by unpacking it; its requirements are here already.
    zipfile.ZipFile(wheel).extractall(site)
    entry = "from cotree.cli import main; import cotree, sys; sys.argv[0] = 'cotree'; main()"
    environment = {"PYTHONPATH": str(site), "COTREE_CACHE_DIR": str(tmp_path / "cache")}
    where = _run(["-c", "import cotree; print(cotree.__file__)"], elsewhere, **environment)
    assert where.startswith(str(site))
    text = _run(["-c", entry, "run", "slider-pendulum"], elsewhere, **environment)
    assert "j1.s" in text
    assert "0.52604505" in text  # the reference's end state
    _run(["-c", entry, "run", "slider-pendulum", "--animate", "a.html"], elsewhere, **environment)
    assert "</html>" in (elsewhere / "a.html").read_text(encoding="utf-8")
    version = _run(["-c", "import cotree; print(cotree.__version__)"], elsewhere, **environment)
    assert version.strip() in wheel.name
