"""Commands, one function each, and the handling of errors and warnings.

Exit codes: 0 done, 1 a failed integration or check, 2 a wrong argument or scene, 130 interrupted.
Commands import slow packages themselves, so that the others start fast.
"""

from __future__ import annotations

import errno
import io
import json
import sys
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any

import click

from cotree.build.cache import cached
from cotree.cli.options import (
    INTERRUPTED,
    check_animated,
    check_folder,
    check_picture,
    csv_option,
    end_time_option,
    given,
    path_option,
    plot_option,
    print_error,
    read_pairs,
    read_robots_with,
    read_scene,
    read_tolerances,
    repeated_option,
    scene_argument,
    sensitivity_option,
    settings_options,
    tree_option,
    warnings_in_one_line,
    write_file,
)
from cotree.errors import Error, FormulationError, SceneError
from cotree.methods import names_of
from cotree.report import Report, Values
from cotree.version import VERSION

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

    from cotree.api import Model, Scene
    from cotree.lint import Finding
    from cotree.scene.graphs import TreeChoice


#: Commands in the order of the help.
_ORDER = (
    "run sweep optimise fit generate export equations graph lint check bench save components new "
    "scenes"
)

#: Modules and names of commands that are imported when needed: by their call or by help.
_LATER = {
    "sweep": "sweep.sweep_scene",
    "optimise": "fitting.optimise_scene",
    "fit": "fitting.fit_scene",
    "components": "guide.show_components",
    "new": "guide.new_scene",
}


