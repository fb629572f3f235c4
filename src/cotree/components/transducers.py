"""Transducers: components with ports in several graphs, which they couple."""

from __future__ import annotations

from cotree.components.component import Component, Role
from cotree.components.electrical import value
from cotree.components.law import Law
from cotree.components.terminal import Kind, Terminal

DC_MOTOR = Component(
    "dc_motor",
    Role.NETWORK,
    "direct current motor or generator with a constant field",
    fields=(
        value("resistance", "ohm", "of the winding"),
        value("inductance", "H", "of the winding"),
        value("constant", "N m/A", "torque per current, and voltage per speed", sign=""),
    ),
    domains=("electrical", "rotational"),
    ports=(
        Terminal(
            "electrical",
            Kind.THROUGH_STORAGE,
            "electrical",
            across=Law(
                lambda through, resistance, constant, across_shaft: (
                    resistance * through + constant * across_shaft
                )
            ),
            storage=Law(lambda inductance: inductance),
        ),
        Terminal(
            "rotational",
            Kind.THROUGH_SOURCE,
            "shaft",
            through=Law(lambda constant, through_electrical: -constant * through_electrical),
        ),
    ),
    loss=Law(lambda through_electrical, resistance: resistance * through_electrical**2),
)

COMPONENTS = (DC_MOTOR,)
