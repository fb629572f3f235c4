"""The quantities of an SBML model in its scene: their names, states and factors."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeVar

from cotree.scene.description import SceneDescription

if TYPE_CHECKING:
    from collections.abc import Mapping

_Scene = TypeVar("_Scene", bound=SceneDescription)


@dataclass(frozen=True)
class SbmlSymbol:
    """A quantity of an SBML model in a scene.

    Attributes
    ----------
    kind : str
        ``compartment``, ``species``, ``parameter``, ``stoichiometry`` or ``reaction``.
    name : str
        The parameter, mode or output of the scene that has its value, in the unit that formulas
        of the model use: the value of a species is its amount or its concentration.
    state : str
        Its state: ``A.c``, or the mode; empty without a state.
    factor : str
        The factor from its value to the state: an expression of outputs and parameters, or empty
        for one. States of species in a compartment whose size changes are amounts.
    initial : str
        The parameter with its initial value, in the unit of ``name``: a number, or derived from
        others. For a constant it is the parameter itself. Empty for reactions and for quantities
        with an assignment rule.
    """

    kind: str
    name: str
    state: str = ""
    factor: str = ""
    initial: str = ""


@dataclass(frozen=True)
class SbmlModel(Generic[_Scene]):
    """A scene read from an SBML model, with the quantities of the model.

    Attributes
    ----------
    scene : Scene
        The scene.
    symbols : mapping of str to SbmlSymbol
        The model's quantities by identifier.
    local : mapping of (str, str) to str
        Parameters of the scene by reaction and identifier of the local parameter.
    assumed : frozenset of str
        Quantities without a value in the model, whose value the caller gave.
    """

    scene: _Scene
    symbols: Mapping[str, SbmlSymbol]
    local: Mapping[tuple[str, str], str] = field(default_factory=dict)
    assumed: frozenset[str] = frozenset()
