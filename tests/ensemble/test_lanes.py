"""Members in lanes of vectors: the same bits for any number, and the runs of ``simulate``."""

import threading

import numpy as np
import pytest
from lane_runs import (
    TIMES,
    assert_bits_depend_on_the_member_alone,
    assert_same,
    plan_of,
    rows_of,
    runs_in_lanes,
)
from rod_chain import rod_chain

import cotree
from cotree.build import find_toolchain
from cotree.codegen.lanes import Lanes, lanes_refusal
from cotree.ensemble.batch import BlockInC, run_block
from cotree.ensemble.pattern import find_lanes, find_pattern, lanes_of
from cotree.errors import SolveError

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(find_toolchain() is None, reason="needs a C compiler"),
]


@pytest.fixture(scope="module")
def slider():
    return cotree.load("slider-pendulum").compile(["L", "zeta"])


@pytest.mark.parametrize("method", ["dop853", "dopri5"])
def test_bits_are_the_same_for_any_lanes_threads_order_and_division(slider, method):
    names = ("L", "m2", "k")

    def make(n):
        return plan_of(slider, names, n, method=method)

    assert_bits_depend_on_the_member_alone(make, rows_of(slider, names, 37), (2, 4, 8))


@pytest.mark.parametrize("method", ["dop853", "dopri5", "rkf45"])
@pytest.mark.parametrize("has_sensitivities", [True, False])
def test_members_are_those_of_the_scalar_engine_to_rounding(slider, method, has_sensitivities):
    names = ("L", "m2", "zeta")
    rows = rows_of(slider, names, 12)
    found, wanted = (
        run_block(plan_of(slider, names, n, method=method, sensitivities=has_sensitivities), rows)
        for n in (None, 1)
    )
    np.testing.assert_array_equal(found.steps, wanted.steps)
    # Lengths of steps differ in their last places, and by more where an error is near rounding.
    np.testing.assert_allclose(found.z, wanted.z, rtol=1e-9, atol=1e-10)
    np.testing.assert_allclose(found.outputs, wanted.outputs, rtol=1e-9, atol=1e-10)
    slopes = found.output_sensitivities, wanted.output_sensitivities
    assert slopes[0].shape == (12, 41, 2 * has_sensitivities, 1)
    np.testing.assert_allclose(*slopes, rtol=1e-9, atol=1e-10)
    # Most values are closer.
    assert np.median(np.abs(found.z - wanted.z)) < 1e-14


def test_the_first_and_the_last_point_are_where_the_run_begins_and_ends(slider):
    names = ("L",)
    rows = rows_of(slider, names, 5)
    block = run_block(plan_of(slider, names), rows)
    np.testing.assert_array_equal(block.z[:, 0, :4], np.tile(slider.initial_state, (5, 1)))
    # More points change no step, so none of the others.
    more = run_block(plan_of(slider, names, times=np.linspace(0.0, 3.0, 81)), rows)
    np.testing.assert_array_equal(more.z[:, ::2], block.z)


def test_lanes_run_backwards(slider):
    names = ("L",)
    rows, times = rows_of(slider, names, 5), np.linspace(0.0, -0.3, 11)
    found, wanted = (run_block(plan_of(slider, names, n, times=times), rows) for n in (None, 1))
    assert runs_in_lanes(plan_of(slider, names, times=times))
    np.testing.assert_allclose(found.z, wanted.z, rtol=1e-9, atol=1e-10)


def test_times_that_interpolation_reads_badly_are_visited():
    """Long steps of a double pendulum: some points need steps of their own."""
    scene, _ = rod_chain(2)
    model = scene.compile()
    names = ("L0", "m1")
    rows = rows_of(model, names, 11)
    plans = [plan_of(model, names, n, rtol=1e-4, atol=1e-6) for n in (None, 1, 2)]
    found, wanted, narrow = (run_block(plan, rows) for plan in plans)
    assert runs_in_lanes(plans[0])
    run = model.simulate((0, 3), TIMES, "dop853", 1e-4, 1e-6)
    # Each step takes 12 evaluations, or 11 where it is refused.
    assert run.statistics.nfev > 12 * run.statistics.n_steps + 50
    # Products are fused in lanes. At this tolerance a change of the last digit grows along the
    # choice of steps to some 1e-6 of their lengths, and the error of what is read between steps,
    # up to 1e-2 in places, follows these: the scalar engine alone, with parameters that differ by
    # 1e-15, changes its values by up to 3e-7.
    apart = np.abs(found.z - wanted.z)
    assert apart.max() < 1e-6
    assert np.median(apart) < 1e-11
    assert_same(found, narrow)


@pytest.mark.slow  # a chain is compiled
def test_columns_of_maps_are_written_out():
    """Ten parameters of a chain: kernels take columns together, lanes do not."""
    scene, wanted = rod_chain(5)
    model = scene.compile(wanted)
    assert any(n.op == "map" for n in model.kernels.program.kernels["augmented_rhs"].order)
    names, times = ("L0", "m1"), np.linspace(0.0, 0.5, 6)
    rows = rows_of(model, names, 5)
    plans = [plan_of(model, names, n, times=times) for n in (None, 1)]
    found, single = (run_block(plan, rows) for plan in plans)
    assert runs_in_lanes(plans[0])
    np.testing.assert_allclose(found.z, single.z, rtol=1e-8, atol=1e-9)


