"""Windings that share flux: two of them, or up to six."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache, partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

from cotree.components.component import Component, Demand, Field, optional, value
from cotree.components.law import Law
from cotree.components.ports import scalar
from cotree.components.terminal import Kind, Terminal

if TYPE_CHECKING:
    from cotree.components.component import Adapted, Given, Nodes

_DOMAIN = "electrical"

#: Names of the windings' ports, in order.
WINDINGS = ("primary", "secondary", "winding3", "winding4", "winding5", "winding6")

_COMPLETE = (
    "couples its windings completely: give a coupling between -1 and 1, or an ideal transformer "
    "with an inductor, which have other equations, so that no parameter leads there; in a netlist, "
    "write the coupling as the number 1"
)
_TOO_CLOSE = "couples its windings by more than the flux that they have: give smaller couplings"


def coupling_field(i: int, j: int) -> str:
    """Name the field of the coupling of two windings, counted from 1."""
    first, second = sorted((i, j))
    return "coupling" if (first, second) == (1, 2) else f"coupling{first}{second}"


def _induced(*values: Any) -> Any:
    """Sum k sqrt(L Lj) dij/dt over the other windings; values are L, then k, Lj and the rates."""
    import sympy

    # Mutual inductance k sqrt(L Lj) times the rate of the other current.
    own, others = values[0], zip(values[1::3], values[2::3], values[3::3], strict=True)
    return sum(coupling * sympy.sqrt(own * other) * rate for coupling, other, rate in others)


def _winding(i: int, n: int) -> Terminal:
    """Make the port of a winding among n: its own flux, and what the others induce."""
    own = f"inductance{i}"
    # Names in threes (k, Lj and the rate of ij) are what ``_induced`` takes apart again.
    names = [own]
    for j in (j for j in range(1, n + 1) if j != i):
        names += [coupling_field(i, j), f"inductance{j}", f"through_rate_{WINDINGS[j - 1]}"]
    return Terminal(
        _DOMAIN,
        Kind.THROUGH_STORAGE,
        WINDINGS[i - 1],
        storage=Law.field(own),
        across=Law.taking(tuple(names), _induced),
    )


def _determinant(n: int, *couplings: Any) -> Any:
    """Give the determinant of the matrix of n windings' couplings, in the order of their pairs."""
    import sympy

    matrix = sympy.eye(n)
    for (i, j), coupling in zip(combinations(range(n), 2), couplings, strict=True):
        matrix[i, j] = matrix[j, i] = coupling
    return sympy.expand(matrix.det())


# Leading minors that are positive make the matrix of inductances positive definite (Sylvester), so
# that energy is stored and the fluxes determine the currents.
def _demand(n: int) -> Demand:
    """Ask for a positive minor of the first n windings: then the fluxes give the currents."""
    names = tuple(coupling_field(*pair) for pair in combinations(range(1, n + 1), 2))
    return Demand(Law.taking(names, partial(_determinant, n)), _COMPLETE if n == 2 else _TOO_CLOSE)


@lru_cache(maxsize=len(WINDINGS))
def _windings(n: int) -> Component:
    every = range(1, n + 1)
    doc = "mutual inductance, by the root of the product of the two"
    couplings: list[Field] = [value("coupling", "1", doc, "")]
    if n > 2:
        pairs = combinations(every, 2)
        # Of two windings the coupling is all that there is to say; of more, pairs may be uncoupled.
        couplings = [optional(coupling_field(*pair), "1", doc, 0.0) for pair in pairs]
    return scalar(
        "coupled_inductors",
        "windings that share a part of their flux",
        (
            *(value(f"inductance{i}", "H", f"of {WINDINGS[i - 1]} alone") for i in every),
            *couplings,
        ),
        *(_winding(i, n) for i in every),
        # The first leading minor is one, so that the minors of two windings and more remain.
        demands=tuple(_demand(k) for k in range(2, n + 1)),
    )


def _as_given(edge: str, nodes: Nodes, fields: Given) -> Adapted:
    """Make as many windings as have an inductance."""
    del edge
    # Windings are counted by the inductances that a scene gives in order.
    n = 2
    while n < len(WINDINGS) and f"inductance{n + 1}" in fields:
        n += 1
    return _windings(n), nodes, fields


COUPLED_INDUCTORS = replace(_windings(2), adapt=_as_given)

COMPONENTS = (COUPLED_INDUCTORS,)
