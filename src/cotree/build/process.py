"""Run the compiler under limits of time and memory, without a terminal, in a folder of its own."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import weakref
from dataclasses import dataclass
from typing import TYPE_CHECKING

from cotree.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

# Ordinary models need a few hundred MiB; a compiler that wants more than this has run away.
_MEMORY_LIMIT_KIB = 8 * 1024 * 1024

# How long the output of a command that was killed is waited for, [s].
_LAST_WORDS = 2.0


# Commands that run, with the thread that each is for, and threads whose work nobody wants any more.
# Threads are told apart by themselves: systems give the number of one that ended to another.
_running: dict[subprocess.Popen[bytes], threading.Thread] = {}
_abandoned: weakref.WeakSet[threading.Thread] = weakref.WeakSet()


@dataclass(frozen=True)
class Outcome:
    """Exit status and output of a command.

    Attributes
    ----------
    status : int or None
        Exit status, negative for a signal as in :mod:`subprocess`; None if time ran out.
    output : str
        Standard output and standard error, interleaved.
    """

    status: int | None
    output: str


def run_limited(
    command: Sequence[str],
    directory: Path,
    time_limit: float,
    owner: threading.Thread | None = None,
) -> Outcome:
    """Run a command and wait for it, at most ``time_limit`` seconds.

    The command's temporary files go to ``directory``, which is also its current directory, so that
    nothing outlives it there. It reads nothing, and whatever it started dies with it when time
    runs out or the caller is interrupted.

    Parameters
    ----------
    command : sequence of str
        The program and its arguments; no shell reads them.
    directory : Path
        Its current directory.
    time_limit : float
        Seconds after which it is killed.
    owner : threading.Thread, optional
        The thread that the command is for; the one that calls where absent.

    Returns
    -------
    Outcome
        Exit status and output, or that time ran out.

    Raises
    ------
    OSError
        If the command cannot be started.
    BuildError
        If nobody wants it any more; see :func:`abandon`.
    """
    folder, owner = str(directory), owner or threading.current_thread()
    process = subprocess.Popen(
        _with_memory_limit(command),
        cwd=folder,
        # Messages are searched for English words.
        env={**os.environ, "LC_ALL": "C", "TMPDIR": folder, "TMP": folder, "TEMP": folder},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        # One signal to the session's group then reaches the passes that a compiler starts, too.
        start_new_session=True,
    )
    with process:
        _running[process] = owner
        try:
            _check_wanted(owner)
            output, _ = process.communicate(timeout=time_limit)
            _check_wanted(owner)  # one that was killed for that has not failed
            status: int | None = process.returncode
        except subprocess.TimeoutExpired:
            _kill_group(process)
            # The pipe is emptied, and the killed process waited for; what left the group may hold
            # the pipe open for as long as it likes.
            try:
                output, _ = process.communicate(timeout=_LAST_WORDS)
            except subprocess.TimeoutExpired as error:
                output = error.stdout or b""
            status = None
        # Ctrl-C ends the compiler with the caller.
        except BaseException:
            _kill_group(process)
            raise
        finally:
            del _running[process]
    return Outcome(status, output.decode("utf-8", "replace"))


def abandon(thread: threading.Thread) -> None:
    """End what a thread compiles, and let it compile nothing else: the program is about to end."""
    _abandoned.add(thread)
    for process, owner in list(_running.items()):
        if owner is thread:
            with contextlib.suppress(ProcessLookupError):  # it has just ended by itself
                _kill_group(process)


def _check_wanted(thread: threading.Thread) -> None:
    if thread in _abandoned:
        raise BuildError("nobody waits for the compiler any more")


def _with_memory_limit(command: Sequence[str]) -> list[str]:
    """Let a shell set the limit and become the command.

    A preexec_fn is unsafe in a process with threads, which NumPy's libraries start. A system that
    refuses the limit runs the command without one.
    """
    if sys.platform == "win32":
        return list(command)
    script = f'ulimit -S -v {_MEMORY_LIMIT_KIB} 2>/dev/null; exec "$@"'
    return ["/bin/sh", "-c", script, "sh", *command]


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    """Kill the compiler with the passes it has started."""
    if sys.platform == "win32":
        process.kill()
        return
    # The leader's number names the group for certain until the leader has been waited for. Not
    # poll(): it would wait for a leader that is gone while its passes live on.
    if process.returncode is None:
        os.killpg(process.pid, signal.SIGKILL)
