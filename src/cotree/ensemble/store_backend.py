"""xarray backend for ensemble stores: ``xarray.open_dataset(FOLDER, engine="cotree")``."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path
from typing import Any

import numpy as np
import xarray
from xarray.backends import BackendArray, BackendEntrypoint
from xarray.core import indexing

from cotree.ensemble.dataset import OCCURRENCE
from cotree.ensemble.plan import NOT_RUN, NOT_RUN_SENTENCE
from cotree.ensemble.store import COORDINATES, MANIFEST, block_path, read_array, read_manifest

# Fill values for members that were not run, by variable or by type.
_BLANKS = {"status": NOT_RUN, "message": NOT_RUN_SENTENCE, "seconds": 0.0}
_BLANK_OF_KIND = {"i": 0, "f": np.nan}


class StoreBackend(BackendEntrypoint):  # type: ignore[misc]
    """Backend that opens ensemble stores and reads values on access."""

    description = "Open stores of cotree's ensembles"

    def open_dataset(self, filename_or_obj: Any, *, drop_variables: Any = None) -> Any:
        """Return the Dataset of a folder; missing members are nan with status -3."""
        return _lazy_dataset(Path(filename_or_obj)).drop_vars(drop_variables or [])

    def guess_can_open(self, filename_or_obj: Any) -> bool:
        """Return whether a path is the folder of a store."""
        try:
            return (Path(filename_or_obj) / MANIFEST).is_file()
        except TypeError:
            return False


def open_store(path: Path) -> Any:
    """Return the Dataset of a store, in dask chunks if dask is installed."""
    found = _lazy_dataset(path)
    has_dask = importlib.util.find_spec("dask") is not None
    for name, row in found.data_vars.items():
        if row.dtype.kind == "O":  # dask would warn when it writes texts to files
            row.load()
        elif has_dask:
            found[name] = row.chunk(row.encoding["preferred_chunks"])
    return found


def _lazy_dataset(path: Path) -> Any:
    manifest = read_manifest(path)
    with np.load(path / COORDINATES) as archive:
        coordinates = {
            name: (dims, read_array(archive, name), about)
            for name, (dims, about) in manifest["dims"].items()
        }
    shape, size = tuple(manifest["shape"]), manifest["block"]
    n_occurrences = _most_occurrences(path, manifest)
    chunks = max(1, size // math.prod(shape[1:]))
    variables = {}
    for name, (dims, rest, dtype, about) in manifest["variables"].items():
        whole = list(shape) + [
            n_occurrences if dim == OCCURRENCE else n
            for dim, n in zip(dims[len(shape) :], rest, strict=True)
        ]
        values = _BlockArray(path, name, shape, size, tuple(whole), np.dtype(dtype))
        lazy = indexing.LazilyIndexedArray(values)
        encoding = {"preferred_chunks": {dims[0]: chunks}}
        variables[name] = xarray.Variable(dims, lazy, about, encoding)
    return xarray.Dataset(variables, coordinates, manifest["attributes"])


def _most_occurrences(path: Path, manifest: dict[str, Any]) -> int:
    """Return the largest number of occurrences of an event in one member."""
    rows = manifest["variables"].items()
    times = next((name for name, (dims, *_) in rows if dims[-1] == OCCURRENCE), None)
    if times is None:
        return 0
    most = 0
    for file in sorted(block_path(path, 0).parent.glob("*.npz")):
        with np.load(file) as archive:
            most = max(most, read_array(archive, times).shape[-1])
    return most


class _BlockArray(BackendArray):  # type: ignore[misc]
    """A variable over all members, whose values are read from block files on access."""

    def __init__(
        self,
        path: Path,
        name: str,
        members: tuple[int, ...],
        size: int,
        shape: tuple[int, ...],
        dtype: Any,
    ) -> None:
        self._path, self._name, self._members, self._size = path, name, members, size
        self.shape, self.dtype = shape, dtype

    def __getitem__(self, key: Any) -> Any:
        return indexing.explicit_indexing_adapter(
            key, self.shape, indexing.IndexingSupport.OUTER, self._read
        )

    def _read(self, key: tuple[Any, ...]) -> Any:
        n = len(self._members)
        places = [
            np.atleast_1d(np.arange(m)[k]) for m, k in zip(self._members, key[:n], strict=True)
        ]
        members = np.ravel_multi_index(np.ix_(*places), self._members)
        firsts = members.ravel() // self._size * self._size
        found: Any = self._chosen(np.empty((0, *self.shape[n:]), self.dtype), key[n:])
        found = np.empty((firsts.size, *found.shape[1:]), self.dtype)
        for first in np.unique(firsts).tolist():
            here = firsts == first
            rows = self._rows(first, members.ravel()[here] - first)
            found[here] = self._chosen(rows, key[n:])
        found = found.reshape(*members.shape, *found.shape[1:])
        # As in NumPy, an integer index removes its dimension.
        return found[
            tuple(
                0 if np.ndim(k) == 0 and not isinstance(k, slice) else slice(None) for k in key[:n]
            )
        ]

    def _rows(self, first: int, rows: Any) -> Any:
        """Return the given rows of a block; fill values replace missing blocks and events."""
        kind = self.dtype.kind
        blank = _BLANKS.get(self._name, _BLANK_OF_KIND.get(kind))
        found = np.full((len(rows), *self.shape[len(self._members) :]), blank, self.dtype)
        try:
            with np.load(block_path(self._path, first)) as archive:
                values = read_array(archive, self._name)[rows]
        except FileNotFoundError:
            return found
        found[tuple(slice(0, n) for n in values.shape)] = values
        return found

    @staticmethod
    def _chosen(values: Any, key: tuple[Any, ...]) -> Any:
        """Apply an index to each dimension after the first."""
        for axis in reversed(range(len(key))):
            values = values[(slice(None),) * (axis + 1) + (key[axis],)]
        return values
