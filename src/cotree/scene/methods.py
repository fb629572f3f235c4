"""Methods of scenes that add components and parts.

Types and docstrings for editors and type checkers stand in ``component_methods.pyi``, which a test
compares with the table of components.
"""

from __future__ import annotations

import inspect
from functools import lru_cache
from os import PathLike
from types import MethodType
from typing import TYPE_CHECKING, Any, cast

from cotree.components import OWN
from cotree.errors import SceneError, brief
from cotree.scene.description import SceneDescription
from cotree.scene.part_adding import add_part
from cotree.scene.toml_file import load_part

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from pathlib import Path

    from cotree.scene.edge import Entry, Usage


class ComponentMethod:
    """The method of one component, made when it is first used."""

    # Descriptions of ninety components would take longer to make than a scene to read.
    def __init__(self, type: str) -> None:
        self.type = type

    def __get__(self, scene: object, owner: object = None) -> Callable[..., None]:
        function = _function(self.type)
        return function if scene is None else MethodType(function, scene)


class ComponentMethods:
    """Methods that add an edge of each component: ``scene.revolute("h", "D", "B", axis=...)``.

    Each stands for a call of :meth:`cotree.Scene.edge` with the name of the component. Fields take
    numbers in SI, names of parameters, expressions in quotes, and values with a unit, as in
    ``{"value": 35, "unit": "mm"}``. Types that :func:`cotree.register_component` made are added by
    that method itself.
    """


for _type in sorted(OWN):
    # A defect of the table, which the first import would show: methods must not hide each other.
    assert not hasattr(ComponentMethods, _type)
    setattr(ComponentMethods, _type, ComponentMethod(_type))


@lru_cache(maxsize=256)
def _function(type: str) -> Callable[..., None]:
    """Make the function that adds an edge of a type."""
    from cotree.scene.edge import usage_of
    from cotree.scene.usage_text import docstring_of

    def add(
        scene: Any,
        name: str,
        /,
        *nodes: str,
        initial: Mapping[str, Any] | None = None,
        **fields: Any,
    ) -> None:
        # What a caller leaves open by None is not given; defaults are those of the table.
        given = {key: value for key, value in fields.items() if value is not None}
        scene.edge(name, type, *nodes, initial=initial, **given)

    usage = usage_of(type)
    add.__name__, add.__qualname__ = type, f"Scene.{type}"
    add.__doc__ = docstring_of(usage)
    add.__signature__ = _signature(usage)  # type: ignore[attr-defined]
    return add


def _signature(usage: Usage) -> inspect.Signature:
    """Form the signature that help and notebooks show."""
    alone, keyword = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.KEYWORD_ONLY
    needed, rest = usage.nodes[: usage.n_needed], usage.nodes[usage.n_needed :]
    rows = [inspect.Parameter(name, alone) for name in ("scene", "name", *needed)]
    rows += [inspect.Parameter(name, alone, default=None) for name in rest]
    if usage.has_ports:
        rows.append(inspect.Parameter("nodes", inspect.Parameter.VAR_POSITIONAL))
    rows += [inspect.Parameter(e.name, keyword, default=_default(e)) for e in usage.entries]
    if usage.initial:
        rows.append(inspect.Parameter("initial", keyword, default=None))
    return inspect.Signature(rows)


def _default(entry: Entry) -> Any:
    return inspect.Parameter.empty if entry.required else entry.default


class PartMethods:
    """The method of scenes that adds a part."""

    def add(
        self,
        name: str,
        part: SceneDescription | str | Path,
        /,
        *,
        count: int | Sequence[int] | None = None,
        index: str | Sequence[str] | None = None,
        nodes: Mapping[str, str] | None = None,
        parameters: Mapping[str, Any] | None = None,
        inputs: Mapping[str, Any] | None = None,
        set: Mapping[str, Any] | None = None,
        **bindings: Any,
    ) -> None:
        """Add a part: another scene, whose declarations get names within this one.

        Parameters
        ----------
        name : str
            Its name; what it holds is called ``name.edge.variable``, ``name.parameter``, ...
        part : Scene, str or Path
            A scene, which is copied; the name of a shipped part; or the path of a TOML file.
        count : int or sequence of int, optional
            Makes an array of parts: ``name1``, ``name2``, ...; ``name1_1`` of two counts.
        index : str or sequence of str, optional
            What the numbers of a part are called in bindings; ``i``, ``j`` and ``k`` by default.
            Names of nodes hold them in braces: ``left="n{i - 1}"``.
        nodes : mapping of str to str, optional
            Nodes of this scene, by those of the part that they are. The ground is one for all.
        parameters, inputs : mapping of str to float, str, or table of value and unit, optional
            Values of the part's parameters and inputs: numbers, or expressions of this scene. What
            has none keeps the value of its own scene. Inputs take tables, (times, values), too.
        set : mapping of str to float or str, optional
            Values of single parts of an array by their whole name, ``{"cell3.R": 0.05}``.
        **bindings
            Nodes, parameters and inputs by their names, as in the three tables.

        Raises
        ------
        ModelError
            If a name is unknown or taken, a port is left open, or a value is not accepted.

        Examples
        --------
        >>> import cotree
        >>> cell = cotree.Scene("cell")
        >>> cell.parameter("R", 1.0)
        >>> cell.edge("series", "resistor", "left", "right", resistance="R")
        >>> cell.edge("shunt", "capacitor", "right", "ground", capacitance=1.0)
        >>> ladder = cotree.Scene("ladder")
        >>> ladder.add("cell", cell, count=3, left="n{i - 1}", right="n{i}", R="0.5*i")
        >>> ladder.edge("source", "voltage_source", "n0", "ground", voltage=1.0)
        >>> ladder.compile().states
        ('cell1.shunt.v', 'cell2.shunt.v', 'cell3.shunt.v')
        """
        if isinstance(part, SceneDescription):
            scene, source = template_of(part), ""
        elif isinstance(part, (str, PathLike)):
            scene, source = load_part(part)
        else:
            raise SceneError(
                f"part '{brief(name)}' is made of {brief(repr(part))}: give a scene, a file, or "
                "the name of a shipped part"
            )
        own = {"count": count, "index": index, "nodes": nodes, "parameters": parameters}
        own |= {"inputs": inputs, "set": set}
        given = {key: value for key, value in own.items() if value is not None}
        add_part(cast("SceneDescription", self), name, scene, {**given, **bindings}, source)


def template_of(scene: SceneDescription) -> SceneDescription:
    """Copy a scene as something that parts are made of, which does not follow the original."""
    made = SceneDescription(scene.name)
    # A plain description: equal templates are equal whatever class the user's scene has.
    made.__dict__.update(scene.copied().__dict__)
    return made
