"""Rules about names: unused ones, and those that differ in case only."""

from __future__ import annotations

import re
from itertools import chain
from typing import TYPE_CHECKING, Any

from cotree.components import Role
from cotree.lint.findings import Finding
from cotree.lint.similar import look_alike
from cotree.scene.dimensions import entries
from cotree.scene.expressions import Expression

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from cotree.scene.description import SceneDescription

_WORD = re.compile(r"[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)*")
#: Shorter names follow a notation, as r and R or m and M do.
_SHORTEST = 3


def findings(scene: SceneDescription) -> Iterator[Finding]:
    """Find unused parameters and inputs, and names that differ in case only."""
    used = used_names(scene)
    # Readers of other tools' files declare what a model has, used or not.
    own = scene.origin is None
    for kind, table in (("parameter", scene.parameters), ("input", scene.inputs)):
        for name in table:
            if own and name not in used:
                close = look_alike(name, used & {*scene.parameters, *scene.inputs})
                hint = f"; is it meant where '{close}' is used?" if close else ""
                told = f"{kind} '{name}' is used nowhere: remove it, or use it{hint}"
                yield Finding(f"unused-{kind}", kind, name, told)
    yield from _similar(scene)


def used_names(scene: SceneDescription) -> set[str]:
    """Collect the names in all expressions of a scene."""
    rows = [*scene.gravity, *scene.outputs.values(), *(m.initial for m in scene.modes.values())]
    rows += [held for _, held in scene.defaults.held]
    rows += [row for event in scene.events.values() for row in event.expressions]
    signals = [row.value for row in scene.inputs.values()]
    values_of = [*signals, *(row.value for row in scene.parameters.values())]
    rows += [value for value in values_of if isinstance(value, Expression)]
    found = {name for row in rows for name in row.names}
    found |= set(_gravities(scene, ""))
    for edge in scene.edges.values():
        values = chain(edge.fields.values(), edge.initial.values())
        found |= {name for value in values for entry in entries(value) for name in entry.names}
        # Some components take their fields apart before they become expressions.
        fields = {k: v for k, v in edge.statement.items() if k not in ("type", "nodes")}
        found |= set(_words(fields))
    return found


def _gravities(scene: SceneDescription, prefix: str) -> Iterator[str]:
    """List the names in the gravity of parts, which is that of the outer scene."""
    for member, part in scene.members.items():
        own = f"{prefix}{member}."
        for row in part.scene.gravity:
            yield from (f"{own}{name}" for name in row.names)
        yield from _gravities(part.scene, own)


def _words(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield from _WORD.findall(value)
    elif isinstance(value, dict):
        for item in value.values():
            yield from _words(item)
    elif isinstance(value, (list, tuple)):
        for item in value:
            yield from _words(item)


def _similar(scene: SceneDescription) -> Iterator[Finding]:
    signals = [*scene.parameters, *scene.inputs, *scene.modes, *scene.outputs]
    domains = _domains(scene)
    groups: tuple[tuple[str, Iterable[str], int], ...] = (
        ("parameter", signals, _SHORTEST),
        ("edge", scene.edges, 2),
        ("node", scene.nodes, 1),
    )
    for kind, all_names, shortest in groups:
        seen: dict[str, str] = {}
        for name in dict.fromkeys(all_names):
            other = seen.setdefault(name.casefold(), name)
            if other != name and len(name) >= shortest:
                own = _kind(scene, name) if kind == "parameter" else kind
                # A hydraulic node c beside a mechanical C is drawn like that in textbooks.
                if kind == "node" and not domains.get(name, set()) & domains.get(other, set()):
                    continue
                told = f"{own} '{name}' and '{other}' differ in the case of letters only"
                yield Finding("similar-names", own, name, f"{told}: are they the same?")


def _kind(scene: SceneDescription, name: str) -> str:
    kinds = (("parameter", scene.parameters), ("input", scene.inputs), ("mode", scene.modes))
    return next((kind for kind, table in kinds if name in set(table)), "output")


def _domains(scene: SceneDescription) -> dict[str, set[str]]:
    """Give the domains in which each node is touched."""
    found: dict[str, set[str]] = {}
    for edge in scene.edges.values():
        if edge.component.role is not Role.NETWORK:
            for node in edge.nodes:
                found.setdefault(node, set()).add("multibody")
        for port, ends in zip(edge.component.ports, edge.ports, strict=True):
            for node in (ends.tail, ends.head):
                found.setdefault(node, set()).add(port.domain)
            for node in ends.acts_on:
                found.setdefault(node, set()).add("multibody")
    return found
