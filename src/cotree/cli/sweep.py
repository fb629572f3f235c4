"""The command that runs a scene with many values of its parameters."""

from __future__ import annotations

import time
from pathlib import Path  # noqa: TC003 - typer reads the annotations
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cotree.cli.arguments import (
    check_options,
    check_picture,
    read_members_of,
)
from cotree.cli.options import (
    INTERRUPTED,
    EndTime,
    SceneName,
    Sensitivity,
    complain,
    read_scene,
    with_options,
    write_file,
)
from cotree.errors import ParameterError, nearest
from cotree.quiet import without_warnings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.api import Model


@with_options()
def sweep_scene(
    scene: SceneName,
    grid: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=VALUES",
            help="An axis of a grid: L=0.8:1.2:11 for 11 values, k=1:1000:7:log, or k=40,50,60; a "
            "parameter, or a state by its initial value; may be repeated.",
        ),
    ] = [],  # noqa: B006 - typer copies it
    sample: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=KIND:NUMBERS",
            help="A distribution: uniform:low:high, loguniform:low:high, triangular:low:mode:high, "
            "normal:mean:deviation, truncated:mean:deviation:low:high, lognormal:median:factor, or "
            "relative:share of the scene's value; may be repeated.",
        ),
    ] = [],  # noqa: B006
    members: Annotated[
        str | None,
        typer.Option(
            metavar="N|FILE",
            help="How many are drawn by --sample; or a table in CSV with a column for each name.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(metavar="N", help="Of --sample: equal seeds draw equal members.")
    ] = None,
    sampling: Annotated[
        str | None, typer.Option(help="Of --sample: sobol, latin, halton or random.")
    ] = None,
    file: Annotated[
        Path | None,
        typer.Option("--file", "-o", help="Write all results to this: .nc, .zarr or .csv."),
    ] = None,
    sensitivity: Sensitivity = [],  # noqa: B006
    output: Annotated[
        list[str],
        typer.Option(metavar="NAME", help="An output; may be repeated. All if absent."),
    ] = [],  # noqa: B006
    t_end: EndTime = None,
    points: Annotated[int, typer.Option(min=2, help="Number of evenly spaced times.")] = 101,
    settings: Any = None,
    tree: Any = None,
    threads: Annotated[
        int | None, typer.Option(min=1, help="Threads; as many as processors if absent.")
    ] = None,
    lanes: Annotated[
        int | None,
        typer.Option(min=1, help="Members side by side in vectors; 1 for none."),
    ] = None,
    store: Annotated[
        Path | None,
        typer.Option(help="Store results in this folder; an interrupted sweep resumes from it."),
    ] = None,
    on_error: Annotated[
        str,
        typer.Option(metavar="keep|raise", help="What a member that fails does: nan, or the end."),
    ] = "keep",
    plot: Annotated[
        Path | None,
        typer.Option(
            help="Draw to this file, .svg, .png or .pdf: heat maps of a grid of two axes, curves "
            "of one, bands of all else."
        ),
    ] = None,
    show: Annotated[
        list[str],
        typer.Option(
            metavar="NAME",
            help="What --plot draws: a state, output or d(STATE)/d(PARAMETER); may be repeated.",
        ),
    ] = [],  # noqa: B006
    of: Annotated[
        str, typer.Option(help="What heat maps show: last, max, min or mean over time.")
    ] = "last",
) -> None:
    """Run a scene with many values of its parameters: a grid, samples, or a table."""
    import numpy as np

    from cotree.cli.sweep_report import sweep_report
    from cotree.ensemble.dataset import check_dataset_file, check_xarray, write_dataset
    from cotree.ensemble.run import MemberError
    from cotree.plot.ensembles import SUMMARIES, picture
    from cotree.plot.files import save_figure
    from cotree.solvers.engine import build_ahead

    # Arguments are checked before the scene is compiled.
    check_xarray()
    check_options(grid, sample, members, seed=seed, sampling=sampling)
    if file is not None:
        check_dataset_file(file)
    check_picture(plot)
    if show and plot is None:
        raise typer.BadParameter("--show says what --plot draws: give --plot FILE, too")
    if of not in SUMMARIES:
        raise typer.BadParameter(f"--of is '{of}': give {', '.join(SUMMARIES)}")
    swept = (text.partition("=")[0].strip() for text in (*grid, *sample))
    described = read_scene(scene, settings, swept)
    build_ahead(settings.get("method") or described.defaults.method)
    model = described.compile(sensitivity, tree)
    rows = read_members_of(model, grid, sample, members, seed, sampling)
    _check_shown(model, show, output)
    end = described.defaults.t_end if t_end is None else t_end
    begun = time.perf_counter()
    try:
        # The report lists failed members.
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
        complain(str(error))
        raise typer.Exit(1) from None
    typer.echo(sweep_report(runs, time.perf_counter() - begun).text())
    write_file(file, lambda path: write_dataset(runs, path))
    status = np.asarray(runs["status"].values)
    if (status == 0).any():
        write_file(plot, lambda path: save_figure(picture(runs, show, of), path))
    if (status == -3).any():
        raise typer.Exit(INTERRUPTED)
    # The sweep has failed if no member succeeded.
    if not (status == 0).any():
        raise typer.Exit(1)


def _check_shown(model: Model, show: Sequence[str], outputs: Sequence[str]) -> None:
    """Refuse unknown names of --plot and --output, before anything runs."""
    from cotree.plot import choose_curves

    for name in outputs:
        if name not in model.outputs:
            raise ParameterError(f"--output names no output '{name}'{nearest(name, model.outputs)}")
    if show:
        choose_curves(show, model.states, outputs or model.outputs, (), model.sensitivities)
