"""Commands that choose parameters: estimation from measurements, and optimisation of a design."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer reads the annotations
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cotree.cli.options import (
    INTERRUPTED,
    Csv,
    EndTime,
    Plot,
    SceneName,
    check_folder,
    check_picture,
    print_error,
    read_numbers,
    read_pairs,
    read_scene,
    with_options,
    write_file,
)
from cotree.errors import ParameterError, SolveError, brief
from cotree.files import number_or_text
from cotree.scene.settings import STEPS_OF_FIT

if TYPE_CHECKING:
    from collections.abc import Sequence


@with_options(
    max_steps=STEPS_OF_FIT,
    inputs="In place of an input: a number, or an expression, whose new names are in --set or "
    "--estimate; a column with its name is it, too; may be repeated.",
)
def fit_scene(
    scene: SceneName,
    more: Annotated[
        list[str] | None,
        typer.Argument(metavar="[NAME[=RANGE]]...", help="More of what --estimate takes."),
    ] = None,
    data: Annotated[
        list[Path],
        typer.Option(
            metavar="FILE",
            help="Measurements in CSV, with a column t or time; one run each; may be repeated.",
        ),
    ] = [],  # noqa: B006 - typer copies it
    estimate: Annotated[
        list[str],
        typer.Option(
            "--estimate",
            "-e",
            metavar="NAME[=RANGE]",
            help="What is estimated: a parameter, or a state by its initial value; k=10:100:log "
            "has bounds and a scale, lin, log or log10; k alone lies within a hundredth and a "
            "hundred times its value in the scene; may be repeated.",
        ),
    ] = [],  # noqa: B006
    observe: Annotated[
        list[str],
        typer.Option(
            metavar="COLUMN=EXPRESSION",
            help="What a column measures, of states and outputs; columns with their names if "
            "absent; may be repeated.",
        ),
    ] = [],  # noqa: B006
    noise: Annotated[
        list[str],
        typer.Option(
            metavar="[COLUMN=]VALUE",
            help="Standard deviation of a column, or of all: a number in its unit, another column, "
            "or an expression; estimated if absent; may be repeated.",
        ),
    ] = [],  # noqa: B006
    unit: Annotated[
        list[str],
        typer.Option(
            metavar="COLUMN=UNIT",
            help="Unit of a column that has none in its name, as in 'v [mV]'; may be repeated.",
        ),
    ] = [],  # noqa: B006
    time: Annotated[str | None, typer.Option(metavar="COLUMN", help="The column of times.")] = None,
    start: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=NUMBER", help="Where estimation begins: the scene's value if absent."
        ),
    ] = [],  # noqa: B006
    per_experiment: Annotated[
        list[str],
        typer.Option(metavar="NAME", help="It has an estimate for each file; may be repeated."),
    ] = [],  # noqa: B006
    loss: Annotated[
        str, typer.Option(help="linear, or soft_l1, huber, cauchy, arctan: outliers count less.")
    ] = "linear",
    starts: Annotated[int, typer.Option(min=1, help="Number of starts of the optimiser.")] = 20,
    seed: Annotated[int, typer.Option(metavar="N", help="Of the starts but the first.")] = 0,
    settings: Any = None,
    plot: Annotated[
        Path | None,
        typer.Option(help="Draw data, computed curves and residuals: .svg, .png or .pdf."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help="Write the result to this, as JSON."),
    ] = None,
) -> None:
    """Estimate parameters of a scene from measurements, with their uncertainty."""
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
        raise typer.Exit(1) from None
    typer.echo(str(result))
    write_file(output, result.to_json)
    write_file(plot, lambda path: save_figure(result.plot(), path))
    if any(row.message.startswith("interrupted") for row in result.starts):
        raise typer.Exit(INTERRUPTED)
    # Print the estimates even if the optimiser did not converge.
    if not result.starts[0].is_converged:
        raise typer.Exit(1)


def _ranges(texts: Sequence[str]) -> dict[str, Any]:
    """Parse the bounds of parameters: ``name``, ``name=low:high`` or ``name=low:high:scale``."""
    found: dict[str, Any] = {}
    for text in texts:
        name, equals, bounds = (part.strip() for part in text.partition("="))
        if name in found:
            raise ParameterError(f"--estimate names '{brief(name)}' twice: name it once")
        found[name] = _range("--estimate", name, bounds, "R=10:100:log") if equals else None
    if not found:
        raise ParameterError("a fit needs something to estimate: give --estimate k=10:100:log")
    return found


def _range(option: str, name: str, text: str, example: str) -> tuple[Any, ...]:
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


@with_options()
def optimise_scene(
    scene: SceneName,
    minimise: Annotated[
        str,
        typer.Option(
            metavar="GOAL",
            help="What to minimise, such as integral(x**2), maximum(P) or end(j.s) + L: a name "
            "is a value at the end; at(TIME, x), start, mean, minimum and time(EVENT), too.",
        ),
    ],
    over: Annotated[
        list[str],
        typer.Option(
            metavar="NAME=LOW:HIGH[:log]",
            help="A parameter, or a state by its initial value, with bounds; may be repeated.",
        ),
    ],
    subject_to: Annotated[
        list[str], typer.Option(metavar="CONDITION", help="With <=, >= or ==; may be repeated.")
    ] = [],  # noqa: B006 - typer copies it
    guess: Annotated[
        list[str],
        typer.Option(metavar="NAME=NUMBER", help="Starting point of the search; may be repeated."),
    ] = [],  # noqa: B006
    starts: Annotated[int, typer.Option(min=1, help="Number of searches.")] = 1,
    seed: Annotated[int, typer.Option(help="Seed of their random starting points.")] = 0,
    optimiser: Annotated[str, typer.Option(help="slsqp or trust-constr.")] = "slsqp",
    t_end: EndTime = None,
    settings: Any = None,
    csv: Csv = None,
    plot: Plot = None,
) -> None:
    """Choose parameters that minimise a goal subject to conditions."""
    from cotree.design.optimise import optimise

    check_folder(csv)
    check_picture(plot)
    described = read_scene(scene, settings)
    pairs = read_pairs("--over", over).items()
    ranges = {name: _range("--over", name, text, "L=0.5:2") for name, text in pairs}
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
    typer.echo(found.summary())
    if csv is not None or plot is not None:
        from cotree.cli.picture import draw_run

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
        raise typer.Exit(1)
