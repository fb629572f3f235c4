from __future__ import annotations

import dataclasses
import os
import sys
from pathlib import Path

import pytest

from cotree.build import cache as cache_module
from cotree.build import cache_directory, cache_key, clear_cache
from cotree.errors import BuildError

posix_only = pytest.mark.skipif(sys.platform == "win32", reason="POSIX permissions")


def key_of(default_toolchain, **changes):
    arguments = {
        "files": {"model.c": "int a;", "model.h": "int b;"},
        "abi_version": 1,
        "toolchain": default_toolchain,
        "flags": ["-O1"],
        "cpu_features": "",
    }
    arguments.update(changes)
    return cache_key(arguments.pop("files"), **arguments)


def test_key_is_the_same_for_the_same_content(fake_gcc):
    swapped = {"model.h": "int b;", "model.c": "int a;"}
    assert key_of(fake_gcc) == key_of(fake_gcc, files=swapped, flags=("-O1",))


def test_key_changes_with_every_ingredient(fake_gcc):
    changes = [
        {},
        {"files": {"model.c": "int a; ", "model.h": "int b;"}},
        {"files": {"model.c": "int a;int b;", "model.h": ""}},
        {"files": {"other.c": "int a;", "model.h": "int b;"}},
        {"abi_version": 2},
        {"toolchain": dataclasses.replace(fake_gcc, version="gcc 13.1.0")},
        {"toolchain": dataclasses.replace(fake_gcc, command=("/nowhere/gcc", "-m32"))},
        {"flags": ["-O0"]},
        {"flags": ["-O1", "-march=native"]},
        {"flags": ["-O1", "-march=native"], "cpu_features": "sse2 avx2"},
    ]
    keys = {key_of(fake_gcc, **change) for change in changes}
    assert len(keys) == len(changes)


def test_folder_is_created_private(cache: Path):
    assert cache_directory() == cache
    assert cache.is_dir()
    if sys.platform != "win32":
        assert cache.stat().st_mode & 0o777 == 0o700


def test_default_folder_is_the_platforms(monkeypatch, tmp_path: Path):
    import platformdirs

    monkeypatch.delenv("COTREE_CACHE_DIR")
    monkeypatch.setattr(
        platformdirs, "user_cache_dir", lambda name, appauthor: str(tmp_path / "caches" / name)
    )
    assert cache_directory() == tmp_path / "caches" / "cotree"


@posix_only
@pytest.mark.parametrize("mode", [0o770, 0o702, 0o777])
def test_folder_open_to_others_is_refused(cache: Path, mode):
    cache.mkdir()
    cache.chmod(mode)
    with pytest.raises(BuildError, match="can be written by other users") as caught:
        cache_directory()
    assert str(cache) in str(caught.value)
    assert "COTREE_CACHE_DIR" in str(caught.value)


@posix_only
def test_folder_of_someone_else_is_refused(cache: Path, monkeypatch):
    cache_directory()
    monkeypatch.setattr(os, "geteuid", lambda: cache.stat().st_uid + 1)
    with pytest.raises(BuildError, match="belongs to another user"):
        cache_directory()


def test_relative_folder_is_refused(monkeypatch, tmp_path: Path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COTREE_CACHE_DIR", "somewhere")
    with pytest.raises(BuildError, match="'somewhere' is not an absolute path"):
        cache_directory()
    assert not Path("somewhere").exists()


def test_folder_that_is_a_file_is_refused(cache: Path):
    cache.write_text("")
    with pytest.raises(BuildError, match="cannot be created"):
        cache_directory()


def test_absent_and_damaged_libraries_are_not_found(cache: Path):
    key = "0" * 64
    assert cache_module.find_published(key) is None
    with cache_module.private_directory() as folder:
        (folder / "library.so").write_bytes(b"content")
        path = cache_module.publish(folder / "library.so", key)
    assert cache_module.find_published(key) == path
    assert {entry.name for entry in cache.iterdir()} == {f"{key}.so", f"{key}.sha256"}
    path.write_bytes(b"conten")
    assert cache_module.find_published(key) is None
    path.write_bytes(b"content")
    path.with_suffix(".sha256").unlink()
    assert cache_module.find_published(key) is None


def test_clear_removes_only_what_cotree_wrote(cache: Path):
    assert clear_cache() == 0
    key = "a" * 64
    (cache / f"{key}.so").write_bytes(b"")
    (cache / f"{key}.sha256").write_bytes(b"")
    cache_module.save_failed_sources({"model.c": "", "model.h": ""}, key)
    interrupted = cache / "cotree-build-xyz"
    interrupted.mkdir()
    (interrupted / "model.c").touch()
    foreign = [cache / "thesis.tex", cache / "libother.so", cache / "failed" / "notes"]
    for path in foreign:
        path.touch()
    assert clear_cache() == 5
    assert sorted(path for path in cache.rglob("*") if path.is_file()) == sorted(foreign)
