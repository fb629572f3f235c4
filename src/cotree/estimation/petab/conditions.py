"""Conditions of a PEtab problem: values of parameters and initial values of the model in each.

The condition table takes precedence over the parameter table, and both over the model. After a
preequilibration each state keeps its value unless the condition sets it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from cotree.errors import nearest

if TYPE_CHECKING:
    from collections.abc import Mapping

    from cotree.estimation.petab.tables import ConditionRow, Tables

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
    #: The entries of ``parameters`` and ``states`` without a value in the model.
    valueless: frozenset[str] = frozenset()
    #: Values of the entries of ``parameters`` that are numbers in the model.
    numbers: Mapping[str, float] = field(default_factory=dict)


class Link(NamedTuple):
    """A run, with the values that its condition sets, by names in the scene."""

    name: str  # in messages
    parameters: dict[str, Setting]
    initial: dict[str, Setting]


class ConditionReader:
    """Reads the values that conditions set."""

    def __init__(self, tables: Tables, entities: Entities) -> None:
        self._tables, self._entities = tables, entities
        known = {*entities.parameters, *entities.states}
        for condition in tables.conditions.values():
            for name in condition.cells:
                if name not in known:
                    raise condition.row.error(
                        f"the column '{name}' is not a parameter, compartment or species of the "
                        f"model that can be set{nearest(name, known)}"
                    )

    def chain(self, condition: str, before: str, is_at_rest: bool) -> tuple[Link, ...]:
        """Return the runs up to measured values; all but the last end at a steady state.

        ``before`` is the preequilibration, or empty. ``is_at_rest`` means that values were measured
        at the steady state of the condition itself.
        """
        first = (self._link(before, before),) if before else ()
        name = f"{condition} after {before}" if before else condition
        own = self._link(condition, name, *first)
        # Values at a steady state are those at the start of a run that begins there.
        last = (Link(f"{name} at rest", own.parameters, {}),) if is_at_rest else ()
        return (*first, own, *last)

    def _link(self, key: str, name: str, before: Link | None = None) -> Link:
        """Return the values that a condition sets, perhaps after a preequilibration."""
        condition, entities = self._tables.conditions[key], self._entities
        found = Link(name, {}, {})
        for identifier, parameter in entities.parameters.items():
            value = self._setting(condition, identifier)
            if value is not None:
                found.parameters[parameter] = value
        # Parameters that are initial values keep their value, which has no effect after a run.
        for parameter in entities.initial.values() if before else ():
            if before and parameter in before.parameters:
                found.parameters[parameter] = before.parameters[parameter]
        for identifier, state in entities.states.items():
            if before and condition.cells.get(identifier) is None:
                continue
            value = self._setting(condition, identifier)
            if value is None:
                continue
            # An initial value that is a number in the model is a parameter of the scene, from which
            # other initial values may be derived.
            if not before and identifier in entities.initial:
                found.parameters[entities.initial[identifier]] = value
            else:
                found.initial[state] = value
        return found

    def _setting(self, condition: ConditionRow, identifier: str) -> Setting | None:
        """Return the value of an entity in a condition; None keeps that of the model."""
        if identifier not in condition.cells:
            value = self._listed(identifier)
        else:
            value = condition.cells[identifier]
            if isinstance(value, str):
                value = self._named(condition, identifier, value)
        if value is None and identifier in self._entities.valueless:
            raise condition.row.error(
                f"'{identifier}' has no value in condition '{condition.name}': set it there or in "
                "the parameter table"
            )
        return value

    def _listed(self, name: str) -> Setting | None:
        """Return a parameter of the table: its name if it is estimated, else its number."""
        row = self._tables.parameters.get(name)
        return name if row and row.is_estimated else row.nominal if row else None

    def _named(self, condition: ConditionRow, identifier: str, cell: str) -> Setting:
        """Return the value of a name in a cell: a parameter, or a constant of the model."""
        numbers, named = self._entities.numbers, cell
        for _ in range(len(condition.cells) + 1):
            value = self._listed(named)
            if value is not None:
                return value
            own = condition.cells.get(named)
            if own is None:
                break  # the condition does not set it: it keeps the model's value
            if not isinstance(own, str):
                return own
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
