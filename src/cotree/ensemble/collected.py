"""The results of all members in whole arrays, filled as blocks of them arrive in any order."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING

import numpy as np

from cotree.ensemble.results import NOT_RUN, Results, n_sensitivities
from cotree.errors import SolveError

if TYPE_CHECKING:
    from cotree.ensemble.plan import Block, Plan


class Collected(Results):
    """Results of members, nan for those that no block has brought yet.

    Parameters
    ----------
    plan : Plan
        What they share.
    n_members : int
        Number of members.

    Attributes
    ----------
    done, failed : int
        Members that were run, and those of them that failed.

    Raises
    ------
    SolveError
        If their results cannot be held in memory.
    """

    def __init__(self, plan: Plan, n_members: int) -> None:
        check_memory(member_bytes(plan) * n_members, n_members)
        super().__init__(plan, n_members)
        self.done = self.failed = 0

    def take(self, first: int, block: Block) -> None:
        """Take the results of some members, of which the first is given by its number."""
        there = slice(first, first + len(block.status))
        self.z[there], self.outputs[there] = block.z, block.outputs
        self.slopes[there] = block.output_sensitivities
        self.status[there], self.messages[there] = block.status, block.messages
        self.steps[there], self.seconds[there] = block.steps, block.seconds
        own = block.happened
        self.add_happened(np.column_stack([own.member + first, own.event, own.t, own.s]))
        was_run = block.status != NOT_RUN
        self.done += int(was_run.sum())
        self.failed += int((was_run & (block.status != 0)).sum())


def member_bytes(plan: Plan) -> int:
    """Give the bytes of the results of one member, events left out."""
    n_values = len(plan.model.states) + len(plan.outputs)
    return 8 * int(np.size(plan.settings.t_eval)) * n_values * (1 + n_sensitivities(plan))


def check_memory(n_bytes: int, n_members: int) -> None:
    """Refuse results that are larger than the memory of the machine.

    Raises
    ------
    SolveError
        If they are.
    """
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return  # a system that does not tell
    if n_bytes > there:
        raise SolveError(
            f"the results of {n_members} members take {n_bytes / 2**30:.3g} GiB, and this machine "
            f"has {there / 2**30:.3g} GiB of memory: ask for fewer times or outputs, for no "
            "sensitivities, or give a store"
        )
