"""C programs of tests: built with warnings and sanitizers as errors, and run."""

from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

    from cotree.export.c_project import CProject

STRICT = ["-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror"]
SANITIZE = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def execute(command: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=120)


def run(command: list[str], folder: Path) -> str:
    done = execute(command, folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def need(program: str) -> str:
    if shutil.which(program) is None:
        pytest.skip(f"{program} is not installed")
    return program


def build(project: CProject, compiler: str) -> str:
    """Run the project's own command, made stricter; give the executable."""
    command = project.command.split()
    run([compiler, *STRICT, *SANITIZE, *command[1:]], project.directory)
    return "./" + command[command.index("-o") + 1]


def printed(text: str) -> dict[str, float]:
    rows = [line.split(" = ") for line in text.splitlines()]
    return {name: float(value) for name, value in rows}
