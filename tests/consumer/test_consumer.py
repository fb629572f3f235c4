"""Type checkers read cotree from outside: types serve users' scripts, and find their mistakes."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

_HERE = Path(__file__).parent
_SOURCES = _HERE.parents[1] / "src"
_SCRIPT = _HERE / "script.py"


def _refused_lines():
    lines = _SCRIPT.read_text(encoding="utf-8").splitlines()
    return {i for i, line in enumerate(lines, 1) if line.endswith("# refused")}


def _run(command, folder, **environment):
    return subprocess.run(
        [sys.executable, "-m", *command],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
        env={"PATH": "", "HOME": str(folder), **environment},
    )


@pytest.mark.slow
def test_mypy_accepts_a_users_script_and_finds_its_mistakes(tmp_path):
    pytest.importorskip("mypy")
    # Errors within cotree are those of its own check; the user's configuration is the strict one.
    options = ["--strict", "--follow-imports=silent", "--config-file=", f"--cache-dir={tmp_path}"]
    done = _run(["mypy", *options, str(_SCRIPT)], tmp_path, MYPYPATH=str(_SOURCES))
    found = {int(line) for line in re.findall(r"script\.py:(\d+): error", done.stdout)}
    assert found == _refused_lines(), done.stdout + done.stderr


@pytest.mark.slow
def test_pyright_accepts_a_users_script_and_finds_its_mistakes(tmp_path):
    pytest.importorskip("basedpyright")
    settings = {
        "include": [str(_SCRIPT)],
        "extraPaths": [str(_SOURCES)],
        "typeCheckingMode": "strict",
        "pythonVersion": "3.11",
    }
    (tmp_path / "pyrightconfig.json").write_text(json.dumps(settings), encoding="utf-8")
    done = _run(
        ["basedpyright", "-p", str(tmp_path), "--pythonpath", sys.executable, "--outputjson"],
        tmp_path,
    )
    told = json.loads(done.stdout)["generalDiagnostics"]
    found = {row["range"]["start"]["line"] + 1 for row in told if row["severity"] == "error"}
    assert found == _refused_lines(), [row["message"] for row in told]
