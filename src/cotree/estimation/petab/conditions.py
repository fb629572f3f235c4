"""Conditions of a PEtab problem: values of parameters and initial values of the model in each.

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

    from cotree.estimation.petab.tables import Cell, ConditionRow, MeasurementRow, Tables

#: A value: the name of an estimated parameter, or a number.
Setting = str | float


@dataclass(frozen=True)
class Entities:
    """The quantities of a model that tables may set, by identifier."""

    #: Constants of the model, and parameters that only formulas use: parameters of the scene.
    parameters: Mapping[str, str]
    states: Mapping[str, str]  # quantities that change with time: states of the model
    #: Parameters of the scene that are the initial values of some of these states, as numbers.
    initial: Mapping[str, str]
    #: The entries of ``parameters`` and ``states`` to which the model gives no value.
    valueless: frozenset[str] = frozenset()
    #: Values of the entries of ``parameters`` to which the model gives numbers.
    numbers: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """Values that a condition sets, by names in the scene."""

    parameters: dict[str, Setting] = field(default_factory=dict)
    initial: dict[str, Setting] = field(default_factory=dict)


@dataclass(frozen=True)
class Run:
    """A run that measured rows need: a condition, its preequilibration, and where it ends."""

    #: Names in the condition table; ``before`` is empty without a preequilibration.
    condition: str
    before: str
    is_at_rest: bool  # whether values were measured at the steady state of the condition itself

    @classmethod
    def of(cls, row: MeasurementRow) -> Run:
        """Return the run in which a row was measured."""
        return cls(row.condition, row.before, math.isinf(row.t))

    @property
    def name(self) -> str:
        """Name of the run in messages."""
        return f"{self.condition} after {self.before}" if self.before else self.condition


class ConditionReader:
    """Reads the values that conditions set.

    Parameters
    ----------
    tables : Tables
        The tables.
    entities : Entities
        The quantities that can be set.
    """

    def __init__(self, tables: Tables, entities: Entities) -> None:
        self._tables, self._entities = tables, entities
        for condition in tables.conditions.values():
            self._check(condition)

    def settings(self, name: str) -> Settings:
        """Return the values that a condition sets at the start of its run."""
        condition, entities = self._tables.conditions[name], self._entities
        found = Settings(self._parameters(condition))
        for identifier, state in entities.states.items():
            value = self._setting(condition, identifier)
            if value is None:
                self._check_value(condition, identifier)
            # An initial value that is a number in the model is a parameter of the scene, from which
            # other initial values may be derived.
            elif identifier in entities.initial:
                found.parameters[entities.initial[identifier]] = value
            else:
                found.initial[state] = value
        return found

    def settings_after(self, name: str, before: Settings) -> Settings:
        """Return the values that a condition sets after a preequilibration."""
        condition, entities = self._tables.conditions[name], self._entities
        found = Settings(self._parameters(condition))
        # Parameters that are initial values keep their value, which has no effect in this run.
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
        """Return a parameter of the table: its name if it is estimated, else its number."""
        row = self._tables.parameters.get(name)
        if row is None:
            return None
        return name if row.is_estimated else row.nominal

    def _parameters(self, condition: ConditionRow) -> dict[str, Setting]:
        """Return the parameters that a condition sets, by names in the scene."""
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
                f"'{identifier}' has no value in condition '{condition.name}': set it there or in "
                "the parameter table"
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
        """Return the value of a constant of the model in a condition.

        Cells may also name constants that the parameter table does not list.
        """
        numbers, named = self._entities.numbers, cell
        for _ in condition.cells:
            own = condition.cells.get(named)
            if own is None:
                break  # the condition does not set it: it keeps the model's value
            if not isinstance(own, str):
                return own
            value = self.value(own)
            if value is not None:
                return value
            named = own
        else:
            raise condition.row.error(
                f"'{identifier}' of condition '{condition.name}' depends on itself through the "
                f"column '{cell}': give a number or an entry of the parameter table"
            )
        if named in numbers:
            return numbers[named]
        hint = nearest(named, {*self._tables.parameters, *numbers})
        raise condition.row.error(
            f"'{identifier}' of condition '{condition.name}' is '{named}', which is neither in the "
            f"parameter table nor a constant of the model with a number{hint}"
        )

    def _check(self, condition: ConditionRow) -> None:
        known = {*self._entities.parameters, *self._entities.states}
        for name in condition.cells:
            if name not in known:
                raise condition.row.error(
                    f"the column '{name}' is not a parameter, compartment or species of the model "
                    f"that can be set{nearest(name, known)}"
                )