class Commands(click.Group):
    """A group of commands, some of which are imported at their first use."""

    def list_commands(self, ctx: Any) -> list[str]:
        """Return the names of all commands."""
        return _ORDER.split()

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command by name, or None if there is none."""
        if cmd_name in _LATER and cmd_name not in self.commands:
            module, _, command = _LATER[cmd_name].partition(".")
            self.add_command(getattr(import_module(f"cotree.cli.{module}"), command))
        return super().get_command(ctx, cmd_name)


@click.group(cls=Commands, context_settings={"show_default": True})
@click.version_option(VERSION, message="cotree %(version)s", help="Print the version.")
@click.option(
    "--base", default="fixed", help="Base of a URDF robot: fixed (to the ground) or free."
)
@click.option(
    "--mimic/--no-mimic",
    default=True,
    help="Whether mimic joints of a URDF robot follow their leaders.",
)
def app(base: str, mimic: bool) -> None:
    """Simulate mechanisms, circuits and processes by generated C code, with exact sensitivities."""
    read_robots_with(base, mimic)


# Largest number of findings that a run prints.
_MOST_WARNINGS = 5


@app.command("lint")
@scene_argument
@repeated_option(
    "--allow",
    metavar="RULE[:NAME]",
    help="Allow this finding, because the entry is intended; may be repeated.",
)
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def lint_scene(scene: str, allow: Sequence[str], as_json: bool) -> None:
    """List suspicious entries of a scene.

    Examples are unused names, dangling nodes and inconsistent units. If there are findings, the
    exit code is 1. To allow a finding, write allow = ["RULE:NAME"] in the scene file.
    """
    found = read_scene(scene).lint(allow)
    if as_json:
        click.echo(json.dumps([row.to_dict() for row in found], indent=2))
    else:
        for line in finding_lines(found) or ["nothing suspicious"]:
            click.echo(line)
    if found:
        raise click.exceptions.Exit(1)


def warn_of(scene: Scene) -> None:
    """Print lint findings about a scene on standard error before it runs."""

    def findings() -> list[Finding]:
        from cotree.lint import lint

        # Errors are left to the run, and unused names do not change results.
        return [row for row in lint(scene, is_formed=False) if not row.rule.startswith("unused")]

    # Only an empty result is cached, because findings contain line numbers, which change.
    found = findings() if cached(("findings", scene), lambda: bool(findings())) else []
    for row in found[:_MOST_WARNINGS]:
        click.echo(str(row), err=True)
    if len(found) > _MOST_WARNINGS:
        click.echo(f"{len(found) - _MOST_WARNINGS} more findings: see `cotree lint`", err=True)


def finding_lines(found: Sequence[Finding]) -> list[str]:
    """Return a line for each finding, and a line with the ``allow`` entries that permit them."""
    lines = [str(row) for row in found]
    entries = ", ".join(f'"{row.allow}"' for row in found if row.allow)
    if entries:
        lines.append(f"on purpose? write at the top of the scene file: allow = [{entries}]")
    return lines


def derived_values(model: Model, parameters: Mapping[str, float] | None) -> Values:
    """Return a table of the derived parameters: name, expression, value and unit."""
    values = model.kernels.derived(parameters)
    rows = [(f"{r.name} = {r.text}", values[r.name], r.unit) for r in model.kernels.layout.derived]
    return Values((), rows, "derived parameters", digits=10)


@app.command("check")
@scene_argument
@sensitivity_option
@end_time_option
@settings_options("atol", "initial", rtol=1e-12)
@tree_option
def check_scene(
    scene: str,
    sensitivity: Sequence[str],
    t_end: float | None,
    settings: dict[str, Any],
    tree: TreeChoice,
) -> None:
    """Compare sensitivities with finite differences.

    By default, the sensitivities to all parameters are compared.
    """
    from cotree.lint import lint

    described = read_scene(scene, settings)
    values = settings.pop("parameters")
    # Parameters that are constants in the code have no sensitivities.
    names = sensitivity or [row.name for row in described.parameters.values() if row.is_argument]
    if sys.stderr.isatty():
        what = f"{described.name} with {len(names)} sensitivities, then without"
        click.echo(f"cotree: compiling {what}", err=True)
    model = described.compile(names, tree)
    for line in finding_lines(lint(described, is_formed=False)):
        click.echo(line)
    if derived := derived_values(model, values).text():
        click.echo(derived)
    report = model.check(t_end=t_end, parameters=values, report=_at_once, **settings)
    if not report.passed:
        raise click.exceptions.Exit(1)


@app.command("bench")
@scene_argument
@sensitivity_option
@repeated_option("--method", help="Method to measure; may be repeated. Default: all methods.")
@repeated_option(
    "--tolerance",
    metavar="RTOL[,ATOL]",
    help="Tolerances to measure; may be repeated. Default: 1e-3 to 1e-11. Without ATOL, it is a "
    "hundredth of RTOL.",
)
@click.option(
    "--repeats",
    type=click.IntRange(1),
    metavar="N",
    help="Number of timed runs of each method and tolerance. Default: 25, or 9 with --quick.",
)
@end_time_option
@settings_options("method", "rtol", "atol", "initial", "inputs", time_limit=5.0)
@click.option(
    "--budget",
    type=float,
    metavar="S",
    help="Limit of the processor time of all runs, in s. Default: 20, or 4 with --quick.",
)
@click.option(
    "--quick",
    is_flag=True,
    help="Measure only the tolerances 1e-3, 1e-6 and 1e-9, with fewer runs.",
)
@tree_option
@path_option("--json", help="Write all results to this JSON file.")
@plot_option
def bench_scene(
    scene: str,
    sensitivity: Sequence[str],
    method: Sequence[str],
    tolerance: Sequence[str],
    repeats: int | None,
    t_end: float | None,
    settings: dict[str, Any],
    budget: float | None,
    quick: bool,
    tree: TreeChoice,
    json: Path | None,
    plot: Path | None,
) -> None:
    """Measure all methods on a scene and recommend one.

    The table lists times and errors at several tolerances.
    """
    from cotree.plot import save_figure
    from cotree.studies import bench as study

    check_folder(json)
    check_picture(plot)
    tolerances = read_tolerances(tolerance)
    # Options on the command line take precedence over --quick.
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
    click.echo(report.summary())
    write_file(json, report.to_json)
    write_file(plot, lambda path: save_figure(report.plot(), path))


@contextmanager
def _bar() -> Iterator[Callable[[str, float], None]]:
    """Show a progress bar on standard error if it is a terminal; remove it at the end."""
    if not sys.stderr.isatty():
        yield lambda text, share: None
        return
    from rich.console import Console
    from rich.progress import Progress

    with Progress(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("compiling", total=1.0)
        yield lambda text, share: bar.update(task, description=text, completed=share)


def _at_once(text: str) -> None:
    """Print a line and flush it, for programs that read a pipe."""
    click.echo(text)
    sys.stdout.flush()


#: Names of the methods available in C projects and FMUs.
_EXPLICIT, _IMPLICIT = names_of("cotree", implicit=False), names_of("cotree", implicit=True)

_KINDS = {"me": "ModelExchange", "cs": "CoSimulation"}


@app.command("export")
@scene_argument
@path_option("--output", "-o", metavar="FILE", help="FMU to write; its name ends in .fmu.")
@path_option("--web", metavar="FILE", help="Interactive page to write; its name ends in .html.")
@sensitivity_option
@tree_option
@click.option("--version", type=int, default=3, help="Version of the FMI standard: 3 or 2.")
@repeated_option(
    "--kind",
    metavar="KIND",
    help="Interface type: me (Model Exchange) or cs (Co-Simulation); may be repeated. Default: "
    "both.",
)
@click.option(
    "--integrator", help=f"Integrator of Co-Simulation: {_EXPLICIT}; for stiff systems {_IMPLICIT}."
)
@repeated_option(
    "--outside",
    metavar="INPUT",
    help="Input that the importer sets; may be repeated. Default: all inputs that are constant in "
    "the scene.",
)
@repeated_option(
    "--platform",
    metavar="PLATFORM",
    help="Platform of a library in the FMU: x86_64-linux, aarch64-linux, x86_64-windows, "
    "x86_64-darwin, aarch64-darwin, or none for sources only; may be repeated. Default: this "
    "machine.",
)
@repeated_option(
    "--range",
    metavar="NAME=LOW:HIGH",
    help="Range of a slider of the page; may be repeated. Default: from zero to twice the value.",
)
def export_scene(
    scene: str,
    output: Path | None,
    web: Path | None,
    sensitivity: Sequence[str],
    tree: TreeChoice,
    version: int,
    kind: Sequence[str],
    integrator: str | None,
    outside: Sequence[str],
    platform: Sequence[str],
    range: Sequence[str],
) -> None:
    """Write a scene as an FMU for other simulators, or as an interactive page.

    The page needs no network. Unless sensitivities are named, it predicts changes of the first
    parameters.
    """
    if (output is None) == (web is None):
        raise click.UsageError("give --output FILE for an FMU, or --web FILE for a page")
    if web is not None:
        write_web(read_scene(scene), web, sensitivity, tree, range)
        return
    assert output is not None
    if output.suffix.lower() != ".fmu":
        raise SceneError(f"cannot write '{output}': the name of an FMU ends in .fmu")
    check_folder(output)
    kinds = [_KINDS.get(name, name) for name in kind] or list(_KINDS.values())
    platforms = [name for name in platform if name != "none"] if platform else None
    model = read_scene(scene).compile(sensitivity, tree)
    unit = model.export_fmu(
        output, version, kinds, integrator, inputs=outside or None, platforms=platforms
    )
    where = ", ".join(unit.platforms) or "no platform (sources only)"
    click.echo(f"wrote {unit.path}: FMI {unit.version}, {' and '.join(unit.kinds)}, for {where}")


# Number of parameters to which a page has sensitivities by default.
_PREDICTED = 8


def write_web(
    scene: Scene,
    path: Path,
    sensitivities: Sequence[str],
    tree: TreeChoice,
    ranges: Sequence[str],
) -> None:
    """Write the page of a scene; see :func:`cotree.web.export_web`."""
    from cotree.web import export_web
    from cotree.web.wasm import check_zig

    check_zig()
    check_folder(path)
    intervals = {}
    if ranges:
        from cotree.cli.fitting import read_range

        pairs = read_pairs("--range", ranges)
        intervals = {n: read_range("--range", n, text, "L=0.5:2") for n, text in pairs.items()}
    names = [row.name for row in scene.parameters.values() if row.is_argument][:_PREDICTED]
    try:
        model = scene.compile(sensitivities or names, tree)
    except FormulationError as error:
        if sensitivities:
            raise
        click.echo(f"cotree: the page has no sensitivities: {error}", err=True)
        model = scene.compile((), tree)
    click.echo(f"wrote {export_web(model, path, ranges=intervals)}")


#: Error numbers of a full output device: disk full, quota exceeded, file too large, I/O error.
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EIO)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line, with the arguments of the process by default; return the exit code."""
    for stream in (sys.stdout, sys.stderr):
        # The encoding of a terminal or pipe may lack the Greek letters of equations.
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    try:
        with warnings_in_one_line():
            try:
                code: int | None = app.main(arguments, "cotree", standalone_mode=False)
            finally:
                if sys.stdout is not None:  # the process may start with a closed output
                    sys.stdout.flush()
    except SystemExit as stop:
        # Click raises SystemExit if a pipe is closed. A text as exit code is a failure.
        return stop.code if isinstance(stop.code, int) else 1 if stop.code else 0
    except click.ClickException as error:
        error.show()
        return error.exit_code
    # Any other exception is a defect of cotree and keeps its traceback.
    except Error as error:
        print_error(str(error))
        return 2
    except (click.Abort, KeyboardInterrupt):  # Click raises Abort at Ctrl-C
        return INTERRUPTED
    except OSError as error:
        if error.errno not in _FULL:
            raise
        print_error(f"the output cannot be written: {error.strerror}")
        sys.stdout = None  # otherwise Python would try to flush stdout when it exits
        return 2
    return code or 0


