"""Commands that choose parameters: estimation from measurements, and optimisation of a design."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from cotree.cli.options import (
    INTERRUPTED,
    PATH,
    check_folder,
    check_picture,
    csv_option,
    end_time_option,
    path_option,
    plot_option,
    print_error,
    read_numbers,
    read_pairs,
    read_scene,
    repeated_option,
    scene_argument,
    settings_options,
    write_file,
)
from cotree.errors import ParameterError, SolveError, brief
from cotree.files import number_or_text
from cotree.scene.settings import STEPS_OF_FIT

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path


@click.command("fit")
@scene_argument
@click.argument("more", nargs=-1, metavar="[NAME[=RANGE]]...", help="Further values of --estimate.")
@repeated_option(
    "--data",
    type=PATH,
    metavar="FILE",
    help="CSV file with the measurements of one experiment and a column t or time; may be "
    "repeated.",
)
@repeated_option(
    "--estimate",
    "-e",
    metavar="NAME[=RANGE]",
    help="Parameter to estimate, or state whose initial value to estimate; may be repeated. "
    "k=10:100:log sets bounds and a scale (lin, log or log10). Default bounds: a hundredth and a "
    "hundred times the value in the scene.",
)
@repeated_option(
    "--observe",
    metavar="COLUMN=EXPRESSION",
    help="Quantity that a column measures, as an expression of states and outputs; may be "
    "repeated. Default: the state or output with the name of the column.",
)
@repeated_option(
    "--noise",
    metavar="[COLUMN=]VALUE",
    help="Standard deviation of the noise of one column or of all columns: a number in the unit "
    "of the column, another column, or an expression; may be repeated. Default: estimated.",
)
@repeated_option(
    "--unit",
    metavar="COLUMN=UNIT",
    help="Unit of a column whose name contains no unit, such as 'v [mV]'; may be repeated.",
)
@click.option(
    "--time", metavar="COLUMN", help="Column that contains the times. Default: t or time."
)
@repeated_option(
    "--start",
    metavar="NAME=NUMBER",
    help="Initial guess; may be repeated. Default: the value in the scene.",
)
@repeated_option(
    "--per-experiment",
    metavar="NAME",
    help="Parameter with a separate estimate for each --data file; may be repeated.",
)
@click.option(
    "--loss",
    default="linear",
    help="Loss function: linear, or one that reduces the influence of outliers (soft_l1, huber, "
    "cauchy, arctan).",
)
@click.option(
    "--starts",
    type=click.IntRange(1),
    metavar="N",
    default=20,
    help="Number of starting points of the optimiser.",
)
@click.option(
    "--seed", type=int, default=0, metavar="N", help="Seed of the random starting points."
)
@settings_options(
    max_steps=STEPS_OF_FIT,
    inputs="Replace an input by a number or an expression; may be repeated. --set or --estimate "
    "specifies new names in the expression. A data column with the name of an input replaces it, "
    "too.",
)
@path_option(
    "--plot", help="Draw data, fitted curves and residuals to this file: .svg, .png or .pdf."
)
@path_option("--output", "-o", metavar="FILE", help="Write the result to this JSON file.")
def fit_scene(
    scene: str,
    more: Sequence[str],
    data: Sequence[Path],
    estimate: Sequence[str],
    observe: Sequence[str],
    noise: Sequence[str],
    unit: Sequence[str],
    time: str | None,
    start: Sequence[str],
    per_experiment: Sequence[str],
    loss: str,
    starts: int,
    seed: int,
    settings: dict[str, Any],
    plot: Path | None,
    output: Path | None,
) -> None:
    """Estimate parameters of a scene from measurements.

    The report also contains their standard errors and confidence intervals.
    """
    from cotree.estimation.experiment import Experiment
    from cotree.estimation.fit import fit
    from cotree.plot import save_figure

    # Check arguments before anything is compiled.
    check_picture(plot)
    check_folder(output)
    if not data:
        raise ParameterError("a fit needs measurements: give --data run1.csv")
    ranges = _ranges([*estimate, *(more or [])])
    described = read_scene(scene)
    known = {
        "inputs": {name: number_or_text(text) for name, text in settings.pop("inputs").items()},
        "initial": settings.pop("initial"),
        "parameters": settings.pop("parameters"),
        "observables": read_pairs("--observe", observe) or None,
        "noise": _noise(noise),
        "units": read_pairs("--unit", unit) or None,
        "time": time,
    }
    experiments = [Experiment(path, **known) for path in data]
    try:
        result = fit(
            described,
            experiments,
            ranges,
            per_experiment=per_experiment,
            start=read_numbers("--start", start),
            loss=loss,
            starts=starts,
            seed=seed,
            **settings,
        )
    except SolveError as error:
        print_error(str(error))
        raise click.exceptions.Exit(1) from None
    click.echo(str(result))
    write_file(output, result.to_json)
    write_file(plot, lambda path: save_figure(result.plot(), path))
    if any(row.message.startswith("interrupted") for row in result.starts):
        raise click.exceptions.Exit(INTERRUPTED)
    # Print the estimates even if the optimiser did not converge.
    if not result.starts[0].is_converged:
        raise click.exceptions.Exit(1)


def _ranges(texts: Sequence[str]) -> dict[str, Any]:
    """Parse the bounds of parameters: ``name``, ``name=low:high`` or ``name=low:high:scale``."""
    found: dict[str, Any] = {}
    for text in texts:
        name, equals, bounds = (part.strip() for part in text.partition("="))
        if name in found:
            raise ParameterError(f"--estimate names '{brief(name)}' twice: name it once")
        found[name] = read_range("--estimate", name, bounds, "R=10:100:log") if equals else None
    if not found:
        raise ParameterError("a fit needs something to estimate: give --estimate k=10:100:log")
    return found


def read_range(option: str, name: str, text: str, example: str) -> tuple[Any, ...]:
    """Parse a range ``low:high`` or ``low:high:scale`` of a parameter."""
    try:
        low, high, *scale = text.split(":")
        if len(scale) < 2:
            return (float(low), float(high), *scale)
    except ValueError:
        pass  # the text has one part only, or a bound is not a number
    raise ParameterError(
        f"{option} {brief(name)}={brief(text)} is not of the form NAME=LOW:HIGH or "
        f"NAME=LOW:HIGH:SCALE: write it as {option} {example}"
    )


def _noise(texts: Sequence[str]) -> Any:
    """Parse the noise level of all columns, or of each column."""
    alone = [text for text in texts if "=" not in text]
    if not alone:
        pairs = read_pairs("--noise", texts)
        return {name: number_or_text(text) for name, text in pairs.items()} or None
    if len(texts) > 1:
        raise ParameterError(
            f"--noise {brief(alone[0])} is that of all columns: give nothing else, or name the "
            f"column, --noise v={brief(alone[0])}"
        )
    return number_or_text(alone[0])


@click.command("optimise")
@scene_argument
@click.option(
    "--minimise",
    required=True,
    metavar="GOAL",
    help="Objective to minimise, such as integral(x**2), maximum(P) or end(j.s) + L. A plain name "
    "is the value at the end. Also at(TIME, x), start, mean, minimum and time(EVENT).",
)
@repeated_option(
    "--over",
    required=True,
    metavar="NAME=LOW:HIGH[:log]",
    help="Parameter to vary, or state whose initial value to vary, with bounds; may be repeated.",
)
@repeated_option(
    "--subject-to", metavar="CONDITION", help="Constraint with <=, >= or ==; may be repeated."
)
@repeated_option(
    "--guess",
    metavar="NAME=NUMBER",
    help="Initial guess; may be repeated. Default: the value in the scene.",
)
@click.option(
    "--starts",
    type=click.IntRange(1),
    metavar="N",
    default=1,
    help="Number of starting points of the search.",
)
@click.option("--seed", type=int, default=0, help="Seed of the random starting points.")
@click.option("--optimiser", default="slsqp", help="Method of SciPy: slsqp or trust-constr.")
@end_time_option
@settings_options()
@csv_option
@plot_option
def optimise_scene(
    scene: str,
    minimise: str,
    over: Sequence[str],
    subject_to: Sequence[str],
    guess: Sequence[str],
    starts: int,
    seed: int,
    optimiser: str,
    t_end: float | None,
    settings: dict[str, Any],
    csv: Path | None,
    plot: Path | None,
) -> None:
    """Minimise an objective subject to constraints.

    The variables are parameters and initial values of a scene.
    """
    from cotree.design.optimise import optimise

    check_folder(csv)
    check_picture(plot)
    described = read_scene(scene, settings)
    pairs = read_pairs("--over", over).items()
    ranges = {name: read_range("--over", name, text, "L=0.5:2") for name, text in pairs}
    values, initial = settings.pop("parameters"), settings.pop("initial")
    method = settings.pop("method", None)
    found = optimise(
        described,
        minimise,
        ranges,
        subject_to,
        t_span=None if t_end is None else (0.0, t_end),
        parameters={name: value for name, value in values.items() if name in described.parameters},
        initial=initial,
        guess=read_numbers("--guess", guess),
        starts=starts,
        seed=seed,
        method=optimiser,
        solver=method,
        **settings,
    )
    click.echo(found.summary())
    if csv is not None or plot is not None:
        from cotree.cli.run_picture import draw_run

        # Output all steps of this run; runs of the search output only the times of the goals.
        settings |= {
            "parameters": {**values, **found.settings["parameters"]},
            "initial": {**initial, **found.settings["initial"]},
            "method": method,
        }
        model = described.compile()
        run = model.simulate((0.0, float(found.result.t[-1])), **settings)
        write_file(csv, run.to_csv)
        write_file(plot, lambda path: draw_run(model, run, path, settings))
    if not found.success:
        raise click.exceptions.Exit(1)
