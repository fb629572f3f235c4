from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import pytest

from cotree.build import Toolchain, find_toolchain

if TYPE_CHECKING:
    from pathlib import Path

MODEL = {
    "cotree_abi.h": "#define ABI_VERSION 1\n",
    "model.h": "double twice(double x);\nint abi_version(void);\n",
    "model.c": (
        '#include "cotree_abi.h"\n#include "model.h"\n#include <math.h>\n'
        "double twice(double x) { return x + fabs(x); }\n"
        "int abi_version(void) { return ABI_VERSION; }\n"
    ),
}
CDEF = "double twice(double x); int abi_version(void);"


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Use a separate cache for each test."""
    folder = tmp_path / "cache"
    monkeypatch.setenv("COTREE_CACHE_DIR", str(folder))
    return folder


@pytest.fixture
def files() -> dict[str, str]:
    return dict(MODEL)


@pytest.fixture
def cdef() -> str:
    return CDEF


@pytest.fixture
def toolchain() -> Toolchain:
    found = find_toolchain()
    if found is None:
        pytest.skip("no C compiler")
    return found


@pytest.fixture
def fake_gcc() -> Toolchain:
    """A toolchain that is never started."""
    return Toolchain(("/nowhere/gcc",), "gcc 12.2.0", "cc")


@pytest.fixture
def make_script(tmp_path: Path):
    """Write an executable shell script that stands in for a compiler."""
    if sys.platform == "win32":
        pytest.skip("needs a POSIX shell")

    def write(body: str, name: str = "compiler") -> str:
        path = tmp_path / name
        path.write_text(f"#!/bin/sh\n{body}\n")
        path.chmod(0o755)
        return str(path)

    return write