@app.command("run")
@scene_argument
@sensitivity_option
@end_time_option
@settings_options()
@tree_option
@csv_option
@plot_option
@repeated_option(
    "--show",
    metavar="NAME",
    help="Quantity that --plot draws: a state, output, input or d(STATE)/d(PARAMETER); may be "
    "repeated. Default: all coordinates.",
)
@path_option(
    "--animate",
    help="Write an animation to this file: .html or .gif. If nothing moves in space, write curves "
    "instead.",
)
@click.option(
    "--trust-paths", is_flag=True, help="Also read mesh files outside the folder of the robot."
)
@click.option(
    "--points",
    type=click.IntRange(2),
    metavar="N",
    help="Number of evenly spaced output times. Default: the steps of the solver.",
)
def run_scene(
    scene: str,
    sensitivity: Sequence[str],
    t_end: float | None,
    settings: dict[str, Any],
    tree: TreeChoice,
    csv: Path | None,
    plot: Path | None,
    show: Sequence[str],
    animate: Path | None,
    trust_paths: bool,
    points: int | None,
) -> None:
    """Simulate a scene and print its final state and sensitivities."""
    from cotree.solvers.engine import build_ahead

    # Output files are checked before the run, so that no results are lost.
    check_folder(csv)
    check_picture(plot)
    if show and plot is None and animate is None:
        raise click.BadParameter("--show selects the curves of a plot: also give --plot FILE")
    described = read_scene(scene, settings)
    is_moving = check_animated(animate, described)
    warn_of(described)
    method = settings.get("method") or described.defaults.method
    build_ahead(method, has_events=bool(described.events))
    model = described.compile(sensitivity, tree)
    if plot is not None or (animate is not None and not is_moving):
        from cotree.cli.run_picture import check_names, draw_curves, draw_run

        check_names(model, show)
    end = described.defaults.t_end if t_end is None else t_end
    result = model.simulate((0.0, end), points, **settings)
    # Print the report even if a file cannot be written.
    kernels = f"kernels in {model.kernels.backend}"
    kernels += " from the cache" if model.kernels.cached else ""
    # A failed run has already been reported by a warning, so its first part is skipped.
    parts = result.report().parts[0 if result.success else 1 :]
    title = f"{described.headline}; {len(model.states)} states, {kernels}"
    click.echo(Report(title, *parts, derived_values(model, settings["parameters"])).text())
    write_file(csv, result.to_csv)
    write_file(plot, lambda path: draw_run(model, result, path, settings, show))
    if is_moving:
        write_file(animate, result.animate(trust_paths=trust_paths).save)
    elif animate is not None:
        draw_curves(result, animate, show)
        click.echo(f"wrote {animate}: nothing moves in space here, so it shows curves over time")
    # Write files even if the run failed.
    if not result.success:
        raise click.exceptions.Exit(1)


