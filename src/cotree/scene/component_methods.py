"""Methods of scenes for built-in components; :mod:`cotree.scene.usage_text` builds their stub."""

from __future__ import annotations

import inspect
from functools import lru_cache
from types import MethodType
from typing import TYPE_CHECKING, Any

from cotree.components import OWN

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree.scene.usage_text import Usage


class ComponentMethod:
    """Descriptor of one component's method, which is created when it is first used."""

    # Creating all ninety methods at import would take longer than reading a scene.
    def __init__(self, type: str) -> None:
        self.type = type

    def __get__(self, scene: object, owner: object = None) -> Callable[..., None]:
        function = _function(self.type)
        return function if scene is None else MethodType(function, scene)


class ComponentMethods:
    """One method per component type, which adds an edge: ``scene.revolute("h", "D", "B", ...)``.

    Each calls :meth:`cotree.Scene.edge` with the component's name. Fields accept numbers in SI,
    names of parameters, expressions in quotes, and values with a unit, as in
    ``{"value": 35, "unit": "mm"}``. :func:`cotree.register_component` adds the methods of the types
    that it registers.
    """


for _type in sorted(OWN):
    # Component methods must not hide other methods; this assertion checks all names at import.
    assert not hasattr(ComponentMethods, _type)
    setattr(ComponentMethods, _type, ComponentMethod(_type))


@lru_cache(maxsize=256)
def _function(type: str) -> Callable[..., None]:
    from cotree.scene.usage_text import docstring_of, usage_of

    def add(
        scene: Any,
        name: str,
        /,
        *nodes: str,
        initial: Mapping[str, Any] | None = None,
        **fields: Any,
    ) -> None:
        # Arguments that are None are omitted, so that defaults apply.
        given = {key: value for key, value in fields.items() if value is not None}
        scene.edge(name, type, *nodes, initial=initial, **given)

    usage = usage_of(type)
    add.__name__, add.__qualname__ = type, f"Scene.{type}"
    add.__doc__ = docstring_of(usage)
    add.__signature__ = _signature(usage)  # type: ignore[attr-defined]
    return add


def _signature(usage: Usage) -> inspect.Signature:
    """Return the signature that help() and notebooks show."""
    alone, keyword = inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.KEYWORD_ONLY
    needed, rest = usage.nodes[: usage.n_needed], usage.nodes[usage.n_needed :]
    rows = [inspect.Parameter(name, alone) for name in ("scene", "name", *needed)]
    rows += [inspect.Parameter(name, alone, default=None) for name in rest]
    if usage.has_ports:
        rows.append(inspect.Parameter("nodes", inspect.Parameter.VAR_POSITIONAL))
    for entry in usage.entries:
        default = inspect.Parameter.empty if entry.required else entry.default
        rows.append(inspect.Parameter(entry.name, keyword, default=default))
    if usage.initial:
        rows.append(inspect.Parameter("initial", keyword, default=None))
    return inspect.Signature(rows)
