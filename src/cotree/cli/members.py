"""Texts of options that say which members a sweep has, with one sentence for each refusal."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.cli.arguments import read_pairs
from cotree.ensemble.grid import grid
from cotree.ensemble.sampling import sample
from cotree.errors import Error, ParameterError, brief
from cotree.files import read_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.api import Model

_GRID = "--grid L=0.8:1.2:11, --grid k=1:1000:7:log or --grid k=40,50,60"
_SAMPLE = "--sample L=uniform:0.9:1.1"

# A table of members, [byte].
_LARGEST_TABLE = 2**30


def check_options(
    grids: Sequence[str], samples: Sequence[str], members: str | None, **of_samples: object
) -> None:
    """Refuse options that contradict each other.

    Raises
    ------
    ParameterError
        If members are given in no way, or in several.
    """
    is_number = members is not None and members.isdecimal()
    ways = {"--grid": bool(grids), "--sample": bool(samples)}
    ways["--members with a file"] = members is not None and not is_number
    chosen = [name for name, is_given in ways.items() if is_given]
    if len(chosen) > 1:
        raise ParameterError(f"{' and '.join(chosen)} exclude each other: give one of them")
    if not chosen and is_number:
        raise ParameterError(f"--members {members} is how many are drawn: give {_SAMPLE}, too")
    if not chosen:
        raise ParameterError(
            f"a sweep needs members: give {_GRID}; {_SAMPLE} --members 200; or --members table.csv"
        )
    if grids and is_number:
        raise ParameterError(f"a grid has as many members as it has: leave out --members {members}")
    if samples and members is None:
        raise ParameterError("--sample needs the number of members: give --members 200")
    for name, value in of_samples.items():
        if value is not None and not samples:
            raise ParameterError(f"--{name} says how members are drawn: give --sample, too")


def read_members_of(
    model: Model,
    grids: Sequence[str],
    samples: Sequence[str],
    members: str | None,
    seed: int | None,
    sampling: str | None,
) -> Any:
    """Read the members of a sweep from options that do not contradict each other.

    Raises
    ------
    ModelError
        If a text is not accepted.
    """
    if grids:
        return grid({name: _axis(name, text) for name, text in read_pairs("--grid", grids).items()})
    if samples:
        drawn = {
            name: _distribution(name, text)
            for name, text in read_pairs("--sample", samples).items()
        }
        try:
            return sample(model, drawn, int(members or 0), method=sampling or "sobol", seed=seed)
        except ParameterError as error:
            raise ParameterError(f"--sample: {error}") from None
    return _table(Path(members or ""))


def _axis(name: str, text: str) -> Any:
    """Read ``first:last:number``, with ``:log`` behind it, or ``value,value,...``."""
    shown = f"--grid {brief(name)}={brief(text)}"
    try:
        if ":" not in text:
            return [float(part) for part in text.split(",")]
        first, last, number, *scale = text.split(":")
        low, high, n = float(first), float(last), int(number)
    except ValueError:
        raise ParameterError(f"{shown} is no range and no list of numbers: write {_GRID}") from None
    if scale not in ([], ["log"]):
        raise ParameterError(f"{shown} ends in '{brief(':'.join(scale))}': write {_GRID}")
    if n < 1:
        raise ParameterError(f"{shown} has {n} values: give at least 1")
    if scale and not (low > 0.0 and high > 0.0):
        raise ParameterError(f"{shown} is logarithmic: both ends must be positive")
    return np.geomspace(low, high, n) if scale else np.linspace(low, high, n)


def _distribution(name: str, text: str) -> tuple[Any, ...]:
    """Read ``kind:number:number``; which numbers a kind has is known elsewhere."""
    kind, *numbers = text.split(":")
    try:
        return (kind.strip(), *(float(number) for number in numbers))
    except ValueError:
        raise ParameterError(
            f"--sample {brief(name)}={brief(text)} is no distribution: write it as {_SAMPLE}"
        ) from None


def _table(path: Path) -> Any:
    """Read a table of members; a column ``member`` labels them."""
    try:
        import pandas as pd
    except ImportError as error:
        raise Error("tables of members need pandas: run `pip install cotree[ensembles]`") from error
    text = read_text(path, _LARGEST_TABLE)
    try:
        # Tables come with commas, semicolons and tabs.
        separator = max(",;\t", key=text.partition("\n")[0].count)
        table = pd.read_csv(io.StringIO(text), sep=separator, skipinitialspace=True)
    except (ValueError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise ParameterError(f"--members {path} is no table: {brief(error)}") from None
    table.columns = [str(name).strip() for name in table.columns]
    return table.set_index("member") if "member" in table.columns else table
