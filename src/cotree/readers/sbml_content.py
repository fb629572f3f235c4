"""The content of an SBML model in plain data; formulas stay libsbml's trees."""

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
        Where it stands.
    what : str
        What it belongs to, for messages: ``kinetic law of reaction 'R1'``.
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
        Its kind, identifier and name for people.
    at : SourceLine
        Where it stands.
    value : float or None
        The number given as its value at the start.
    is_constant : bool
        Whether nothing may change it.
    compartment : str
        Of a species: where it is.
    is_amount : bool
        Of a species: whether its identifier means an amount, not a concentration.
    gives_amount : bool
        Of a species: whether ``value`` is an amount.
    is_boundary : bool
        Of a species: whether reactions leave it as it is.
    conversion : str
        Of a species: the parameter by which reactions' extents become amounts of it.
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
        """Name it in messages."""
        return f"{self.kind} '{brief(self.id)}'"


@dataclass(frozen=True)
class Part:
    """A reactant or product of a reaction.

    Attributes
    ----------
    species : str
        Which it is.
    sign : int
        -1 for a reactant, 1 for a product.
    stoichiometry : float or str or Formula
        Its stoichiometry: a number, the identifier of a quantity, or a formula.
    at : SourceLine
        Where it stands.
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
    """An event: when it happens, and the values that it sets.

    Attributes
    ----------
    id : str
        Its identifier, or a name made of its number.
    trigger : Formula
        The condition; the event happens when it turns true.
    sets : dict of str to Formula
        The value of each quantity that it sets.
    is_initially_true : bool
        Whether the trigger counts as true before the start.
    priority : float
        Of events at the same time, those of higher priority act first.
    is_persistent : bool
        Whether it happens even if an event at the same time turns its trigger false again.
    uses_trigger_values : bool
        Whether values are those before events at the same time act, or those that they leave.
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
        Compartments, species, parameters and stoichiometries with an identifier.
    functions : dict of str to node
        Trees of the function definitions.
    initials, assignments, rates : dict of str to Formula
        Initial assignments, assignment rules and rate rules by what they determine.
    reactions, events : list
        The reactions and events.
    notes : list of str
        What is not read.
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
    _document: Any = None  # libsbml's trees live as long as their document
