"""Commands that examine a scene: lint, check of sensitivities, comparison of methods."""

from __future__ import annotations

import json
import sys
from contextlib import contextmanager
from pathlib import Path  # noqa: TC003 - typer reads the annotations
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cotree.build.cache import cached
from cotree.cli.options import (
    EndTime,
    Plot,
    SceneName,
    Sensitivity,
    check_folder,
    check_picture,
    given,
    read_scene,
    read_tolerances,
    with_options,
    write_file,
)
from cotree.report import Values

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from cotree.api import Model, Scene
    from cotree.lint import Finding


# Findings that a run prints.
_MOST_WARNINGS = 5


def lint_scene(
    scene: SceneName,
    allow: Annotated[
        list[str],
        typer.Option(metavar="RULE[:NAME]", help="A finding that is on purpose; may be repeated."),
    ] = [],  # noqa: B006 - typer copies it
    as_json: Annotated[bool, typer.Option("--json", help="Print a list of objects.")] = False,
) -> None:
    """List suspicious statements of a scene: unused names, dangling nodes, inconsistent units.

    Exit code 1 if anything is. Entries of allow = ["RULE:NAME"] in the file are on purpose.
    """
    found = read_scene(scene).lint(allow)
    if as_json:
        typer.echo(json.dumps([row.to_dict() for row in found], indent=2))
    else:
        for line in finding_lines(found) or ["nothing suspicious"]:
            typer.echo(line)
    if found:
        raise typer.Exit(1)


def warn_of(scene: Scene) -> None:
    """Print the findings of lint on a scene that is about to run, to standard error."""

    def findings() -> list[Finding]:
        from cotree.lint import lint

        # Errors are reported by the run itself, and unused names do not change results.
        return [row for row in lint(scene, is_formed=False) if not row.rule.startswith("unused")]

    # Most scenes have no findings, which is cached; lines are those of the present file.
    found = findings() if cached(("findings", scene), lambda: bool(findings())) else []
    for row in found[:_MOST_WARNINGS]:
        typer.echo(str(row), err=True)
    if len(found) > _MOST_WARNINGS:
        typer.echo(f"{len(found) - _MOST_WARNINGS} more findings: see `cotree lint`", err=True)


def finding_lines(found: Sequence[Finding]) -> list[str]:
    """Return a line for each finding, and one with the entry that allows them."""
    lines = [str(row) for row in found]
    entries = ", ".join(f'"{row.allow}"' for row in found if row.allow)
    if entries:
        lines.append(f"on purpose? write at the top of the scene file: allow = [{entries}]")
    return lines


def derived_values(model: Model, parameters: Mapping[str, float] | None) -> Values:
    """List the parameters that follow from others: name, expression, value and unit."""
    values = model.kernels.derived(parameters)
    rows = [(f"{r.name} = {r.text}", values[r.name], r.unit) for r in model.kernels.layout.derived]
    return Values((), rows, "derived parameters", digits=10)


@with_options("atol", "initial", rtol=1e-12)
def check_scene(
    scene: SceneName,
    sensitivity: Sensitivity = [],  # noqa: B006
    t_end: EndTime = None,
    settings: Any = None,
    tree: Any = None,
) -> None:
    """Compare sensitivities with finite differences; all parameters if none is named."""
    from cotree.lint import lint

    described = read_scene(scene, settings)
    values = settings.pop("parameters")
    # Constants in the code have no sensitivities.
    names = sensitivity or [row.name for row in described.parameters.values() if row.is_argument]
    _progress(f"compiling {described.name} with {len(names)} sensitivities, then without")
    model = described.compile(names, tree)
    for line in finding_lines(lint(described, is_formed=False)):
        typer.echo(line)
    if derived := derived_values(model, values).text():
        typer.echo(derived)
    report = model.check(t_end=t_end, parameters=values, report=_at_once, **settings)
    if not report.passed:
        raise typer.Exit(1)


@with_options("method", "rtol", "atol", "initial", "inputs", time_limit=5.0)
def bench_scene(
    scene: SceneName,
    sensitivity: Sensitivity = [],  # noqa: B006 - typer copies it
    method: Annotated[
        list[str], typer.Option(help="A method; may be repeated. All of them if absent.")
    ] = [],  # noqa: B006
    tolerance: Annotated[
        list[str],
        typer.Option(
            metavar="RTOL[,ATOL]",
            help="Tolerances; may be repeated. 1e-3 to 1e-11 if absent, atol a hundredth of rtol.",
        ),
    ] = [],  # noqa: B006
    repeats: Annotated[
        int | None, typer.Option(min=1, help="Timed runs of each: 25 if absent, 9 with --quick.")
    ] = None,
    t_end: EndTime = None,
    settings: Any = None,
    budget: Annotated[
        float | None,
        typer.Option(metavar="S", help="Processor time of all runs: 20 if absent, 4 with --quick."),
    ] = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Tolerances 1e-3, 1e-6 and 1e-9, and fewer runs.")
    ] = False,
    tree: Any = None,
    json: Annotated[Path | None, typer.Option(help="Write all numbers to this file.")] = None,
    plot: Plot = None,
) -> None:
    """Measure speed against error of every method on a scene, and recommend one."""
    from cotree.plot import save_figure
    from cotree.studies import bench as study

    check_folder(json)
    check_picture(plot)
    tolerances = read_tolerances(tolerance)
    # Given options take precedence over --quick.
    settings |= given(repeats=repeats, budget=budget)
    if quick:
        tolerances = tolerances or list(study.QUICK_TOLERANCES)
        settings = {"repeats": study.QUICK_REPEATS, "budget": study.QUICK_BUDGET} | settings
    with _bar() as progress:
        report = study.bench(
            read_scene(scene),
            sensitivity,
            method or None,
            tolerances or study.TOLERANCES,
            t_end=t_end,
            values=settings.pop("parameters"),
            tree=tree,
            progress=progress,
            **settings,
        )
    typer.echo(report.summary())
    write_file(json, report.to_json)
    write_file(plot, lambda path: save_figure(report.plot(), path))


@contextmanager
def _bar() -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar on standard error, if it is a terminal; it is removed at the end."""
    if not sys.stderr.isatty():
        yield lambda text, share: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling", total=1.0)
        yield lambda text, share: bar.update(task, description=text, completed=share)


def _progress(text: str) -> None:
    """Print a line on standard error, if it is a terminal."""
    if sys.stderr.isatty():
        typer.echo(f"cotree: {text}", err=True)


def _at_once(text: str) -> None:
    """Print a line and flush it, for programs that read a pipe."""
    typer.echo(text)
    sys.stdout.flush()
