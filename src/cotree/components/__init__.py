"""Component types by name: terminal equations and what a scene may say of each."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.components import (
    chemical,
    constraints,
    electrical,
    electrochemical,
    forces,
    hydraulic,
    joints,
    mechanical,
    rigid_body,
    thermal,
    transducers,
)
from cotree.components.component import (
    Acts,
    Component,
    Field,
    Freedom,
    FreeRotation,
    MotionStep,
    Role,
    Shape,
)
from cotree.components.law import Law
from cotree.components.register import make_component
from cotree.components.terminal import Integral, Kind, Terminal, integral_of
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: Every component type, by the name that scenes use.
COMPONENTS: dict[str, Component] = {
    row.name: row
    for family in (
        *(rigid_body, joints, constraints, forces),
        *(electrical, hydraulic, thermal, mechanical, chemical, electrochemical, transducers),
    )
    for row in family.COMPONENTS
}


def register_component(
    name: str,
    law: Callable[..., Any],
    *,
    along: str = "line",
    units: Mapping[str, str] | None = None,
    doc: str = "",
) -> Component:
    """Register a force element with a law of your own, for every scene made afterwards.

    Its sensitivity terminal equations come from the law; parameters as in
    :func:`cotree.components.register.make_component`.

    Raises
    ------
    SceneError
        If the name is taken by a component that cotree comes with, or the law is not accepted.

    Examples
    --------
    >>> drag = register_component("air_drag", lambda speed, c: -c * speed**2, along="velocity")
    >>> [field.name for field in drag.fields]
    ['c']
    """
    if name in OWN:
        raise SceneError(f"the component '{name}' comes with cotree: choose another name")
    made = make_component(name, law, along=along, units=units, doc=doc)
    COMPONENTS[name] = made
    return made


#: The types that cotree comes with; users may register more.
OWN = frozenset(COMPONENTS)

__all__ = [
    "COMPONENTS",
    "OWN",
    "Acts",
    "Component",
    "Field",
    "FreeRotation",
    "Freedom",
    "Integral",
    "Kind",
    "Law",
    "MotionStep",
    "Role",
    "Shape",
    "Terminal",
    "integral_of",
    "register_component",
]
