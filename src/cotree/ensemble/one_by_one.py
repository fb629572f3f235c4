"""Members of an ensemble as runs of their own, where no batch in C can have them.

Models without a compiler and methods that run in Python come here.
"""

from __future__ import annotations

import time
import warnings
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from cotree.ensemble.plan import Block, Happened
from cotree.errors import Error
from cotree.solvers.evaluate import FAILED
from cotree.solvers.simulate import simulate

if TYPE_CHECKING:
    from cotree.ensemble.plan import Plan
    from cotree.solvers.base import FloatArray
    from cotree.solvers.result import RunRecord


def run_one_by_one(plan: Plan, rows: FloatArray) -> Block:
    """Run members one after another.

    Parameters
    ----------
    plan : Plan
        What they share.
    rows : ndarray, shape (n_members, n_columns)
        What they set.
    """
    layout, shape = plan.model.layout, np.shape(plan.settings.t_eval)
    n, n_s, n_y = len(plan.model.states), _n_sensitivities(plan), len(plan.outputs)
    n_members, n_t = len(rows), shape[0]
    z = np.full((n_members, n_t, n * (1 + n_s)), np.nan)
    outputs = np.full((n_members, n_t, n_y), np.nan)
    slopes = np.full((n_members, n_t, n_s, n_y), np.nan)
    status, steps = np.zeros(n_members, dtype=np.int8), np.zeros(n_members, dtype=np.int64)
    seconds, messages, happened = np.zeros(n_members), [""] * n_members, []
    places = [plan.model.outputs.index(name) for name in plan.outputs]
    for i, row in enumerate(rows.tolist()):
        begun = time.perf_counter()
        run, messages[i] = _run(plan, row)
        seconds[i] = time.perf_counter() - begun
        status[i] = FAILED if run is None else run.status
        if run is None or run.status != 0:
            continue
        reached = len(run.t)
        z[i, :reached, :n] = run.y.T
        z[i, :reached, n:] = run.s[:, :n_s].transpose(2, 1, 0).reshape(reached, n_s * n)
        outputs[i, :reached] = run.output_values[places].T
        slopes[i, :reached] = run.output_sensitivities[places, :n_s].transpose(2, 1, 0)
        steps[i] = run.statistics.n_steps
        happened += _happened(run, i, [event.name for event in layout.events], n_s)
    return Block(
        z, outputs, slopes, status, tuple(messages), steps, seconds, gathered(happened, n_s)
    )


def gathered(rows: list[tuple[int, int, float, FloatArray]], n_sensitivities: int) -> Happened:
    """Put events together: the member, the event, its time and the sensitivities of that."""
    rows.sort(key=lambda row: (row[0], row[2]))
    return Happened(
        np.array([row[0] for row in rows], dtype=np.intp),
        np.array([row[1] for row in rows], dtype=np.intp),
        np.array([row[2] for row in rows], dtype=float),
        np.array([row[3] for row in rows], dtype=float).reshape(len(rows), n_sensitivities),
    )


def _n_sensitivities(plan: Plan) -> int:
    """Count the parameters of sensitivity of a run."""
    return len(plan.model.sensitivities) if plan.has_sensitivities else 0


def _run(plan: Plan, row: list[float]) -> tuple[RunRecord | None, str]:
    """Run one member: its record, if it has one, and the reason of a failure."""
    settings, model = plan.settings, plan.model
    own = dict(zip(plan.columns, row, strict=True))
    initial = {name: value for name, value in own.items() if name in model.states}
    p = model.parameter_array(settings.parameters)
    try:
        # The same checks as of one run, value by value.
        for name in own.keys() - initial.keys():
            place = model.parameters.index(name)
            p[place] = model.parameter_array({name: own[name]})[place]
        settings = replace(settings, parameters=p, initial={**settings.initial, **initial})
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a message says the same
            run = simulate(model, settings, {})
    except Error as error:
        return None, str(error)
    return run, run.message if run.status != 0 else ""


def _happened(
    run: RunRecord, member: int, names: list[str], n_s: int
) -> list[tuple[int, int, float, FloatArray]]:
    """List the events of one run."""
    return [
        (member, names.index(name), float(t), row.s[:n_s, j])
        for name, row in run.events.items()
        for j, t in enumerate(row.t)
    ]
