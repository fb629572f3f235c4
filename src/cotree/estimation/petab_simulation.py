"""Predictions in the form of PEtab's simulation table."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import numpy as np
    import numpy.typing as npt


def measurement_frame(files: Sequence[Path], values: npt.NDArray[np.float64]) -> Any:
    """Replace measured values by predictions.

    Parameters
    ----------
    files : sequence of Path
        Measurement tables, in order.
    values : ndarray, shape (n_rows,)
        A value for each row.

    Returns
    -------
    pandas.DataFrame
        With the column ``simulation``.
    """
    import pandas

    # Read with pandas as other tools for PEtab do, so that the cells are equal; this engine keeps
    # all digits of numbers in every version.
    tables = [pandas.read_csv(file, sep="\t", engine="python") for file in files]
    # Rows that contain only separators are skipped.
    table = pandas.concat(tables, ignore_index=True).dropna(how="all").reset_index(drop=True)
    table["measurement"] = values
    return table.rename(columns={"measurement": "simulation"})
