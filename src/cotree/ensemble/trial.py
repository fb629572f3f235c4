"""Execution of members one at a time, and trial runs before an ensemble.

SciPy methods, and inputs that are Python functions, require members to run one at a time.
"""

from __future__ import annotations

import contextlib
import time
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.ensemble.plan import Block, Plan
from cotree.errors import Error
from cotree.methods import METHODS, method_row
from cotree.quiet import level_of_user, without_warnings
from cotree.solvers.result import FAILED
from cotree.solvers.select import probe_steps
from cotree.solvers.simulate import simulate

if TYPE_CHECKING:
    from collections.abc import Sequence
    from threading import Event

    from cotree.ensemble.members import Members
    from cotree.model.model import CompiledModel
    from cotree.scene.settings import Settings
    from cotree.solvers.result import FloatArray, RunRecord


def run_one_by_one(plan: Plan, rows: FloatArray, *, stop: Event | None = None) -> Block:
    """Run the members with the given rows one after another."""
    block = Block(plan, len(rows))
    for i, row in enumerate(rows.tolist()):
        if stop is not None and stop.is_set():
            break
        run_member(plan, row, block, i)
    return block.finished()


def run_member(plan: Plan, row: Sequence[float], block: Block, member: int) -> None:
    """Run one member by ``simulate``, and add its results to a block."""
    begun = time.perf_counter()
    try:
        settings = settings_of(plan.model, plan.settings, plan.columns, row)
        with without_warnings():  # messages of results contain the same texts
            block.add_run(plan, member, simulate(plan.model, settings))
    except Error as error:
        block.fail(member, FAILED, str(error))
    block.seconds[member] += time.perf_counter() - begun


def settings_of(
    model: CompiledModel, settings: Settings, columns: Sequence[str], row: Sequence[float]
) -> Settings:
    """Return the settings of one member."""
    own = dict(zip(columns, row, strict=True))
    initial = {name: value for name, value in own.items() if name not in model.parameters}
    p = model.parameter_array(settings.parameters)
    # Values are checked one by one, as for a single run.
    for name in own.keys() - initial.keys():
        place = model.parameters.index(name)
        p[place] = model.parameter_array({name: own[name]})[place]
    return replace(settings, parameters=p, initial={**settings.initial, **initial})


#: Default number of evenly spaced output times of an ensemble.
POINTS = 101

# Number of steps that a trial run takes after the choice of its method.
_TRIAL_STEPS = 10

# Method if all trials fail. Each member then reports why it fails with this method.
_OTHERWISE = "dop853"

# Number of members that are run on trial if the run with the scene's values fails.
_TRIED = 3


def tried_settings(model: CompiledModel, settings: Settings, members: Members) -> Settings:
    """Check settings by trial runs, and return them with the chosen method.

    "auto" is chosen once for all members, from the first steps with the scene's values, and with
    the members that have the smallest and the largest value of each column. If one of these is
    stiff, the method is one for stiff problems. Members that become stiff later are detected when
    they run.
    """
    settings = replace(settings, throw=False)
    if settings.method != "auto":
        method_row(settings.method)
    most = probe_steps(settings.rtol) + _TRIAL_STEPS
    short = replace(settings, max_steps=min(settings.max_steps or most, most))
    base = _first_success(model, short, members)
    if settings.method != "auto":
        return settings
    runs = [base] if base else []
    for row in _extremes(members) if base else ():
        # Members with invalid values fail later, with a message.
        with contextlib.suppress(Error), without_warnings():
            runs.append(simulate(model, settings_of(model, short, members.columns, row)))
    begun = [run.statistics.began_with or run.statistics.method for run in runs]
    stiff = [method for method in begun if METHODS[method].implicit]
    return replace(settings, method=[*stiff, *begun, _OTHERWISE][0])


def _first_success(model: CompiledModel, settings: Settings, members: Members) -> RunRecord | None:
    """Run with the scene's values or, if that fails, with those of the first members."""
    try:
        return _run_with_warnings(model, settings)
    except Error as error:
        found = error
    reasons = {str(found)}
    for row in members.rows[:_TRIED].tolist():
        try:
            with without_warnings():
                return simulate(model, settings_of(model, settings, members.columns, row))
        except Error as error:
            reasons.add(str(error))
    if len(reasons) == 1:
        raise found
    return None


def _run_with_warnings(model: CompiledModel, settings: Settings) -> RunRecord:
    """Run once, and pass on all warnings except the one that the trial ended early."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = simulate(model, settings)
    for warning in caught:
        if str(warning.message) != run.message:
            warnings.warn(str(warning.message), warning.category, stacklevel=level_of_user())
    return run


def _extremes(members: Members) -> list[list[float]]:
    rows = members.rows
    # Rows are sorted, so that the choice among equal values does not depend on their order.
    ordered = rows[np.lexsort(rows.T[::-1])] if rows.shape[1] else rows
    places = {*np.argmin(ordered, axis=0).tolist(), *np.argmax(ordered, axis=0).tolist()}
    found: list[list[float]] = ordered[sorted(places)].tolist()
    return found
