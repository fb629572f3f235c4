"""Storage of ensemble results in a folder.

``manifest.json`` identifies the ensemble and states the number of members per block, and
``coordinates.npz`` has the coordinates of the Dataset. Each file of ``blocks`` is a NumPy archive
with an array and its CRC-32 for each variable, and a hash of these. Files are written under a
temporary name and then renamed. Several processes may write blocks of one store. Each locks the
blocks that it runs, and the system releases the locks of a process that dies.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import os
import struct
import zipfile
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.dataset import DatasetSchema, plain
from cotree.ensemble.plan import NOT_RUN, Block, Plan
from cotree.ensemble.reasons import Reasons
from cotree.errors import SolveError, StoreError, brief
from cotree.files import template_folder
from cotree.model.signals import read_signals
from cotree.quiet import parsing
from cotree.scene.settings import SHARED
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from threading import Event

    from filelock import BaseFileLock

# Values of an identity with more characters than this, such as tables, are compared by their hash.
_LONGEST = 200


def identity_of(plan: Plan) -> dict[str, Any]:
    """Return the data that identify an ensemble, by name, as JSON values.

    Members and times are compared as coordinates of the results instead.
    """
    model, settings = plan.model, plan.settings
    signals = read_signals(settings.inputs, model.inputs)
    for place in {*signals.by_position, *signals.sampled} - set(signals.tables):
        raise SolveError(
            f"input '{model.inputs[place]}' is a function of Python, which cannot be compared with "
            "that of another call: with store=... give a table or an expression"
        )
    p = model.parameter_array(settings.parameters).tolist()
    values = dict(zip(model.parameters, p, strict=True))
    tables = {model.inputs[i]: plain([t, y]) for i, (t, y) in signals.tables.items()}
    return {
        "cotree": VERSION,
        "scene": model.layout.name,
        "columns": list(plan.columns),
        **{name: plain(getattr(settings, name)) for name in (*SHARED, "initial")},
        # Whether stiff members may use a method other than the chosen one.
        "method_is_chosen": plan.is_chosen,
        "t_span": plain(settings.t_span),
        "inputs": {name: _short(table) for name, table in tables.items()},
        "parameters": {name: v for name, v in values.items() if name not in plan.columns},
        "outputs": list(plan.outputs),
        "sensitivities": list(model.sensitivities) if plan.n_sensitivities else [],
        "kernels": model.backend,
        "model": model.digest,
        "engine": _engine(),
    }


def first_difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Return a description of the first difference, or an empty string if there is none."""
    for name, value in here.items():
        # The manifest contains JSON values, so the compared value is converted to JSON.
        old, new = there.get(name), json.loads(json.dumps(value))
        if old == new:
            continue
        if name == "model":
            return "its model has other equations, laws, names or compiler options"
        if name == "engine":
            return "it was written by another build of cotree, whose methods may differ"
        if isinstance(old, dict) and isinstance(new, dict):
            key = next(key for key in {**new, **old} if old.get(key) != new.get(key))
            name, old, new = f"of {name} '{key}'", old.get(key), new.get(key)
        return f"{name} is {_shown(old)} there and {_shown(new)} here"
    return ""


def _shown(value: Any) -> str:
    return "not given" if value is None else brief(json.dumps(value))


def _short(value: Any) -> Any:
    text = json.dumps(value)
    return value if len(text) <= _LONGEST else f"the table with hash {_digest(text)[:16]}"


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


@cache
def _engine() -> str:
    """Return a hash of the C sources of the methods, which may differ within one version."""
    found = hashlib.sha256()
    for path in sorted(path for path in template_folder().rglob("*") if path.is_file()):
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


_ONE_FILE = (".nc", ".nc4", ".cdf", ".h5", ".hdf5", ".zip")


