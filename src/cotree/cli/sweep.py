"""The command that runs a scene with many parameter values."""

from __future__ import annotations

import io
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from cotree.cli.options import (
    INTERRUPTED,
    check_picture,
    end_time_option,
    path_option,
    print_error,
    read_pairs,
    read_scene,
    repeated_option,
    scene_argument,
    sensitivity_option,
    settings_options,
    tree_option,
    write_file,
)
from cotree.errors import ParameterError, brief, check_known, optional_package
from cotree.files import read_text
from cotree.quiet import without_warnings
from cotree.report import Report, Table

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.api import Model
    from cotree.scene.graphs import TreeChoice


_GRID = "--grid L=0.8:1.2:11, --grid k=1:1000:7:log or --grid k=40,50,60"
_SAMPLE = "--sample L=uniform:0.9:1.1"

# Largest size of a member table, [byte].
_LARGEST_TABLE = 2**30


def _check_options(
    grids: Sequence[str], samples: Sequence[str], members: str | None, **of_samples: object
) -> None:
    """Raise an error if options specify no members or contradict each other."""
    is_number = members is not None and members.isdecimal()
    ways = {"--grid": bool(grids), "--sample": bool(samples)}
    ways["--members with a file"] = members is not None and not is_number
    chosen = [name for name, is_given in ways.items() if is_given]
    if len(chosen) > 1:
        raise ParameterError(f"{' and '.join(chosen)} exclude each other: give one of them")
    if not chosen and is_number:
        raise ParameterError(f"--members {members} is the number of samples: give {_SAMPLE}, too")
    if not chosen:
        raise ParameterError(
            f"a sweep needs members: give {_GRID}; {_SAMPLE} --members 200; or --members table.csv"
        )
    if grids and is_number:
        raise ParameterError(
            f"the axes of a grid determine its number of members: leave out --members {members}"
        )
    if samples and members is None:
        raise ParameterError("--sample needs the number of members: give --members 200")
    for name, value in of_samples.items():
        if value is not None and not samples:
            raise ParameterError(f"--{name} sets how members are drawn: give --sample, too")


def _read_members(
    model: Model,
    grids: Sequence[str],
    samples: Sequence[str],
    members: str | None,
    seed: int | None,
    sampling: str | None,
) -> Any:
    """Build the members of a sweep from options that do not contradict each other."""
    if grids:
        from cotree.ensemble.members import grid

        return grid({name: _axis(name, text) for name, text in read_pairs("--grid", grids).items()})
    if samples:
        from cotree.ensemble.sampling import sample

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
    """Parse grid values: ``first:last:number``, optionally with ``:log``, or ``value,...``."""
    shown = f"--grid {brief(name)}={brief(text)}"
    try:
        if ":" not in text:
            return [float(part) for part in text.split(",")]
        first, last, number, *scale = text.split(":")
        low, high, n = float(first), float(last), int(number)
    except ValueError:
        raise ParameterError(
            f"{shown} is not a range or a list of numbers: write {_GRID}"
        ) from None
    if scale not in ([], ["log"]):
        raise ParameterError(f"{shown} ends in '{brief(':'.join(scale))}': write {_GRID}")
    if n < 1:
        raise ParameterError(f"{shown} has {n} values: give at least 1")
    if scale and not (low > 0.0 and high > 0.0):
        raise ParameterError(f"{shown} is logarithmic: both ends must be positive")
    return np.geomspace(low, high, n) if scale else np.linspace(low, high, n)


def _distribution(name: str, text: str) -> tuple[Any, ...]:
    """Parse a distribution, ``kind:number:...``; the kind determines how many numbers follow."""
    kind, *numbers = text.split(":")
    try:
        return (kind.strip(), *(float(number) for number in numbers))
    except ValueError:
        raise ParameterError(
            f"--sample {brief(name)}={brief(text)} is not a distribution: write it as {_SAMPLE}"
        ) from None


