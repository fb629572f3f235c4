"""The model of a PEtab problem: a scene from an SBML file, with outputs for the measured values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.api import Scene
from cotree.errors import ModelError, SceneError
from cotree.estimation.conditions import Condition, Measured
from cotree.estimation.estimated import Estimated
from cotree.estimation.petab.conditions import ConditionReader, Entities, Run, Setting, Settings
from cotree.estimation.petab.formulas import PLACEHOLDER, Formula, Outputs
from cotree.readers.names import Namer
from cotree.readers.sbml.scene import SbmlModel, read_sbml_model

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.compiled import Model
    from cotree.estimation.petab.tables import ParameterRow, Tables


class PetabModel:
    """A scene, and the names that its quantities have in the tables.

    Parameters
    ----------
    tables : Tables
        The tables.

    Attributes
    ----------
    scene : Scene
        The scene; outputs are added to it by :meth:`add_outputs`.
    entities : Entities
        The quantities that conditions may set.

    Raises
    ------
    SceneError
        If the SBML file cannot be read, or the tables set a quantity that cannot be set.
    """

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        self._sbml: SbmlModel[Scene] = read_sbml_model(tables.model, Scene, _values(tables))
        self.scene = self._sbml.scene
        self._namer = Namer()
        for name in (*self.scene.parameters, *self.scene.outputs, *self.scene.modes):
            self._namer.own(name)
        for name in (*self.scene.inputs, *self.scene.edges, *self.scene.nodes):
            self._namer.own(name)
        self._added = self._added_parameters()
        self.entities = self._entities()

    def meaning(self, name: str) -> str | None:
        """Return the expression for a name in the tables, or None."""
        symbol = self._sbml.symbols.get(name)
        return self._added.get(name) if symbol is None else symbol.name

    def new_name(self, wish: str) -> str:
        """Return an unused name of the scene, close to the wish."""
        return self._namer.own(wish)

    def add_outputs(self, outputs: Outputs) -> None:
        """Add observables and noise to the scene."""
        for name, expression in outputs.expressions.items():
            try:
                self.scene.output(name, expression)
            except ModelError as error:
                raise SceneError(f"{self._tables.file}: {error}") from None

    def _added_parameters(self) -> dict[str, str]:
        """Declare parameters of observables and noise that are not in the model."""
        tables = self._tables
        names: dict[str, None] = {}
        for observable in tables.observables.values():
            for text in (observable.formula, observable.noise):
                names.update(dict.fromkeys(_names_in(text)))
        for row in tables.measurements:
            given = (*row.observable_parameters, *row.noise_parameters)
            names.update(dict.fromkeys(value for value in given if isinstance(value, str)))
        columns = {c for row in tables.conditions.values() for c in row.cells}
        known = {*tables.parameters, *columns}
        added = {}
        for name in names:
            if name in known and name not in self._sbml.symbols:
                added[name] = self._namer.own(name)
                known_as = tables.parameters.get(name)
                nominal = known_as.nominal if known_as else None
                value = 1.0 if nominal is None else nominal
                self.scene.parameter(added[name], value)
        return added

    def _entities(self) -> Entities:
        """List the quantities that can be set."""
        parameters, states, initial = dict(self._added), {}, {}
        tables = self._tables
        used = {c for row in tables.conditions.values() for c in row.cells} | {*tables.parameters}
        freed, numbers = set(), {}
        for identifier, symbol in self._sbml.symbols.items():
            if symbol.state:
                if symbol.factor and identifier in used:
                    raise SceneError(
                        f"{tables.file}: the initial value of '{identifier}' cannot be set, since "
                        "the size of its compartment changes"
                    )
                states[identifier] = symbol.state
                if symbol.initial and self._is_number(symbol.initial):
                    initial[identifier] = symbol.initial
            elif symbol.initial == symbol.name:
                if not self._is_number(symbol.name):
                    if identifier not in used:
                        continue
                    # The tables replace its initial assignment.
                    self.scene.set(symbol.name, 1.0)
                    freed.add(identifier)
                elif identifier not in self._sbml.assumed:
                    numbers[identifier] = self.scene.parameters[symbol.name].number
                parameters[identifier] = symbol.name
            elif identifier in tables.parameters:
                raise tables.parameters[identifier].row.error(
                    f"'{identifier}' cannot be set, since a rule of the model determines it"
                )
        columns = {c for row in tables.conditions.values() for c in row.cells}
        valueless = {name for name in self._added if name in columns} | freed | self._sbml.assumed
        return Entities(parameters, states, initial, frozenset(valueless), numbers)

    def _is_number(self, parameter: str) -> bool:
        return not self.scene.parameters[parameter].is_derived


def _names_in(text: str) -> tuple[str, ...]:
    try:
        return tuple(n for n in Formula(text).names if not PLACEHOLDER.match(n))
    except ModelError:
        return ()  # the error is raised where the formula is used, with its row


def _values(tables: Tables) -> dict[str, float]:
    """Collect values from the tables for quantities to which the model may give none."""
    found: dict[str, float] = {}
    for condition in tables.conditions.values():
        for name, cell in condition.cells.items():
            found.setdefault(name, cell if isinstance(cell, float) else 1.0)
    for name, row in tables.parameters.items():
        found[name] = 1.0 if row.nominal is None else row.nominal
    return found


#: Names and settings of consecutive runs; values are measured in the last one.
Chain = tuple[tuple[str, Settings], ...]


@dataclass(frozen=True, eq=False)
class Mapped:
    """A PEtab problem in the form of an estimation problem."""

    scene: Scene  # the model with its outputs
    #: As in an estimation problem; measured values are in the order of the measurement tables.
    estimated: tuple[Estimated, ...]
    conditions: tuple[Condition, ...]
    measured: Measured
    nominal: dict[str, float]  # nominal values of estimated parameters


def mapped(tables: Tables) -> Mapped:
    """Assemble the problem and compile its model."""
    rows = [row for row in tables.parameters.values() if row.is_estimated]
    if not rows:
        raise SceneError(f"{tables.file}: no parameter is estimated: set 'estimate' to 1 in a row")
    found = PetabModel(tables)
    outputs = Outputs(tables, found.meaning, found.new_name)
    pairs = [outputs.of_row(row) for row in tables.measurements]
    found.add_outputs(outputs)
    reader = ConditionReader(tables, found.entities)
    runs = [Run.of(row) for row in tables.measurements]
    chains = {run: _chain(run, reader) for run in dict.fromkeys(runs)}
    try:
        model = found.scene.compile(_wanted(chains.values()))
    except ModelError as error:
        raise type(error)(f"{tables.file}: {error}") from None
    conditions = _conditions(chains.values(), model)
    place = {run: i for i, run in enumerate(chains)}
    observables = [tables.observables[row.observable] for row in tables.measurements]
    measured = Measured(
        condition=np.array([place[run] for run in runs], dtype=np.intp),
        t=np.array([0.0 if math.isinf(row.t) else row.t for row in tables.measurements]),
        observable=[observable for observable, _ in pairs],
        value=np.array([row.value for row in tables.measurements]),
        noise=[noise for _, noise in pairs],
        transformation=[row.transformation for row in observables],
        distribution=[row.distribution for row in observables],
    )
    nominal = {row.name: row.nominal for row in rows if row.nominal is not None}
    estimated = tuple(_estimated(row) for row in rows)
    return Mapped(found.scene, estimated, conditions, measured, nominal)


def _estimated(row: ParameterRow) -> Estimated:
    # Rounding may put nominal values slightly out of bounds; starts must be within them.
    start = None if row.nominal is None else min(max(row.nominal, row.lower), row.upper)
    return Estimated(row.name, row.lower, row.upper, row.scale, start)


def _chain(run: Run, reader: ConditionReader) -> Chain:
    """Return the runs up to the measured values; all but the last end at a steady state."""
    chain: Chain = ()
    if run.before:
        chain = ((run.before, reader.settings(run.before)),)
        own = reader.settings_after(run.condition, chain[0][1])
    else:
        own = reader.settings(run.condition)
    chain = (*chain, (run.name, own))
    if run.is_at_rest:
        # Values at a steady state are those at the start of a run that begins there.
        chain = (*chain, (f"{run.name} at rest", Settings(own.parameters)))
    return chain


def _wanted(chains: Iterable[Chain]) -> list[str]:
    """List the parameters and initial values to which sensitivities are needed."""
    found: dict[str, None] = {}
    for _, settings in (link for chain in chains for link in chain):
        for table in (settings.parameters, settings.initial):
            found.update(dict.fromkeys(k for k, v in table.items() if isinstance(v, str)))
    return list(found)


def _conditions(chains: Iterable[Chain], model: Model) -> tuple[Condition, ...]:
    """Make the conditions; those that begin at the same steady state share the runs before."""
    leading: dict[tuple[object, ...], Condition] = {}
    found = []
    for *before, (name, own) in chains:
        last: Condition | None = None
        for its_name, its in before:
            key = (its_name, last, *_key_of(its.parameters), *_key_of(its.initial))
            last = leading.setdefault(
                key, Condition(its_name, model, its.parameters, its.initial, before=last)
            )
        found.append(Condition(name, model, own.parameters, own.initial, before=last))
    return tuple(found)


def _key_of(settings: dict[str, Setting]) -> tuple[object, ...]:
    return tuple(sorted(settings.items()))
