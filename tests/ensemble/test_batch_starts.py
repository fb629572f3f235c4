"""Members in C that are prepared in Python are the runs that ``simulate`` makes, bit by bit."""

from dataclasses import replace

import numpy as np
import pytest
from batches import assert_same, rows_of
from constrained_scenes import winch

import cotree
from cotree import Scene
from cotree.ensemble.batch import BlockInC, Worker, pattern_of, run_block
from cotree.ensemble.pattern import Pattern, find_pattern
from cotree.ensemble.plan import Plan
from cotree.ensemble.trial import run_one_by_one
from cotree.scene.settings import Settings

TIMES = np.linspace(0.0, 1.0, 9)


def plan_of(model, columns, method, **settings):
    settings = {"t_span": (0.0, TIMES[-1]), "t_eval": TIMES, "rtol": 1e-6, **settings}
    return Plan(model.kernels, Settings(method=method, **settings), tuple(columns), model.outputs)


def check(model, columns, method, *, is_searched=False, **settings):
    """Compare a block in two threads with runs one by one, and a part of it with the whole."""
    rows, plan = rows_of(model, 3, columns), plan_of(model, columns, method, **settings)
    pattern = find_pattern(plan)
    assert isinstance(pattern, Pattern)  # it runs in C
    assert pattern.is_searched == is_searched
    block = run_block(plan, rows, threads=2)
    assert (block.status == 0).all(), block.messages
    assert_same(block, run_one_by_one(plan, rows))
    np.testing.assert_array_equal(run_block(plan, rows[1:]).z, block.z[1:])
    return block


@pytest.fixture(scope="module")
def rectifier():
    return cotree.load("bridge-rectifier").compile(["V"])


@pytest.fixture(scope="module")
def pendulum():
    """A pendulum whose rod shortens, as a constraint."""
    scene = winch().scene
    scene.parameter("m", 1.3)
    scene.edge("weight", "rigid_body", "ground", "B", mass="m", inertia=0.1)
    return scene.compile(["m"])


@pytest.mark.parametrize("method", ["dop853", "cvode", "ida"])
def test_algebraic_unknowns(rectifier, method):
    times = np.linspace(0.0, 0.02, 9)
    settings = {"t_span": (0.0, 0.02), "t_eval": times}
    check(rectifier, ("V",), method, **settings)
    # The frequency moves corners, which Python lists for each member.
    check(rectifier, ("V", "f"), method, is_searched=True, **settings)


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_constraints(pendulum, method):
    check(pendulum, ("m", "p.x_dot"), method)


@pytest.mark.parametrize("wanted", [[], ["L"]])
def test_members_of_a_closed_loop_never_ask_python(monkeypatch, wanted):
    """Each member has another length of a bar, and another start."""
    model = cotree.load("motor-linkage").compile(wanted)
    plan, rows = plan_of(model, ("L",), "dop853"), np.linspace(0.33, 0.37, 5)[:, None]
    expected = run_one_by_one(plan, rows)
    pattern_of(plan)  # which all members share

    def refuse(*_):
        raise AssertionError

    for name in ("_prepare_member", "_resolve", "_problem"):
        monkeypatch.setattr(Worker, name, refuse)
    monkeypatch.setattr(BlockInC, "rerun_single", refuse)
    monkeypatch.setattr("cotree.solvers.prepare.find_start", refuse)
    block = run_block(plan, rows, threads=2)
    assert (block.status == 0).all(), block.messages
    assert_same(block, expected)
    starts = [
        model.start(p=model.kernels.parameter_array({"L": length})).z for length in rows[:, 0]
    ]
    # The first point is projected: a few roundings of angles and of their derivatives.
    np.testing.assert_allclose(block.z[:, 0], starts, rtol=1e-14, atol=1e-14)


def test_a_member_without_a_start_says_why(pendulum):
    plan = plan_of(pendulum, ("p.y", "p.x"), "dop853")
    rows = np.array([[-2.0, 0.0], [-3.0, 0.5], [-1.6, 1.2]])
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, -1, 0]
    assert "violate the constraints" in block.messages[1]
    assert_same(block, run_one_by_one(plan, rows))


def switched(load: str) -> Scene:
    """Draw a capacitor whose source jumps with its voltage."""
    scene = Scene("switched")
    scene.parameter("E", 2.0)
    scene.parameter("v0", 0.4)
    source = f"E + {load}*sign(C.v - 0.5)"
    scene.edge("V", "voltage_source", "a", "ground", voltage=source)
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0, initial={"v": "v0"})
    return scene


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
def test_expressions_that_jump(method):
    check(switched("0.5").compile(["E"]), ("E",), method)


