"""The folder of a store: where it may be, who may write into it, and files that are whole.

In: names of arrays with their dimensions. Out: a Zarr group (format 3) whose arrays have a file for
each chunk, with the checksum of its bytes at the end. Files are written under another name and
renamed, so that a reader never meets half of one.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import shutil
import tempfile
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree.errors import StoreError, brief

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from filelock import BaseFileLock

_ONE_FILE = (".nc", ".nc4", ".cdf", ".h5", ".hdf5", ".zip")

# The file that describes a group or an array.
_ABOUT = "zarr.json"

# Bytes of a checksum.
_CHECK = 4


def read_path(store: Any) -> Path:
    """Accept the folder of a store.

    Raises
    ------
    StoreError
        If it is no path, or of a file that a kill in the middle of a write could make unreadable.
    """
    if not isinstance(store, (str, os.PathLike)) or not str(store):
        raise StoreError(f"store is {brief(repr(store))}: give a folder, such as 'runs.zarr'")
    path = Path(store)
    if "://" in str(store):
        raise StoreError(
            f"the store '{brief(str(store))}' is not on this machine: give a folder here, such as "
            "'runs.zarr', and copy it when it is done"
        )
    if path.suffix.lower() in _ONE_FILE:
        raise StoreError(
            f"the store '{path}' would be one file, which a kill in the middle of a write can make "
            "unreadable: give a folder, such as 'runs.zarr', and convert it when it is done: "
            "xarray.open_zarr('runs.zarr').to_netcdf('runs.nc')"
        )
    path = path.expanduser().absolute()
    if path.exists() and not path.is_dir():
        raise StoreError(f"the store '{path}' is a file: give a folder, such as 'runs.zarr'")
    return path


def check_zarr() -> Any:
    """Give the module zarr.

    Raises
    ------
    StoreError
        If it is not installed.
    """
    try:
        import zarr
    except ImportError as error:
        raise StoreError(
            "stores of ensembles need zarr: run `pip install zarr`, or install the extra, "
            "`pip install cotree[ensembles]`"
        ) from error
    return zarr


@contextlib.contextmanager
def told(path: Path) -> Iterator[None]:
    """Say what is wrong with a folder in a sentence.

    Raises
    ------
    StoreError
        Where the system refuses a read or a write.
    """
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"the store '{path}' cannot be used ({error.strerror or error}): what it holds is "
            "kept. Make room there, or correct its permissions, and run the same call again: it "
            "computes what is missing"
        ) from error


def locked(path: Path) -> BaseFileLock:
    """Lock a folder against other processes; the system takes the lock from one that dies.

    Raises
    ------
    StoreError
        If another process has it.
    """
    import filelock

    lock = filelock.FileLock(f"{path}.lock", timeout=0, thread_local=False)
    if path.is_dir() and not os.access(path.parent, os.W_OK):
        return lock  # a store that is complete may be read where nobody can write
    path.parent.mkdir(parents=True, exist_ok=True)
    try:
        lock.acquire()
    except filelock.Timeout:
        raise StoreError(
            f"the store '{path}' is being written by another call: wait until it is done, or give "
            "another folder"
        ) from None
    except NotImplementedError:
        pass  # some network file systems have no locks
    return lock


def unlock(lock: BaseFileLock) -> None:
    """Let others have a folder."""
    if lock.is_locked:
        with contextlib.suppress(OSError):
            Path(lock.lock_file).unlink()
        lock.release()


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give a folder that gets its place when all of it is written; what a kill left is removed."""
    for left in path.parent.glob(f"{path.name}.*.partial"):
        shutil.rmtree(left, ignore_errors=True)
    written = Path(tempfile.mkdtemp(suffix=".partial", prefix=f"{path.name}.", dir=path.parent))
    try:
        written.chmod(0o777 & ~_umask())  # as of folders that anyone makes
        yield written
        written.replace(path)
    except BaseException:
        shutil.rmtree(written, ignore_errors=True)
        raise


