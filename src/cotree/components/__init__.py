"""Component types by name: their terminal equations and their fields in scenes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cotree.components import (
    chemical,
    contact,
    electrical,
    electrochemical,
    friction,
    hydraulic,
    mechanical,
    multibody,
    thermal,
    transducers,
    transistors,
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
from cotree.components.register import make_component, make_network_component
from cotree.components.terminal import Integral, Kind, Terminal, content_of, integral_of
from cotree.errors import SceneError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

#: Every component type, by the name that scenes use.
COMPONENTS: dict[str, Component] = {
    row.name: row
    for family in (
        multibody,
        contact,
        electrical,
        transistors,
        hydraulic,
        thermal,
        mechanical,
        friction,
        chemical,
        electrochemical,
        transducers,
    )
    for row in family.COMPONENTS
}


def register_component(
    name: str,
    law: Callable[..., Any] | Mapping[str, Callable[..., Any]],
    *,
    domain: str = "",
    along: str = "line",
    units: Mapping[str, str] | None = None,
    doc: str = "",
    **ports: Any,
) -> Component:
    """Register a component with your own law, for all scenes made afterwards.

    Its sensitivity terminal equations come from the law. Without ``domain`` it is a force element
    of multibody systems, with parameters as in
    :func:`cotree.components.register.make_component`. With one it is a component of that graph,
    with parameters as in :func:`cotree.components.register.make_network_component`.

    Parameters
    ----------
    name : str
        Name of the component type in scenes.
    law : callable, or mapping of str to callable
        The terminal equation as a function of SymPy symbols, by port where there are several. The
        names of its arguments say what they are.
    domain : str
        The physical domain of a scalar component; empty for a force element.
    along : {'line', 'velocity'}
        Direction along which a force element acts.
    units : mapping of str to str, optional
        SI unit of each field.
    doc : str
        One line on what it is.
    **ports
        Further options of scalar components.

    Returns
    -------
    Component
        The component, which scenes may now name.

    Raises
    ------
    SceneError
        If the name is taken by a component that cotree comes with, or the law is not accepted.

    Examples
    --------
    >>> drag = register_component("air_drag", lambda speed, c: -c * speed**2, along="velocity")
    >>> [field.name for field in drag.fields]
    ['c']
    >>> lamp = register_component(
    ...     "lamp", lambda across, k: k * across**3, domain="electrical", units={"k": "A/V^3"}
    ... )
    >>> lamp.ports[0].kind.name
    'DISSIPATOR'
    """
    if name in OWN:
        raise SceneError(f"the component '{name}' is built in: choose another name")
    if domain:
        made = make_network_component(name, law, domain=domain, units=units, doc=doc, **ports)
    elif ports or not callable(law):
        raise SceneError(f"component '{name}' has ports: name the domain of their graph")
    else:
        made = make_component(name, law, along=along, units=units, doc=doc)
    COMPONENTS[name] = made
    return made


#: The built-in types; users may register more.
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
    "content_of",
    "integral_of",
    "register_component",
]
