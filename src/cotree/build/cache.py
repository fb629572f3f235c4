"""Cache of compiled libraries in a folder of the user; keys depend on all inputs of a library.

Libraries are stored as ``<key>.so``, object files that several libraries link as ``<key>.o``, and C
text with its program as ``<key>.text``. A file that does not match its checksum in ``<key>.sha256``
counts as missing. Files are published by atomic renaming from a private folder, so that readers
never find an incomplete file. The lock of a key only saves work: a process that cannot acquire it
builds the library itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import pickle
import platform
import re
import shutil
import stat
import sys
import sysconfig
import tempfile
import time
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from cotree.errors import BuildError
from cotree.files import template_folder

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from cotree.build.toolchain import Toolchain

_T = TypeVar("_T")

_VARIABLE = "COTREE_CACHE_DIR"
_FAILED = "failed"
_PRIVATE_PREFIX = "cotree-build-"
#: Suffixes of the files of cotree on which cached texts depend.
_SOURCES = (".py", ".jinja", ".c", ".h")
# Patterns of file names in the cache; other files in the folder are never removed.
_KEY = re.compile(r"[0-9a-f]{64}")
_PUBLISHED = re.compile(r"[0-9a-f]{64}\.(so|o|text|sha256|lock)")
#: Suffixes of libraries, of object files that several libraries link, and of pickled C texts.
LIBRARY, OBJECT, TEXT = ".so", ".o", ".text"

#: Whether texts are cached. Tests that change the generator disable this.
KEEPS = True
# Age after which a private folder counts as abandoned, [s]; no build takes this long.
_ABANDONED_AFTER = 24.0 * 3600.0


def cache_directory() -> Path:
    """Return the absolute path of the cache folder, created with mode 0700 if it does not exist.

    The folder is ``COTREE_CACHE_DIR`` or, by default, the platform's folder for caches.

    Raises
    ------
    BuildError
        If the path is relative or the folder cannot be created. On POSIX also if another user owns
        the folder or can write to it, because its libraries run with the rights of this user.
    """
    directory = _configured_directory()
    if not directory.is_absolute():
        raise BuildError(
            f"The cache folder '{directory}' is not an absolute path; correct the environment "
            f"variable {_VARIABLE}."
        )
    try:
        directory.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = directory.stat()
    except OSError as error:
        raise BuildError(
            f"The cache folder '{directory}' cannot be created ({error.strerror}); name another "
            f"one with the environment variable {_VARIABLE}."
        ) from error
    # The permissions of an existing folder are not changed.
    _check_private(directory, status)
    return directory


def cache_key(
    files: Mapping[str, str],
    *,
    abi_version: int,
    toolchain: Toolchain,
    flags: Sequence[str],
    cpu_features: str = "",
) -> str:
    """Return a hash of everything on which a library depends, as 64 hexadecimal digits.

    ``files`` are C texts by name; ``cpu_features`` names the processor's features if the flags
    select this machine's processor.

    >>> from cotree.build import Toolchain, cache_key
    >>> gcc = Toolchain(("/usr/bin/gcc",), "gcc 12.2.0", "cc")
    >>> len(cache_key({"a.c": "int a;"}, abi_version=1, toolchain=gcc, flags=["-O1"]))
    64
    """
    ingredients = {
        "files": dict(files),
        "abi_version": abi_version,
        "command": toolchain.command,
        "version": toolchain.version,
        "flags": list(flags),
        "cpu_features": cpu_features,
        # Machines with different C libraries may share a home folder.
        "platform": [sysconfig.get_platform(), *platform.libc_ver()],
    }
    # The keys are sorted, so that the order of the mapping has no effect.
    return hashlib.sha256(json.dumps(ingredients, sort_keys=True).encode()).hexdigest()


def find_published(key: str, end: str = LIBRARY) -> Path | None:
    """Return the cached file of a key, or None if it is missing or does not match its checksum."""
    library, checksum = _published_paths(key, end)
    try:
        # Loading a damaged library would crash the process instead of raising an error.
        is_intact = checksum.read_bytes() == _digest(library)
    except OSError:
        return None
    return library if is_intact else None


def publish(built: Path, key: str, end: str = LIBRARY) -> Path:
    """Move a file from a private folder into the cache, and return its path."""
    library, checksum = _published_paths(key, end)
    # The name is unique, because threads publish the objects of a library concurrently.
    written = built.with_name(f"{built.name}.checksum")
    written.write_bytes(_digest(built))
    try:
        # A reader between the two renames finds a wrong checksum and builds the library itself.
        os.replace(built, library)
        os.replace(written, checksum)
    except PermissionError:
        # Windows cannot replace a loaded library; this is harmless if the library is intact.
        if find_published(key, end) is None:
            raise
    return library


def cached(of: object, make: Callable[[], _T]) -> _T:
    """Return the result of a function, from the cache if ``of`` and the result can be pickled.

    The result must depend only on ``of`` and on cotree's files. It is not cached if ``of`` is None.
    """
    data = pickled(of) if KEEPS and of is not None else None
    if data is None:
        return make()
    key = hashlib.sha256(_sources() + data).hexdigest()
    # If the cache cannot be used, the value is computed.
    with contextlib.suppress(BuildError, OSError):
        path = find_published(key, TEXT)
        if path is not None:
            # Unpickling is safe, because only the user can write to the folder.
            found: _T = pickle.loads(path.read_bytes())
            return found
    made = make()
    data = pickled(made)
    if data is not None:
        # All processes continue from the same value, without what was left out of the pickle.
        made = pickle.loads(data)
    with contextlib.suppress(BuildError, OSError):
        if data is not None:
            with private_directory() as directory:
                written = directory / "kept"
                written.write_bytes(data)
                publish(written, key, TEXT)
    return made


def pickled(value: object) -> bytes | None:
    """Return the pickle of a value, or None if the value cannot be pickled."""
    try:
        return pickle.dumps(value, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError, RecursionError):
        # External functions are Python functions, which cannot always be pickled.
        return None


@cache
def _sources() -> bytes:
    """Return bytes that identify cotree's files, on which cached texts depend."""
    # The version of NumPy is included, because pickled arrays depend on it.
    rows = [sys.version, np.__version__]
    for place in (Path(__file__).parents[1], template_folder()):
        for folder, _, names in os.walk(place):  # three times as fast as ``Path.rglob``
            for path in (os.path.join(folder, name) for name in names if name.endswith(_SOURCES)):
                status = os.stat(path)
                rows.append(f"{path} {status.st_size} {status.st_mtime_ns}")
    return "\n".join(sorted(rows)).encode()