@pytest.mark.slow  # a scene of its own is compiled
def test_inputs_and_functions_of_the_scene_are_evaluated_in_lanes():
    for name, wanted in (("spring-mass-damper", "c"), ("two-tanks", ""), ("cart-pole", "")):
        model = cotree.load(name).compile([wanted] if wanted else [])
        names = model.parameters[:2]
        rows = rows_of(model, names, 5)
        plans = [plan_of(model, names, n) for n in (None, 1)]
        found, single = (run_block(plan, rows) for plan in plans)
        assert runs_in_lanes(plans[0])
        np.testing.assert_allclose(found.z, single.z, rtol=1e-9, atol=1e-10, err_msg=name)


def test_a_member_that_fails_changes_no_other_and_has_its_sentence(slider):
    names = ("m1", "L")
    rows = rows_of(slider, names, 9)
    plan = plan_of(slider, names)
    alone = run_block(plan, rows)
    rows[4] = -1.0, 1.0
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, 0, 0, 0, -1, 0, 0, 0, 0]
    assert "m1" in block.messages[4]
    assert np.isnan(block.z[4]).all()
    others = np.arange(9) != 4
    np.testing.assert_array_equal(block.z[others], alone.z[others])


def test_budgets_hold_in_lanes(slider):
    names = ("L",)
    rows = rows_of(slider, names, 5)
    for budget, word in (({"max_steps": 9}, "9 steps"), ({"time_limit": 1e-7}, "time limit")):
        block = run_block(plan_of(slider, names, **budget), rows)
        assert set(block.status.tolist()) == {-2}
        assert word in block.messages[0]


def test_steps_too_few_to_read_from_are_taken_by_the_scalar_engine(slider):
    times, names = np.linspace(0.0, 1e-4, 5), ("L",)
    rows = rows_of(slider, names, 3)
    found, wanted = (run_block(plan_of(slider, names, n, times=times), rows) for n in (None, 1))
    assert (wanted.steps < 5).all()
    assert_same(found, wanted)


def test_lanes_that_are_stopped_leave_the_rest(slider):
    pattern = find_pattern(plan_of(slider, ("L",)))
    members = BlockInC(pattern, rows_of(slider, ("L",), 20))
    members.stop()
    block = members.block([])
    assert set(block.status.tolist()) == {-3}
    stop = threading.Event()
    stop.set()
    block = run_block(plan_of(slider, ("L",)), rows_of(slider, ("L",), 50), threads=2, stop=stop)
    assert np.isnan(block.z[block.status == -3]).all()
    assert np.isfinite(block.z[block.status == 0]).all()


def test_models_and_runs_without_lanes_say_why(slider):
    ball = cotree.load("bouncing-ball").compile()
    linkage = cotree.load("motor-linkage").compile()
    why = {
        "events": plan_of(ball, ("g",)),
        "one lane": plan_of(slider, ("L",), 1),
    }
    for word, plan in why.items():
        assert word in find_lanes(find_pattern(plan))
    assert "no method" in lanes_refusal(slider.kernels.program, "cvode", has_sensitivities=True)
    pattern = find_pattern(plan_of(linkage, linkage.parameters[:1]))
    assert isinstance(pattern, str) or "constraints" in find_lanes(pattern)
    with pytest.raises(SolveError, match="lanes is 3"):
        run_block(plan_of(slider, ("L",), 3), np.ones((1, 1)))


def test_vectors_are_chosen_by_the_processor(monkeypatch):
    monkeypatch.setattr("platform.machine", lambda: "x86_64")
    assert lanes_of(["sse2"]).width == 2
    assert lanes_of(["avx2"], 4) == Lanes(4, 1, "avx2", is_fused=False)
    avx2, avx512 = ["avx2", "fma"], ["avx512f", "avx512dq", "avx512vl"]
    assert lanes_of([*avx2, *avx512]) == Lanes(8, 1, "avx512f,avx512dq,avx512vl,fma", is_fused=True)
    # Products are fused for any number of lanes, or for none.
    assert all(lanes_of(avx2, n).is_fused for n in (2, 4, 8, 16))
    assert not any(lanes_of(["avx2", *avx512], n).is_fused for n in (2, 4, 8, 16))
    # Two vectors in turn where members are small.
    assert [lanes_of(avx2, None, n).n_bundles for n in (4, 8, 36)] == [2, 2, 1]
    assert [lanes_of([*avx2, *avx512], None, n).n_bundles for n in (4, 8, 36)] == [2, 1, 1]
    assert lanes_of(["avx2"], 8) == lanes_of(["avx2"], 8)
    assert (lanes_of(["avx2"], 8).width, lanes_of(["avx2"], 8).n_bundles) == (4, 2)
    assert lanes_of(["avx2"], 2).width == 2
    monkeypatch.setattr("platform.machine", lambda: "aarch64")
    assert lanes_of(["asimd"], 8).n_bundles == 4
