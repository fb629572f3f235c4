"""Budgets of a run: steps, events, time and memory, whatever the method."""

from __future__ import annotations

import math
import subprocess
import sys
import time

import numpy as np
import pytest

import cotree
from cotree.errors import ParameterError
from cotree.sharing import RecentCache
from cotree.solvers import budgets
from cotree.solvers.budgets import Thinning

METHODS = ["dop853", "rodas5", "cvode", "DOP853", "LSODA"]


def _swing(gain: float) -> cotree.Scene:
    """A pendulum on a cart; a positive gain feeds its speed back with the wrong sign."""
    scene = cotree.Scene("swing", gravity=[0, -9.81, 0])
    scene.parameter("c", gain)
    scene.edge("rail", "prismatic", "ground", "R", axis=[1, 0, 0])
    scene.edge("cart", "rigid_body", "ground", "R", mass=1.0)
    scene.edge(
        "hinge",
        "revolute",
        "R",
        "A",
        axis=[0, 0, 1],
        torque="c*hinge.theta_dot",
        initial={"theta": 0.1},
    )
    scene.edge("rod", "arm", "A", "B", vector=[0, -1, 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass=1.0)
    return scene


@pytest.fixture(scope="module")
def swing() -> cotree.Model:
    return _swing(5.0).compile(["c"])


@pytest.fixture(scope="module")
def decay() -> cotree.Model:
    """x'' = -x with x(0) = 1: cos t."""
    scene = cotree.Scene("oscillator")
    scene.parameter("k", 1.0)
    scene.edge("x", "prismatic", "ground", "A", axis=[1, 0, 0], force="-k*x.s", initial={"s": 1.0})
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    return scene.compile(["k"])


def _needs(method: str) -> None:
    if method in ("cvode", "ida"):
        pytest.importorskip("sksundae")


@pytest.mark.parametrize(
    ("method", "t_eval"), [*((method, None) for method in METHODS), ("dop853", [1.0, 6.0])]
)
def test_growth_without_bound_names_the_state(swing, method, t_eval):
    _needs(method)
    with pytest.warns(RuntimeWarning, match=r"limit of 1000 steps is reached.*'\w+\.\w+' grows"):
        result = swing.simulate((0, 6), t_eval, method=method, max_steps=1000, rtol=1e-5)
    assert result.status == -2
    # What is there of the run is there: from the start or the first wanted time to the last point.
    assert 0.0 < result.t[-1] < 6.0
    assert np.all(np.isfinite(result.y))
    assert "since t = " in result.message


def test_growth_backwards_is_dated_backwards():
    model = _swing(-30.0).compile()
    with pytest.warns(RuntimeWarning, match="grows without bound: since t = -0"):
        result = model.simulate((0, -1), max_steps=5000)
    assert result.status == -2


def test_finite_escape_names_the_state():
    """v' = v^2 from 1 is 1 / (1 - t)."""
    scene = cotree.Scene("escape")
    scene.edge(
        "x", "prismatic", "ground", "A", axis=[1, 0, 0], force="x.s_dot**2", initial={"s_dot": 1.0}
    )
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    with pytest.warns(RuntimeWarning, match=r"'x.s_dot' grows without bound: since t = 0.0"):
        result = scene.compile().simulate((0, 2))
    # Steps end where they end in the first tenth; the pole is reached to rounding.
    assert result.t[-1] == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize("rate", [1.0, 40.0])
def test_growth_that_ends_is_no_failure(rate):
    """x' = a x over one second, as chemical chains and populations grow: e^a."""
    scene = cotree.Scene("chain")
    scene.edge("C", "capacitor", "n", "ground", capacitance=1.0, initial={"v": 1.0})
    scene.edge("G", "current_source", "ground", "n", current=f"{rate}*C.v")
    result = scene.compile().simulate((0, 1), rtol=1e-10)
    assert result.success
    # Relative errors of 1e-10 a step grow at most by the number of e-foldings and of steps.
    assert result["C.v"][-1] == pytest.approx(math.exp(rate), rel=1e-6)


def test_what_stays_is_not_said_to_grow(decay):
    with pytest.warns(RuntimeWarning, match="limit of 50 steps is reached") as caught:
        decay.simulate((0, 1e6), max_steps=50)
    assert "grows" not in str(caught[0].message)


@pytest.mark.parametrize("method", METHODS)
def test_steps_beyond_the_memory_are_thinned(decay, method, monkeypatch):
    """Whatever the method, the points left are steps, and begin and end are among them."""
    _needs(method)
    whole = decay.simulate((0, 60), method=method, rtol=1e-9, atol=1e-11)
    # Rows of t, 2 states, 2 sensitivities, and no outputs: room for 100 of them.
    monkeypatch.setattr(budgets, "MOST_STORED", 100 * 8 * 5)
    monkeypatch.setattr(
        decay, "_kept", RecentCache(8)
    )  # jobs that wait to begin again have more room
    thinned = decay.simulate((0, 60), method=method, rtol=1e-9, atol=1e-11)
    assert thinned.success
    assert len(whole.t) > 101 >= len(thinned.t) > 33
    assert thinned.statistics.n_steps == whole.statistics.n_steps
    assert "One step in" in thinned.message
    assert thinned.t[-1] == 60.0
    places = np.searchsorted(whole.t, thinned.t)
    stride = int(places[1])
    assert places[:-1].tolist() == list(range(0, stride * (len(places) - 1), stride))
    np.testing.assert_array_equal(whole.y[:, places], thinned.y)
    np.testing.assert_array_equal(whole.s[:, :, places], thinned.s)


def test_thinned_steps_beside_events(monkeypatch):
    """Each bounce is an event, whose points are stored or not like others."""
    model = cotree.load("bouncing-ball").compile()
    whole = model.simulate((0, 2), rtol=1e-12)
    monkeypatch.setattr(budgets, "MOST_STORED", 1)
    thinned = model.simulate((0, 2), rtol=1e-12)
    # The least that a curve needs is stored at any rate.
    assert len(thinned.t) <= 65
    assert set(thinned.t) <= set(whole.t)
    for name, row in whole.events.items():
        np.testing.assert_array_equal(row.t, thinned.events[name].t)


def test_every_so_manyth_step_is_taken():
    thinning, stored = Thinning(), []
    for start in range(0, 100, 7):
        new = list(range(start, start + 7))
        stored += new[thinning.select(len(new))]
        if len(stored) > 10:
            stored = stored[thinning.thin()]
    assert stored == list(range(0, 105, thinning.stride))


def test_bounds_can_be_lifted(decay):
    for unbounded in (None, math.inf):
        result = decay.simulate(
            (0, 1), max_steps=unbounded, max_events=unbounded, time_limit=unbounded
        )
        assert result.success
    with pytest.raises(ParameterError, match="max_steps is nan"):
        decay.simulate((0, 1), max_steps=math.nan)


_IN_LITTLE_MEMORY = """
import resource, warnings, sys
import cotree
sys.path.insert(0, {folder!r})
from test_budgets import _swing
from cotree.solvers import budgets
warnings.simplefilter("ignore")
model = _swing(5.0).compile(["c"])
model.simulate((0, 0.1), method="dop853")  # everything is loaded
budgets.MOST_STORED = 2**18
taken = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
# Room for a result of the bound, for four times as much while it is made, and for Python's own.
resource.setrlimit(resource.RLIMIT_AS, (taken + 12 * 2**20,) * 2)
result = model.simulate((0, 6), method="dop853", max_steps=100_000)
assert result.status == -2, result.message
assert "grows without bound" in result.message, result.message
print(len(result.t))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="RLIMIT_AS and /proc are Linux's")
def test_a_run_without_end_keeps_its_memory(request):
    """Of 100,000 steps the rows alone would take 7 MB, and four times as much as they are made."""
    code = _IN_LITTLE_MEMORY.format(folder=str(request.path.parent))
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    # Rows of t, 4 states and as many sensitivities.
    assert int(done.stdout) <= 2**18 // (8 * 9) + 1


def test_short_pulses_in_a_long_run_begin_soon():
    """Four million corners are listed in about a second, not one by one."""
    scene = cotree.Scene("rc")
    times = {"delay": 0.0, "rise": 5e-10, "width": 4e-9, "fall": 5e-10, "period": 1e-8}
    scene.edge("V", "pulse_voltage", "a", "ground", low=0.0, high=1.0, **times)
    scene.edge("R", "resistor", "a", "b", resistance=1e3)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1e-9)
    model = scene.compile()
    begin = time.process_time()
    with pytest.warns(RuntimeWarning, match="2000 steps"):
        model.simulate((0, 1e-2), max_steps=2000)
    # One by one they took 20 s; a loaded machine takes a few times the second.
    assert time.process_time() - begin < 8.0


def test_a_counter_of_turns_does_not_grow_without_bound():
    """A driven shaft counts its turns, and the budget of events ends the run."""
    scene = cotree.Scene("turns")
    scene.mode("n", 0)
    hinge = {"axis": [0, 0, 1], "torque": 1.0, "damping": 0.001}
    scene.revolute("h", "ground", "A", **hinge)
    scene.rigid_body("b", "ground", "A", mass=1.0, inertia=0.1)
    scene.event("turn", "mod(h.theta, 6.28) - 3", direction=1, set={"n": "n + 1"})
    with pytest.warns(RuntimeWarning) as told:
        run = scene.compile().simulate((0, 1e6), max_events=3000)
    assert run.status != 0
    # Counts and angles grow as the square of time at most.
    assert not any("grows without bound" in str(row.message) for row in told)


def test_an_event_that_atol_hides_names_atol():
    """An electron crosses a picometre; the tolerance of 1e-9 m is a thousand times as wide."""
    mass, charge, field, d = 9.1093837139e-31, 1.602176634e-19, 1e13, 1e-12
    scene = cotree.Scene("plates")
    scene.parameter("d", d)
    scene.prismatic("x", "ground", "A", axis=[1, 0, 0], force=charge * field)
    scene.rigid_body("b", "ground", "A", mass=mass)
    scene.event("hit", "x.s - d", direction=1, stop=True)
    model, t = scene.compile(["d"]), math.sqrt(2 * d * mass / (charge * field))
    with pytest.warns(RuntimeWarning, match="give a smaller atol"):
        model.simulate((0, 1.5 * t), method="dop853")
    run = model.simulate((0, 1.5 * t), method="dop853", atol=1e-20)
    assert run.events["hit"].t == pytest.approx([t], rel=1e-6)
    assert run.event_sensitivity("hit", "d") == pytest.approx([t / (2 * d)], rel=1e-6)


@pytest.mark.parametrize("method", ["dop853", "rodas5", "ida"])
def test_a_fold_of_the_algebraic_equations_is_named(method):
    """An amplifier with positive feedback: its upper solution ends where the input reaches b V."""
    scene = cotree.Scene("amplifier")
    scene.edge("R1", "resistor", "o", "c", resistance=1e4)
    scene.edge("C1", "capacitor", "c", "ground", capacitance=1e-7, initial={"v": 0.1})
    scene.edge("d1", "resistor", "o", "f", resistance=6e3)
    scene.edge("d2", "resistor", "f", "ground", resistance=4e3)
    law = "max(-12, min(12, 1000*(d2.v - C1.v)))"
    scene.edge("S", "voltage_source", "o", "ground", voltage=law)
    with pytest.warns(RuntimeWarning, match=r"fold at t = .*'S\.v'"):
        run = scene.compile().simulate((0, 5e-3), method=method, rtol=1e-8, max_steps=5000)
    # At 0.4 of the supply, less the millivolts that drive the output to it: V (b - 1/1000).
    assert abs(run["C1.v"][-1]) == pytest.approx(12 * (0.4 - 1e-3), rel=1e-6)


def test_a_body_too_light_for_its_forces_is_named():
    """A nanogram that constraints hold beside 1.5 kg."""
    scene = cotree.Scene("light", gravity=[0, -9.81, 0])
    scene.parameter("eps", 1e-9)
    scene.planar("b", "ground", "P", normal=[0, 0, 1])
    scene.rigid_body("d", "ground", "P", mass=1.5, inertia=0.05)
    scene.prismatic("u", "ground", "U", axis=[1, 0, 0], initial={"s": -1.4})
    scene.rigid_body("ub", "ground", "U", mass="eps")
    scene.constraint("cx", "ground", "P", expression="P.x - u.s")
    scene.constraint("cy", "ground", "P", expression="P.y - 0.4*u.s**2")
    with pytest.warns(RuntimeWarning, match=r"[Mm]ass of edge 'ub' is 1e-09"):
        scene.compile().simulate((0, 3), rtol=1e-9, max_steps=3)
    assert "ub" in [row.name for row in scene.lint() if row.rule == "inertia"]
    scene.set("eps", 1e-3)
    assert not [row for row in scene.lint() if row.rule == "inertia"]


def test_a_singular_position_is_named():
    """Two axes are parallel at a middle angle of zero, and one of their motions moves nothing."""
    scene = cotree.Scene("gimbal")
    scene.revolute("a", "ground", "A", axis=[0, 0, 1])
    scene.revolute("b", "A", "B", axis=[1, 0, 0], initial={"theta": 0.0})
    scene.revolute("c", "B", "C", axis=[0, 0, 1], initial={"theta": 0.25})
    scene.rigid_body("r", "ground", "C", mass=1.0, inertia=[1, 1, 1])
    with pytest.raises(cotree.SingularSystemError, match=r"b\.theta = 0, c\.theta = 0\.25"):
        scene.compile().simulate((0, 1))


def test_the_time_limit_includes_the_list_of_time_events():
    scene = cotree.Scene("staircase")
    scene.parameter("rate", 1e7)
    scene.translational_mass("M", "ground", "x", mass=1.0)
    scene.force_source("f", "ground", "x", force="floor(rate*t)")
    model = scene.compile(tunable=["rate"], optimize="-O0")
    begin = time.process_time()  # other processes may delay this one
    with pytest.raises(
        cotree.SolveError, match=r"limit of 0\.1 s was exceeded by the search for 1000000"
    ):
        model.simulate((0, 1), time_limit=0.1)
    # One operation on all times takes less than a second; the whole list takes several.
    assert time.process_time() - begin < 3.0
    with pytest.warns(RuntimeWarning, match=r"1 of 2 members failed.*limit of 0\.1 s was exceeded"):
        few = model.ensemble((0, 1), {"rate": [1.0, 1e7]}, time_limit=0.1)
    assert few.status.values.tolist()[0] == 0
    assert few.status.values.tolist()[1] != 0
