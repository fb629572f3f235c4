"""The content of an SBML model as plain data; formulas remain libsbml's trees."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from cotree.errors import brief

if TYPE_CHECKING:
    from cotree.readers.source_line import SourceLine


@dataclass(frozen=True)
class Formula:
    """A formula of a model.

    Attributes
    ----------
    node : libsbml.ASTNode
        Its tree.
    at : SourceLine
        Its file and line.
    what : str
        Its description in messages: ``kinetic law of reaction 'R1'``.
    """

    node: Any = field(repr=False)
    at: SourceLine
    what: str


@dataclass(frozen=True)
class Quantity:
    """A compartment, a species, a parameter or a stoichiometry.

    Attributes
    ----------
    kind, id, title : str
        Its kind, identifier and descriptive name.
    at : SourceLine
        Its file and line.
    value : float or None
        Its initial value, if the file gives a number.
    is_constant : bool
        Whether it is declared constant.
    compartment : str
        Compartment of a species.
    is_amount : bool
        Whether the identifier of a species denotes an amount instead of a concentration.
    gives_amount : bool
        Whether ``value`` of a species is an amount.
    is_boundary : bool
        Whether reactions do not change a species.
    conversion : str
        Conversion factor of a species: the parameter that converts extents of reactions to amounts.
    """

    kind: str
    id: str
    title: str
    at: SourceLine
    value: float | None = None
    is_constant: bool = False
    compartment: str = ""
    is_amount: bool = False
    gives_amount: bool = False
    is_boundary: bool = False
    conversion: str = ""

    @property
    def whose(self) -> str:
        """Its kind and identifier, for messages."""
        return f"{self.kind} '{brief(self.id)}'"


@dataclass(frozen=True)
class Part:
    """A reactant or product of a reaction.

    Attributes
    ----------
    species : str
        Its identifier.
    sign : int
        -1 for a reactant, 1 for a product.
    stoichiometry : float or str or Formula
        Its stoichiometry: a number, the identifier of a quantity, or a formula.
    at : SourceLine
        Its file and line.
    """

    species: str
    sign: int
    stoichiometry: float | str | Formula
    at: SourceLine


@dataclass(frozen=True)
class Reaction:
    """A reaction: its rate, local parameters, and parts."""

    id: str
    law: Formula
    local: dict[str, Quantity]
    parts: tuple[Part, ...]


@dataclass(frozen=True)
class SbmlEvent:
    """An event: its trigger and its assignments.

    Attributes
    ----------
    id : str
        Its identifier, or a name made from its number.
    trigger : Formula
        The condition; the event occurs when it becomes true.
    sets : dict of str to Formula
        The assigned values by identifier.
    is_initially_true : bool
        Whether the trigger counts as true before the start.
    priority : float
        Of simultaneous events, those with higher priority act first.
    is_persistent : bool
        Whether it occurs even if a simultaneous event makes its trigger false again.
    uses_trigger_values : bool
        Whether assigned values are evaluated before simultaneous events act, or after them.
    """

    id: str
    trigger: Formula
    sets: dict[str, Formula]
    is_initially_true: bool
    priority: float = 0.0
    is_persistent: bool = True
    uses_trigger_values: bool = True


@dataclass
class SbmlContent:
    """The content of a model, by identifier.

    Attributes
    ----------
    id : str
        The model's identifier.
    quantities : dict of str to Quantity
        Compartments, species, parameters, and stoichiometries with an identifier.
    functions : dict of str to node
        Trees of the function definitions.
    initials, assignments, rates : dict of str to Formula
        Initial assignments, assignment rules and rate rules, by identifier of their target.
    reactions, events : list
        The reactions and events.
    notes : list of str
        Elements that are ignored.
    """

    id: str
    quantities: dict[str, Quantity] = field(default_factory=dict)
    functions: dict[str, Any] = field(default_factory=dict)
    initials: dict[str, Formula] = field(default_factory=dict)
    assignments: dict[str, Formula] = field(default_factory=dict)
    rates: dict[str, Formula] = field(default_factory=dict)
    reactions: list[Reaction] = field(default_factory=list)
    events: list[SbmlEvent] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    _document: Any = None  # kept alive, since it owns libsbml's trees
