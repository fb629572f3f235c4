"""The model of a PEtab problem: a scene from an SBML file, with outputs for the measured values."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cotree.api import Scene
from cotree.errors import ModelError, SceneError
from cotree.estimation.petab_conditions import Entities
from cotree.estimation.petab_formulas import Formula
from cotree.estimation.petab_outputs import PLACEHOLDER, Outputs
from cotree.readers.names import Namer
from cotree.readers.sbml import read_sbml_model

if TYPE_CHECKING:
    from cotree.estimation.petab_tables import Tables
    from cotree.readers.sbml_model import SbmlModel


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
        """Add observables and noise to the scene.

        Raises
        ------
        SceneError
            If the scene does not accept one.
        """
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
