"""Terminal equations of scalar components.

What an edge of an electrical, hydraulic, thermal or one-dimensional mechanical graph says of its
across and through variables.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from cotree.components.law import Law


class Kind(Enum):
    """What an edge is to the normal tree: the first become branches before the last."""

    ACROSS_SOURCE = 0  # an across variable that is given; always a branch
    ACROSS_STORAGE = 1  # capacitors, tanks, masses: through = capacity * rate of across
    COUPLED = 2  # a port of a transformer or gyrator
    DISSIPATOR = 3  # resistors: through and across at the same instant
    THROUGH_STORAGE = 4  # inductors: across = inertance * rate of through
    SPRING = 5  # through by the integral of across; a chord
    THROUGH_SOURCE = 6  # a through variable that is given; always a chord


@dataclass(frozen=True)
class Terminal:
    """The terminal equation of one port.

    Laws are functions of ``across`` and ``through`` of the port itself, ``across_<port>`` and
    ``through_<port>`` of the component's other ports, ``t``, and the fields of the component.
    Through variables flow from the head to the tail inside the element, so that across times
    through is the power that it takes up.

    Attributes
    ----------
    domain : str
        The graph that the port has its edge in.
    kind : Kind
        Its place in the normal tree.
    port : str
        Its name; empty where the component has one port only.
    across : Law or None
        The across variable, explicitly; for storages of through, what is added to
        ``inertance * rate``.
    through : Law or None
        The through variable, explicitly; for storages of across, what is added to
        ``capacity * rate``; for springs a function of ``stretch`` as well.
    storage : Law or None
        Capacity or inertance of a storage; of springs, what through grows by for a unit of
        ``stretch``.
    is_passive : bool
        Whether linear equations made of it are symmetric and positive definite.
    between : tuple of str
        Of a component whose ports share nodes: the terminals at head and tail.
    """

    domain: str
    kind: Kind
    port: str = ""
    across: Law | None = None
    through: Law | None = None
    storage: Law | None = None
    is_passive: bool = True
    between: tuple[str, str] = ("", "")