@app.command("generate")
@scene_argument
@path_option("--output", "-o", required=True, metavar="DIR", help="Folder to write.")
@sensitivity_option
@tree_option
@click.option(
    "--integrator",
    default="dopri5",
    help=f"Integrator: {_EXPLICIT}; for stiff systems {_IMPLICIT}; with a fixed step "
    "size rk4, euler. Separate several by commas.",
)
@click.option("--step", type=float, metavar="SECONDS", help="Step size of rk4 and euler, in s.")
@click.option("--real", default="double", help="Floating-point type: double or float.")
@click.option(
    "--prefix",
    default="",
    show_default=False,
    help="Prefix of all names in C. Default: the name of the scene.",
)
@click.option("--cpp", is_flag=True, help="Also write a header for C++.")
@click.option(
    "--single-file", is_flag=True, help="Write one header and one source instead of a project."
)
def generate_project(
    scene: str,
    output: Path,
    sensitivity: Sequence[str],
    tree: TreeChoice,
    integrator: str,
    step: float | None,
    real: str,
    prefix: str,
    cpp: bool,
    single_file: bool,
) -> None:
    """Write a C project that simulates a scene without Python."""
    model = read_scene(scene).compile(sensitivity, tree)
    project = model.write(
        output, integrator, step, real=real, prefix=prefix, cpp=cpp, single_file=single_file
    )
    for file in project.files:
        click.echo(f"wrote {file}")
    click.echo(f"build it there with: {project.command}")


