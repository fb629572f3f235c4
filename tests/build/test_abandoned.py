"""Compilations whose results are no longer needed."""

from __future__ import annotations

import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from cotree.build import abandon
from cotree.build.toolchain import run_limited
from cotree.errors import BuildError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="commands of a POSIX shell")


def test_an_abandoned_thread_ends_its_compiler_and_starts_no_other(tmp_path):
    found: list[object] = []

    def compile_twice():
        owner = threading.current_thread()
        for name in ("begun", "again"):
            try:
                # Threads of a pool may wait for the command, as for one of several files.
                with ThreadPoolExecutor(1) as pool:
                    command = ["/bin/sh", "-c", f"echo > {name}; sleep 600"]
                    pool.submit(run_limited, command, tmp_path, 900.0, owner).result()
            except BuildError as error:
                found.append(str(error))

    thread = threading.Thread(target=compile_twice)
    thread.start()
    while not (tmp_path / "begun").exists():
        time.sleep(0.01)
    abandon(thread)
    thread.join(60.0)  # far less than the commands would take
    assert not thread.is_alive()
    assert found == ["compilation cancelled: its result is no longer needed"] * 2
    # Threads that nobody abandoned are left alone.
    assert run_limited(["/bin/sh", "-c", "true"], tmp_path, 60.0).status == 0
