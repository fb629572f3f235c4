from __future__ import annotations

import shlex
import sys
from pathlib import Path

import pytest

from cotree.build import Toolchain, find_toolchain, toolchain
from cotree.errors import BuildError

VERSION_1 = 'echo "first 1.0"; echo "second line"'


@pytest.fixture(autouse=True)
def _no_request(monkeypatch):
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.delenv("COTREE_COMPILER", raising=False)


def test_none_means_no_compiler(monkeypatch):
    monkeypatch.setenv("COTREE_COMPILER", "none")
    monkeypatch.setenv("CC", "/nowhere/cc")
    assert find_toolchain() is None


def test_other_value_of_the_switch_is_refused(monkeypatch):
    monkeypatch.setenv("COTREE_COMPILER", "gcc")
    with pytest.raises(BuildError, match="COTREE_COMPILER is 'gcc'"):
        find_toolchain()


@pytest.mark.parametrize("request_", ["/nowhere/cc -O2", "no-such-compiler", "gcc 'unclosed"])
def test_unusable_request_is_named(monkeypatch, request_):
    monkeypatch.setenv("CC", request_)
    with pytest.raises(BuildError) as caught:
        find_toolchain()
    assert f"CC is '{request_}'" in str(caught.value)


def test_request_that_fails_on_version_is_named(monkeypatch, make_script):
    monkeypatch.setenv("CC", make_script("exit 3"))
    with pytest.raises(BuildError, match=r"CC is .*exit status 3"):
        find_toolchain()


def test_request_with_arguments(monkeypatch, make_script):
    script = make_script(VERSION_1, name="my compiler")
    monkeypatch.setenv("CC", f"{shlex.quote(script)} -m64 '-DX=a b'")
    assert find_toolchain() == Toolchain((script, "-m64", "-DX=a b"), "first 1.0", "cc")


def test_change_of_request_is_seen(monkeypatch, make_script):
    monkeypatch.setenv("CC", make_script("echo one", name="one"))
    assert find_toolchain().version == "one"
    monkeypatch.setenv("CC", make_script("echo two", name="two"))
    assert find_toolchain().version == "two"


def test_version_is_read_once_per_command(monkeypatch, make_script, tmp_path: Path):
    calls = tmp_path / "calls"
    monkeypatch.setenv("CC", make_script(f"echo x >> {shlex.quote(str(calls))}; echo one"))
    assert find_toolchain() == find_toolchain()
    assert calls.read_text() == "x\n"


def test_compiler_repaired_meanwhile_is_found(monkeypatch, make_script):
    monkeypatch.setenv("CC", make_script("exit 1"))
    with pytest.raises(BuildError):
        find_toolchain()
    make_script("echo repaired")
    assert find_toolchain().version == "repaired"


def test_order_and_broken_candidates(monkeypatch, make_script, tmp_path: Path):
    make_script("exit 1", name="cc")
    gcc = make_script(VERSION_1, name="gcc")
    make_script("echo clang", name="clang")
    monkeypatch.setenv("PATH", str(tmp_path))
    assert find_toolchain().command == (gcc,)


def test_nothing_is_run_from_the_current_directory(monkeypatch, make_script, tmp_path: Path):
    make_script(VERSION_1, name="cc")
    (tmp_path / "ziglang").mkdir()
    (tmp_path / "ziglang" / "__init__.py").touch()
    (tmp_path / "ziglang" / "__main__.py").write_text("print('wrong')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend("")
    monkeypatch.setenv("PATH", f".:{tmp_path / 'nothing'}")
    found = find_toolchain()
    # The real ziglang package may be installed.
    assert found is None or found.version != "wrong"
    assert found is None or found.command[0] == sys.executable


def test_kinds():
    assert Toolchain(("/usr/bin/cc",), "Apple clang version 15.0.0", "cc").is_clang
    assert Toolchain(("/usr/bin/zig", "cc"), "something", "zig").is_clang
    assert not Toolchain(("/usr/bin/cc",), "cc (Debian 12.2.0-14) 12.2.0", "cc").is_clang


def test_zig_by_request(monkeypatch, make_script):
    monkeypatch.setenv("CC", f"{make_script(VERSION_1, name='zig')} cc")
    assert find_toolchain().kind == "zig"


def test_a_compiler_that_hangs_is_asked_once_and_leaves_nothing_behind(
    monkeypatch, make_script, tmp_path
):
    monkeypatch.setattr(toolchain, "_ANSWER_TIME", 0.3)
    count, child = tmp_path / "count", tmp_path / "child"
    path = make_script(f"echo asked >> {count}; sleep 600 & echo $! > {child}; wait", "hangs")
    monkeypatch.setenv("CC", path)
    for _ in range(3):
        with pytest.raises(BuildError, match=rf"'{path}' does not answer --version within 0.3 s"):
            find_toolchain()
    assert count.read_text() == "asked\n"
    status = Path(f"/proc/{child.read_text().strip()}/status")
    # A child that was killed stays as a zombie until whoever adopts it has looked.
    assert not status.exists() or "zombie" in status.read_text()
