"""Results of an ensemble in a folder, which survives what happens to the process that fills it.

In: a plan. Out: an ``Identity`` of texts and numbers that JSON has, and the first difference
between two of them as a sentence.

Members lie in the order of their rows, and in a grid the last axis goes fastest. A chunk is one
place of the first axes, some places of one axis, and all of the others: its members are a range.

In: blocks as they are done. Out: a Zarr store that ``xarray.open_zarr`` reads as the Dataset that a
call without a store gives. Each block is a chunk of each array; that of ``status`` is written last,
and says that its members are there. Members without it were not run, whatever else a kill left.
"""

from __future__ import annotations

import hashlib
import json
import math
from concurrent.futures import Future, ThreadPoolExecutor
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.codegen.render import template_folder
from cotree.ensemble.dataset import OCCURRENCE, Frame
from cotree.ensemble.plan import NOT_RUN, NOT_RUN_SENTENCE, Block, Plan, Results
from cotree.ensemble.reasons import Reasons
from cotree.ensemble.zarr_folder import (
    attribute_text,
    check_zarr,
    checked,
    consolidate,
    in_memory,
    locked,
    make_array,
    new_folder,
    read_attribute,
    read_path,
    remove_partial,
    repair,
    told,
    unlock,
    whole_bytes,
)
from cotree.errors import SolveError, StoreError, brief
from cotree.model.signals import read_signals
from cotree.scene.settings import SHARED
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    import numpy.typing as npt


# Longer values, as of tables, are told apart by their hash.
_LONGEST = 200


def identity_of(plan: Plan) -> dict[str, Any]:
    """Tell what all members of a plan share, by name.

    What members set, and the times, are coordinates of the results, and are compared there.

    Raises
    ------
    SolveError
        If inputs are functions of Python, of which nobody can tell whether they are the same.
    """
    model, settings = plan.model, plan.settings
    signals = read_signals(settings.inputs, model.inputs)
    for place in {*signals.by_position, *signals.sampled} - set(signals.tables):
        raise SolveError(
            f"input '{model.inputs[place]}' is a function of Python, and nobody can tell whether "
            "another call's is the same: with store=... give a table or an expression"
        )
    p = model.parameter_array(settings.parameters).tolist()
    values = dict(zip(model.parameters, p, strict=True))
    tables = {model.inputs[i]: [t, y] for i, (t, y) in signals.tables.items()}
    return {
        "cotree": VERSION,
        "scene": model.layout.name,
        "columns": list(plan.columns),
        **{name: _plain(getattr(settings, name)) for name in (*SHARED, "initial")},
        # Members that an automatically chosen method finds stiff are run with another one.
        "method_is_chosen": plan.is_chosen,
        "t_span": _plain(settings.t_span),
        "inputs": {name: _short(_plain(table)) for name, table in tables.items()},
        # A column goes before these.
        "parameters": {name: v for name, v in values.items() if name not in plan.columns},
        "leaves_explicit": plan.is_chosen,
        "outputs": list(plan.outputs),
        "sensitivities": list(model.sensitivities) if plan.has_sensitivities else [],
        "kernels": model.backend,
        "model": model.digest,
        "engine": _engine(),
    }


def first_difference(there: Mapping[str, Any], here: Mapping[str, Any]) -> str:
    """Say what differs first, as a sentence without a capital and an end; empty if nothing does."""
    for name, value in here.items():
        # What was written came through JSON.
        old, new = there.get(name), json.loads(json.dumps(value))
        if old == new:
            continue
        if name == "model":
            return "its model has other equations, laws, names or compiler options"
        if name == "engine":
            return "it was written by another build of cotree, whose methods may differ"
        if isinstance(old, dict) and isinstance(new, dict):
            key = next(key for key in {**new, **old} if old.get(key) != new.get(key))
            return (
                f"of {name} '{key}' is {_told(old.get(key))} there and {_told(new.get(key))} here"
            )
        return f"{name} is {_told(old)} there and {_told(new)} here"
    return ""


def _told(value: Any) -> str:
    return "not given" if value is None else brief(json.dumps(value))


def _plain(value: Any) -> Any:
    """Turn mappings, arrays and numbers into those that JSON has."""
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if hasattr(value, "items"):
        return {str(name): _plain(item) for name, item in sorted(value.items())}
    if isinstance(value, float) or np.ndim(value) == 0:
        return float(value)
    return [_plain(item) for item in value]


def _short(value: Any) -> Any:
    text = json.dumps(value)
    if len(text) <= _LONGEST:
        return value
    return f"the table with hash {hashlib.sha256(text.encode()).hexdigest()[:16]}"


