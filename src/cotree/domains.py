"""Table of the physical domains: names, symbols and units of across and through variables.

A domain defines the variables of one linear graph ([1] section 1.1), in a row of `_ROWS`.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from cotree.errors import SceneError, nearest

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class Domain:
    """The across and through variables of one physical domain; symbols and units in SI."""

    name: str
    #: The across variables, each one the time derivative of the one before it.
    across: tuple[str, ...]
    across_symbol: str
    through: str
    through_symbol: str
    across_unit: str
    through_unit: str
    #: Symbol and unit of the time integral of the across variable, if it has a name.
    stretch: str = ""
    stretch_unit: str = ""
    #: Symbol and unit of the contents of storages: integrals of the through variable, such as
    #: charge, and of the across variable, such as flux linkage, unless ``stretch`` names it.
    content: tuple[str, str] = ("", "")
    impulse: tuple[str, str] = ("", "")
    #: Whether variables are scalars, as in networks, instead of vectors, as in multibody systems.
    is_scalar: bool = False
    #: Whether the across variable is written with the edge's head before its tail.
    head_first: bool = False
    #: Part of a message: what to add at a node whose across variable has no equation.
    remedy: str = "a resistance or a storage"
    #: Part of a message: fault and remedy for a storage with an absolute across variable that
    #: starts at node ``{tail}`` instead of the ground.
    absolute: str = ""

    def summary(self) -> str:
        """Return a description of the domain on one line."""
        return (
            f"{self.name}: across {self.across_symbol} [{self.across_unit}] "
            f"({', '.join(self.across)}), through {self.through_symbol} [{self.through_unit}] "
            f"({self.through})"
        )


def _network(
    name: str,
    across: tuple[str, str, str],
    through: tuple[str, str, str],
    content: tuple[str, str],
    impulse: tuple[str, str] = ("", ""),
    **words: str,
) -> Domain:
    """Make a domain of scalars from the name, symbol and unit of each variable."""
    return Domain(
        name,
        # A scalar network has one across variable, multibody domains also its time derivatives.
        (across[0],),
        across[1],
        through[0],
        through[1],
        across[2],
        through[2],
        content=content,
        impulse=impulse,
        is_scalar=True,
        head_first=True,
        **words,
    )


_INERTIAL = (
    "is connected to '{tail}', but inertia is relative to the ground: name 'ground' first, "
    "then the node that it moves with"
)


_ROWS = (
    # Vectors of multibody systems. Position, velocity and acceleration are three across variables
    # of one edge, each with its f-circuit equation (Eq. (2)).
    Domain("translation", ("position", "velocity", "acceleration"), "r", "force", "F", "m", "N"),
    Domain(
        "rotation",
        ("orientation", "angular velocity", "angular acceleration"),
        "theta",
        "torque",
        "T",
        "rad",
        "N m",
    ),
    # Capacitors hold charge, the integral of the current; inductors hold flux linkage, the integral
    # of the voltage. The other scalar domains follow this pattern.
    _network(
        "electrical", ("voltage", "v", "V"), ("current", "i", "A"), ("q", "C"), ("flux", "V s")
    ),
    _network(
        "hydraulic",
        ("pressure", "p", "Pa"),
        ("volume flow", "q", "m^3/s"),
        ("V", "m^3"),
        ("Gamma", "Pa s"),
    ),
    # Heat can be stored in capacitances, but no component stores the integral of temperature.
    _network("thermal", ("temperature", "T", "K"), ("heat flow", "q", "W"), ("H", "J")),
    _network(
        "chemical",
        ("concentration", "c", "mol/m^3"),
        ("molar flow", "n", "mol/s"),
        ("N", "mol"),
        remedy="a species or a reaction",
        # A concentration is absolute, so storage edges must start at the reference.
        absolute=(
            "is connected to '{tail}', but its amount follows from its concentration "
            "relative to zero: name its node first, then 'ground'"
        ),
    ),
    Domain(
        # One-dimensional mechanics: velocity is across, force is through (mobility analogy). Masses
        # store momentum, the integral of force; springs store the integral of velocity.
        "translational",
        ("velocity",),
        "v",
        "force",
        "f",
        "m/s",
        "N",
        content=("p", "N s"),
        stretch="s",
        stretch_unit="m",
        is_scalar=True,
        remedy="a mass or a damper",
        absolute=_INERTIAL,
    ),
    Domain(
        "rotational",
        ("angular velocity",),
        "w",
        "torque",
        "tau",
        "rad/s",
        "N m",
        content=("L", "N m s"),
        stretch="theta",
        stretch_unit="rad",
        is_scalar=True,
        remedy="an inertia or a damper",
        absolute=_INERTIAL,
    ),
)

DOMAINS: Mapping[str, Domain] = MappingProxyType({row.name: row for row in _ROWS})
"""Every domain by its name, in the order of the table."""


def domain(name: str) -> Domain:
    """Return the domain with the given name; raise SceneError if there is none."""
    try:
        return DOMAINS[name]
    except KeyError:
        raise SceneError(f"unknown domain '{name}'{nearest(name, DOMAINS)}") from None
