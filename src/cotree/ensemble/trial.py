"""Members that run one at a time, and trial runs before an ensemble.

Methods of SciPy, and inputs sampled by Python functions, have no loop over members in C.

In: a model, settings and members. Out: settings with times and a method by name.
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
    """Run members one after another."""
    block = Block(plan, len(rows))
    for i, row in enumerate(rows.tolist()):
        if stop is not None and stop.is_set():
            break
        run_member(plan, row, block, i)
    return block.finished()


def run_member(plan: Plan, row: Sequence[float], block: Block, member: int) -> None:
    """Run one member by ``simulate``, and add it to a block."""
    begun = time.perf_counter()
    try:
        settings = settings_of(plan.model, plan.settings, plan.columns, row)
        with without_warnings():  # warnings are left out: error messages have the same text
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
    # The same checks as for a single run, value by value.
    for name in own.keys() - initial.keys():
        place = model.parameters.index(name)
        p[place] = model.parameter_array({name: own[name]})[place]
    return replace(settings, parameters=p, initial={**settings.initial, **initial})


#: Number of evenly spaced output times of an ensemble for which none are given.
POINTS = 101

# Number of steps of a trial in addition to those for the choice of the method.
_TRIAL_STEPS = 10

# Method used if no trial succeeds: each member then reports the cause of its failure.
_OTHERWISE = "dop853"

# Number of members that are tried if the run with the scene's values fails.
_TRIED = 3


def tried_settings(model: CompiledModel, settings: Settings, members: Members) -> Settings:
    """Try settings; return them with the name of a method.

    Wrong settings raise before any member runs. The method ``auto`` is chosen once for all members,
    from the first steps of runs with the values of the scene, and with those of the members that
    have the smallest and the largest value of each column. If one of them is stiff, the method is
    one for stiff problems. Members that become stiff later are detected when they run.
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
        # Members with refused values fail later, with a message.
        with contextlib.suppress(Error), without_warnings():
            runs.append(simulate(model, settings_of(model, short, members.columns, row)))
    begun = [run.statistics.began_with or run.statistics.method for run in runs]
    stiff = [method for method in begun if METHODS[method].implicit]
    return replace(settings, method=[*stiff, *begun, _OTHERWISE][0])


def _first_success(model: CompiledModel, settings: Settings, members: Members) -> RunRecord | None:
    """Run with the scene's own values, or with those of the first members if these fail.

    Raises
    ------
    ModelError, SolveError
        If all fail for the same reason, which is then in the settings.
    """
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
    """Run, and repeat warnings except that about the end of the trial."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = simulate(model, settings)
    for warning in caught:
        if str(warning.message) != run.message:
            warnings.warn(str(warning.message), warning.category, stacklevel=level_of_user())
    return run


def _extremes(members: Members) -> list[list[float]]:
    """Return the members with the smallest and the largest value of each column."""
    rows = members.rows
    # Sorted, so that among equal values the choice does not depend on the order of members.
    ordered = rows[np.lexsort(rows.T[::-1])] if rows.shape[1] else rows
    places = {*np.argmin(ordered, axis=0).tolist(), *np.argmax(ordered, axis=0).tolist()}
    found: list[list[float]] = ordered[sorted(places)].tolist()
    return found
