"""Reasons why members failed, and how often each occurred."""

from __future__ import annotations

import re
from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.plan import NOT_RUN
from cotree.solvers.budgets import events_spent, steps_spent, time_spent
from cotree.solvers.messages import with_growth
from cotree.solvers.native import stiffness_note, summary
from cotree.solvers.result import BUDGET_SPENT, FloatArray, Statistics, Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from cotree.solvers.problem import RunProblem


_NUMBER = re.compile(r"[-+.\d]+(e[-+]?\d+)?")


class Reasons:
    """Counts of the distinct messages of failed members.

    ``first`` is the index and message of the failed member with the lowest index.
    """

    def __init__(self) -> None:
        self.done = self.failed = 0
        self.first: tuple[int, str] | None = None
        self._counts: Counter[str] = Counter()
        self._shown: dict[str, tuple[int, str]] = {}

    def add(self, first: int, status: npt.NDArray[np.int8], messages: Sequence[str]) -> None:
        """Add the members of a block; ``first`` is the index of its first member."""
        self.done += int(np.count_nonzero(status != NOT_RUN))
        for i in np.flatnonzero((status != 0) & (status != NOT_RUN)).tolist():
            row = first + i, str(messages[i])
            reason = _NUMBER.sub("#", row[1])
            self.failed += 1
            self._counts[reason] += 1
            self._shown[reason] = min(row, self._shown.get(reason, row))
            self.first = row if self.first is None else min(row, self.first)

    def summary(self, n_members: int) -> str:
        """Return the number of failures and the most frequent reason as text; empty if none."""
        if not self.failed:
            return ""
        # Of equally frequent reasons, take the one with the first member.
        reason, count = min(self._counts.items(), key=lambda row: (-row[1], self._shown[row[0]]))
        often = f", {count} of them for this reason" if count < self.failed else ""
        return (
            f"{self.failed} of {n_members} members failed and are nan{often}: "
            + (self._shown[reason][1])
        )


#: Outcomes of members in C that exhausted a budget, as in cotree_batch.h.
STEPS_SPENT, EVENTS_SPENT, TIME_SPENT = 7, 8, 9


def budget_message(
    problem: RunProblem, method: str, job: Any, ended: int, kept: FloatArray, last: FloatArray
) -> str:
    """Return a sentence on where a member exhausted its budget and which state grew."""
    settings = problem.settings
    if ended == EVENTS_SPENT:
        reason = events_spent(job.most_events)
    elif ended == STEPS_SPENT:
        reason = steps_spent(settings.max_steps or 0)
    else:
        reason = time_spent(settings.time_limit or 0.0)
    sentences = [*summary(problem, method, float(job.t), reason), stiffness_note(job)]
    assert settings.t_eval is not None  # settings of a plan always contain ``t_eval``
    t, z = settings.t_eval[: len(kept)], kept
    # Like a single run, also test the growth of the last point.
    if not (len(t) and t[-1] == float(job.t)):
        t, z = np.append(t, float(job.t)), np.vstack([z, last])
    work = Statistics(method, 0, 0, 0, int(job.n_steps), 0.0)
    message = " ".join(filter(None, sentences))
    return with_growth(problem, Trajectory(t, z.T, BUDGET_SPENT, message, work)).message
