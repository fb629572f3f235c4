"""Methods with fixed steps in C projects: orders, stiff systems, constraints, refusals."""

from __future__ import annotations

import math
import sys

import pytest
from c_programs import build, need, printed, run

from cotree import Scene, load
from cotree.errors import CodegenError, SolveError

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.skipif(sys.platform == "win32", reason="needs a POSIX compiler"),
]


def ends(scene, folder, integrator, step, sensitivities=(), compiler="gcc", t_end=None):
    need(compiler)
    project = scene.compile(list(sensitivities)).write(folder / str(step), integrator, step)
    end = [] if t_end is None else [repr(t_end)]
    return printed(run([build(project, compiler), *end], project.directory))


@pytest.mark.sampled(1)
@pytest.mark.parametrize("compiler", ["gcc", pytest.param("clang", marks=pytest.mark.slow)])
@pytest.mark.parametrize(("integrator", "order", "step"), [("rk4", 4, 0.02), ("euler", 1, 0.004)])
def test_orders_of_states_and_sensitivities(tmp_path, integrator, order, step, compiler):
    scene = load("slider-pendulum")
    exact = scene.compile(["L"]).simulate((0.0, 2.0), [2.0], rtol=1e-12, atol=1e-14)
    expected = {name: value[0] for name, value in zip(exact.states, exact.y, strict=True)}
    expected |= {f"d({name})/d(L)": exact.sensitivity(name, "L")[0] for name in exact.states}
    coarse, fine = (
        ends(scene, tmp_path, integrator, h, ["L"], compiler, 2.0) for h in (step, step / 2)
    )
    for name, value in expected.items():
        ratio = (coarse[name] - value) / (fine[name] - value)
        # Twice as many steps; the next term of the error is a tenth to a fifth of the first.
        assert math.log2(abs(ratio)) == pytest.approx(order, abs=0.35), name


def test_a_stiff_decay_with_long_steps(tmp_path):
    """1e6 time constants in each step: the source's sine is followed, to the first order."""
    scene = Scene("low-pass")
    scene.input("u", "sin(t)")
    scene.edge("source", "voltage_source", "ground", "a", voltage="u")
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1e-8)
    (state,) = scene.compile().states
    found = ends(scene, tmp_path, "euler", 0.01, t_end=1.0)
    # The source is continued by its slope, which is off by half a square of the step.
    assert abs(found[state]) == pytest.approx(math.sin(1.0), abs=0.5 * 0.01**2)


@pytest.mark.slow
def test_unknowns_of_a_rectifier(tmp_path):
    """Steps of a 4,000th of the period: the error, of the first order, is that share."""
    scene = load("bridge-rectifier")
    model = scene.compile()
    exact = model.simulate((0.0, 0.03), [0.03], rtol=1e-9, atol=1e-11)
    for integrator in ("rk4", "euler"):
        found = ends(scene, tmp_path / integrator, integrator, 5e-6, t_end=0.03)
        for name, (value,) in zip(model.states, exact.y, strict=True):
            assert found[name] == pytest.approx(value, abs=2e-3 * max(1.0, abs(value))), name


def test_constraints_are_held(tmp_path):
    scene = load("crane")
    model = scene.compile()
    exact = model.simulate((0.0, 1.0), [1.0], rtol=1e-10, atol=1e-12)
    found = ends(scene, tmp_path, "rk4", 1e-3, t_end=1.0)
    for name, (value,) in zip(model.states, exact.y, strict=True):
        assert found[name] == pytest.approx(value, abs=1e-6 * max(1.0, abs(value))), name


@pytest.mark.sampled(2)
@pytest.mark.parametrize(
    ("scene", "integrator", "step", "text"),
    [
        ("slider-pendulum", "rk4", None, "rk4 has fixed steps: give step"),
        ("slider-pendulum", "euler", 0.0, "a positive number of seconds"),
        ("slider-pendulum", "euler", math.nan, "a positive number of seconds"),
        (
            "slider-pendulum",
            "dopri5",
            1e-3,
            "dopri5 controls its step size: give step only for rk4 or",
        ),
        ("bouncing-ball", "rk4", 1e-3, "rk4 does not locate events"),
    ],
)
def test_refusals(tmp_path, scene, integrator, step, text):
    with pytest.raises(CodegenError, match=text):
        load(scene).compile().write(tmp_path / "p", integrator, step)
    assert not (tmp_path / "p").exists()


def behind_a_capacitor(is_loop):
    """A pulse behind a capacitor, whose current follows the source's rate, or a resistor."""
    scene = Scene("pulsed")
    scene.parameter("td", 1e-3)
    settings = {"low": 0.0, "high": 5.0, "rise": 1e-3, "fall": 1e-3, "width": 1e-3}
    scene.edge("V", "pulse_voltage", "a", "ground", delay="td", **settings)
    given = {"capacitance": 5e-7} if is_loop else {"resistance": 1e3}
    scene.edge("Z", "capacitor" if is_loop else "resistor", "a", "b", **given)
    scene.edge("R", "resistor", "b", "ground", resistance=1e3)
    scene.edge("C", "capacitor", "b", "ground", capacitance=2.5e-7)
    return scene


@pytest.mark.parametrize("integrator", ["rk4", "euler"])
def test_sensitivities_that_jump_at_kinks_are_refused(tmp_path, integrator):
    """Steps of one length pass over the kink: where the rate jumps there, so must d/d(td)."""
    with pytest.raises(CodegenError, match=rf"depend on 'td', .* {integrator} does not locate"):
        behind_a_capacitor(True).compile(["td"]).write(tmp_path / "p", integrator, 1e-5)
    assert not (tmp_path / "p").exists()
    behind_a_capacitor(True).compile().write(tmp_path / "plain", integrator, 1e-5)
    behind_a_capacitor(False).compile(["td"]).write(tmp_path / "smooth", integrator, 1e-5)


def test_a_start_on_a_jump_that_a_sensitivity_moves_is_refused(tmp_path):
    scene = Scene("edge")
    scene.parameter("v0", 0.0)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": "v0"})
    scene.edge("I", "current_source", "a", "ground", current="sign(C.v) + 0.5*t")
    scene.compile().write(tmp_path / "plain", "dopri5")
    with pytest.raises(SolveError, match=r"'sign.C\.v. up' occurs exactly at the start"):
        scene.compile(["v0"]).write(tmp_path / "p", "dopri5")
    assert not (tmp_path / "p").exists()
