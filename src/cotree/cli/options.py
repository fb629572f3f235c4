"""Arguments and options that several commands share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SceneName = Annotated[
    str,
    typer.Argument(metavar="SCENE", help="A shipped scene, or a TOML, URDF, SPICE or SBML file."),
]
Sensitivity = Annotated[
    list[str],
    typer.Option(
        "--sensitivity",
        "-s",
        metavar="NAME",
        help="Parameter, or state whose initial value is meant; may be repeated.",
    ),
]
Setting = Annotated[
    list[str],
    typer.Option("--set", metavar="NAME=NUMBER", help="Value of a parameter; may be repeated."),
]
TreeOption = Annotated[
    list[str],
    typer.Option(
        "--tree",
        metavar="EDGES",
        help="Branches, as j1,h2 or once as translation=... and once as rotation=...",
    ),
]
EndTime = Annotated[
    float | None, typer.Option("--t-end", metavar="S", help="End time in s; the scene's if absent.")
]
InputOption = Annotated[
    list[str],
    typer.Option(
        "--input",
        metavar="NAME=VALUE",
        help="In place of an input: a number, or an expression of t, parameters, states and "
        "outputs; --set gives values of new names in it; may be repeated.",
    ),
]
InitialOption = Annotated[
    list[str],
    typer.Option(
        "--initial", metavar="STATE=NUMBER", help="Initial value of a state; may be repeated."
    ),
]
MaxSteps = Annotated[
    float | None,
    typer.Option(metavar="N", help="Budget of steps of a run: 1000000 if absent; inf for none."),
]
TimeLimit = Annotated[
    float | None,
    typer.Option(metavar="S", help="Computing time of a run in s: 3600 if absent; inf for none."),
]
Method = Annotated[
    str | None,
    typer.Option(
        help="dopri5, rkf45, dop853, rodas4, rodas5, RK45, RK23, DOP853, Radau, BDF, LSODA, "
        "cvode, ida, cvodes, cvodes-simultaneous, idas or auto."
    ),
]
Rtol = Annotated[float | None, typer.Option(help="Relative tolerance of runs.")]
Atol = Annotated[float | None, typer.Option(help="Absolute tolerance of runs.")]
Plot = Annotated[Path | None, typer.Option(help="Draw to this file: .svg, .png or .pdf.")]
Csv = Annotated[Path | None, typer.Option(help="Write all columns of the run to this file.")]
