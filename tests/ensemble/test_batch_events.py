"""Events of members, where a worker gets more room for them."""

import numpy as np
import pytest

import cotree
from cotree.ensemble.batch import Worker, run_block
from cotree.ensemble.plan import Plan
from cotree.ensemble.trial import run_one_by_one
from cotree.scene.settings import Settings


@pytest.mark.compiler
def test_events_are_not_read_from_room_that_was_given_up(monkeypatch):
    """Times of a few members were whatever stood in memory that the worker had freed."""
    whole, given_up = Worker._grow_records, []

    def make_room(worker):
        before = worker._kept.get("records")
        whole(worker)
        if before is not None:
            before[:] = np.nan
            given_up.append(before)

    monkeypatch.setattr(Worker, "_grow_records", make_room)
    ball = cotree.load("bouncing-ball").compile(["e"])
    plan = Plan(ball.kernels, Settings((0.0, 3.0), np.linspace(0.0, 3.0, 3), "dopri5"), ("e",))
    rows = np.linspace(0.3, 0.9, 150)[:, np.newaxis]
    block, wanted = run_block(plan, rows, threads=1), run_one_by_one(plan, rows)
    assert len(given_up) >= 1
    np.testing.assert_array_equal(block.events[:, 2:], wanted.events[:, 2:])
