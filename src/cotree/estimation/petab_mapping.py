"""From the tables of a PEtab problem to conditions, measured rows and estimated parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from cotree.errors import ModelError, SceneError
from cotree.estimation.conditions import Condition, Measured
from cotree.estimation.estimated import Estimated
from cotree.estimation.petab_conditions import ConditionReader, Run
from cotree.estimation.petab_model import PetabModel
from cotree.estimation.petab_outputs import Outputs

if TYPE_CHECKING:
    from collections.abc import Iterable

    from cotree.api import Scene
    from cotree.compiled import Model
    from cotree.estimation.petab_conditions import Setting, Settings
    from cotree.estimation.petab_tables import ParameterRow, Tables


@dataclass(frozen=True, eq=False)
class Mapped:
    """A PEtab problem in the terms of estimation.

    Attributes
    ----------
    scene : Scene
        The model with its outputs.
    estimated, conditions, measured
        As of an estimation problem; measured rows are those of the measurement tables, in order.
    nominal : dict of str to float
        Nominal values of estimated parameters.
    """

    scene: Scene
    estimated: tuple[Estimated, ...]
    conditions: tuple[Condition, ...]
    measured: Measured
    nominal: dict[str, float]


def mapped(tables: Tables) -> Mapped:
    """Form the problem, and compile its model.

    Parameters
    ----------
    tables : Tables
        The tables.

    Raises
    ------
    ModelError, FormulationError, BuildError
        If a row makes no sense, or the model cannot be formed or compiled.
    """
    rows = [row for row in tables.parameters.values() if row.is_estimated]
    if not rows:
        raise SceneError(f"{tables.file}: no parameter is estimated: 'estimate' is 0 in all rows")
    found = PetabModel(tables)
    outputs = Outputs(tables, found.meaning, found.new_name)
    pairs = [outputs.of_row(row) for row in tables.measurements]
    found.add_outputs(outputs)
    reader = ConditionReader(tables, found.entities)
    runs = [Run.of(row) for row in tables.measurements]
    begins = {run: _settings(run, reader) for run in dict.fromkeys(runs)}
    try:
        model = found.scene.compile(_wanted(begins.values()))
    except ModelError as error:
        raise type(error)(f"{tables.file}: {error}") from None
    conditions = _conditions(begins, model)
    place = {run: i for i, run in enumerate(begins)}
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
    # Nominal values may be out of bounds by a rounding, which a start may not.
    start = None if row.nominal is None else min(max(row.nominal, row.lower), row.upper)
    return Estimated(row.name, row.lower, row.upper, row.scale, start)


def _settings(run: Run, reader: ConditionReader) -> tuple[Settings, Settings | None]:
    """Give what a run sets, and what the run to the steady state before it does."""
    if run.is_at_rest:
        own = reader.settings(run.condition)
        return type(own)(dict(own.parameters)), own
    if not run.before:
        return reader.settings(run.condition), None
    before = reader.settings(run.before)
    return reader.settings_after(run.condition, before), before


def _wanted(begins: Iterable[tuple[Settings, Settings | None]]) -> list[str]:
    """List the parameters and initial values to which sensitivities are needed."""
    found: dict[str, None] = {}
    for pair in begins:
        for settings in pair:
            if settings is None:
                continue
            for table in (settings.parameters, settings.initial):
                found.update(dict.fromkeys(k for k, v in table.items() if isinstance(v, str)))
    return list(found)


def _conditions(
    begins: dict[Run, tuple[Settings, Settings | None]], model: Model
) -> tuple[Condition, ...]:
    """Make the conditions; those that begin at the same steady state share the run to it."""
    first_runs: dict[tuple[object, ...], Condition] = {}
    found = []
    for run, (own, before) in begins.items():
        first = None
        if before is not None:
            name = run.before or run.condition
            key = (name, *_told(before.parameters), *_told(before.initial))
            first = first_runs.setdefault(
                key, Condition(name, model, before.parameters, before.initial)
            )
        found.append(Condition(run.name, model, own.parameters, own.initial, before=first))
    return tuple(found)


def _told(settings: dict[str, Setting]) -> tuple[object, ...]:
    return tuple(sorted(settings.items()))
