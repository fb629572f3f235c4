"""Conditions of a PEtab problem: what parameters and initial values of the model are in each.

The condition table takes precedence over the parameter table, and both over the model. After a
preequilibration each state keeps its value unless the condition sets it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from cotree.errors import nearest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.estimation.petab_tables import Cell, ConditionRow, MeasurementRow, Tables

#: What something is: the name of an estimated parameter, or a number.
Setting = str | float


@dataclass(frozen=True)
class Entities:
    """The quantities of a model that tables may set, by identifier.

    Attributes
    ----------
    parameters : mapping of str to str
        Constants of the model, and parameters of formulas alone: parameters of the scene.
    states : mapping of str to str
        Quantities with a rate: states of the model.
    initial : mapping of str to str
        Parameters of the scene that hold initial values of some of these states as numbers.
    valueless : frozenset of str
        Those of ``parameters`` and ``states`` that have no value of their own.
    numbers : mapping of str to float
        Values that the model itself gives to those of ``parameters`` that are numbers in it.
    """

    parameters: Mapping[str, str]
    states: Mapping[str, str]
    initial: Mapping[str, str]
    valueless: frozenset[str] = frozenset()
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """Values that a condition sets, by names of the scene."""

    parameters: dict[str, Setting] = field(default_factory=dict)
    initial: dict[str, Setting] = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """A run that measured rows ask for: a condition, its preequilibration, and whether to rest.

    Attributes
    ----------
    condition, before : str
        Names in the condition table; ``before`` is empty for none.
    is_at_rest : bool
        Whether it was measured at the steady state that the condition itself leads to.
    """

    condition: str
    before: str
    is_at_rest: bool

    @classmethod
    def of(cls, row: MeasurementRow) -> Run:
        """Tell which run a measured row is of."""
        return cls(row.condition, row.before, math.isinf(row.t))

    @property
    def name(self) -> str:
        """Name the run of the condition itself for people."""
        return f"{self.condition} after {self.before}" if self.before else self.condition


class ConditionReader:
    """Reads what conditions set.

    Parameters
    ----------
    tables : Tables
        The tables.
    entities : Entities
        What can be set.
    """

    def __init__(self, tables: Tables, entities: Entities) -> None:
        self._tables, self._entities = tables, entities
        for condition in tables.conditions.values():
            self._check(condition)

    def settings(self, name: str) -> Settings:
        """Give what a condition sets where a run begins with it.

        Raises
        ------
        SceneError
            If it names what is not in the parameter table, or leaves open what the model does.
        """
        condition, entities = self._tables.conditions[name], self._entities
        found = Settings(self._parameters(condition))
        for identifier, state in entities.states.items():
            value = self._setting(condition, identifier)
            if value is None:
                self._check_value(condition, identifier)
            # What begins at a number of the model has a parameter for it, from which initial values
            # of others may be derived.
            elif identifier in entities.initial:
                found.parameters[entities.initial[identifier]] = value
            else:
                found.initial[state] = value
        return found

    def settings_after(self, name: str, before: Settings) -> Settings:
        """Give what a condition sets after a preequilibration."""
        condition, entities = self._tables.conditions[name], self._entities
        found = Settings(self._parameters(condition))
        # Initial values acted before; that they are parameters still makes no difference now.
        for parameter in entities.initial.values():
            if parameter in before.parameters:
                found.parameters[parameter] = before.parameters[parameter]
        for identifier, state in entities.states.items():
            if condition.cells.get(identifier) is not None:
                value = self._setting(condition, identifier)
                assert value is not None
                found.initial[state] = value
        return found

    def value(self, name: str) -> Setting | None:
        """Give a parameter of the table: its name if it is estimated, else its number."""
        row = self._tables.parameters.get(name)
        if row is None:
            return None
        return name if row.is_estimated else row.nominal

    def _parameters(self, condition: ConditionRow) -> dict[str, Setting]:
        """Give the parameters that a condition sets, by names of the scene."""
        found = {}
        for identifier, parameter in self._entities.parameters.items():
            value = self._setting(condition, identifier)
            if value is None:
                self._check_value(condition, identifier)
            else:
                found[parameter] = value
        return found

    def _check_value(self, condition: ConditionRow, identifier: str) -> None:
        if identifier in self._entities.valueless:
            raise condition.row.error(
                f"'{identifier}' has no value in condition '{condition.name}': give it one, or put "
                "it into the parameter table"
            )

    def _setting(self, condition: ConditionRow, identifier: str) -> Setting | None:
        # An empty cell or NaN keeps the value of the model.
        if identifier not in condition.cells:
            return self.value(identifier)
        cell: Cell = condition.cells[identifier]
        if not isinstance(cell, str):
            return cell
        value = self.value(cell)
        return self._of_model(condition, identifier, cell) if value is None else value

    def _of_model(self, condition: ConditionRow, identifier: str, cell: str) -> Setting:
        """Give the value that a constant of the model has in a condition.

        Constants that the parameter table does not list may stand in cells, too.
        """
        numbers, named = self._entities.numbers, cell
        for _ in condition.cells:
            own = condition.cells.get(named)
            if own is None:
                break  # the condition does not set it: the model's own value holds
            if not isinstance(own, str):
                return own
            value = self.value(own)
            if value is not None:
                return value
            named = own
        else:
            raise condition.row.error(
                f"'{identifier}' of condition '{condition.name}' leads back to itself through the "
                f"column '{cell}': give a number or an entry of the parameter table"
            )
        if named in numbers:
            return numbers[named]
        hint = nearest(named, {*self._tables.parameters, *numbers})
        raise condition.row.error(
            f"'{identifier}' of condition '{condition.name}' is '{named}', which is neither in the "
            f"parameter table nor a constant that the model gives a number{hint}"
        )

    def _check(self, condition: ConditionRow) -> None:
        known = {*self._entities.parameters, *self._entities.states}
        for name in condition.cells:
            if name not in known:
                raise condition.row.error(
                    f"the column '{name}' is no parameter, compartment or species of the model "
                    f"that can be set{nearest(name, known)}"
                )
