from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from cotree.build import BuildOptions, build_library, load_library
from cotree.errors import BuildError

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.compiler
def test_library_is_loaded_once(files, cdef, toolchain):
    built = build_library(
        files, abi_version=1, n_operations=10, options=BuildOptions(), toolchain=toolchain
    )
    library = load_library(built.path, cdef)
    assert load_library(str(built.path), cdef) is library
    assert load_library(built.path, "int abi_version(void);") is not library
    assert library.ffi.sizeof("double") == 8


def test_what_is_no_library_is_refused(tmp_path: Path):
    path = tmp_path / "text.so"
    path.write_text("not a library")
    with pytest.raises(BuildError, match=r"text\.so' cannot be loaded"):
        load_library(path, "int f(void);")


def test_bare_name_is_not_searched_in_system_folders(tmp_path: Path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(BuildError, match="cannot be loaded"):
        load_library("libm.so.6", "double cos(double x);")
