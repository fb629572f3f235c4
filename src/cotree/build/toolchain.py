"""Search for a C compiler.

Candidates are, in this order, the environment variable ``CC``, ``cc``, ``gcc``, ``clang``, and the
package ``ziglang``. ``COTREE_COMPILER=none`` disables all compilers.
"""

from __future__ import annotations

import contextlib
import functools
import importlib.util
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from cotree.errors import BuildError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence


# Memory limit of the compiler, [KiB]; usual models need a few hundred MiB.
_MEMORY_LIMIT_KIB = 8 * 1024 * 1024

# Time limit for reading the remaining output of a killed command, [s].
_LAST_WORDS = 2.0


# Threads of the running commands, and threads whose results are no longer needed. Threads are
# identified by their objects, because systems reuse thread numbers.
_running: dict[subprocess.Popen[bytes], threading.Thread] = {}
_abandoned: weakref.WeakSet[threading.Thread] = weakref.WeakSet()


@dataclass(frozen=True)
class Outcome:
    """Exit status and output of a command."""

    #: Exit status, negative for a signal as in :mod:`subprocess`; None after the time limit.
    status: int | None
    output: str  # standard output and standard error, interleaved


def run_limited(
    command: Sequence[str],
    directory: Path,
    time_limit: float,
    owner: threading.Thread | None = None,
) -> Outcome:
    """Run a command for at most ``time_limit`` seconds, without input.

    ``directory`` is the current directory of the command, also for its temporary files. The whole
    process group is killed after the time limit or if the caller is interrupted. Raise OSError if
    the command cannot be started, and BuildError if the thread ``owner``, by default the calling
    thread, has been abandoned.
    """
    folder, owner = str(directory), owner or threading.current_thread()
    process = subprocess.Popen(
        _with_memory_limit(command),
        cwd=folder,
        # The locale is English, because messages are searched for English words.
        env={**os.environ, "LC_ALL": "C", "TMPDIR": folder, "TMP": folder, "TEMP": folder},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        # A signal to the process group also reaches the processes that a compiler starts.
        start_new_session=True,
    )
    with process:
        _running[process] = owner
        try:
            _check_wanted(owner)
            output, _ = process.communicate(timeout=time_limit)
            _check_wanted(owner)  # a cancelled command was killed and has not failed
            status: int | None = process.returncode
        except subprocess.TimeoutExpired:
            _kill_group(process)
            # Processes outside the group may keep the pipe open, hence the time limit.
            try:
                output, _ = process.communicate(timeout=_LAST_WORDS)
            except subprocess.TimeoutExpired as error:
                output = error.stdout or b""
            status = None
        # Ctrl-C stops both the caller and the compiler.
        except BaseException:
            _kill_group(process)
            raise
        finally:
            del _running[process]
    return Outcome(status, output.decode("utf-8", "replace"))


def abandon(thread: threading.Thread) -> None:
    """Kill the compilers of a thread, and prevent it from starting others, as a program ends."""
    _abandoned.add(thread)
    for process, owner in list(_running.items()):
        if owner is thread:
            with contextlib.suppress(ProcessLookupError):  # the process may have ended
                _kill_group(process)


def _check_wanted(thread: threading.Thread) -> None:
    if thread in _abandoned:
        raise BuildError("compilation cancelled: its result is no longer needed")


def _with_memory_limit(command: Sequence[str]) -> list[str]:
    """Return a shell command that sets the memory limit and then runs the command.

    A ``preexec_fn`` would be unsafe, because NumPy's libraries start threads in this process.
    """
    if sys.platform == "win32":
        return list(command)
    script = f'ulimit -S -v {_MEMORY_LIMIT_KIB} 2>/dev/null; exec "$@"'
    return ["/bin/sh", "-c", script, "sh", *command]


def _kill_group(process: subprocess.Popen[bytes]) -> None:
    if sys.platform == "win32":
        process.kill()
        return
    # The number of the first process identifies the group until poll() or wait() reaps it. Thus
    # poll() is not called while other processes of the group may be running.
    if process.returncode is None:
        os.killpg(process.pid, signal.SIGKILL)


_NAMES = ("cc", "gcc", "clang")
# Time limit of the first call, [s], which may wait for a network file system or a virus scanner.
_ANSWER_TIME = 10.0


