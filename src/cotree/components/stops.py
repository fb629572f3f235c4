"""Rigid stops: limits that hold what runs into them, in translation and rotation.

Each edge has a mode, which :mod:`cotree.scene.stops` adds: 0 while it is free, 1 and -1 while its
upper or its lower limit holds it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Demand, Field, optional
from cotree.components.law import Law
from cotree.components.ports import scalar
from cotree.components.terminal import Kind, Stop, Terminal
from cotree.errors import SceneError

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Given, Nodes


def rebound(across: Any, restitution: Any) -> Any:
    """Give what an impact changes a relative speed by."""
    return -(1 + restitution) * across


def excess(across: Any, restitution: Any, rest_speed: Any) -> Any:
    """Give the speed that an impact leaves, less that at which it leaves none."""
    import sympy

    return restitution * sympy.Abs(across) - rest_speed


def _port(domain: str, given: Given) -> Terminal:
    upper = Law(lambda stretch, upper: upper - stretch) if "upper" in given else None
    lower = Law(lambda stretch, lower: stretch - lower) if "lower" in given else None
    stop = Stop(upper, lower, Law(rebound), Law(excess))
    return Terminal(domain, Kind.STOP, is_passive=False, stop=stop)


_APART = Demand(Law(lambda lower, upper: upper - lower), "needs an upper limit above the lower one")
BOUNDED = Demand(
    Law(lambda restitution: 1 + 1e-15 - restitution), "needs a restitution of one at most"
)


def _stop(domain: str, length: str, unit: str) -> Component:
    def adapt(edge: str, nodes: Nodes, given: Given) -> Adapted:
        if "lower" not in given and "upper" not in given:
            raise SceneError(f"edge '{edge}' of type '{made.name}' needs a lower or an upper limit")
        apart = (_APART,) if "lower" in given and "upper" in given else ()
        own = replace(made, ports=(_port(domain, given),), demands=(*apart, BOUNDED))
        return own, nodes, given

    fields = (
        # A limit that moves would push: nodes move, limits do not.
        Field("lower", unit, f"least {length}; none where left out"),
        Field("upper", unit, f"largest {length}; none where left out"),
        optional("restitution", "1", "speed after an impact over that before", 0.0, "nonnegative"),
        optional("rest_speed", f"{unit}/s", "after an impact, below it is held", 1e-3, "positive"),
    )
    both = {"lower": 0, "upper": 1}
    made = scalar(
        f"{domain}_rigid_stop", "limits that hold what runs into them", fields, _port(domain, both)
    )
    return replace(made, adapt=adapt)


COMPONENTS = (
    _stop("translational", "length", "m"),
    _stop("rotational", "angle", "rad"),
)
