"""The model of a PEtab problem: a scene from an SBML file, with outputs for the measured values."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from cotree.api import Scene
from cotree.errors import ModelError, SceneError
from cotree.estimation.conditions import Condition, Measured
from cotree.estimation.petab.conditions import ConditionReader, Entities, Link
from cotree.estimation.petab.formulas import PLACEHOLDER, Formula, Outputs
from cotree.readers.names import Namer
from cotree.readers.sbml.scene import SbmlModel, read_sbml_model

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.compiled import Model
    from cotree.estimation.petab.tables import Tables


class PetabModel:
    """A scene, and the names that its quantities have in the tables.

    ``scene`` is the scene, to which :meth:`add_outputs` adds outputs, ``namer`` has its names, and
    ``entities`` are the quantities that conditions may set.
    """

    def __init__(self, tables: Tables) -> None:
        self._tables = tables
        self._sbml: SbmlModel[Scene] = read_sbml_model(tables.model, Scene, _values(tables))
        self.scene = self._sbml.scene
        self.namer = Namer()
        scene = self.scene
        variables = (*scene.parameters, *scene.outputs, *scene.modes, *scene.inputs)
        for name in (*variables, *scene.edges, *scene.nodes):
            self.namer.own(name)
        self._added = self._added_parameters()
        self.entities = self._entities()

    def meaning(self, name: str) -> str | None:
        """Return the expression for a name in the tables, or None."""
        symbol = self._sbml.symbols.get(name)
        return self._added.get(name) if symbol is None else symbol.name

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
        names: list[str | float] = []
        for observable in tables.observables.values():
            names += [*_names_in(observable.formula), *_names_in(observable.noise)]
        for row in tables.measurements:
            names += [*row.observable_parameters, *row.noise_parameters]
        added = {}
        for name in dict.fromkeys(name for name in names if isinstance(name, str)):
            if name in tables.settable and name not in self._sbml.symbols:
                added[name] = self.namer.own(name)
                known = tables.parameters.get(name)
                self.scene.parameter(added[name], known.value if known else 1.0)
        return added

    def _entities(self) -> Entities:
        """List the quantities that can be set."""
        parameters, states, initial = dict(self._added), {}, {}
        tables = self._tables
        valueless = {*self._added} & tables.columns | self._sbml.assumed
        numbers = {}
        for identifier, symbol in self._sbml.symbols.items():
            if symbol.state:
                if symbol.factor and identifier in tables.settable:
                    raise SceneError(
                        f"{tables.file}: the initial value of '{identifier}' cannot be set, since "
                        "the size of its compartment changes"
                    )
                states[identifier] = symbol.state
                if symbol.initial and self._is_number(symbol.initial):
                    initial[identifier] = symbol.initial
            elif symbol.initial == symbol.name:
                if not self._is_number(symbol.name):
                    if identifier not in tables.settable:
                        continue
                    # The tables replace its initial assignment.
                    self.scene.set(symbol.name, 1.0)
                    valueless.add(identifier)
                elif identifier not in self._sbml.assumed:
                    numbers[identifier] = self.scene.parameters[symbol.name].number
                parameters[identifier] = symbol.name
            elif identifier in tables.parameters:
                raise tables.parameters[identifier].row.error(
                    f"'{identifier}' cannot be set, since a rule of the model determines it"
                )
        return Entities(parameters, states, initial, frozenset(valueless), numbers)

    def _is_number(self, parameter: str) -> bool:
        return not self.scene.parameters[parameter].is_derived


def _names_in(text: str) -> tuple[str, ...]:
    try:
        return tuple(n for n in Formula(text).names if not PLACEHOLDER.match(n))
    except ModelError:
        return ()  # the error is raised where the formula is used, with its row


def _values(tables: Tables) -> dict[str, float]:
    """Return values from the tables, for quantities without a value in the model."""
    found: dict[str, float] = {}
    for condition in tables.conditions.values():
        for name, cell in condition.cells.items():
            found.setdefault(name, cell if isinstance(cell, float) else 1.0)
    for name, row in tables.parameters.items():
        found[name] = row.value
    return found


def mapped(tables: Tables) -> tuple[Scene, tuple[Condition, ...], Measured]:
    """Compile the model; return its scene with outputs, the conditions and the measured values.

    Measured values are in the order of the measurement tables.
    """
    found = PetabModel(tables)
    outputs = Outputs(tables, found.meaning, found.namer.own)
    pairs = [outputs.of_row(row) for row in tables.measurements]
    found.add_outputs(outputs)
    reader = ConditionReader(tables, found.entities)
    runs = [(row.condition, row.before, math.isinf(row.t)) for row in tables.measurements]
    chains = {run: reader.chain(*run) for run in dict.fromkeys(runs)}
    try:
        model = found.scene.compile(_wanted(chains.values()))
    except ModelError as error:
        raise type(error)(f"{tables.file}: {error}") from None
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
    return found.scene, _conditions(chains.values(), model), measured


def _wanted(chains: Iterable[Iterable[Link]]) -> list[str]:
    """List the parameters and initial values to which sensitivities are needed."""
    tables = [table for chain in chains for link in chain for table in link[1:]]
    return list(
        dict.fromkeys(k for table in tables for k, v in table.items() if isinstance(v, str))
    )


def _conditions(chains: Iterable[Iterable[Link]], model: Model) -> tuple[Condition, ...]:
    """Make the conditions; those that begin at the same steady state share the runs before."""
    leading: dict[tuple[object, ...], Condition] = {}
    found = []
    for *before, (name, parameters, initial) in chains:
        last: Condition | None = None
        for link in before:
            key = (link.name, last, *(tuple(sorted(table.items())) for table in link[1:]))
            last = leading.setdefault(
                key, Condition(link.name, model, link.parameters, link.initial, before=last)
            )
        found.append(Condition(name, model, parameters, initial, before=last))
    return tuple(found)