@contextlib.contextmanager
def private_directory() -> Iterator[Path]:
    """Create a private folder for one build on the file system of the cache."""
    _remove_abandoned()
    with tempfile.TemporaryDirectory(
        prefix=_PRIVATE_PREFIX, dir=cache_directory(), ignore_cleanup_errors=True
    ) as name:
        yield Path(name)


@contextlib.contextmanager
def building(key: str, time_limit: float) -> Iterator[None]:
    """Hold the lock of a library during the repeated search for it and the build.

    If another process holds the lock for more than ``time_limit`` seconds, both build the library.
    """
    import filelock

    lock = filelock.FileLock(cache_directory() / f"{key}.lock", timeout=time_limit)
    # Some network file systems do not support locks.
    with contextlib.suppress(filelock.Timeout, OSError, NotImplementedError):
        lock.acquire()
    try:
        yield
    finally:
        if lock.is_locked:
            # Processes that wait for this file, or create a new one, then find the library; after a
            # failed build, they may build it concurrently.
            with contextlib.suppress(OSError):
                Path(lock.lock_file).unlink()
            lock.release()


def save_failed_sources(files: Mapping[str, str], key: str) -> Path:
    """Write the sources of a failed build to ``failed/<key>`` and return that folder."""
    directory = cache_directory() / _FAILED / key
    directory.mkdir(parents=True, exist_ok=True)
    write_files(files, directory)
    return directory


def write_files(files: Mapping[str, str], directory: Path) -> None:
    """Write texts to files in a folder, with the same bytes on every platform."""
    for name, text in files.items():
        (directory / name).write_text(text, encoding="utf-8", newline="\n")


def clear_cache() -> int:
    """Remove libraries, texts and files of failed or interrupted builds; return their number.

    All other files in the folder remain. Loaded libraries remain usable, and other processes
    restart builds in progress.

    Raises
    ------
    BuildError
        If the cache folder cannot be used or a file cannot be removed.
    """
    directory = cache_directory()
    try:
        entries = list(directory.iterdir())
        removed = 0
        for path in entries:
            if _PUBLISHED.fullmatch(path.name):
                path.unlink(missing_ok=True)
                removed += 1
            elif path.name.startswith(_PRIVATE_PREFIX):
                removed += _remove_tree(path)
        failed = directory / _FAILED
        if failed.is_dir():
            kept = [path for path in failed.iterdir() if _KEY.fullmatch(path.name)]
            removed += sum(_remove_tree(path) for path in kept)
    except OSError as error:
        raise BuildError(
            f"The cache folder '{directory}' cannot be cleared ({error}); correct its permissions "
            "or close the programs that use it."
        ) from error
    return removed


def _remove_abandoned() -> None:
    oldest = time.time() - _ABANDONED_AFTER
    for path in cache_directory().glob(f"{_PRIVATE_PREFIX}*"):
        # Another process may remove the same folder.
        with contextlib.suppress(OSError):
            if path.stat().st_mtime < oldest:
                _remove_tree(path)


def _configured_directory() -> Path:
    configured = os.environ.get(_VARIABLE, "")
    if configured:
        return Path(configured).expanduser()
    import platformdirs

    return Path(platformdirs.user_cache_dir("cotree", appauthor=False))


def _check_private(directory: Path, status: os.stat_result) -> None:
    if sys.platform == "win32":
        return
    if status.st_uid != os.geteuid():
        raise BuildError(
            f"The cache folder '{directory}' belongs to another user (uid {status.st_uid}), who "
            "could replace the libraries in it; name a folder of your own with the environment "
            f"variable {_VARIABLE}."
        )
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        raise BuildError(
            f"The cache folder '{directory}' can be written by other users "
            f"(mode {stat.S_IMODE(status.st_mode):04o}), who could replace the libraries in it; "
            f"run 'chmod go-w' on it, or name another one with the environment variable "
            f"{_VARIABLE}."
        )


def _published_paths(key: str, end: str) -> tuple[Path, Path]:
    directory = cache_directory()
    # All systems use the same suffix, because libraries are loaded by their full path.
    return directory / f"{key}{end}", directory / f"{key}.sha256"


def _digest(path: Path) -> bytes:
    return hashlib.sha256(path.read_bytes()).hexdigest().encode()


def _remove_tree(directory: Path) -> int:
    n_files = sum(path.is_file() for path in directory.rglob("*"))
    # A build that ends in the meantime removes its own folder.
    with contextlib.suppress(FileNotFoundError):
        shutil.rmtree(directory)
    return n_files
