"""Members in one call into C are the runs that ``simulate`` makes, to the last bit."""

import functools
import threading
from dataclasses import replace

import numpy as np
import pytest
from batches import assert_same, rows_of

import cotree
from cotree.ensemble.batch import run_block
from cotree.ensemble.pattern import find_pattern
from cotree.ensemble.plan import Plan as PlanOfMembers
from cotree.ensemble.trial import run_one_by_one
from cotree.scene.settings import Settings
from cotree.sharing import usable_cores
from cotree.solvers.engine import load_engine
from cotree.solvers.native import engine_of

# Members one after another; those in lanes are tested in test_lanes.py.
Plan = functools.partial(PlanOfMembers, lanes=1)

TIMES = np.linspace(0.0, 2.0, 9)


@pytest.fixture(scope="module")
def slider():
    return cotree.load("slider-pendulum").compile(["L"])


@pytest.fixture(scope="module")
def ball():
    return cotree.load("bouncing-ball").compile(["g", "h"])


def settings_of(**others):
    return Settings((0.0, 2.0), TIMES, **{"method": "dop853", "rtol": 1e-6, **others})


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode", "ida"])
def test_a_member_is_the_run_that_simulate_makes(slider, method):
    names = ("L", "m1", "j1.s", "h2.theta_dot")
    rows = rows_of(slider, 3, names)
    plan = Plan(slider.kernels, settings_of(method=method), names, ("rod_x",))
    block = run_block(plan, rows)
    for i, row in enumerate(rows):
        own = dict(zip(names, row, strict=True))
        run = slider.simulate(
            (0, 2),
            TIMES,
            method=method,
            rtol=1e-6,
            parameters={name: own[name] for name in ("L", "m1")},
            initial={name: own[name] for name in ("j1.s", "h2.theta_dot")},
        )
        np.testing.assert_array_equal(block.z[i, :, :4].T, run.y)
        np.testing.assert_array_equal(block.z[i, :, 4:].T, run.s[:, 0])
        np.testing.assert_array_equal(block.outputs[i, :, 0], run["rod_x"])
        np.testing.assert_array_equal(
            block.output_sensitivities[i, :, 0, 0], run.sensitivity("rod_x", "L")
        )
        assert block.steps[i] == run.statistics.n_steps


def test_members_without_events_have_the_engine_of_single_runs(slider, ball):
    for model in slider, ball:
        pattern = find_pattern(Plan(model.kernels, settings_of(), ()))
        assert pattern.engine is engine_of("dop853", pattern.problem)
        with_events = load_engine("dop853")
        assert (pattern.engine is with_events) is model.kernels.program.layout.has_events


def test_threads_order_and_blocks_change_no_bit(slider):
    names = ("L", "k")
    rows = rows_of(slider, 12, names)
    plan = Plan(slider.kernels, settings_of(), names, slider.outputs)
    block = run_block(plan, rows)
    assert_same(run_block(plan, rows, threads=2), block)
    turned = run_block(plan, rows[::-1], threads=2)
    np.testing.assert_array_equal(turned.z[::-1], block.z)
    parts = [run_block(plan, part) for part in (rows[:5], rows[5:])]
    np.testing.assert_array_equal(np.concatenate([part.z for part in parts]), block.z)


def test_without_sensitivities_a_member_is_a_run_of_the_model_without_them(slider):
    names = ("L", "k")
    rows = rows_of(slider, 3, names)
    plain = cotree.load("slider-pendulum").compile()
    block = run_block(Plan(slider.kernels, settings_of(sensitivities=False), names), rows)
    assert block.z.shape == (3, 9, 4)
    assert_same(block, run_block(Plan(plain.kernels, settings_of(), names), rows))
    run = slider.simulate(
        (0, 2),
        TIMES,
        method="dop853",
        rtol=1e-6,
        parameters=dict(zip(names, rows[0], strict=True)),
        sensitivities=False,
    )
    np.testing.assert_array_equal(block.z[0].T, run.y)


def test_a_member_without_sensitivities_that_fails_says_what_its_run_says(ball):
    settings = Settings((0.0, 8.0), TIMES, "dop853", 1e-6)
    plan = Plan(ball.kernels, replace(settings, sensitivities=False), ("v",), ball.outputs)
    rows = np.array([[0.5], [0.0]])
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, -1]
    assert_same(block, run_one_by_one(plan, rows))


@pytest.mark.parametrize("scales", [{}, {"L": 0.01}])
def test_tolerances_of_sensitivities_follow_each_members_own_parameter(slider, scales):
    # A length of zero counts as one; the rod of the second is a hundred times as long.
    rows = np.array([[1.0], [100.0]])
    for tests in (True, False):
        settings = settings_of(scales=scales, error_test_sensitivities=tests)
        plan = Plan(slider.kernels, settings, ("L",))
        assert_same(run_block(plan, rows), run_one_by_one(plan, rows))


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_events_and_the_sensitivities_of_their_times(ball, method):
    names = ("e", "h", "j.s_dot")
    rows = rows_of(ball, 6, names)
    plan = Plan(ball.kernels, settings_of(method=method), names, ball.outputs)
    block = run_block(plan, rows, threads=2)
    assert_same(block, run_one_by_one(plan, rows))
    # It falls from h with v: h + v t - g t^2 / 2 = 0, so dt/dh = 1 / (g t - v).
    first = np.searchsorted(block.events[:, 0], np.arange(6))
    g = ball.default_parameters[ball.parameters.index("g")]
    t, v, h = block.events[first, 2], rows[:, 2], rows[:, 1]
    # Times are as good as the tolerance of 1e-6.
    np.testing.assert_allclose(h + v * t - g * t * t / 2, 0.0, atol=1e-5)
    np.testing.assert_allclose(block.events[first, 4], 1 / (g * t - v), rtol=1e-5)


