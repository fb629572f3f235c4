"""The command that chooses parameters of a scene."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from cotree.cli.arguments import check_folder, check_picture, read_inputs, read_numbers, read_pairs
from cotree.cli.options import (  # noqa: TC001 - typer reads the annotations
    Atol,
    Csv,
    EndTime,
    InitialOption,
    InputOption,
    Method,
    Plot,
    Rtol,
    SceneName,
    Setting,
)
from cotree.cli.source import read_scene
from cotree.errors import ParameterError, brief


def optimise_scene(
    scene: SceneName,
    minimise: Annotated[
        str,
        typer.Option(
            metavar="GOAL",
            help="What is to be least, such as integral(x**2), maximum(P) or end(j.s) + L: a name "
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
        list[str],
        typer.Option(metavar="CONDITION", help="With <=, >= or ==; may be repeated."),
    ] = [],  # noqa: B006 - typer copies it
    guess: Annotated[
        list[str],
        typer.Option(metavar="NAME=NUMBER", help="Where the search begins; may be repeated."),
    ] = [],  # noqa: B006
    starts: Annotated[int, typer.Option(min=1, help="Number of searches.")] = 1,
    seed: Annotated[int, typer.Option(help="Of the places where they begin.")] = 0,
    optimiser: Annotated[str, typer.Option(help="slsqp or trust-constr.")] = "slsqp",
    t_end: EndTime = None,
    method: Method = None,
    rtol: Rtol = None,
    atol: Atol = None,
    setting: Setting = [],  # noqa: B006
    initial: InitialOption = [],  # noqa: B006
    inputs: InputOption = [],  # noqa: B006
    csv: Csv = None,
    plot: Plot = None,
) -> None:
    """Choose parameters such that a goal is least and conditions hold."""
    from cotree.design.optimise import optimise

    check_folder(csv)
    check_picture(plot)
    values = read_numbers("--set", setting)
    described = read_inputs(read_scene(scene), inputs, values)
    found = optimise(
        described,
        minimise,
        {name: _bounds(name, text) for name, text in read_pairs("--over", over).items()},
        subject_to,
        t_span=None if t_end is None else (0.0, t_end),
        parameters={name: value for name, value in values.items() if name in described.parameters},
        initial=read_numbers("--initial", initial),
        guess=read_numbers("--guess", guess),
        starts=starts,
        seed=seed,
        method=optimiser,
        solver=method,
        rtol=rtol,
        atol=atol,
    )
    typer.echo(found.summary())
    if csv is not None or plot is not None:
        # The runs of the search hold the times that goals ask for; these have the solver's steps.
        settings: dict[str, Any] = {
            "parameters": {**values, **found.settings["parameters"]},
            "initial": {**read_numbers("--initial", initial), **found.settings["initial"]},
            "method": method,
            "rtol": rtol,
            "atol": atol,
        }
        model = described.compile()
        run = model.simulate((0.0, float(found.result.t[-1])), **settings)
        if csv is not None:
            run.to_csv(csv)
            typer.echo(f"wrote {csv}")
        if plot is not None:
            from cotree.cli.picture import draw_run

            draw_run(model, run, plot, settings)
            typer.echo(f"wrote {plot}")
    if not found.success:
        raise typer.Exit(1)


def _bounds(name: str, text: str) -> Any:
    """Read ``low:high`` or ``low:high:log``."""
    low, *rest = text.split(":")
    try:
        if len(rest) not in (1, 2):
            raise ValueError
        return (float(low), float(rest[0]), *rest[1:])
    except ValueError:
        raise ParameterError(
            f"--over {brief(name)}={brief(text)} is not of the form NAME=LOW:HIGH or "
            "NAME=LOW:HIGH:log: write it as --over L=0.5:2"
        ) from None
