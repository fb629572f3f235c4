"""Commands for beginners, which show the catalogue of components and write scenes to start from."""

from __future__ import annotations

import re
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import click

from cotree.cli.options import check_folder
from cotree.errors import SceneError, nearest
from cotree.report import Report, Table

if TYPE_CHECKING:
    from collections.abc import Iterable

#: Shipped scenes that serve as templates, by short name.
TEMPLATES = {
    "mechanism": "spring-mass-damper",
    "pendulum": "slider-pendulum",
    "robot": "robot-arm",
    "circuit": "resonant-circuit",
    "hydraulic": "two-tanks",
    "thermal": "heated-room",
    "drive": "motor-linkage",
    "battery": "battery-cell",
    "events": "bouncing-ball",
}


@click.command("components")
@click.argument("name", required=False, help="Component or part to describe. Default: list all.")
def show_components(name: str | None) -> None:
    """List components and parts, or describe one.

    A description contains the nodes, the fields and an example.
    """
    if name is not None:
        click.echo(_describe(name))
        return
    from cotree.components import COMPONENTS
    from cotree.scene.toml_file import shipped_parts

    rows = [(row.name, _graphs(row.domains), row.doc) for row in COMPONENTS.values()]
    parts = [(name, _about(_text(name))) for name in shipped_parts()]
    hint = "cotree components NAME shows nodes, fields and an example of one."
    tables = Table(("component", "graphs", "meaning"), rows), Table(("part", "meaning"), parts)
    click.echo(Report("", *tables, hint).text())


def _graphs(domains: Iterable[str]) -> str:
    return ", ".join(domains) or "none"


def _describe(name: str) -> str:
    """Return a description of a component: nodes, fields, initial values and an example."""
    from cotree.scene.toml_file import shipped_parts

    if name in shipped_parts():
        return _describe_part(name)
    from cotree.scene.toml_text import table_text
    from cotree.scene.usage_text import (
        default_of,
        edge_call,
        examples,
        nodes_of,
        takes_of,
        usage_of,
    )

    usage = usage_of(name)
    row = usage.component
    parts = [f"{name}: {row.doc}\ngraphs: {_graphs(row.domains)}\nnodes:  {nodes_of(usage)}"]
    if usage.entries:
        cells = [(e.name, takes_of(e), e.unit, default_of(e), e.doc) for e in usage.entries]
        parts.append(Table(("field", "takes", "unit", "default", "meaning"), cells).text())
    if usage.initial:
        parts.append(f"initial values: {', '.join(usage.initial)}")
    edge, statement = examples()[name]
    text = table_text(f"edges.{edge}", statement).strip()
    parts += [f"in a scene file:\n\n{_indented(text)}"]
    parts += [f"in Python:\n\n{_indented(edge_call(edge, statement))}"]
    return "\n\n".join(parts)


def _describe_part(name: str) -> str:
    """Return a description of a part: ports, parameters, inputs, outputs and an example."""
    from cotree.scene.toml_file import load_part
    from cotree.scene.toml_text import table_text

    scene, _ = load_part(name)
    parts = [f"{name}: {_about(_text(name))}\nports: {', '.join(scene.ports)}"]
    cells = [row.cells() for row in scene.parameters.values() if "." not in row.name]
    parts.append(Table(("parameter", "value", "unit", "meaning"), cells, align="llll").text())
    if inputs := [(n, row.unit, row.doc) for n, row in scene.inputs.items() if "." not in n]:
        parts.append(Table(("input", "unit", "meaning"), inputs).text())
    if outputs := [n for n in scene.outputs if "." not in n]:
        parts.append(f"outputs: {', '.join(outputs)}")
    own = {"scene": name, **{port: f"my_{port}" for port in scene.ports}}
    parts.append(f"in a scene file:\n\n{_indented(table_text('parts.x', own).strip())}")
    ports = "".join(f', {port}="my_{port}"' for port in scene.ports)
    parts.append(f'in Python:\n\n    scene.add("x", "{name}"{ports})')
    return "\n\n".join(parts)


def _indented(text: str) -> str:
    return "\n".join(f"    {line}".rstrip() for line in text.splitlines())


@click.command("new")
@click.argument("name", required=False, help="Name of the scene, or path of its .toml file.")
@click.option(
    "--like",
    metavar="TEMPLATE",
    help="Template to copy, one of those that --list prints. Default: mechanism.",
)
@click.option("--list", "list_", is_flag=True, help="List the templates.")
def new_scene(name: str | None, like: str | None, list_: bool) -> None:
    """Write a copy of a shipped scene as a starting point."""
    from cotree.naming import check_scene_name
    from cotree.scene.toml_file import shipped_parts

    if list_:
        rows = [(short, scene, _about(_text(scene))) for short, scene in TEMPLATES.items()]
        click.echo(Table(("template", "scene", "what it is"), rows).text())
        click.echo("\ncotree new NAME --like TEMPLATE writes NAME.toml.")
        return
    if name is None:
        raise click.BadParameter("name the scene, as in: cotree new arm --like robot")
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    # Without --like, the file name may be that of a template: ``cotree new robot``.
    wanted = like or (path.stem if path.stem in TEMPLATES else "mechanism")
    text = _text(_shipped(wanted))
    check_folder(path)
    check_scene_name(path.stem)
    own = re.sub("^name = .*$", f'name = "{path.stem}"', text, flags=re.MULTILINE)
    try:
        with path.open("x", encoding="utf-8", newline="\n") as file:
            file.write(own)
    except FileExistsError:
        raise SceneError(f"'{path}' exists already: choose another name, or move it away") from None
    except OSError as error:
        raise SceneError(f"cannot write '{path}': {error.strerror}") from None
    picture = path.with_suffix(".svg")
    click.echo(f"wrote {path}, from '{_shipped(wanted)}': {_about(text)}")
    step = f"cotree run {path} --plot {picture}"
    if _shipped(wanted) in shipped_parts():
        step = f'name it in another scene, [parts.x] with scene = "{path.name}"'
    click.echo(f"next: {step}")
    click.echo("cotree components lists what scenes are made of.")


def _shipped(template: str) -> str:
    """Return the shipped scene or part with the given name or short name."""
    from cotree.scene.toml_file import shipped_parts, shipped_scenes

    known = (*shipped_scenes(), *shipped_parts())
    scene = TEMPLATES.get(template, template)
    if scene not in known:
        hint = nearest(template, [*TEMPLATES, *known])
        raise SceneError(f"--like '{template}' is not a template{hint}")
    return scene


def _text(scene: str) -> str:
    files = (resources.files("cotree") / kind / f"{scene}.toml" for kind in ("scenes", "parts"))
    return next(file for file in files if file.is_file()).read_text(encoding="utf-8")


def _about(text: str) -> str:
    """Return the description of a shipped scene, the comment on its first line."""
    return text.partition("\n")[0].lstrip("# ")
