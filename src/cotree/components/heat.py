"""Loss of a component as heat into a thermal node: one more port of the component."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING

from cotree.components.law import Law
from cotree.components.terminal import Kind, Terminal

if TYPE_CHECKING:
    from cotree.components.component import Component

#: Name of the port.
HEAT = "heat"


def loss_of(component: Component) -> Law | None:
    """Give the heat of a component, [W]: its own loss, or all power that a dissipator takes up."""
    if component.loss is not None:
        return component.loss
    if len(component.ports) == 1 and component.ports[0].kind is Kind.DISSIPATOR:
        # A single port has an empty name: others call its variables ``across_`` and ``through_``.
        return Law(lambda across_, through_: across_ * through_)
    return None


@lru_cache(maxsize=256)
def with_heat(component: Component) -> Component:
    """Add a port to a component that gives its loss to a thermal node.

    The heat flows out of the component: minus the loss flows into its port.
    """
    loss = loss_of(component)
    assert loss is not None  # asked for only where there is one
    port = Terminal("thermal", Kind.THROUGH_SOURCE, HEAT, through=Law.of(-loss.expression))
    return replace(
        component, ports=(*component.ports, port), domains=(*component.domains, "thermal")
    )
