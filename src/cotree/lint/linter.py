"""The linter itself: every rule over a scene, without allowed findings."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.errors import Error
from cotree.files import read_text
from cotree.lint.rules import (
    Finding,
    dangling_nodes,
    name_findings,
    topology_findings,
    value_findings,
)
from cotree.model.start import check_start
from cotree.scene.description import check_allowed, is_allowed
from cotree.scene.part_adding import origin_note, origin_of, statement_lines
from cotree.scene.toml_file import LARGEST_FILE
from cotree.spec import BuildSpec

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from cotree.scene.description import SceneDescription

# Larger scenes take long to compile: only their equations are formed.
_LARGEST_STARTED = 60  # edges


def lint(
    scene: SceneDescription, allow: Sequence[str] = (), *, is_formed: bool = True
) -> tuple[Finding, ...]:
    """Return the findings of a scene, without those in ``allow`` and in the scene's own list.

    Entries of ``allow`` are ``rule`` or ``rule:name``; SceneError is raised for an unknown rule. If
    ``is_formed``, the equations are formed, too, and errors are findings.
    """
    allowed = (*scene.allowed, *check_allowed(list(allow)))
    found: list[Finding] = []
    # A scene with open ports may float: it is formed as a part.
    if is_formed and not scene.ports:
        found += _refused(scene)
    for findings in (name_findings, topology_findings, value_findings):
        found += findings(scene)
    found = list(_once_in_parts(scene, found))
    kept = [row for row in found if not is_allowed(row.rule, row.name, allowed)]
    for entry in dict.fromkeys(allowed):
        if not any(is_allowed(row.rule, row.name, (entry,)) for row in found):
            message = f"allow has '{entry}', but there is no such finding: remove it"
            kept.append(Finding("unused-allow", "scene", entry, message))
    return tuple(_with_lines(scene, kept))


def _once_in_parts(scene: SceneDescription, found: Iterable[Finding]) -> Iterable[Finding]:
    """Keep one of equal findings in parts of one scene, and none that the scene allows."""
    seen = set()
    for row in found:
        place = origin_of(row.name, scene.members)
        if place is None:
            yield row
            continue
        part, local = place
        key = (row.rule, row.kind, id(part.scene), local)
        if key not in seen and not is_allowed(row.rule, local, part.scene.allowed):
            seen.add(key)
            message = origin_note(f"'{row.name}'", scene.members, scene)
            yield replace(row, message=f"{row.message}{message}")


def dangling_hint(scene: SceneDescription) -> str:
    """Suggest a misspelt node for the end of a message; empty if there is none."""
    found = list(dangling_nodes(scene, is_refused=True))
    # A node with a similar name is reported before all others.
    found.sort(key=lambda row: "did you mean" not in row.message)
    return f"; {found[0].message}" if found else ""


def _refused(scene: SceneDescription) -> Iterable[Finding]:
    """Form the equations, and find the start of scenes that compile quickly."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            if len(scene.edges) <= _LARGEST_STARTED:
                model, _ = BuildSpec(scene.copied()).compile()
                if model.backend != "none":
                    check_start(model)
                return
            # Imported here, since every run lints without forming equations.
            from cotree.formulation.early import check_numbers, within_range
            from cotree.pipeline import formulate
            from cotree.scene.jumps import lower_discontinuities

            with within_range(scene):
                acting = lower_discontinuities(scene, has_sensitivities=False)
                formulate(acting, (), None, 0.0, check_numbers)
    except Error as error:
        message = f"{error}{dangling_hint(scene)}"
        yield Finding("refused", *_culprit(scene, message), message, "error")


def _culprit(scene: SceneDescription, message: str) -> tuple[str, str]:
    """Return the element of a scene that a message names first."""
    kinds: dict[str, Mapping[str, object]] = {
        "edge": scene.edges,
        "parameter": scene.parameters,
        "input": scene.inputs,
        "output": scene.outputs,
        "event": scene.events,
    }
    named = [(kind, name) for kind, row in kinds.items() for name in row]
    places = [(message.find(f"{kind} '{name}'"), kind, name) for kind, name in named]
    found = sorted(place for place in places if place[0] >= 0)
    return (found[0][1], found[0][2]) if found else ("scene", scene.name)


def _with_lines(scene: SceneDescription, found: Iterable[Finding]) -> Iterable[Finding]:
    """Add lines of the scene's file."""
    lines: dict[tuple[str, str], int] = {}
    if scene.file.endswith(".toml") and os.path.isfile(scene.file):
        lines = statement_lines(read_text(scene.file, LARGEST_FILE))
    first: dict[str, str] = {}
    for edge in scene.edges.values():
        for node in edge.nodes:
            first.setdefault(node, edge.name)
    for row in found:
        # The line of a node is that of its first edge.
        key = ("edge", first.get(row.name, "")) if row.kind == "node" else (row.kind, row.name)
        yield replace(row, line=lines.get(key))
