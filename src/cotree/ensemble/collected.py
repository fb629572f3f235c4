"""The results of all members in whole arrays, filled as blocks of them arrive in any order."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.ensemble.reasons import Reasons
from cotree.ensemble.results import NOT_RUN, Results, n_sensitivities
from cotree.errors import SolveError

if TYPE_CHECKING:
    from cotree.ensemble.dataset import Frame
    from cotree.ensemble.plan import Block, Plan


class Collected(Results):
    """Results of members, nan for those that no block has brought yet.

    Parameters
    ----------
    frame : Frame
        What their Dataset is made of, but for them.

    Attributes
    ----------
    done : int
        Members that were run.
    reasons : Reasons
        Those of them that failed.

    Raises
    ------
    SolveError
        If their results cannot be held in memory.
    """

    def __init__(self, frame: Frame) -> None:
        n_members = len(frame.members.rows)
        check_memory(member_bytes(frame.plan) * n_members, n_members)
        super().__init__(frame.plan, n_members)
        self._frame = frame
        self.done, self.reasons = 0, Reasons()

    def take(self, first: int, block: Block) -> None:
        """Take the results of some members, of which the first is given by its number."""
        there = slice(first, first + len(block.status))
        self.z[there], self.outputs[there] = block.z, block.outputs
        self.slopes[there] = block.output_sensitivities
        self.status[there], self.messages[there] = block.status, block.messages
        self.steps[there], self.seconds[there] = block.steps, block.seconds
        own = block.happened
        self.add_happened(np.column_stack([own.member + first, own.event, own.t, own.s]))
        self.done += int(np.count_nonzero(block.status != NOT_RUN))
        self.reasons.add(first, block.status, block.messages)

    def close(self) -> None:
        """Hold nothing open, as a store does."""

    def dataset(self) -> Any:
        """Put them into an ``xarray.Dataset``."""
        return self._frame.dataset(self._frame.variables(self._frame.shape, self.block()))


def member_bytes(plan: Plan) -> int:
    """Give the bytes of the results of one member, events left out."""
    n_values = len(plan.model.states) + len(plan.model.layout.positions) + len(plan.outputs)
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
