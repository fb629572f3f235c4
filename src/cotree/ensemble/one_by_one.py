"""Members of an ensemble as runs of their own, where no batch in C can have them.

Models without a compiler and methods that run in Python come here.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

from cotree.ensemble.results import Results
from cotree.errors import Error
from cotree.quiet import without_warnings
from cotree.solvers.evaluate import FAILED
from cotree.solvers.simulate import simulate

if TYPE_CHECKING:
    from collections.abc import Sequence
    from threading import Event

    from cotree.ensemble.plan import Block, Plan
    from cotree.model.model import CompiledModel
    from cotree.solvers.base import FloatArray
    from cotree.solvers.settings import Settings


def run_one_by_one(plan: Plan, rows: FloatArray, *, stop: Event | None = None) -> Block:
    """Run members one after another.

    Parameters
    ----------
    plan : Plan
        What they share.
    rows : ndarray, shape (n_members, n_columns)
        What they set.
    stop : threading.Event, optional
        Once it is set, no other member is begun.
    """
    results = Results(plan, len(rows))
    for i, row in enumerate(rows.tolist()):
        if stop is not None and stop.is_set():
            break
        run_member(plan, row, results, i)
    return results.block()


def run_member(plan: Plan, row: Sequence[float], results: Results, member: int) -> None:
    """Run one member by itself, as ``simulate`` does, and put it among the results."""
    begun = time.perf_counter()
    try:
        settings = settings_of(plan.model, plan.settings, plan.columns, row)
        settings = replace(settings, sensitivities=plan.has_sensitivities)
        with without_warnings():  # a message says the same
            results.put(member, simulate(plan.model, settings, {}))
    except Error as error:
        results.fail(member, FAILED, str(error))
    results.seconds[member] += time.perf_counter() - begun


def settings_of(
    model: CompiledModel, settings: Settings, columns: Sequence[str], row: Sequence[float]
) -> Settings:
    """Give the settings of one member.

    Raises
    ------
    ParameterError
        If a value is not accepted.
    """
    own = dict(zip(columns, row, strict=True))
    initial = {name: value for name, value in own.items() if name not in model.parameters}
    p = model.parameter_array(settings.parameters)
    # The same checks as of one run, value by value.
    for name in own.keys() - initial.keys():
        place = model.parameters.index(name)
        p[place] = model.parameter_array({name: own[name]})[place]
    return replace(settings, parameters=p, initial={**settings.initial, **initial})
