"""Compilations that nobody waits for any more."""

from __future__ import annotations

import sys
import threading
import time

import pytest

from cotree.build import abandon
from cotree.build.process import run_limited
from cotree.errors import BuildError

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="commands of a POSIX shell")


def test_an_abandoned_thread_ends_its_compiler_and_starts_no_other(tmp_path):
    found: list[object] = []

    def compile_twice():
        found.append(run_limited(["/bin/sh", "-c", "echo > begun; sleep 600"], tmp_path, 900.0))
        try:
            run_limited(["/bin/sh", "-c", "echo > again; sleep 600"], tmp_path, 900.0)
        except BuildError as error:
            found.append(str(error))

    thread = threading.Thread(target=compile_twice)
    thread.start()
    while not (tmp_path / "begun").exists():
        time.sleep(0.01)
    abandon(thread)
    thread.join(60.0)  # far less than the commands would take
    assert not thread.is_alive()
    killed, said = found
    assert killed.status < 0  # by a signal
    assert said == "nobody waits for the compiler any more"
    # Threads that nobody abandoned are left alone.
    assert run_limited(["/bin/sh", "-c", "true"], tmp_path, 60.0).status == 0
