"""A battery cell: a store of charge with its open-circuit voltage, a resistance, and RC pairs."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import TYPE_CHECKING

from cotree.components.component import Field, value
from cotree.components.electrochemical import STATE_OF_CHARGE
from cotree.components.law import Law
from cotree.components.ports import resistive, scalar
from cotree.components.terminal import Kind, PortMeasure, Terminal

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cotree.components.component import Adapted, Given, Nodes

_DOMAIN = "electrical"
_EVERY = range(1, 4)  # numbers of the RC pairs that a cell may have


def _ports(pairs: Sequence[int]) -> tuple[Terminal, ...]:
    """Chain the cell from plus to minus: resistance, pairs of R and C, store of charge.

    This is Thevenin's equivalent circuit, v = OCV(soc) + R i + sum of v_k, with i positive into the
    plus node and R_k C_k dv_k/dt = R_k i - v_k. A capacity of 1 Ah is 3600 C.
    """
    places = ["plus", *(f"n{i}" for i in range(len(pairs) + 1)), "minus"]
    ports = [resistive(_DOMAIN, "resistance", "series", (places[0], places[1]))]
    # One pair of nodes is left over, that of the store of charge at the minus end.
    for i, between in zip(pairs, pairwise(places[1:]), strict=False):
        storage = Law.field(f"capacitance{i}")
        ports += [
            resistive(_DOMAIN, f"resistance{i}", f"resistor{i}", between),
            Terminal(_DOMAIN, Kind.ACROSS_STORAGE, f"pair{i}", storage=storage, between=between),
        ]
    # The store is an across source whose voltage depends on the integral of its own current.
    store = Terminal(
        _DOMAIN,
        Kind.ACROSS_SOURCE,
        "",
        across=Law.field("open_circuit_voltage"),
        between=(places[-2], "minus"),
        integral=STATE_OF_CHARGE,
    )
    return (*ports, store)


def _measures(pairs: Sequence[int]) -> tuple[PortMeasure, ...]:
    # Terminal voltage is the sum along the chain; in each RC pair the capacitor gives it.
    parts = ("series", *(f"pair{i}" for i in pairs), "")
    return (
        PortMeasure("v", "V", tuple((1, "across", part) for part in parts)),
        PortMeasure("i", "A", ((1, "through", "series"),)),
    )


def _fields(pairs: Sequence[int]) -> tuple[Field, ...]:
    own = [
        value("open_circuit_voltage", "V", "by a table or an expression of NAME.soc", ""),
        value("capacity", "C", "charge from empty to full"),
        value("resistance", "ohm", "in series"),
    ]
    for i in pairs:
        for name, unit in ((f"resistance{i}", "ohm"), (f"capacitance{i}", "F")):
            doc = f"of pair {i}; both or none"
            own.append(Field(name, unit, doc, constant=False, sign="positive"))
    return tuple(own)


def _as_given(edge: str, nodes: Nodes, fields: Given) -> Adapted:
    """Leave out the RC pairs that a scene does not give."""
    del edge
    # A pair with one of its two fields is kept, so that the missing one is reported as required.
    pairs = [i for i in _EVERY if {f"resistance{i}", f"capacitance{i}"} & fields.keys()]
    given = tuple(replace(row, required=True) for row in _fields(pairs))
    own = replace(BATTERY_CELL, fields=given, ports=_ports(pairs), measures=_measures(pairs))
    return own, nodes, fields


BATTERY_CELL = scalar(
    "battery_cell",
    "open-circuit voltage by the state of charge, a resistance and up to three RC pairs",
    _fields(_EVERY),
    *_ports(_EVERY),
    terminals=("plus", "minus"),
    measures=_measures(_EVERY),
    adapt=_as_given,
)

COMPONENTS = (BATTERY_CELL,)
