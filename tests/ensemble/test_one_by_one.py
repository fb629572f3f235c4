"""Members that run one after another."""

import numpy as np
import pytest

import cotree
from cotree.ensemble.plan import Plan
from cotree.ensemble.trial import run_one_by_one
from cotree.scene.settings import Settings

TIMES = np.linspace(0.0, 2.0, 5)


@pytest.fixture(scope="module")
def model():
    return cotree.load("slider-pendulum").compile(["L"])


def test_each_member_is_a_run(model):
    plan = Plan(model.kernels, Settings((0.0, 2.0), TIMES), ("L", "j1.s"), ("rod_x",))
    block = run_one_by_one(plan, np.array([[1.0, 0.5], [1.1, 0.4]]))
    run = model.simulate((0, 2), TIMES, parameters={"L": 1.1}, initial={"j1.s": 0.4})
    assert block.status.tolist() == [0, 0]
    np.testing.assert_array_equal(block.z[1, :, :4].T, run.y)
    np.testing.assert_array_equal(block.z[1, :, 4:].T, run.s[:, 0])
    np.testing.assert_array_equal(block.outputs[1, :, 0], run["rod_x"])
    np.testing.assert_array_equal(
        block.output_sensitivities[1, :, 0, 0], run.sensitivity("rod_x", "L")
    )


def test_a_member_that_fails_is_nan_with_its_sentence(model):
    plan = Plan(model.kernels, Settings((0.0, 2.0), TIMES), ("m1",))
    block = run_one_by_one(plan, np.array([[1.0], [-1.0]]))
    assert block.status.tolist() == [0, -1]
    assert "m1" in block.messages[1]
    assert np.isnan(block.z[1]).all()
    assert np.isfinite(block.z[0]).all()


def test_events_are_listed_by_member():
    model = cotree.load("bouncing-ball").compile()
    plan = Plan(model.kernels, Settings((0.0, 2.0), TIMES), (model.parameters[0],))
    value = model.default_parameters[0]
    block = run_one_by_one(plan, np.array([[value], [1.1 * value]]))
    runs = [
        model.simulate((0, 2), TIMES, parameters={model.parameters[0]: v})
        for v in (value, 1.1 * value)
    ]
    times = [t for run in runs for row in run.events.values() for t in row.t]
    assert block.events[:, 2].tolist() == times
    assert set(block.events[:, 0].tolist()) == {0, 1}