def test_many_events_of_one_member_find_room(ball):
    # A ball that loses little speed bounces often; records begin with room for a few hundred.
    plan = Plan(ball.kernels, Settings((0.0, 30.0), TIMES, "dop853", 1e-3), ("h", "e", "v"))
    rows = np.array([[1.0, 0.8, 0.5], [0.1, 0.99, 1e-3], [1.0, 0.8, 0.5]])
    block = run_block(plan, rows)
    assert np.bincount(block.events[:, 0].astype(int))[1] > 300
    assert_same(block, run_one_by_one(plan, rows))


def test_a_member_that_fails_says_what_its_run_says(slider):
    rows = np.array([[1.0, 1.0], [-1.0, 1.0], [np.nan, 1.0], [1.0, np.inf], [1.1, 1.0]])
    plan = Plan(slider.kernels, settings_of(), ("m1", "j1.s"), ("rod_x",))
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, -1, -1, -1, 0]
    assert_same(block, run_one_by_one(plan, rows))
    assert "m1" in block.messages[1]
    # What is beside them is as it is alone.
    np.testing.assert_array_equal(block.z[4], run_block(plan, rows[4:]).z[0])


def test_a_member_that_fails_on_its_way_says_what_its_run_says(ball):
    # Without a speed below which it rests, a ball bounces ever faster.
    rows = np.array([[0.5], [0.0], [0.4]])
    plan = Plan(ball.kernels, Settings((0.0, 8.0), TIMES, "dop853", 1e-6), ("v",), ball.outputs)
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, -1, 0]
    assert "accumulates" in block.messages[1]
    assert 1 not in block.events[:, 0]
    assert_same(block, run_one_by_one(plan, rows))


def test_budgets_hold_for_each_member(slider, ball):
    plan = Plan(slider.kernels, settings_of(max_steps=40), ("L", "k"))
    # A negative spring drives the block away.
    rows = np.array([[1.0, 50.0], [1.1, -5000.0]])
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, -2]
    assert "the limit of 40 steps is reached. 'j1.s_dot' grows" in block.messages[1]
    assert_same(block, run_one_by_one(plan, rows))
    plan = Plan(ball.kernels, Settings((0.0, 8.0), TIMES, "dop853", 1e-6, max_events=2), ("v",))
    block = run_block(plan, np.array([[0.5], [100.0]]))
    assert block.status.tolist() == [-2, 0]
    assert "the limit of 2 events is reached" in block.messages[0]
    assert_same(block, run_one_by_one(plan, np.array([[0.5], [100.0]])))


def test_a_member_may_take_so_much_time(slider):
    plan = Plan(slider.kernels, settings_of(time_limit=1e-9), ("L",))
    block = run_block(plan, np.array([[1.0]]))
    assert block.status.tolist() == [-2]
    assert "the time limit of 1e-09 s is spent" in block.messages[0]


def test_what_is_stopped_is_not_run(slider):
    stop = threading.Event()
    stop.set()
    rows = np.ones((2000, 1))
    for threads in (1, 2):
        block = run_block(
            Plan(slider.kernels, settings_of(), ("L",)), rows, threads=threads, stop=stop
        )
        is_run = block.status == 0
        assert is_run.sum() < 2000
        assert set(block.status[~is_run].tolist()) == {-3}
        assert "not run" in block.messages[-1]
        assert np.isnan(block.z[~is_run]).all()
        assert np.isfinite(block.z[is_run]).all()


@pytest.fixture(scope="module")
def cart():
    return cotree.load("cart-pole").compile()


def test_tables_in_place_of_inputs_reach_the_outputs(cart):
    model, name = cart, cart.inputs[0]
    table = ([0.0, 0.7, 2.0], [0.0, 3.0, -1.0])
    plan = Plan(
        model.kernels, settings_of(inputs={name: table}), model.parameters[:2], model.outputs
    )
    rows = rows_of(model, 2, model.parameters[:2])
    assert_same(run_block(plan, rows), run_one_by_one(plan, rows))


def test_late_times_are_refused_as_in_a_run(cart):
    model = cart
    times = 1e9 + TIMES
    settings = Settings((1e9, 1e9 + 2.0), times, "dop853", 1e-11)
    plan = Plan(model.kernels, settings, model.parameters[:1])
    rows = rows_of(model, 1, model.parameters[:1])
    assert_same(run_block(plan, rows), run_one_by_one(plan, rows))


def test_cores_are_counted():
    assert usable_cores() >= 1
