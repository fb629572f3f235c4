"""Parts of a scene: scenes within it, each once or as an array.

A part is a statement: a scene, and what its nodes, parameters and inputs are in the outer scene.
What it stands for are the declarations of that scene under the part's name, ``leg1.knee``, which
the outer scene holds beside its own (`part_rows.py`).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, Any

from cotree.scene.part_index import in_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from cotree.scene.description import SceneDescription
    from cotree.scene.origin import Origin

#: Tables of a scene whose rows a part brings along.
TABLES = ("tables", "parameters", "inputs", "modes", "edges", "outputs", "events")


@dataclass(frozen=True, eq=False)
class Part:
    """A scene within a scene.

    Attributes
    ----------
    name : str
        Its name; the parts of an array are called ``cell1``, ``cell2``, or ``cell1_1``.
    scene : SceneDescription
        What it is made of. Nothing changes it afterwards.
    counts : tuple of int
        How many parts an array has, along each of its directions; empty for a single part.
    index : tuple of str
        Names of the numbers of a part within the array, in bindings.
    nodes : mapping of str to str
        Nodes of the outer scene by those of the part.
    parameters, inputs : mapping of str to object
        Values of the part's parameters and inputs: numbers, or expressions of the outer scene.
    set : mapping of str to object
        Values of parameters and inputs of single parts, by their whole name: ``cell3.R``.
    source : str
        What it was read from: a path, the name of a shipped part or of a scene within the file.
    """

    name: str
    scene: SceneDescription
    counts: tuple[int, ...] = ()
    index: tuple[str, ...] = ()
    nodes: Mapping[str, str] = field(default_factory=dict)
    parameters: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Any] = field(default_factory=dict)
    set: Mapping[str, Any] = field(default_factory=dict)
    source: str = ""

    def __eq__(self, other: object) -> bool:
        # Where it came from is no part of what it says.
        return isinstance(other, Part) and all(
            getattr(self, name) == getattr(other, name)
            for name in self.__dataclass_fields__
            if name != "source"
        )

    __hash__ = None  # type: ignore[assignment]

    def members(self) -> Iterator[tuple[str, dict[str, int]]]:
        """List the parts of the array by name, each with the values of the index."""
        if not self.counts:
            yield self.name, {}
            return
        for place in product(*(range(1, n + 1) for n in self.counts)):
            yield (
                f"{self.name}{'_'.join(map(str, place))}",
                dict(zip(self.index, place, strict=True)),
            )

    def nodes_of(self, member: str) -> Mapping[str, str]:
        """Give the nodes of the outer scene by those of one part of the array."""
        return {**self.nodes, **self._own_nodes.get(member, {})} if self.set else self.nodes

    def is_node(self, name: str) -> bool:
        """Tell whether the whole name of something in a part is that of a node it connects."""
        member, _, local = name.partition(".")
        return local in self._own_nodes.get(member, {})

    @cached_property
    def _own_nodes(self) -> dict[str, dict[str, str]]:
        """Nodes that single parts connect in another way than the others, by part and node."""
        ports = self.scene.ports or self.node_names - {"ground"}
        found: dict[str, dict[str, str]] = {}
        for name, value in self.set.items():
            member, _, local = name.partition(".")
            is_other = local in self.scene.parameters or local in self.scene.inputs
            if local in ports and not is_other:
                found.setdefault(member, {})[local] = value
        return found

    @cached_property
    def node_names(self) -> frozenset[str]:
        """The nodes of the part's scene."""
        return frozenset(self.scene.nodes)

    @property
    def shown(self) -> str:
        """The part in a line: its name, its scene and how many there are."""
        number = " x ".join(map(str, self.counts))
        array = f"{number} parts " if number else ""
        pairs = ", ".join(f"{own} = {outer}" for own, outer in self.nodes.items())
        return f"{self.name:12} {array}{self.scene.headline}" + (f" ({pairs})" if pairs else "")


def origins_of(scene: SceneDescription) -> Iterator[Origin]:
    """List what other tools' files say of a scene and of its parts, at nodes of the scene."""
    if scene.origin is not None:
        yield scene.origin
    for part in scene.parts.values():
        # Most parts come from no other tool's file, and need no look at each of an array.
        inner = list(origins_of(part.scene))
        for member, index in part.members() if inner else ():
            nodes = {own: in_name(n, index, n) for own, n in part.nodes_of(member).items()}
            for origin in inner:
                visuals = (
                    replace(row, node=nodes.get(row.node, f"{member}.{row.node}"))
                    for row in origin.visuals
                )
                yield replace(origin, visuals=tuple(visuals))


def owner_of(scene: SceneDescription, name: str) -> tuple[Part, str, str] | None:
    """Find the part that brings a name along.

    Returns
    -------
    part : Part
        The part of this scene.
    member : str
        The name of the part, of an array that of one of its parts.
    local : str
        The name within the part.
    """
    member, dot, local = name.partition(".")
    part = scene.members.get(member) if dot else None
    return (part, member, local) if part is not None else None
