"""Results of an ensemble in a folder, which survives what happens to the process that fills it.

In: blocks as they are done. Out: a Zarr store that ``xarray.open_zarr`` reads as the Dataset that a
call without a store gives. Each block is a chunk of each array; that of ``status`` is written last,
and says that its members are there. Members without it were not run, whatever else a kill left.
"""

from __future__ import annotations

import json
import math
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.chunks import chunk_lengths, chunk_places, chunk_region, member_range
from cotree.ensemble.dataset import OCCURRENCE, Frame
from cotree.ensemble.identity import first_difference, identity_of
from cotree.ensemble.reasons import Reasons
from cotree.ensemble.results import NOT_RUN, NOT_RUN_SENTENCE, Results
from cotree.ensemble.zarr_folder import (
    check_zarr,
    consolidate,
    locked,
    make_array,
    new_folder,
    read_path,
    remove_partial,
    told,
    unlock,
    whole_bytes,
)
from cotree.errors import StoreError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    import numpy.typing as npt

    from cotree.ensemble.plan import Block

# The attribute that tells whose results a store holds.
_IDENTITY = "cotree_store"

# Events of a chunk along their dimension, which grows as members turn up that have more.
_OCCURRENCES = 8

# Coordinates are cut as results are, which programs that read them expect, up to so many files.
_MOST_CUTS = 256

# What stands for members that were not run; all other values are nan.
_BLANKS: Mapping[str, Any] = {"status": NOT_RUN, "message": NOT_RUN_SENTENCE, "seconds": 0.0}


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
        try:
            self._group = self._zarr.open_group(str(self.path), mode="r+", use_consolidated=False)
            there = json.loads(self._group.attrs[_IDENTITY])
            self._arrays = {name: self._group[name] for name in self._rows if name in self._group}
        except (KeyError, ValueError, FileNotFoundError, NotADirectoryError) as error:
            raise StoreError(
                f"'{self.path}' exists, and is no store of an ensemble ({error}): give another "
                "folder"
            ) from error
        difference = first_difference(there, self._identity) or self._other_coordinates()
        if difference:
            raise StoreError(
                f"the store '{self.path}' holds another ensemble: {difference}. Give what it was "
                "begun with, or another folder"
            )
        self._lengths = tuple(self._arrays["status"].chunks)
        remove_partial(self.path)
        self._missing = self._find_missing()
        if self._missing:
            # A kill may have come between the growth of arrays and this.
            consolidate(self.path)

    def _make(self, size: int) -> None:
        """Write coordinates, attributes and empty arrays."""
        frame, lengths = self._frame, chunk_lengths(self._shape, size)
        empty = frame.dataset({})
        empty.attrs[_IDENTITY] = json.dumps(self._identity)
        with new_folder(self.path) as path:
            empty.to_zarr(
                str(path),
                zarr_format=3,
                consolidated=False,
                mode="w",
                encoding=self._cuts(empty, lengths),
            )
            group = self._zarr.open_group(str(path), mode="r+")
            for name, (dims, values, about) in self._rows.items():
                own, kind = values.shape[len(lengths) :], values.dtype.kind
                rest = [
                    _OCCURRENCES if dim == OCCURRENCE else n
                    for dim, n in zip(dims[len(lengths) :], own, strict=True)
                ]
                make_array(
                    group,
                    name,
                    dims=dims,
                    shape=(*self._shape, *own),
                    chunks=(*lengths, *rest),
                    dtype=str if kind == "O" else values.dtype,
                    blank=_BLANKS.get(name, 0 if kind == "i" else np.nan),
                    about=about,
                )
            consolidate(path)

    def _cuts(self, empty: Any, lengths: tuple[int, ...]) -> dict[str, Any]:
        """Cut what members set as their results are, unless that makes very many files."""
        n_files = len(list(chunk_places(self._shape, lengths)))
        if n_files > _MOST_CUTS or len(lengths) > 1:
            return {}
        return {
            name: {"chunks": lengths}
            for name, row in empty.coords.items()
            if row.dims == self._frame.dims
        }

    def _other_coordinates(self) -> str:
        """Say which coordinate differs from those of this call, and where; empty if none does."""
        for name, wanted in self._frame.dataset({}).coords.items():
            there = np.asarray(self._group[name][...] if name in self._group else [])
            here = wanted.values
            if there.shape != here.shape:
                return f"'{name}' has {there.size} values there and {here.size} here"
            differs = np.flatnonzero(there.astype(here.dtype) != here)
            if differs.size:
                i = int(differs[0])
                return f"'{name}' at place {i} is {there[i]} there and {here[i]} here"
        return ""

    def _find_missing(self) -> list[tuple[int, int]]:
        """Find the blocks of which something is missing, and count the members of the others."""
        missing = []
        for place in chunk_places(self._shape, self._lengths):
            region = chunk_region(self._shape, self._lengths, place)
            first, end = member_range(self._shape, region)
            status = self._status(place, region)
            if status is None:
                missing.append((first, end))
                continue
            self.done += end - first
            if status.any():
                messages = self._arrays["message"][region].ravel()
                self.reasons.add(first, status.ravel(), messages)
        return missing

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