def remove_partial(path: Path) -> None:
    """Remove files whose writing was killed."""
    for left in path.rglob("*.partial"):
        left.unlink(missing_ok=True)


def make_array(
    group: Any,
    name: str,
    *,
    dims: Sequence[str],
    shape: Sequence[int],
    chunks: Sequence[int],
    dtype: Any,
    blank: Any,
    about: dict[str, Any],
) -> None:
    """Make an array whose chunks are files with checksums; values that nobody wrote are blank."""
    from zarr.codecs import Crc32cCodec

    group.create_array(
        name,
        shape=tuple(shape),
        # A dimension without values still has chunks.
        chunks=tuple(max(1, length) for length in chunks),
        dtype=dtype,
        fill_value=blank,
        # Digits of results do not compress; bytes as they are can be read by anything.
        compressors=[Crc32cCodec()],
        dimension_names=tuple(dims),
        attributes=about,
        # A chunk that happens to be blank is a file, too, or else it would count as missing.
        config={"write_empty_chunks": True},
    )


def checked() -> dict[str, Any]:
    """Return the encoding of an array whose chunks are as they are, with checksums."""
    from zarr.codecs import Crc32cCodec

    return {"compressors": [Crc32cCodec()]}


@contextlib.contextmanager
def in_memory() -> Iterator[tuple[Any, dict[str, bytes]]]:
    """Return a Zarr store in memory, and a dict that holds its files at the end."""
    from zarr.storage import MemoryStore

    held: dict[str, Any] = {}
    files: dict[str, bytes] = {}
    yield MemoryStore(held), files
    files.update({name: buffer.to_bytes() for name, buffer in held.items()})


def attribute_text(value: Mapping[str, Any]) -> str:
    """Write a table as the text of an attribute, with its hash before it."""
    text = json.dumps(value)
    return f"{_digest(text)} {text}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def read_attribute(path: Path, name: str) -> dict[str, Any]:
    """Read a table that :func:`attribute_text` wrote to an attribute of the outermost group.

    Raises
    ------
    StoreError
        If there is none.
    """
    file = path / _ABOUT
    remedy = "give another folder, or delete this one, whose results nothing tells from others"
    try:
        digest, _, text = json.loads(file.read_bytes())["attributes"][name].partition(" ")
        if digest != _digest(text):
            raise ValueError(name)
        found: dict[str, Any] = json.loads(text)
    except FileNotFoundError as error:
        raise StoreError(
            f"'{path}' exists, and is no store of an ensemble ({_ABOUT} is missing): {remedy}"
        ) from error
    except (KeyError, ValueError, TypeError, AttributeError, RecursionError) as error:
        raise StoreError(
            f"'{file}' is damaged, or is of no store of an ensemble: {remedy}"
        ) from error
    return found


def repair(path: Path, documents: Mapping[str, bytes]) -> None:
    """Write files that are missing or differ; what describes all of them comes last."""
    for name in sorted(documents, key=lambda name: (name == _ABOUT, name)):
        file, wanted = path / name, documents[name]
        try:
            is_there = file.read_bytes() == wanted
        except FileNotFoundError:
            is_there = False
        if not is_there:
            file.parent.mkdir(parents=True, exist_ok=True)
            draft = file.with_name(f"{file.name}.partial")
            draft.write_bytes(wanted)
            draft.replace(file)


def whole_bytes(path: Path) -> bytes | None:
    """Give the bytes of a chunk that is there and fits its checksum; None for any other."""
    import google_crc32c

    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    found = int.from_bytes(data[-_CHECK:], "little")
    is_whole = len(data) > _CHECK and google_crc32c.value(data[:-_CHECK]) == found
    return data[:-_CHECK] if is_whole else None


def consolidate(store: Any) -> None:
    """Write what describes all arrays into one file, so that readers see all of it at once."""
    zarr = check_zarr()
    with warnings.catch_warnings():
        # It is not in the specification yet; readers that do not know it read the arrays' own.
        warnings.filterwarnings("ignore", "Consolidated metadata")
        zarr.consolidate_metadata(store if not isinstance(store, Path) else str(store))


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
