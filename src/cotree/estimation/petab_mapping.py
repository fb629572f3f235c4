"""Mapping of PEtab's tables to conditions, measured values and estimated parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ModelError, SceneError
from cotree.estimation.conditions import Condition, Measured
from cotree.estimation.estimated import Estimated
from cotree.estimation.petab_conditions import ConditionReader, Run, Settings
from cotree.estimation.petab_model import PetabModel
from cotree.estimation.petab_outputs import Outputs

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.api import Scene
    from cotree.compiled import Model
    from cotree.estimation.petab_conditions import Setting
    from cotree.estimation.petab_tables import ParameterRow, Tables

#: Names and settings of consecutive runs; values are measured in the last one.
Chain = tuple[tuple[str, Settings], ...]


@dataclass(frozen=True, eq=False)
class Mapped:
    """A PEtab problem in the form of an estimation problem.

    Attributes
    ----------
    scene : Scene
        The model with its outputs.
    estimated, conditions, measured
        As in an estimation problem; measured values are in the order of the measurement tables.
    nominal : dict of str to float
        Nominal values of estimated parameters.
    """

    scene: Scene
    estimated: tuple[Estimated, ...]
    conditions: tuple[Condition, ...]
    measured: Measured
    nominal: dict[str, float]


def mapped(tables: Tables) -> Mapped:
    """Assemble the problem and compile its model.

    Parameters
    ----------
    tables : Tables
        The tables.

    Raises
    ------
    ModelError, FormulationError, BuildError
        If a row is invalid, or the model cannot be formed or compiled.
    """
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
            key = (its_name, last, *_told(its.parameters), *_told(its.initial))
            last = leading.setdefault(
                key, Condition(its_name, model, its.parameters, its.initial, before=last)
            )
        found.append(Condition(name, model, own.parameters, own.initial, before=last))
    return tuple(found)


def _told(settings: dict[str, Setting]) -> tuple[object, ...]:
    return tuple(sorted(settings.items()))
