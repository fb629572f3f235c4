"""Values that touch the level of a jump without crossing it, and those that would later on."""

import pytest

from cotree import Scene

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-10, "atol": 1e-12}
METHODS = ["dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida"]


def _charged(current: str, start: float = 0.0, **values: float) -> Scene:
    """A capacitor of 1 F that a current charges."""
    scene = Scene("charged")
    for name, value in values.items():
        scene.parameter(name, value)
    scene.edge("I", "current_source", "ground", "a", current=current)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": start})
    return scene


@pytest.mark.parametrize("sensitivities", [[], ["q"]])
@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("beside", "slow", "fast"), [("0.2*sign(C.v - 0.5)", 0.4, 0.8), ("0.2*floor(2*C.v)", 0.6, 0.8)]
)
def test_a_kink_that_touches_a_level_is_no_crossing(beside, slow, fast, method, sensitivities):
    """A count of 1.2 u + 1.5 |u| is zero on both sides of u = 0, where another jump crosses."""
    count = "floor(1.2*(C.v - 0.5) + 1.5*abs(C.v - 0.5))/2"
    scene = _charged(f"0.6*q + {count} + {beside}", q=1.0)
    end = 0.5 / slow + 0.4
    run = scene.compile(sensitivities).simulate((0, end), method=method, **TIGHT)
    assert run.status == 0, run.message
    # A hundred tolerances: multistep methods begin anew at the jump.
    assert run["C.v"][-1] == pytest.approx(0.5 + 0.4 * fast, abs=1e-8)
    if sensitivities:
        slope = 0.6 * 0.4 + fast * 0.5 * 0.6 / slow**2
        assert run.sensitivity("C.v", "q")[-1] == pytest.approx(slope, abs=1e-7)


@pytest.mark.parametrize("method", METHODS)
def test_a_parameter_that_moves_a_touching_kink_has_no_derivative(method):
    """With d above zero the count falls to -1 for a time of its order."""
    count = "floor(1.2*(C.v - 0.5) + 1.5*abs(C.v - 0.5) - d)/2"
    model = _charged(f"0.6 + {count}", d=0.0).compile(["d"])
    with pytest.warns(RuntimeWarning, match="only touches zero"):
        run = model.simulate((0, 1.5), method=method, **TIGHT)
    assert run.status < 0


@pytest.mark.parametrize("method", METHODS)
def test_what_would_graze_behind_an_event_does_not(method):
    """The motion turns back at t = 0.8, before its value reaches the level that it would touch."""
    current = "q*0.6*where(X.v > 0.8, -1, 1) + 0.1*where((C.v - 0.6)**2 > d, 1, 0)"
    scene = _charged(current, q=1.0, d=0.0)
    scene.edge("J", "current_source", "ground", "b", current="1")
    scene.edge("X", "capacitor", "b", "ground", capacitance=1.0)
    run = scene.compile(["q", "d"]).simulate((0, 2.0), method=method, **TIGHT)
    assert run.status == 0, run.message
    assert run["C.v"][-1] == pytest.approx(0.7 * 0.8 - 0.5 * 1.2, abs=1e-8)
    assert run.sensitivity("C.v", "q")[-1] == pytest.approx(0.6 * 0.8 - 0.6 * 1.2, abs=1e-7)
    assert run.sensitivity("C.v", "d")[-1] == pytest.approx(0.0, abs=1e-9)
