"""Stiff members in lanes of vectors: the same bits for any number, and the runs of ``simulate``."""

import numpy as np
import pytest
from cascades import HEATER, heater
from domain_scenes import scene_of_domain
from lane_runs import (
    assert_bits_depend_on_the_member_alone,
    assert_same,
    plan_of,
    rows_of,
    runs_in_lanes,
)
from network_scenes import rc_grid, rc_ladder

import cotree
from cotree.build import find_toolchain
from cotree.codegen.tableaus import ROSENBROCK
from cotree.ensemble.batch import LEFT, BlockInC, run_block
from cotree.ensemble.pattern import find_lanes, find_pattern

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(find_toolchain() is None, reason="needs a C compiler"),
]

METHODS = ["rodas4", "rodas5"]


def stiff_plan(model, names, lanes=None, **others):
    settings = {"method": "rodas5", "rtol": 1e-6, "atol": 1e-9, **others}
    return plan_of(model, names, lanes, **settings)


def relaxation():
    """Van der Pol's oscillator with its stiffness as a parameter, driven by a force."""
    scene = cotree.Scene("relaxation")
    for name, value in (("mu", 5.0), ("a", 0.5)):
        scene.parameter(name, value)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0, initial={"v": -0.05})
    scene.edge("s", "translational_spring", "ground", "A", stiffness=1.0, initial={"s": 2.0})
    scene.edge("d", "translational_damper", "ground", "A", damping="mu*(s.s**2 - 1)")
    scene.edge("f", "force_source", "ground", "A", force="a*sin(3*t)")
    return scene


def growth():
    """A rate that bends sharply where the run begins, as in tests/solvers/test_growing_modes.py."""
    scene = cotree.Scene("growth")
    scene.parameter("c", 1.0)
    for mass, node, force in (("u", "A", "c + u.v/(u.v + v.v + 1e-30)"), ("v", "B", "c")):
        scene.edge(mass, "translational_mass", "ground", node, mass=1.0, initial={"v": 0.0})
        scene.edge(f"F{mass}", "force_source", "ground", node, force=force)
    return scene


def runaway():
    """2 A to 3 A: c' = k c^2 has no solution beyond 1/k."""
    scene = cotree.Scene("runaway")
    scene.parameter("k", 0.05)
    scene.edge("A", "species", "A", "ground", volume=1.0, initial={"c": 1.0})
    scene.edge("r", "reaction", reactants=["A", "A"], products=["A", "A", "A"], rate="k")
    return scene


@pytest.fixture(scope="module")
def hires():
    scene = scene_of_domain("chem_hires")
    return scene.compile(list(scene.parameters)[:3])


@pytest.fixture(scope="module")
def oscillator():
    return relaxation().compile(["mu"])


TIMES = np.linspace(0.0, 321.8122, 41)


def test_bits_are_the_same_for_any_lanes_threads_order_and_division(hires):
    names = hires.parameters[:3]

    def make(n):
        return stiff_plan(hires, names, n, times=TIMES)

    assert_bits_depend_on_the_member_alone(make, rows_of(hires, names, 37), (2, 4, 8, 16))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("has_sensitivities", [True, False])
def test_members_are_those_of_the_scalar_engine_to_rounding(hires, method, has_sensitivities):
    names = hires.parameters[:3]
    rows = rows_of(hires, names, 12)
    given = {"method": method, "times": TIMES, "sensitivities": has_sensitivities}
    found, wanted = (run_block(stiff_plan(hires, names, n, **given), rows) for n in (None, 1))
    assert runs_in_lanes(stiff_plan(hires, names, **given))
    np.testing.assert_array_equal(found.steps, wanted.steps)
    # Lengths of steps differ in their last places, and by more where an error is near rounding.
    np.testing.assert_allclose(found.z, wanted.z, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(found.outputs, wanted.outputs, rtol=1e-8, atol=1e-12)
    np.testing.assert_allclose(
        found.output_sensitivities, wanted.output_sensitivities, rtol=1e-8, atol=1e-12
    )
    assert np.median(np.abs(found.z - wanted.z)) < 1e-15


@pytest.mark.parametrize(
    ("scene", "sensitivities", "end", "atol"),
    [
        (scene_of_domain("chem_robertson"), ["k1", "k3"], 1e4, 1e-10),
        (heater(), HEATER, 5.0, 1e-9),  # sensitivities vanish, rates change with time
        (rc_ladder(12), ["R", "C"], 50.0, 1e-9),
        (rc_grid(4), [], 20.0, 1e-9),
        (growth(), [], 1e-3, 1e-15),  # a step that seems accurate goes against a growing mode
    ],
    ids=["robertson", "heater", "ladder", "grid", "growth"],
)
def test_models_of_many_kinds_have_their_runs(scene, sensitivities, end, atol):
    model = scene.compile([name for name in sensitivities if name in scene.parameters])
    names, times = model.parameters[:2], np.linspace(0.0, end, 31)
    rows = rows_of(model, names, 9)
    blocks = {
        n: run_block(stiff_plan(model, names, n, times=times, atol=atol), rows) for n in (1, 2, 8)
    }
    assert runs_in_lanes(stiff_plan(model, names, 8, times=times, atol=atol))
    assert_same(blocks[2], blocks[8])
    assert (blocks[8].status == 0).all()
    np.testing.assert_array_equal(blocks[8].steps, blocks[1].steps)
    sizes = np.abs(blocks[1].z).max(axis=(0, 1))
    assert np.all(np.abs(blocks[8].z - blocks[1].z) <= 1e-8 * sizes)


@pytest.mark.parametrize("method", METHODS)
def test_members_take_as_many_steps_as_each_needs(oscillator, method):
    """A stiffness over four decades, forced in time; some points are visited by steps."""
    times = np.linspace(0.0, 20.0, 201)
    rows = np.geomspace(0.5, 5e3, 23)[:, None]
    given = {"method": method, "times": times, "rtol": 1e-5, "atol": 1e-8}
    found, narrow, wanted = (
        run_block(stiff_plan(oscillator, ("mu",), n, **given), rows) for n in (None, 2, 1)
    )
    assert_same(found, narrow)
    np.testing.assert_array_equal(found.steps, wanted.steps)
    assert found.steps.max() > 4 * found.steps.min()
    sizes = np.abs(wanted.z).max(axis=1, keepdims=True)
    # Where the error of what is read is the tolerance to rounding, one reads and the other visits.
    apart = np.abs(found.z - wanted.z) / sizes
    assert apart.max() < 1e-6
    assert np.median(apart) < 1e-13


def test_lanes_run_backwards(oscillator):
    rows, times = np.linspace(0.1, 0.4, 5)[:, None], np.linspace(0.0, -1.0, 11)
    found, wanted = (
        run_block(stiff_plan(oscillator, ("mu",), n, times=times), rows) for n in (None, 1)
    )
    assert runs_in_lanes(stiff_plan(oscillator, ("mu",), times=times))
    np.testing.assert_allclose(found.z, wanted.z, rtol=1e-9, atol=1e-11)


def test_a_member_that_fails_changes_no_other_and_has_its_sentence():
    model = runaway().compile(["k"])
    rows = np.full((9, 1), 0.05)
    plan = stiff_plan(model, ("k",), times=np.linspace(0.0, 3.0, 7))
    assert runs_in_lanes(plan)
    alone = run_block(plan, rows)
    rows[4] = 0.5
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, 0, 0, 0, -1, 0, 0, 0, 0]
    assert block.messages[4]
    others = np.arange(9) != 4
    np.testing.assert_array_equal(block.z[others], alone.z[others])


