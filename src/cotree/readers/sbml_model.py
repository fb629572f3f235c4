"""Names and factors by which the quantities of an SBML model stand in its scene."""

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
        The parameter, mode or output of the scene that has its value, in the unit in which
        formulas of the model have it: that of a species is its amount or its concentration.
    state : str
        The state that holds it: ``A.c``, or the mode; nothing where it has none.
    factor : str
        What its value is to be multiplied by to give the state: an expression of outputs and
        parameters, or nothing for one. States of species in a compartment whose size changes
        are amounts.
    initial : str
        The parameter that holds its value at the start, in the unit of ``name``: a number or
        derived from others. That of a constant is its own parameter. Nothing for reactions and
        for what an assignment rule determines.
    """

    kind: str
    name: str
    state: str = ""
    factor: str = ""
    initial: str = ""


@dataclass(frozen=True)
class SbmlModel(Generic[_Scene]):
    """A scene that was read from an SBML model, and where its quantities are.

    Attributes
    ----------
    scene : Scene
        The scene.
    symbols : mapping of str to SbmlSymbol
        The model's quantities by identifier.
    local : mapping of (str, str) to str
        Parameters of the scene by reaction and identifier of the local parameter.
    assumed : frozenset of str
        Quantities to which the model gives no value, and the caller of the reader did.
    """

    scene: _Scene
    symbols: Mapping[str, SbmlSymbol]
    local: Mapping[tuple[str, str], str] = field(default_factory=dict)
    assumed: frozenset[str] = frozenset()
