from __future__ import annotations

import shutil
import subprocess
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from pathlib import Path

STRICT = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Wconversion", "-Wshadow", "-Werror"]


@pytest.fixture(params=["gcc", pytest.param("clang", marks=pytest.mark.slow)])
def compiler(request) -> str:
    path = shutil.which(request.param)
    if path is None:
        pytest.skip(f"{request.param} is not installed")
    return path


@pytest.fixture
def run_compiler(compiler, tmp_path):
    """Write files and compile them with every warning an error; give the program's path."""

    def run(files, *flags) -> Path:
        for name, text in files.items():
            (tmp_path / name).write_text(text)
        sources = sorted(name for name in files if name.endswith(".c"))
        command = [compiler, *STRICT, *flags, *sources]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return tmp_path / "a.out"

    return run


@pytest.fixture
def load_kernels():
    """Compile and load a program, with C files of its own if need be."""
    from cotree.build import BuildOptions, build_library, find_toolchain, load_library
    from cotree.codegen.c_files import cdef, render_model
    from cotree.codegen.context import model_context
    from cotree.model.kernels import Kernels
    from cotree.program.text import ModelText
    from cotree.version import ABI_VERSION

    def load(program, extra=None):
        context = model_context(program)
        files = {**render_model(context), **(extra or {})}
        library = build_library(
            files,
            abi_version=ABI_VERSION,
            n_operations=max(kernel.n_operations for kernel in context.kernels),
            options=BuildOptions(),
            toolchain=find_toolchain(),
        )
        loaded = load_library(library.path, cdef(files["cotree_abi.h"], context.prefix))
        return Kernels(ModelText.of(program, prefix=context.prefix), loaded)

    return load
