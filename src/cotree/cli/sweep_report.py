"""Report of a sweep: number of members, failed members, and quantiles of the last values."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.errors import brief
from cotree.report import Report, Table

if TYPE_CHECKING:
    from collections.abc import Sequence

# Failed members that are listed.
_MOST_LISTED = 10

_QUANTILES = (0.025, 0.5, 0.975)


def sweep_report(runs: Any, seconds: float) -> Report:
    """Build the report of a sweep from the Dataset of an ensemble and the elapsed time, [s]."""
    status = np.asarray(runs["status"].values).ravel()
    n, dims = len(status), runs["status"].dims
    shape = " x ".join(f"{name} ({runs.sizes[name]})" for name in dims)
    was_run = int((status != -3).sum())
    own = float(np.sum(runs["seconds"].values)) / max(1, was_run)
    failed = np.flatnonzero((status != 0) & (status != -3))
    return Report(
        f"{runs.attrs['scene']}: {n} members, {shape}; {runs.sizes['time']} times, "
        f"{runs.attrs['method']}",
        f"{was_run} run in {seconds:.3g} s, each {_time(own)} on its thread; {failed.size} failed",
        *_failed_lines(runs, dims, failed),
        _quantiles(runs, dims, status == 0),
    )


def _failed_lines(runs: Any, dims: Sequence[str], failed: Any) -> list[str]:
    """List failed members with their values and messages."""
    if not len(failed):
        return []
    names = [name for name, row in runs.coords.items() if row.dims and set(row.dims) <= set(dims)]
    like = runs["status"]
    columns = {
        name: runs[name].broadcast_like(like).transpose(*dims).values.ravel() for name in names
    }
    messages = runs["message"].values.ravel()
    lines = []
    for i in failed[:_MOST_LISTED]:
        values = ", ".join(f"{name} = {_short(column[i])}" for name, column in columns.items())
        lines.append(f"failed: {values or f'member {i}'}: {brief(messages[i], 300)}")
    if len(failed) > _MOST_LISTED:
        lines.append(f"and {len(failed) - _MOST_LISTED} more")
    return lines


def _quantiles(runs: Any, dims: Sequence[str], done: Any) -> Table:
    """List quantiles of the last values over all members that succeeded."""
    rows = []
    for name, row in runs.data_vars.items():
        if row.dims == (*dims, "time") and done.any():
            last = row.values[..., -1].ravel()[done]
            last = last[~np.isnan(last)]
            if len(last):  # an event may have ended all of them before
                found = np.quantile(last, _QUANTILES).tolist()
                rows.append((name, *found, row.attrs.get("units", "")))
    head = (f"t = {float(runs['time'].values[-1]):.6g} s", "2.5 %", "median", "97.5 %", "")
    return Table(head, rows)


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, (float, np.floating)) else str(value)


def _time(seconds: float) -> str:
    """Write a time with a unit that suits it."""
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"
