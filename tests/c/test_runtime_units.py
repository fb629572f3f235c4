"""Unit tests of the runtime in C: each program of ``runtime/`` runs with sanitizers."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from c_programs import SANITIZE, STRICT, need, run

from cotree.codegen.c_files import method_files, stepper_files
from cotree.codegen.render import with_runtime

pytestmark = pytest.mark.compiler

FOLDER = Path(__file__).with_name("runtime")
PROGRAMS = sorted(FOLDER.glob("test_*.c"))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.stem)
def test_runtime_in_c(path: Path, tmp_path: Path) -> None:
    text = path.read_text("ascii")
    files = {path.name: text, "check.h": (FOLDER / "check.h").read_text("ascii")}
    for method in re.findall(r"\bcotree_(\w+)_stepper\(\)", text):
        files |= {**method_files(method), **stepper_files(method)}
    files = with_runtime(files)
    for name, own in files.items():
        (tmp_path / name).write_text(own)
    sources = [name for name in files if name.endswith(".c")]
    flags = ["-std=c99", "-O0", "-g", *STRICT, *SANITIZE]
    run([need("gcc"), *flags, "-o", path.stem, *sources, "-lm"], tmp_path)
    run([f"./{path.stem}"], tmp_path)
