"""Datasets of ensembles to files: netCDF, Zarr, and tables of text, whole or not at all."""

from __future__ import annotations

import contextlib
import csv
import os
import shutil
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import Error, SceneError
from cotree.files import check_suffix, target_path, written_whole
from cotree.quiet import without_warnings

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

#: Suffixes of files that are written.
SUFFIXES = (".nc", ".zarr", ".csv")


def check_dataset_file(path: Path) -> None:
    """Refuse a file that cannot be written, before anything is run for it.

    Raises
    ------
    SceneError
        If its suffix is unknown, its folder is not there, or its place is taken by another thing.
    """
    suffix = check_suffix(path, SUFFIXES, "write")
    if not path.parent.is_dir():
        raise SceneError(
            f"cannot write '{path}': there is no folder '{path.parent}'; make it first"
        )
    if path.is_dir() and not (suffix == ".zarr" and _is_zarr(path)):
        raise SceneError(f"cannot write '{path}': it is a folder of other things; name another")


def write_dataset(dataset: Any, path: Path) -> None:
    """Write a Dataset of an ensemble.

    Parameters
    ----------
    dataset : xarray.Dataset
        As :meth:`cotree.Model.ensemble` gives it.
    path : Path
        The file; its suffix says in which format: .nc, .zarr or .csv.

    Raises
    ------
    SceneError
        If it cannot be written.
    Error
        If a package for the format is missing.
    """
    check_dataset_file(path)
    suffix = path.suffix.lower()
    if suffix == ".csv":
        with written_whole(path) as draft, draft.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerows(table_rows(dataset))
        return
    try:
        if suffix == ".nc":
            with written_whole(path) as draft:
                dataset.to_netcdf(draft, engine="h5netcdf")
        else:
            _write_zarr(dataset, path)
    except ImportError as error:
        raise Error(
            f"cannot write '{path}': {error}; run `pip install cotree[ensembles]`"
        ) from error


def table_rows(dataset: Any) -> Iterator[list[str]]:
    """Give the rows of a table: a title, then one for each member and time.

    Columns are what members set, the time, and all values by the titles that single runs have,
    sensitivities among them. Values that are not there are empty.
    """
    dims = dataset["status"].dims
    columns = [name for name, row in dataset.coords.items() if set(row.dims) <= set(dims)]
    like = dataset["status"]
    settings = [
        dataset[name].broadcast_like(like).transpose(*dims).values.ravel() for name in columns
    ]
    titles, values = _curves(dataset, dims)
    yield [*columns, "time", *titles]
    times = [_number(t) for t in dataset["time"].values]
    for i in range(like.size):
        own = [_number(column[i]) for column in settings]
        for j, t in enumerate(times):
            yield [*own, t, *(_number(row[i, j]) for row in values)]


def _curves(dataset: Any, dims: tuple[str, ...]) -> tuple[list[str], list[Any]]:
    """List what is over members and time, shape (n_members, n_t) each, with titles."""
    titles: list[str] = []
    values: list[Any] = []
    plain = [name for name, row in dataset.data_vars.items() if row.dims == (*dims, "time")]
    for name in plain:
        titles.append(name)
        values.append(_flat(dataset[name].values, 1))
    for name in plain:
        if f"d({name})" not in dataset:
            continue
        slopes = _flat(dataset[f"d({name})"].values, 2)
        for k, parameter in enumerate(dataset["parameter"].values):
            titles.append(f"d({name})/d({parameter})")
            values.append(slopes[..., k])
    return titles, values


def _flat(values: Any, n_last: int) -> Any:
    """Put the dimensions of members into one."""
    return values.reshape(-1, *values.shape[values.ndim - n_last :])


def _number(value: Any) -> str:
    """Write 17 significant digits, which tell every double from its neighbours."""
    if isinstance(value, (float, np.floating)):
        return "" if np.isnan(value) else f"{value:.17g}"
    return str(value)


def _write_zarr(dataset: Any, path: Path) -> None:
    """Write a folder beside the old one, then put it into its place."""
    target = target_path(path)
    draft, old = (target.with_name(f".{target.name}.{os.getpid()}.{end}") for end in ("tmp", "old"))
    try:
        # Zarr warns that its own format does not know of what xarray adds to be read at once.
        with without_warnings(message="Consolidated metadata"):
            dataset.to_zarr(draft, mode="w")
        # A folder takes no other one's place at once: for a moment there is none.
        if target.exists():
            os.replace(target, old)
        os.replace(draft, target)
    except OSError as error:
        raise SceneError(f"cannot write '{target}': {error.strerror or error}") from None
    finally:
        for folder in (draft, old):
            with contextlib.suppress(OSError):
                shutil.rmtree(folder, ignore_errors=True)


def _is_zarr(path: Path) -> bool:
    return any((path / name).exists() for name in ("zarr.json", ".zgroup"))
