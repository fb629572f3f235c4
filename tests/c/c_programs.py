"""C programs of tests: built with warnings and sanitizers as errors, and run."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import subprocess
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
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
    """Build the project as its own command does, made stricter; give the executable.

    Sanitizers take a compiler ten times as long at -O2 as without optimisation; what is the same
    for several models is compiled once for all tests.
    """
    command = project.command.split()
    level = ["-O0" if word == "-O2" else word for word in command[1:]]
    sources = [word for word in level if word.endswith(".c")]
    name = level[level.index("-o") + 1]
    flags = [word for word in level if word not in {*sources, "-o", name, "-lm"}]
    compile_ = [compiler, *flags, *STRICT, *SANITIZE]
    objects = [compile_once(compile_, project.directory, source) for source in sources]
    run([*compile_, "-o", name, *objects, "-lm"], project.directory)
    return f"./{name}"


def compile_once(command: list[str], folder: Path, source: str) -> str:
    """Return the object of a file, which tests and workers share if its text and headers agree."""
    texts = [path.read_text() for path in _included(folder / source)]
    key = hashlib.sha256("\0".join([*command, *texts]).encode()).hexdigest()
    kept = Path(os.environ["COTREE_CACHE_DIR"]).with_name("objects") / f"{key}.o"
    if not kept.exists():
        kept.parent.mkdir(exist_ok=True)
        own = folder / f"{key}.o"
        run([*command, "-c", source, "-o", own.name], folder)
        # Another worker may do the same.
        shutil.copy(own, kept.with_suffix(f".{os.getpid()}"))
        kept.with_suffix(f".{os.getpid()}").replace(kept)
    return str(kept)


def _included(source: Path) -> list[Path]:
    """Return a file and all files of its folder that it includes."""
    found = [source]
    for path in found:
        names = re.findall(r'#include "(\w+\.h)"', path.read_text())
        found += [own for own in map(source.with_name, names) if own.exists() and own not in found]
    return found


def printed(text: str) -> dict[str, float]:
    rows = [line.split(" = ") for line in text.splitlines()]
    return {name: float(value) for name, value in rows}