def test_budgets_hold_in_lanes(hires):
    names = hires.parameters[:1]
    rows = rows_of(hires, names, 5)
    for budget, word in (({"max_steps": 9}, "9 steps"), ({"time_limit": 1e-7}, "time limit")):
        block = run_block(stiff_plan(hires, names, times=TIMES, **budget), rows)
        assert set(block.status.tolist()) == {-2}
        assert word in block.messages[0]


def test_a_member_whose_planned_pivots_vanish_leaves_its_lane(monkeypatch):
    """The scalar engine exchanges rows where a mode grows as fast as the pivot has it."""
    left = []

    def requeue_rejected(block):
        left.append(np.flatnonzero(block.ended == LEFT).tolist())
        return by_rule(block)

    by_rule = BlockInC.requeue_rejected
    monkeypatch.setattr(BlockInC, "requeue_rejected", requeue_rejected)
    longest = 0.0625  # which is then the length of nearly all steps
    vanishing = 1.0 / (longest * float(ROSENBROCK["rodas5"].gamma))
    scene = cotree.Scene("pivot")
    scene.parameter("a", vanishing)
    for mass, node, force in (
        ("u", "A", "a*u.v - 1000*v.v + sin(t)"),
        ("v", "B", "1000*u.v - 10000*v.v"),
    ):
        scene.edge(mass, "translational_mass", "ground", node, mass=1.0, initial={"v": 0.0})
        scene.edge(f"F{mass}", "force_source", "ground", node, force=force)
    model = scene.compile()
    rows = np.array([vanishing, 10.0, vanishing, 50.0])[:, None]
    given = {"times": np.linspace(0.0, 3.0, 13), "rtol": 1e-3, "atol": 1e-5, "max_step": longest}
    found, wanted = (run_block(stiff_plan(model, ("a",), n, **given), rows) for n in (None, 1))
    assert left == [[0, 2], []]
    np.testing.assert_array_equal(found.z[::2], wanted.z[::2])
    np.testing.assert_allclose(found.z, wanted.z, rtol=1e-9, atol=1e-13)


def test_a_method_that_is_chosen_runs_in_lanes():
    model = rc_ladder(12).compile()
    plan = stiff_plan(model, ("R",), method="auto", times=np.linspace(0.0, 1e4, 11))
    pattern = find_pattern(plan)
    assert pattern.row.name == "rodas5"
    assert not isinstance(find_lanes(pattern), str)


def test_long_eliminations_walk_through_tables():
    model = rc_grid(10).compile(["R"])
    assert model.kernels.program.elimination.n_operations > 3000
    names, times = model.parameters[:2], np.linspace(0.0, 50.0, 11)
    rows = rows_of(model, names, 9)
    blocks = {n: run_block(stiff_plan(model, names, n, times=times), rows) for n in (1, 2, 8)}
    assert runs_in_lanes(stiff_plan(model, names, 8, times=times))
    assert_same(blocks[2], blocks[8])
    np.testing.assert_array_equal(blocks[8].steps, blocks[1].steps)
    np.testing.assert_allclose(blocks[8].z, blocks[1].z, rtol=1e-9, atol=1e-12)


def test_states_alone_of_a_model_with_sensitivities_change_with_time():
    model = heater().compile(HEATER)
    rows = rows_of(model, ("R", "L"), 9)
    given = {"times": np.linspace(0.0, 5.0, 31), "sensitivities": False}
    found, wanted = (run_block(stiff_plan(model, ("R", "L"), n, **given), rows) for n in (2, 1))
    assert runs_in_lanes(stiff_plan(model, ("R", "L"), 2, **given))
    np.testing.assert_array_equal(found.steps, wanted.steps)
    np.testing.assert_allclose(found.z, wanted.z, rtol=1e-9, atol=1e-12)
