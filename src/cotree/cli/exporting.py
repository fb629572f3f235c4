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
    version: Annotated[int, typer.Option(help="Version of FMI: 3 or 2.")] = 3,
    kind: Annotated[
        list[str],
        typer.Option(
            metavar="KIND",
            help="me for Model Exchange, cs for Co-Simulation, by default both; may be repeated.",
        ),
    ] = [],  # noqa: B006
    integrator: Annotated[
        str | None,
        typer.Option(
            help="Integrator of Co-Simulation: dopri5, rkf45, dop853; rodas5, rodas4 if stiff."
        ),
    ] = None,
    outside: Annotated[
        list[str],
        typer.Option(
            "--outside",
            metavar="INPUT",
            help="Input that the importer sets, by default each one that is constant in the "
            "scene; may be repeated.",
        ),
    ] = [],  # noqa: B006
    platform: Annotated[
        list[str],
        typer.Option(
            metavar="PLATFORM",
            help="x86_64-linux, aarch64-linux, x86_64-windows, x86_64-darwin, aarch64-darwin; "
            "by default this machine; none for sources only; may be repeated.",
        ),
    ] = [],  # noqa: B006
) -> None:
    """Write a scene as an FMU for other simulators."""
    if output.suffix.lower() != ".fmu":
        raise SceneError(f"cannot write '{output}': the name of an FMU ends in .fmu")
    check_folder(output)
    kinds = [_KINDS.get(name, name) for name in kind] or list(_KINDS.values())
    platforms = [name for name in platform if name != "none"] if platform else None
    model = read_scene(scene).compile(sensitivity, read_tree(tree))
    unit = model.export_fmu(
        output, version, kinds, integrator, inputs=outside or None, platforms=platforms
    )
    where = ", ".join(unit.platforms) or "no platform (sources only)"
    typer.echo(f"wrote {unit.path}: FMI {unit.version}, {' and '.join(unit.kinds)}, for {where}")