@cache
def _engine() -> str:
    """Hash the C text of the methods, from which the same version may have been built twice."""
    found = hashlib.sha256()
    for path in sorted(template_folder().rglob("*.jinja")):
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def chunk_lengths(shape: Sequence[int], wanted: int) -> tuple[int, ...]:
    """Give the lengths of chunks of at most so many members, and at least one.

    Examples
    --------
    >>> chunk_lengths((4, 10, 3), 7)
    (1, 2, 3)
    """
    lengths, left = [1] * len(shape), max(1, wanted)
    for axis in reversed(range(len(shape))):
        n_chunks = math.ceil(shape[axis] / left)
        lengths[axis] = math.ceil(shape[axis] / n_chunks)
        if n_chunks > 1:
            break
        left = max(1, left // shape[axis])
    return tuple(lengths)


def chunk_places(shape: Sequence[int], lengths: Sequence[int]) -> Iterator[tuple[int, ...]]:
    """Give the places of all chunks, in the order of their members."""
    counts = [math.ceil(n / length) for n, length in zip(shape, lengths, strict=True)]
    return product(*map(range, counts))


def chunk_region(
    shape: Sequence[int], lengths: Sequence[int], place: Sequence[int]
) -> tuple[slice, ...]:
    """Give the part of the dimensions that a chunk holds."""
    rows = zip(place, lengths, shape, strict=True)
    return tuple(slice(i * length, min((i + 1) * length, n)) for i, length, n in rows)


def member_range(shape: Sequence[int], region: Sequence[slice]) -> tuple[int, int]:
    """Give the first member of a chunk, and the one behind its last."""
    first = 0
    for n, part in zip(shape, region, strict=True):
        first = first * n + part.start
    return first, first + math.prod(part.stop - part.start for part in region)


# The attribute that tells whose results a store holds.
_IDENTITY = "cotree_store"

# What it holds besides: the lengths of a block, and hashes of the coordinates.
_LENGTHS, _COORDINATES = "block", "coordinates"

# Events of a chunk along their dimension, which grows as members turn up that have more.
_OCCURRENCES = 8

# Coordinates are cut as results are, which programs that read them expect, up to so many files.
_MOST_CUTS = 256

# What stands for members that were not run; all other values are nan.
_BLANKS: Mapping[str, Any] = {"status": NOT_RUN, "message": NOT_RUN_SENTENCE, "seconds": 0.0}


def _digest(values: npt.NDArray[Any]) -> str:
    """Hash the values of a coordinate."""
    return hashlib.sha256(json.dumps([str(values.dtype), values.tolist()]).encode()).hexdigest()


class Store:
    """The folder of an ensemble, open for writing; nobody else has it meanwhile.

    Parameters
    ----------
    store : str or path-like
        The folder; made where it does not exist.
    frame : Frame
        What the Dataset of the ensemble is made of, but for results.
    size : callable
        Gives the number of members of a block, for a new store.

    Attributes
    ----------
    done : int
        Members that are there.
    reasons : Reasons
        Those of them that failed.

    Raises
    ------
    StoreError
        If the folder holds something else, another process writes into it, or it cannot be used.
    """

    def __init__(self, store: Any, frame: Frame, size: Callable[[], int]) -> None:
        self._zarr, self.path = check_zarr(), read_path(store)
        self._frame, self._shape = frame, frame.shape
        self._identity = identity_of(frame.plan)
        # What blocks consist of: a block of no members has it all.
        self._rows = frame.variables((0,) * len(frame.dims), Results(frame.plan, 0).block())
        self._writer = ThreadPoolExecutor(1, "cotree-store")
        self._writing: Future[None] | None = None
        self.done, self.reasons = 0, Reasons()
        with told(self.path):
            self._lock = locked(self.path)
            try:
                self._open(size)
            except BaseException:
                unlock(self._lock)
                raise

    @property
    def members_of_a_block(self) -> int:
        """The number of members of a block, but for the last ones."""
        return math.prod(self._lengths)

    def ranges(self) -> list[tuple[int, int]]:
        """Give the ranges of members that are not there, each of one block."""
        return self._missing

    def take(self, first: int, block: Block) -> None:
        """Write a block while the next one is computed; one that was broken off is left out.

        Raises
        ------
        StoreError
            If it, or the one before, cannot be written.
        """
        if np.any(block.status == NOT_RUN):
            return
        self._wait()
        self._writing = self._writer.submit(self._write, first, block)
        self.done += len(block.status)
        self.reasons.add(first, block.status, block.messages)

    def close(self) -> None:
        """Write what is on its way, and let others have the folder.

        Raises
        ------
        StoreError
            If it cannot be written.
        """
        try:
            self._wait()
        finally:
            self._writer.shutdown()
            unlock(self._lock)

    def dataset(self) -> Any:
        """Open what is there; values are read when they are asked for."""
        import xarray

        with told(self.path):
            found = xarray.open_zarr(str(self.path), consolidated=True)
        del found.attrs[_IDENTITY]
        # A folder has no order of its own. What members set was in memory for this call, too.
        found = found[list(self._rows)]
        return found.assign_coords({name: row.load() for name, row in found.coords.items()})

    def _wait(self) -> None:
        """Wait until a block is written; an error of its write is raised once."""
        writing, self._writing = self._writing, None
        if writing is not None:
            with told(self.path):
                writing.result()

    def _open(self, size: Callable[[], int]) -> None:
        """Make the folder, or check that it is of the same ensemble, and see what is missing."""
        if not self.path.exists() or (self.path.is_dir() and not any(self.path.iterdir())):
            self._make(size())
        there = read_attribute(self.path, _IDENTITY)
        difference = first_difference(there, self._identity) or self._other_coordinates(there)
        if difference:
            raise StoreError(
                f"the store '{self.path}' holds another ensemble: {difference}. Give what it was "
                "begun with, or another folder"
            )
        self._lengths = tuple(there[_LENGTHS])
        remove_partial(self.path)
        statuses = self._find_missing()
        # All but results follows from the call: what was lost, cut or changed is written again.
        repair(self.path, self._documents(self._lengths, self._occurrences))
        group = self._zarr.open_group(str(self.path), mode="r+", use_consolidated=False)
        self._arrays = {name: group[name] for name in self._rows}
        for first, region, status in statuses:
            self.done += status.size
            if status.any():
                messages = self._arrays["message"][region].ravel()
                self.reasons.add(first, status.ravel(), messages)

    def _make(self, size: int) -> None:
        """Write coordinates, attributes and empty arrays."""
        documents = self._documents(chunk_lengths(self._shape, size), 0)
        with new_folder(self.path) as path:
            repair(path, documents)

    def _documents(self, lengths: tuple[int, ...], n_occurrences: int) -> dict[str, bytes]:
        """Form all files but those of results, by their places in the folder.

        Parameters
        ----------
        lengths : tuple of int
            Of a block, along each dimension of members.
        n_occurrences : int
            Length of the dimension of events.
        """
        frame = self._frame
        empty = frame.dataset({})
        coordinates = {name: _digest(row.values) for name, row in empty.coords.items()}
        identity = {**self._identity, _LENGTHS: list(lengths), _COORDINATES: coordinates}
        empty.attrs[_IDENTITY] = attribute_text(identity)
        with in_memory() as (memory, found):
            empty.to_zarr(
                memory,
                zarr_format=3,
                consolidated=False,
                mode="w",
                encoding=self._encoding(empty, lengths),
            )
            group = self._zarr.open_group(memory, mode="r+")
            for name, (dims, values, about) in self._rows.items():
                own, kind = values.shape[len(lengths) :], values.dtype.kind
                rest = [
                    _OCCURRENCES if dim == OCCURRENCE else n
                    for dim, n in zip(dims[len(lengths) :], own, strict=True)
                ]
                sizes = [
                    max(n, n_occurrences) if dim == OCCURRENCE else n
                    for dim, n in zip(dims[len(lengths) :], own, strict=True)
                ]
                make_array(
                    group,
                    name,
                    dims=dims,
                    shape=(*self._shape, *sizes),
                    chunks=(*lengths, *rest),
                    dtype=str if kind == "O" else values.dtype,
                    blank=_BLANKS.get(name, 0 if kind == "i" else np.nan),
                    about=about,
                )
            consolidate(memory)
        return found

    def _encoding(self, empty: Any, lengths: tuple[int, ...]) -> dict[str, Any]:
        """Give coordinates checksums, and cut what members set as their results are."""
        n_files = len(list(chunk_places(self._shape, lengths)))
        # Programs that read both expect the same chunks, unless that makes very many files.
        is_cut = n_files <= _MOST_CUTS and len(lengths) == 1
        found: dict[str, dict[str, Any]] = {name: checked() for name in empty.coords}
        for name, row in empty.coords.items():
            if is_cut and row.dims == self._frame.dims:
                found[name]["chunks"] = lengths
        return found

    def _other_coordinates(self, there: Mapping[str, Any]) -> str:
        """Say which coordinate differs from those of this call, and where; empty if none does."""
        here = self._frame.dataset({}).coords
        digests = there[_COORDINATES]
        for name in {**here, **digests}:
            row = here.get(name)
            if row is None or digests.get(name) != _digest(row.values):
                told = "" if row is None else self._first_other(name, row.values)
                return told or f"'{name}' has other values there and here"
        return ""

    def _first_other(self, name: str, here: Any) -> str:
        """Return where a coordinate differs first; empty if what is there cannot be read."""
        try:
            values = np.asarray(self._zarr.open_array(str(self.path / name), mode="r")[...])
            if values.shape != here.shape:
                return f"'{name}' has {values.size} values there and {here.size} here"
            differs = np.flatnonzero(values.astype(here.dtype) != here)
        except Exception:  # decoders of damaged bytes raise what they like
            return ""
        if not differs.size:
            return ""
        i = int(differs[0])
        return f"'{name}' at place {i} is {values[i]} there and {here[i]} here"

    def _find_missing(self) -> list[tuple[int, tuple[slice, ...], npt.NDArray[np.int8]]]:
        """Find the blocks of which something is missing; give the status of the others.

        The most events of a member of these is kept, by which the dimension of events is as long.
        """
        self._missing: list[tuple[int, int]] = []
        self._occurrences, found = 0, []
        for place in chunk_places(self._shape, self._lengths):
            region = chunk_region(self._shape, self._lengths, place)
            first, end = member_range(self._shape, region)
            status = self._status(place, region)
            if status is None:
                self._clear(place)
                self._missing.append((first, end))
            else:
                found.append((first, region, status))
        return found

    def _clear(self, place: tuple[int, ...]) -> None:
        """Remove what is damaged of a block, since a write to a part of a chunk reads all of it."""
        for name in self._rows:
            base = self.path.joinpath(name, "c", *(str(i) for i in place))
            for file in [path for path in (base, *base.rglob("*")) if path.is_file()]:
                if whole_bytes(file) is None:
                    file.unlink()

    def _status(
        self, place: tuple[int, ...], region: tuple[slice, ...]
    ) -> npt.NDArray[np.int8] | None:
        """Give the status of a block that was written to the end; None if anything is missing.

        Each of its files is read: one that was lost, cut or changed since is computed again.
        """
        # Most blocks that were not run lack this one.
        status: npt.NDArray[np.int8] | None = self._values("status", place, region)
        most = 0
        if status is None:
            return None
        for name, (dims, values, _) in self._rows.items():
            if OCCURRENCE in dims:
                continue
            if name.startswith("n(") and values.dtype.kind == "i":
                counts = self._values(name, place, region)
                if counts is None:
                    return None
                most = max(most, int(counts.max()))
            elif whole_bytes(self._file(name, place)) is None:
                return None
        # Chunks of events were written as far as its members have any.
        for name, row in self._rows.items():
            if OCCURRENCE in row[0]:
                for k in range(math.ceil(most / _OCCURRENCES)):
                    if whole_bytes(self._file(name, place, k)) is None:
                        return None
        self._occurrences = max(self._occurrences, most)
        return status

    def _values(self, name: str, place: tuple[int, ...], region: tuple[slice, ...]) -> Any:
        """Give a block's whole numbers of an array that has one for each member; None if lost."""
        data = whole_bytes(self._file(name, place))
        if data is None:
            return None
        # Chunks at the end of a dimension are as long as others, with blanks behind it.
        values = np.frombuffer(data, self._rows[name][1].dtype.newbyteorder("<"))
        extent = tuple(slice(0, part.stop - part.start) for part in region)
        return values.reshape(self._lengths)[extent]

    def _file(self, name: str, place: tuple[int, ...], occurrences: int = 0) -> Path:
        """Give the file of a chunk."""
        dims = self._rows[name][0][len(place) :]
        rest = [occurrences if dim == OCCURRENCE else 0 for dim in dims]
        return self.path.joinpath(name, "c", *(str(i) for i in (*place, *rest)))

    def _write(self, first: int, block: Block) -> None:
        """Write the chunks of a block, that of its status last."""
        start = np.unravel_index(first, self._shape)
        place = [int(i) // n for i, n in zip(start, self._lengths, strict=True)]
        region = chunk_region(self._shape, self._lengths, place)
        found = self._frame.variables(tuple(part.stop - part.start for part in region), block)
        status = found.pop("status")[1]
        self._grow(found)
        for name, (_, values, _) in found.items():
            if values.size:
                # Beside the places of members, all that there is, and of events as many.
                rest = tuple(slice(0, n) for n in values.shape[len(region) :])
                self._arrays[name][(*region, *rest)] = values
        self._arrays["status"][region] = status

    def _grow(self, found: Mapping[str, Any]) -> None:
        """Let the dimension of events be as long as that of a block."""
        is_longer = False
        for name, (dims, values, _) in found.items():
            if OCCURRENCE in dims:
                axis, array = dims.index(OCCURRENCE), self._arrays[name]
                if values.shape[axis] > array.shape[axis]:
                    shape = list(array.shape)
                    shape[axis], is_longer = values.shape[axis], True
                    array.resize(tuple(shape))
        if is_longer:
            consolidate(self.path)
