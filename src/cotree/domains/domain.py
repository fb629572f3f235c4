"""The table of physical domains: names, symbols and units of their across and through variables.

A domain says what the edges of one linear graph measure ([1] section 1.1). Adding a domain is
adding a row to `_ROWS`.
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
    """The across and through variables of one physical domain.

    Parameters
    ----------
    name : str
        Name of the domain, also of its linear graph.
    across : tuple of str
        The across variables, each one the time derivative of the one before it.
    across_symbol : str
        Symbol of the first across variable.
    through : str
        The through variable.
    through_symbol : str
        Symbol of the through variable.
    across_unit : str
        SI unit of the first across variable.
    through_unit : str
        SI unit of the through variable.
    """

    name: str
    across: tuple[str, ...]
    across_symbol: str
    through: str
    through_symbol: str
    across_unit: str
    through_unit: str

    def summary(self) -> str:
        """Describe the domain in one line.

        Examples
        --------
        >>> domain("translation").summary()
        'translation: across r [m] (position, velocity, acceleration), through F [N] (force)'
        """
        return (
            f"{self.name}: across {self.across_symbol} [{self.across_unit}] "
            f"({', '.join(self.across)}), through {self.through_symbol} [{self.through_unit}] "
            f"({self.through})"
        )


_ROWS = (
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
)

DOMAINS: Mapping[str, Domain] = MappingProxyType({row.name: row for row in _ROWS})
"""Every domain by its name, in the order of the table."""


def domain(name: str) -> Domain:
    """Look a domain up by its name.

    Parameters
    ----------
    name : str
        Name of the domain.

    Returns
    -------
    Domain
        Its row of the table.

    Raises
    ------
    SceneError
        If no domain has this name.

    Examples
    --------
    >>> domain("rotation").through_unit
    'N m'
    """
    try:
        return DOMAINS[name]
    except KeyError:
        raise SceneError(f"unknown domain '{name}'{nearest(name, DOMAINS)}") from None