def read_path(store: Any) -> Path:
    """Check the path of a store, and return it as an absolute path."""
    if not isinstance(store, (str, os.PathLike)) or not str(store):
        raise StoreError(f"store is {brief(repr(store))}: give a folder, such as 'runs'")
    path = Path(store)
    if "://" in str(store):
        raise StoreError(
            f"the store '{brief(str(store))}' is not on this machine: give a folder here, such as "
            "'runs', and copy it when it is done"
        )
    if path.suffix.lower() in _ONE_FILE:
        raise StoreError(
            f"the store '{path}' would be one file, which is unreadable if a write to it is "
            f"interrupted: give a folder, such as 'runs', and convert the Dataset when it is done: "
            f"runs.to_netcdf('{path.name}')"
        )
    path = path.expanduser().absolute()
    if path.exists() and not path.is_dir():
        raise StoreError(f"the store '{path}' is a file: give a folder, such as 'runs'")
    return path


@contextlib.contextmanager
def store_errors(path: Path) -> Iterator[None]:
    """Convert an OSError in reading or writing to a StoreError."""
    try:
        yield
    except OSError as error:
        raise StoreError(
            f"the store '{path}' cannot be used ({error.strerror or error}): its contents are "
            "kept. Free some space, or correct its permissions, and run the same call again: it "
            "computes what is missing"
        ) from error


MANIFEST, COORDINATES, BLOCKS = "manifest.json", "coordinates.npz", "blocks"

_DRAFT, _LOCK = ".partial", ".lock"


def write_arrays(path: Path, arrays: Mapping[str, Any]) -> None:
    """Write arrays or lists of texts to a NumPy archive."""
    path.parent.mkdir(parents=True, exist_ok=True)
    draft = path.with_name(path.name + _DRAFT)
    with zipfile.ZipFile(draft, "w") as archive:
        for name, given in arrays.items():
            values = np.ascontiguousarray(given)
            if values.dtype.kind == "O":  # texts of any length are in object arrays
                text = json.dumps(values.ravel().tolist())
                values = np.frombuffer(text.encode(), dtype="S1")
            with archive.open(f"{name}.npy", "w", force_zip64=True) as file:
                np.lib.format.write_array(file, values, allow_pickle=False)
        archive.comment = _contents(archive)
    try:
        draft.replace(path)
    except FileNotFoundError:
        if not path.exists():
            raise  # else another process has written the same block, on a file system without locks


def read_array(archive: Any, name: str) -> Any:
    """Return an array of an open archive; texts become an object array."""
    with parsing:  # NumPy parses the header of the array
        values = archive[name]
    if values.dtype.kind != "S":
        return values
    return np.array(json.loads(values.tobytes()), dtype=object)


def read_whole(path: Path) -> Any:
    """Open an archive; return None if it is missing or does not match its checksums."""
    try:
        data = path.read_bytes()
    except FileNotFoundError:
        return None
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            is_whole = archive.comment == _contents(archive) and archive.testzip() is None
    except _DAMAGES:
        return None
    # NumPy requires the archive at the beginning of the file.
    return np.load(io.BytesIO(data)) if is_whole and data.startswith(b"PK") else None


def _contents(archive: zipfile.ZipFile) -> bytes:
    """Return a hash of the names, sizes and checksums of all arrays."""
    rows = [(row.filename, row.file_size, row.CRC) for row in archive.infolist()]
    return _digest(json.dumps(rows)).encode()


# Errors of ZipFile for damaged archives.
_DAMAGES = (zipfile.BadZipFile, ValueError, OSError, EOFError, RuntimeError, struct.error)


def read_manifest(path: Path) -> dict[str, Any]:
    """Read the manifest of a store."""
    remedy = "give another folder, or delete this one, whose results cannot be identified"
    try:
        document = json.loads((path / MANIFEST).read_bytes())
        found: dict[str, Any] = document["store"]
        if document["sha256"] != _digest(json.dumps(found)):
            raise ValueError(path)
    except FileNotFoundError as error:
        raise StoreError(
            f"'{path}' exists, but is not a store of an ensemble ({MANIFEST} is missing): {remedy}"
        ) from error
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise StoreError(
            f"'{path / MANIFEST}' is damaged, or is not of a store of ensembles: {remedy}"
        ) from error
    return found