@app.command("equations")
@scene_argument
@sensitivity_option
@tree_option
@click.option("--latex", is_flag=True, help="Print the equations as LaTeX.")
@click.option("--steps", is_flag=True, help="Print all steps from the graph to the equations.")
def show_equations(
    scene: str, sensitivity: Sequence[str], tree: TreeChoice, latex: bool, steps: bool
) -> None:
    """Print the governing and sensitivity equations of a scene."""
    described = read_scene(scene)
    if steps and latex:
        raise click.BadParameter("give --latex or --steps, not both")
    if steps:
        from cotree.export.steps import formulation_steps
        from cotree.pipeline import formulate

        first, formed, _ = formulate(described, sensitivity, tree)
        click.echo(formulation_steps(first, formed), nl=False)
        return
    equations = described.equations(sensitivity, tree)
    click.echo(equations.latex() if latex else str(equations))


@app.command("graph")
@scene_argument
@path_option(
    "--output", "-o", metavar="FILE", help="Draw the graphs to this file: .svg, .png or .pdf."
)
@tree_option
def show_graph(scene: str, output: Path | None, tree: TreeChoice) -> None:
    """Print or draw the linear graphs of a scene.

    The text also contains the trees and the matrices of f-cutsets and f-circuits.
    """
    check_picture(output)
    report = read_scene(scene).graph(tree)
    if output is None:
        click.echo(report.summary().rstrip())
        return
    write_file(output, report.save)


@app.command("save")
@scene_argument
@path_option(
    "--output", "-o", required=True, metavar="FILE", help="File to write; its name ends in .toml."
)
def save_scene(scene: str, output: Path) -> None:
    """Convert a scene of any format to a TOML scene file."""
    write_file(output, read_scene(scene).save)


@app.command("scenes")
def list_scenes() -> None:
    """List the shipped scenes."""
    from cotree.api import load
    from cotree.scene.toml_file import shipped_scenes

    for name in shipped_scenes():
        click.echo(load(name).headline)


if __name__ == "__main__":
    sys.exit(main())