def _table(path: Path) -> Any:
    """Read a member table from a file; its column ``member``, if any, contains labels."""
    pd = optional_package("pandas", "tables of members need", "ensembles")
    text = read_text(path, _LARGEST_TABLE)
    try:
        separator = max(",;\t", key=text.partition("\n")[0].count)
        table = pd.read_csv(io.StringIO(text), sep=separator, skipinitialspace=True)
    except (ValueError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise ParameterError(f"--members {path} is not a table: {brief(error)}") from None
    table.columns = [str(name).strip() for name in table.columns]
    return table.set_index("member") if "member" in table.columns else table


@click.command("sweep")
@scene_argument
@repeated_option(
    "--grid",
    metavar="NAME=VALUES",
    help="Axis of a grid, for a parameter or the initial value of a state: L=0.8:1.2:11 for 11 "
    "values, k=1:1000:7:log for logarithmic spacing, or k=40,50,60; may be repeated.",
)
@repeated_option(
    "--sample",
    metavar="NAME=KIND:NUMBERS",
    help="Distribution from which values are drawn: uniform:low:high, loguniform:low:high, "
    "triangular:low:mode:high, normal:mean:deviation, truncated:mean:deviation:low:high, "
    "lognormal:median:factor, or relative:fraction of the value in the scene; may be repeated.",
)
@click.option(
    "--members",
    metavar="N|FILE",
    help="Number of members that --sample draws, or a CSV file with one row for each member and "
    "one column for each name.",
)
@click.option(
    "--seed", type=int, metavar="N", help="Seed of --sample. Equal seeds draw equal members."
)
@click.option("--sampling", help="Sampling method of --sample: sobol, latin, halton or random.")
@path_option("--file", "-o", help="Write all results to this file: .nc, .zarr or .csv.")
@sensitivity_option
@repeated_option(
    "--output", metavar="NAME", help="Output to compute; may be repeated. Default: all outputs."
)
@end_time_option
@click.option(
    "--points",
    type=click.IntRange(2),
    metavar="N",
    default=101,
    help="Number of evenly spaced output times.",
)
@settings_options()
@tree_option
@click.option(
    "--threads",
    type=click.IntRange(1),
    metavar="N",
    help="Number of threads. Default: the number of processors.",
)
@click.option(
    "--lanes",
    type=click.IntRange(1),
    metavar="N",
    help="Number of members that are integrated together in vectors; 1 turns this off.",
)
@path_option(
    "--store",
    help="Save results to this folder during the computation. An interrupted sweep resumes from "
    "it.",
)
@click.option(
    "--on-error",
    default="keep",
    metavar="keep|raise",
    help="If a member fails: keep the other members (its values are nan), or raise an error.",
)
@path_option(
    "--plot",
    help="Draw the results to this file (.svg, .png or .pdf): curves for a grid with one axis, "
    "heat maps for a grid with two axes, otherwise bands.",
)
@repeated_option(
    "--show",
    metavar="NAME",
    help="Quantity that --plot draws: a state, output or d(STATE)/d(PARAMETER); may be repeated.",
)
@click.option(
    "--of", default="last", help="Value over time that heat maps show: last, max, min or mean."
)
def sweep_scene(
    scene: str,
    grid: Sequence[str],
    sample: Sequence[str],
    members: str | None,
    seed: int | None,
    sampling: str | None,
    file: Path | None,
    sensitivity: Sequence[str],
    output: Sequence[str],
    t_end: float | None,
    points: int,
    settings: dict[str, Any],
    tree: TreeChoice,
    threads: int | None,
    lanes: int | None,
    store: Path | None,
    on_error: str,
    plot: Path | None,
    show: Sequence[str],
    of: str,
) -> None:
    """Simulate a scene for many parameter sets.

    The parameter sets form a grid, are drawn from distributions or are read from a table.
    """
    from cotree.ensemble.dataset import check_dataset_file, check_xarray, write_dataset
    from cotree.ensemble.run import MemberError
    from cotree.plot import save_figure
    from cotree.plot.ensembles import SUMMARIES, picture
    from cotree.solvers.engine import build_ahead

    # Check arguments before the scene is compiled.
    check_xarray()
    _check_options(grid, sample, members, seed=seed, sampling=sampling)
    if file is not None:
        check_dataset_file(file)
    check_picture(plot)
    if show and plot is None:
        raise click.BadParameter("--show selects the curves of a plot: also give --plot FILE")
    if of not in SUMMARIES:
        raise click.BadParameter(f"--of is '{of}': give {', '.join(SUMMARIES)}")
    swept = (text.partition("=")[0].strip() for text in (*grid, *sample))
    described = read_scene(scene, settings, swept)
    build_ahead(settings.get("method") or described.defaults.method)
    model = described.compile(sensitivity, tree)
    rows = _read_members(model, grid, sample, members, seed, sampling)
    _check_shown(model, show, output)
    end = described.defaults.t_end if t_end is None else t_end
    begun = time.perf_counter()
    try:
        # The report lists failed members, so suppress the warning.
        with without_warnings(message=r"\d+ of \d+ members failed"):
            runs = model.ensemble(
                (0.0, end),
                rows,
                t_eval=points,
                outputs=output or None,
                threads=threads,
                lanes=lanes,
                store=store,
                on_error=on_error,
                **settings,
            )
    except MemberError as error:
        print_error(str(error))
        raise click.exceptions.Exit(1) from None
    click.echo(sweep_report(runs, time.perf_counter() - begun).text())
    write_file(file, lambda path: write_dataset(runs, path))
    status = np.asarray(runs["status"].values)
    if (status == 0).any():
        write_file(plot, lambda path: save_figure(picture(runs, show, of), path))
    if (status == -3).any():
        raise click.exceptions.Exit(INTERRUPTED)
    # The sweep has failed if no member succeeded.
    if not (status == 0).any():
        raise click.exceptions.Exit(1)


def _check_shown(model: Model, show: Sequence[str], outputs: Sequence[str]) -> None:
    """Raise an error if --plot or --output names something unknown; called before any run."""
    from cotree.plot import choose_curves

    check_known(outputs, model.outputs, "--output names no output", error=ParameterError)
    if show:
        choose_curves(show, model.states, outputs or model.outputs, (), model.sensitivities)


# Largest number of failed members in the report.
_MOST_LISTED = 10

_QUANTILES = (0.025, 0.5, 0.975)


def sweep_report(runs: Any, seconds: float) -> Report:
    """Build the report of a sweep from an ensemble's Dataset and the elapsed time, [s]."""
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
    """Return a table of quantiles, over successful members, of the values at the last time."""
    rows = []
    for name, row in runs.data_vars.items():
        if row.dims == (*dims, "time") and done.any():
            last = row.values[..., -1].ravel()[done]
            last = last[~np.isnan(last)]
            if len(last):  # empty if events ended all members before this time
                found = np.quantile(last, _QUANTILES).tolist()
                rows.append((name, *found, row.attrs.get("units", "")))
    head = (f"t = {float(runs['time'].values[-1]):.6g} s", "2.5 %", "median", "97.5 %", "")
    return Table(head, rows)


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, (float, np.floating)) else str(value)


def _time(seconds: float) -> str:
    for factor, unit in ((1.0, "s"), (1e3, "ms")):
        if seconds * factor >= 1.0:
            return f"{seconds * factor:.3g} {unit}"
    return f"{seconds * 1e6:.3g} us"
