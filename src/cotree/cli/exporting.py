"""The command ``export``: a scene as a functional mock-up unit."""

from __future__ import annotations

from pathlib import Path  # noqa: TC003 - typer reads the annotations
from typing import Annotated

import typer

from cotree.cli.arguments import check_folder, read_tree
from cotree.cli.options import (  # noqa: TC001 - typer reads the annotations
    SceneName,
    Sensitivity,
    TreeOption,
)
from cotree.cli.source import read_scene
from cotree.errors import SceneError

_KINDS = {"me": "ModelExchange", "cs": "CoSimulation"}


def export_scene(
    scene: SceneName,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE", help="File to write, x.fmu.")
    ],
    sensitivity: Sensitivity = [],  # noqa: B006
    tree: TreeOption = [],  # noqa: B006
    version: Annotated[int, typer.Option(help="Version of the interface: 3 or 2.")] = 3,
    kind: Annotated[
        list[str],
        typer.Option(
            metavar="KIND",
            help="me for Model Exchange, cs for Co-Simulation; both if absent; may be repeated.",
        ),
    ] = [],  # noqa: B006
    integrator: Annotated[
        str | None,
        typer.Option(help="Of Co-Simulation: dopri5, rkf45, dop853; for stiff rodas5, rodas4."),
    ] = None,
    outside: Annotated[
        list[str],
        typer.Option(
            "--outside",
            metavar="INPUT",
            help="An input that is set from outside; those that are constants if absent; may be "
            "repeated.",
        ),
    ] = [],  # noqa: B006
    platform: Annotated[
        list[str],
        typer.Option(
            metavar="PLATFORM",
            help="x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin; "
            "this machine if absent; none for sources alone; may be repeated.",
        ),
    ] = [],  # noqa: B006
) -> None:
    """Write a scene as an FMU, which other simulators import."""
    if output.suffix.lower() != ".fmu":
        raise SceneError(f"cannot write '{output}': the name of an FMU ends in .fmu")
    check_folder(output)
    kinds = [_KINDS.get(name, name) for name in kind] or list(_KINDS.values())
    platforms = [name for name in platform if name != "none"] if platform else None
    model = read_scene(scene).compile(sensitivity, read_tree(tree))
    unit = model.export_fmu(
        output, version, kinds, integrator, inputs=outside or None, platforms=platforms
    )
    where = ", ".join(unit.platforms) or "no platform: sources alone"
    typer.echo(f"wrote {unit.path}: FMI {unit.version}, {' and '.join(unit.kinds)}, for {where}")