def block_path(path: Path, first: int) -> Path:
    """Return the file path of the block that begins with member ``first``."""
    return path / BLOCKS / f"{first:010}.npz"


class Store:
    """The result folder of an ensemble, open for writing; ``reasons`` counts stored members."""

    def __init__(self, store: Any, schema: DatasetSchema, size: Callable[[], int]) -> None:
        self.path, self._schema = read_path(store), schema
        self._n = len(schema.members.rows)
        self._identity = identity_of(schema.plan)
        self._locks: dict[int, BaseFileLock] = {}
        self._writer = ThreadPoolExecutor(1, "cotree-store")
        self._writing: Future[None] | None = None
        self.reasons = Reasons()
        with store_errors(self.path):
            self.members_of_a_block = self._open(size)
            self._missing = dict.fromkeys(range(0, self._n, self.members_of_a_block))
            self._find_blocks()

    def ranges(self) -> Iterator[tuple[int, int]]:
        """Lock and yield each range of members that no process has stored or is running."""
        for first in list(self._missing):
            with store_errors(self.path):
                if first in self._missing and self._lock(first) and not self._take_file(first):
                    yield first, min(first + self.members_of_a_block, self._n)

    def wait(self, stop: Event) -> bool:
        """Wait for blocks of other processes; return whether any block is still missing."""
        if self._missing and not stop.wait(_PATIENCE):
            with store_errors(self.path):
                self._find_blocks()
        return bool(self._missing) and not stop.is_set()

    def add_block(self, first: int, block: Block) -> None:
        """Write a block in the background; incomplete blocks are not written."""
        if np.any(block.status == NOT_RUN):
            return
        self._wait()
        self._writing = self._writer.submit(self._write, first, block)
        self._count(first, block.status, block.messages)

    def close(self) -> None:
        """Finish writing, and unlock all blocks."""
        try:
            self._wait()
        finally:
            self._writer.shutdown()
            for first in list(self._locks):
                self._unlock(first)

    def dataset(self) -> Any:
        """Return the stored results as a Dataset, whose values are read on access."""
        from cotree.ensemble.store_backend import open_store

        with store_errors(self.path):
            return open_store(self.path)

    def _open(self, size: Callable[[], int]) -> int:
        """Create the folder, or check that it holds this ensemble; return the block size."""
        is_new = self._is_empty()
        empty = self._schema.dataset({})
        coordinates = {name: row.values for name, row in empty.coords.items()}
        is_whole = not is_new and read_whole(self.path / COORDINATES) is not None
        with contextlib.nullcontext() if is_whole else self._exclusive():
            if is_new and not (self.path / MANIFEST).is_file():
                self._create(empty, coordinates, size())
            there = read_manifest(self.path)
            digests = _digests(coordinates)
            difference = first_difference(there["identity"], self._identity)
            if not difference and there["coordinates"] != digests:
                difference = self._other_coordinate(there["coordinates"], digests, coordinates)
            if difference:
                raise StoreError(
                    f"the store '{self.path}' contains another ensemble: {difference}. Give the "
                    "same arguments as before, or another folder"
                )
            if read_whole(self.path / COORDINATES) is None:
                write_arrays(self.path / COORDINATES, coordinates)
        return int(there["block"])

    def _is_empty(self) -> bool:
        return not self.path.exists() or all(
            path.name.endswith((_DRAFT, _LOCK)) for path in self.path.iterdir()
        )

    @contextlib.contextmanager
    def _exclusive(self) -> Iterator[None]:
        """Create the folder, and hold a lock on its manifest."""
        import filelock

        if not ((self.path / MANIFEST).is_file() or self._is_empty()):
            yield  # the folder is not a store, which the caller reports
            return
        self.path.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(self.path / f"{MANIFEST}{_LOCK}")
        with contextlib.suppress(NotImplementedError):  # the file system does not support locks
            lock.acquire()
        try:
            yield
        finally:
            lock.release()

    def _create(self, empty: Any, coordinates: Mapping[str, Any], size: int) -> None:
        schema = self._schema
        # An empty block defines all variables.
        rows = schema.variables((0,) * len(schema.dims), Block(schema.plan, 0))
        about = empty.to_dict(data=False)
        store = {
            "identity": self._identity,
            "block": size,
            "coordinates": _digests(coordinates),
            "attributes": about["attrs"],
            "dims": {name: [row["dims"], row["attrs"]] for name, row in about["coords"].items()},
            "shape": list(schema.shape),
            "variables": {
                name: [list(dims), values.shape[len(schema.dims) :], values.dtype.str, attributes]
                for name, (dims, values, attributes) in rows.items()
            },
        }
        store = json.loads(json.dumps(store))
        text = json.dumps({"sha256": _digest(json.dumps(store)), "store": store})
        draft = self.path / f"{MANIFEST}{_DRAFT}"
        draft.write_text(text, encoding="utf-8")
        draft.replace(self.path / MANIFEST)

    def _other_coordinate(
        self, there: Mapping[str, str], digests: Mapping[str, str], here: Mapping[str, Any]
    ) -> str:
        """Describe the first difference between stored coordinates and those of this call."""
        name = next(name for name in {**digests, **there} if digests.get(name) != there.get(name))
        archive, wanted = read_whole(self.path / COORDINATES), here.get(name)
        if archive is not None and name in there and wanted is not None:
            values = read_array(archive, name)
            if values.shape != wanted.shape:
                return f"'{name}' has {values.size} values there and {wanted.size} here"
            for i in np.flatnonzero(values != wanted)[:1].tolist():
                return f"'{name}' at place {i} is {values[i]} there and {wanted[i]} here"
        return f"'{name}' has other values there and here"

    def _find_blocks(self) -> None:
        """Count the members of stored blocks, and remove damaged blocks."""
        for first in list(self._missing):
            self._take_file(first)

    def _take_file(self, first: int) -> bool:
        """Count the block that begins with ``first``; return False if it is missing or damaged."""
        file = block_path(self.path, first)
        archive = read_whole(file)
        if archive is None:
            file.unlink(missing_ok=True)
            return False
        self._count(first, read_array(archive, "status"), read_array(archive, "message"))
        self._unlock(first)
        return True

    def _count(self, first: int, status: Any, messages: Any) -> None:
        del self._missing[first]
        self.reasons.add(first, status, messages)

    def _write(self, first: int, block: Block) -> None:
        found = self._schema.variables((len(block.status),), block)
        arrays = {name: values for name, (_, values, _) in found.items()}
        write_arrays(block_path(self.path, first), arrays)
        self._unlock(first)

    def _wait(self) -> None:
        """Wait until the current block is written; raise the error if writing failed."""
        writing, self._writing = self._writing, None
        if writing is not None:
            with store_errors(self.path):
                writing.result()

    def _lock(self, first: int) -> bool:
        import filelock

        path = block_path(self.path, first).with_suffix(_LOCK)
        path.parent.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(path, timeout=0, thread_local=False)
        try:
            lock.acquire()
        except filelock.Timeout:
            return False
        except NotImplementedError:
            pass  # a network file system without locks: two processes may write the same block
        self._locks[first] = lock
        return True

    def _unlock(self, first: int) -> None:
        lock = self._locks.pop(first, None)
        if lock is not None and lock.is_locked:
            with contextlib.suppress(OSError):
                Path(lock.lock_file).unlink()
            lock.release()


# Interval at which blocks of other processes are looked for, [s].
_PATIENCE = 0.5


def _digests(coordinates: Mapping[str, Any]) -> dict[str, str]:
    return {
        name: _digest(json.dumps([str(values.dtype), values.tolist()], default=str))
        for name, values in coordinates.items()
    }