def test_a_member_that_starts_on_a_jump():
    """Its rates jump there, and the derivative by its initial value has two sides."""
    rows = np.array([[0.4], [0.5], [0.6]])
    plan = plan_of(switched("0.5").compile(["v0"]), ("v0",), "dop853")
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, -1, 0]
    assert "occurs exactly at the start" in block.messages[1]
    plan = plan_of(switched("(C.v - 0.5)").compile(["v0"]), ("v0",), "dop853")
    block = run_block(plan, rows)
    assert (block.status == 0).all(), block.messages
    assert_same(block, run_one_by_one(plan, rows))


def test_corners_that_members_move():
    scene = Scene("filter")
    scene.parameter("d", 0.5)
    scene.edge("V", "voltage_source", "a", "ground", voltage="1 + sign(t - d)")
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    scene.output("v", "C.v")
    model = scene.compile(["d"])
    # Charged from d on: v = 2 (1 - exp(d - t)), dv/dd = -2 exp(d - t). Errors are those of 1e-6.
    block = check(model, ("d",), "dop853", is_searched=True)
    d = rows_of(model, 3, ("d",))
    expected = np.where(d < TIMES, 2.0 - 2.0 * np.exp(d - TIMES), 0.0)
    np.testing.assert_allclose(block.outputs[:, :, 0], expected, atol=1e-5)


def test_a_network_at_its_operating_point():
    scene = Scene("divider")
    scene.parameter("R", 2.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="1 + t")
    scene.edge("D", "diode", "a", "b", saturation_current=1e-12)
    scene.edge("R1", "resistor", "b", "ground", resistance="R")
    scene.edge("C", "capacitor", "b", "ground", capacitance=0.5)
    scene.output("v", "C.v")
    scene.simulation(start="operating point")
    check(scene.compile(["R"]), ("R",), "rodas5", is_searched=True)


def test_inputs_that_are_functions_of_python():
    model = cotree.load("cart-pole").compile()
    names = (*model.parameters[:1], "hinge.theta")
    check(
        model,
        names,
        "dop853",
        is_searched=True,
        inputs={model.inputs[0]: lambda t: 3.0 * np.sin(t)},
    )


def test_a_function_that_fails_says_so():
    model = cotree.load("cart-pole").compile()

    def push(t):
        if t > 0.5:
            raise RuntimeError("no more")
        return 1.0

    plan = plan_of(model, model.parameters[:1], "dop853", inputs={model.inputs[0]: push})
    with pytest.raises(RuntimeError, match="no more"):
        run_block(plan, rows_of(model, 2, model.parameters[:1]))


@pytest.mark.slow  # 2 s to compile
def test_what_redundant_constraints_leave_open_is_left_out():
    """A beam swings on three equal legs: the sensitivities of what they bear are not unique."""
    scene, z = Scene("bench", gravity=[0, -9.81, 0]), [0, 0, 1]
    scene.parameter("l", 0.5)
    for i in range(3):
        scene.edge(f"g{i}", "arm", "ground", f"G{i}", vector=[float(i), 0, 0])
        scene.edge(f"p{i}", "revolute", f"G{i}", f"L{i}", axis=z, initial={"theta": 0.3})
        scene.edge(f"l{i}", "arm", f"L{i}", f"T{i}", vector=[0, "-l", 0])
    scene.edge("q0", "revolute", "T0", "B0", axis=z)
    for i in (1, 2):
        scene.edge(f"b{i}", "arm", "B0", f"B{i}", vector=[float(i), 0, 0])
        scene.edge(f"q{i}", "revolute", f"T{i}", f"B{i}", axis=z)
    scene.edge("M", "rigid_body", "ground", "B1", mass=4.0, inertia=0.3)
    scene.output("bears", "q0.fy")
    block = check(scene.compile(["l"]), ("l",), "dop853")
    assert np.isnan(block.output_sensitivities).all()
    assert np.isfinite(block.z).all()


def thickening():
    """A mass in what thickens as exp(c t), pushed so that v = sin(t)."""
    scene = Scene("thickening")
    scene.parameter("c", 1.0)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("d", "translational_damper", "ground", "A", damping="exp(c*t)")
    scene.edge("F", "force_source", "ground", "A", force="exp(c*t)*sin(t) + cos(t)")
    return scene


@pytest.mark.parametrize("lanes", [1, None])
def test_a_member_that_becomes_stiff_is_run_with_another_method(lanes):
    model, times = thickening().compile(), np.linspace(0.0, 14.0, 5)
    plan = plan_of(model, ("c",), "auto", t_span=(0.0, 14.0), t_eval=times)
    plan = replace(plan, lanes=lanes)
    # With c = 0.1 the damping is four at the end; with c = 1 a million.
    rows = np.array([[0.1], [1.0]])
    found = find_pattern(plan)
    assert isinstance(found, Pattern)
    assert found.row.name == "dop853"
    block = run_block(plan, rows)
    assert block.status.tolist() == [0, 0]
    assert block.messages[0] == ""
    assert "rodas5 ran it" in block.messages[1]
    whole = model.simulate((0, 14), times, method="rodas5", rtol=1e-6, parameters={"c": 1.0})
    np.testing.assert_array_equal(block.z[1].T, whole.y)
