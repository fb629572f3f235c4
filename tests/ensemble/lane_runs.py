"""Plans of members in lanes, and what is compared of their results."""

import numpy as np

from cotree.ensemble.batch import run_block
from cotree.ensemble.pattern import LoadedLanes, find_lanes, find_pattern
from cotree.ensemble.plan import Plan
from cotree.scene.settings import Settings

TIMES = np.linspace(0.0, 3.0, 41)


def plan_of(model, names, lanes=None, *, times=TIMES, **others):
    settings = {"method": "dop853", "rtol": 1e-7, "atol": 1e-7, **others}
    span = (float(times[0]), float(times[-1]))
    return Plan(model.kernels, Settings(span, times, **settings), names, model.outputs, lanes)


def rows_of(model, names, n):
    values = dict(zip(model.parameters, model.default_parameters, strict=True))
    middle = np.array([values[name] for name in names])
    return middle * np.random.default_rng(2).uniform(0.9, 1.1, (n, len(names)))


def assert_same(block, other):
    for name in ("z", "outputs", "output_sensitivities", "status", "steps"):
        np.testing.assert_array_equal(getattr(block, name), getattr(other, name), name)
    assert block.messages == other.messages


def assert_bits_depend_on_the_member_alone(make, rows, lanes):
    """Run members in numbers of lanes, threads, orders and blocks; ``make(n)`` makes a plan."""
    blocks = {n: run_block(make(n), rows) for n in lanes}
    assert (blocks[2].status == 0).all()
    for block in blocks.values():
        assert_same(block, blocks[2])
    plan, turned = make(None), rows[::-1].copy()
    assert runs_in_lanes(plan)
    assert_same(run_block(plan, rows, threads=2), blocks[2])
    assert_same(run_block(plan, turned), run_block(plan, turned, threads=2))
    np.testing.assert_array_equal(run_block(plan, turned).z[::-1], blocks[2].z)
    np.testing.assert_array_equal(run_block(plan, rows[5:6]).z[0], blocks[2].z[5])


def runs_in_lanes(plan):
    return isinstance(find_lanes(find_pattern(plan)), LoadedLanes)
