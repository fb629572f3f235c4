"""A worker: what one thread needs to run members of a block in C, and what it does besides."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cotree.tolerances import LIMITS

if TYPE_CHECKING:
    from cotree.ensemble.block_in_c import BlockInC
    from cotree.solvers.base import FloatArray

# Results of cotree_batch_work.
_EMPTY, _GLANCE, _ROOM, _ASK, _STOPPED = range(5)


class Worker:
    """Runs members in the thread that calls it; it is mutable.

    Parameters
    ----------
    members : BlockInC
        The members, which other workers take from, too.
    """

    def __init__(self, members: BlockInC) -> None:
        self._members, self._lib = members, members.library.lib
        self._ffi = members.library.ffi
        self._kept: dict[str, Any] = {}
        problem, model = members.pattern.problem, members.pattern.plan.model
        assert problem.t_eval is not None  # a plan gives them
        n_t, m, n_y = len(problem.t_eval), problem.n_sensitivities, len(model.outputs)
        n_y = n_y if members.batch.n_outputs else 0
        c = self._worker = self._ffi.new("cotree_worker *")
        c.batch, c.member = members.batch, -1
        for name, size in (
            ("k", members.batch.pattern.model.n_prepared),
            ("u", len(model.inputs)),
            ("z", problem.size),
            ("times", n_t),
            ("inputs", n_t * len(model.inputs) if n_y else 0),
            ("outputs", n_t * n_y),
            ("slopes", n_t * m * n_y),
        ):
            setattr(c, name, self._room(name, size))
        c.memory = self._room("memory", -(-int(members.batch.memory) // 8))
        self._happened = np.zeros((0, 3 + m))
        self._width, self._at_once = 0, 0
        if problem.events is not None:
            self._width = 2 + m + 2 * problem.n_states
            # The most records of one step: C returns where there is no room for as many.
            self._at_once = len(problem.events.rows) + LIMITS.event_rounds
            self._make_room()

    def go_on(self, glance: float = 0.0) -> bool:
        """Run members until something is to be done here, or for some time; tell if any is left.

        Parameters
        ----------
        glance : float
            That time, [s]; zero for as long as there are members.
        """
        c, members = self._worker, self._members
        members.batch.glance = glance
        result = self._lib.cotree_batch_work(c)
        if result == _ROOM:
            self._make_room()
        elif result == _ASK:
            member, c.member = int(c.member), -1
            members.run_alone(member)
        elif result in (_EMPTY, _STOPPED):
            self._lib.cotree_batch_close(c)
            return False
        return True

    def happened(self) -> FloatArray:
        """Give the events of the members that it ran: member, event, time and its derivatives."""
        return self._happened[: int(self._worker.n_happened)]

    def _make_room(self) -> None:
        """Make more room for events; existing ones stay."""
        c = self._worker
        n_records = int(c.job.n_records)
        # Both grow by what one of them lacks: the events of one member, and those of all.
        most = max(4 * self._at_once, 2 * n_records)
        records = np.zeros((most, self._width))
        if "records" in self._kept:
            records[:n_records] = self._kept["records"][:n_records]
        c.records, c.most_records = self._point("records", records), most
        n, m = int(c.n_happened), self._happened.shape[1]
        happened = np.zeros((max(most, 2 * (n + n_records)), m))
        happened[:n] = self._happened[:n]
        self._happened = happened
        c.happened, c.most_happened = self._point("happened", happened), len(happened)

    def _room(self, name: str, size: int) -> Any:
        return self._point(name, np.zeros(max(1, size)))

    def _point(self, name: str, array: FloatArray) -> Any:
        self._kept[name] = array
        return self._ffi.from_buffer("double[]", array)
