"""The command that lists what is suspicious in a scene."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated

import typer

from cotree.cli.options import SceneName  # noqa: TC001 - typer reads the annotations
from cotree.cli.source import read_scene

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.api import Scene
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
    """List what is suspicious in a scene: unused names, dangling nodes, units that contradict.

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
    """Print to stderr what is suspicious in a scene that is about to run."""
    from cotree.lint import lint

    # What a run refuses is an error of its own, and names that nothing uses change no number.
    found = [row for row in lint(scene, is_formed=False) if not row.rule.startswith("unused")]
    for row in found[:_MOST_WARNINGS]:
        typer.echo(str(row), err=True)
    if len(found) > _MOST_WARNINGS:
        typer.echo(f"{len(found) - _MOST_WARNINGS} more findings: see `cotree lint`", err=True)


def finding_lines(found: Sequence[Finding]) -> list[str]:
    """Write findings, each on a line, and how to say that they are on purpose."""
    lines = [str(row) for row in found]
    entries = ", ".join(f'"{row.allow}"' for row in found if row.allow)
    if entries:
        lines.append(f"on purpose? write at the top of the scene file: allow = [{entries}]")
    return lines