@dataclass(frozen=True)
class Toolchain:
    """A C compiler that has responded to ``--version``."""

    command: tuple[str, ...]  # absolute path of the program, and arguments of every call
    version: str  # first line of the response
    #: ``'zig'`` if the compiler is called through zig, whose defaults differ.
    kind: Literal["cc", "zig"]

    @property
    def is_clang(self) -> bool:
        """Whether the compiler is clang, directly or inside zig."""
        return self.kind == "zig" or "clang" in self.version.lower()


def find_toolchain() -> Toolchain | None:
    """Find a C compiler; return None if there is none, or ``COTREE_COMPILER`` is ``none``.

    The environment is read at each call. Raise BuildError if ``CC`` is not a usable compiler, or if
    ``COTREE_COMPILER`` has another value than ``none``.
    """
    switch = os.environ.get("COTREE_COMPILER", "").strip()
    if switch not in ("", "none"):
        raise BuildError(
            f"The environment variable COTREE_COMPILER is '{switch}', but 'none' is the only value "
            "it takes; name a compiler with the environment variable CC."
        )
    if switch:
        return None
    requested = os.environ.get("CC", "").strip()
    if requested:
        return _requested_toolchain(requested)
    for command in _candidate_commands():
        # Programs on PATH that do not respond are skipped; only CC must be usable.
        with contextlib.suppress(BuildError):
            return _toolchain(command)
    return None


def _requested_toolchain(requested: str) -> Toolchain:
    """Return the compiler that CC specifies, or raise BuildError if it is not usable."""
    try:
        # CC may contain arguments, as in `ccache gcc`, which are part of every call.
        program, *arguments = _split(requested)
        found = _find_program(program)
        if found is None:
            raise BuildError("it is not an executable file, nor the name of one on PATH")
        return _toolchain((found, *arguments))
    except (BuildError, ValueError) as error:
        raise BuildError(
            f"The environment variable CC is '{requested}', which cannot be used as a C compiler: "
            f"{error}. Correct it or unset it."
        ) from error


def _split(text: str) -> list[str]:
    """Split a command line; on Windows, backslashes separate folders and are no escapes."""
    if sys.platform == "win32":
        return [part.strip('"') for part in shlex.split(text, posix=False)]
    return shlex.split(text)


def _candidate_commands() -> Iterator[tuple[str, ...]]:
    for name in _NAMES:
        program = _find_program(name)
        if program is not None:
            yield (program,)
    if sys.executable and importlib.util.find_spec("ziglang") is not None:
        # Without -P, a folder 'ziglang' in the current directory would be imported.
        yield (sys.executable, "-P", "-m", "ziglang", "cc")


def _find_program(name: str) -> str | None:
    """Return the absolute path of a program; relative entries of PATH are ignored.

    Programs in the current directory are run only if ``name`` is a path.
    """
    if os.path.dirname(name):
        return shutil.which(os.path.abspath(name))
    folders = [folder for folder in os.get_exec_path() if os.path.isabs(folder)]
    found = shutil.which(name, path=os.pathsep.join(folders))
    return found if found is not None and os.path.isabs(found) else None


def _toolchain(command: tuple[str, ...]) -> Toolchain:
    version = _answer(command)
    if version is None:
        raise BuildError(
            f"'{command[0]}' does not answer --version within {_ANSWER_TIME:g} s; it is not asked "
            "again in this process"
        )
    # Zig may be a program, or a module that Python runs.
    is_zig = Path(command[0]).stem == "zig" or "ziglang" in command
    return Toolchain(command, version, "zig" if is_zig else "cc")


# All other failures raise an error and are not cached: a compiler installed later is found.
@functools.cache
def _answer(command: tuple[str, ...]) -> str | None:
    """Return the version text of a compiler, or None if it does not respond in time."""
    try:
        _check_command_line_tools(command[0])
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            answer = run_limited([*command, "--version"], Path(folder), _ANSWER_TIME)
    except OSError as error:
        raise BuildError(f"it does not answer --version ({error})") from error
    if answer.status is None:
        return None
    lines = answer.output.strip().splitlines()
    if answer.status != 0 or not lines:
        raise BuildError(f"it does not answer --version (exit status {answer.status})")
    return lines[0].strip()


def _check_command_line_tools(program: str) -> None:
    """Raise BuildError for a placeholder of Apple in /usr/bin, which would open a dialog."""
    if sys.platform == "darwin" and os.path.dirname(program) == "/usr/bin":
        command = ["/usr/bin/xcode-select", "-p"]
        answer = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, check=False)
        if answer.returncode != 0:
            raise BuildError(
                "Apple's command line tools are not installed (xcode-select --install adds them)"
            )
