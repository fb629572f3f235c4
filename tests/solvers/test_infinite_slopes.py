"""Laws whose slope is infinite on both sides of zero: rest in a finite time, and what leaves it."""

from __future__ import annotations

import math
import warnings

import pytest

from cotree import Scene

pytestmark = pytest.mark.compiler

METHODS = ("dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida", "auto")
LAWS = (
    "c*sign({0})*sqrt(abs({0}))",
    "where({0} > 0, c*sqrt({0}), -c*sqrt(-{0}))",
    "c*where({0} >= 0, 1, -1)*abs({0})**0.5",
)
#: A hundred times rtol.
CLOSE = 1e-6


def _tank(law: str, h0: float, inflow: str = "0", sign: str = "") -> Scene:
    scene = Scene("tank")
    scene.parameter("c", 1.0)
    scene.parameter("h0", h0)
    scene.edge("C", "capacitor", "x", "ground", capacitance=1.0, initial={"v": "h0"})
    scene.edge("D", "current_source", "x", "ground", current=f"{sign}({law.format('C.v')})")
    scene.edge("I", "current_source", "ground", "x", current=inflow)
    return scene


def _end(scene: Scene, method: str, t: float) -> list[float]:
    """Return C.v at a time and its derivatives by c and h0."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of runs that stop
        model = scene.compile(["c", "h0"], optimize="-O0")
        found = model.simulate((0, t), method=method, rtol=1e-8, atol=1e-10)
    assert found.success, found.message
    # Chatter on the slope takes tens of thousands.
    assert found.statistics.n_steps < 2000
    return [found["C.v"][-1], *(found.sensitivity("C.v", name)[-1] for name in ("c", "h0"))]


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("method", METHODS)
def test_a_tank_empties_in_a_finite_time(law: str, method: str) -> None:
    """Follow h = (sqrt(h0) - c*t/2)**2 until it is empty, and stay there."""
    scene = _tank(law, 0.25)
    assert _end(scene, method, 0.6) == pytest.approx([0.04, -0.12, 0.4], abs=CLOSE)
    assert _end(scene, method, 5.0) == pytest.approx([0.0, 0.0, 0.0], abs=CLOSE)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("method", METHODS)
def test_an_empty_tank_rests_until_something_flows_in(law: str, method: str) -> None:
    """Rest, whatever the start would be with another h0, then come to h = (q/c)**2."""
    assert _end(_tank(law, 0.0), method, 1.0) == [0.0, 0.0, 0.0]
    # The inflow of 0.3 begins at t = 1; the distance from (q/c)**2 decays with exp(-t*c**2/(2*q)).
    filled = _end(_tank(law, 0.0, "where(t > 1, 0.3, 0)"), method, 16.0)
    assert filled == pytest.approx([0.09, -0.18, 0.0], abs=CLOSE)


@pytest.mark.parametrize("inflow", [1e-3, 1e-6])
@pytest.mark.parametrize("method", ["rodas5", "cvode", "ida"])
def test_a_small_inflow_is_held(inflow: float, method: str) -> None:
    """The level is within the tolerance of (q/c)**2, which may be less than that."""
    level, *slopes = _end(_tank(LAWS[0], 0.25, repr(inflow)), method, 5.0)
    assert level == pytest.approx(inflow**2, abs=1e-8)
    assert slopes == pytest.approx([-2 * inflow**2, 0.0], abs=1e-8)


@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_tanks_in_a_row_come_to_one_level(method: str) -> None:
    scene = Scene("row")
    scene.parameter("c", 0.5)
    scene.parameter("a", 1.0)
    for name, size, level in (("A", "a", 1.0), ("B", 1.0, 0.4), ("E", 2.0, 0.1)):
        scene.edge(name, "capacitor", name, "ground", capacitance=size, initial={"v": level})
    scene.edge("Q", "current_source", "A", "B", current=LAWS[0].format("(A.v - B.v)"))
    scene.edge("P", "current_source", "B", "E", current=LAWS[1].format("(B.v - E.v)"))
    found = scene.compile(["c", "a"], optimize="-O0").simulate((0, 12), method=method, rtol=1e-8)
    assert found.success, found.message
    for name in ("A.v", "B.v", "E.v"):
        assert found[name][-1] == pytest.approx(1.6 / 4, abs=CLOSE)
        assert found.sensitivity(name, "c")[-1] == pytest.approx(0.0, abs=CLOSE)
        assert found.sensitivity(name, "a")[-1] == pytest.approx((4 - 1.6) / 16, abs=CLOSE)


@pytest.mark.parametrize("law", LAWS[:2])
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_a_slope_that_drives_away_is_refused_at_rest_alone(law: str, method: str) -> None:
    """Grow as (sqrt(h0) + c*t/2)**2 from anywhere but zero, where nothing says when it begins."""
    grown = _end(_tank(law, 0.01, sign="-"), method, 1.0)
    assert grown == pytest.approx([0.36, 0.6, 6.0], abs=1e-5)
    model = _tank(law, 0.0, sign="-").compile(optimize="-O0")
    with pytest.warns(RuntimeWarning, match="stopped"):
        found = model.simulate((0, 1), method=method)
    assert "rests at zero" in found.message
    assert "not unique" in found.message
    # A finite rate leaves zero at once: h' = 1 + r with r = sqrt(h) has t = 2*(r - log(1 + r)).
    left = _end(_tank(law, 0.0, "1", sign="-"), method, 1.0)
    root = math.sqrt(left[0])
    assert 2.0 * (root - math.log1p(root)) == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida"])
def test_an_even_law_is_refused_where_it_comes_to_rest(method: str) -> None:
    """-sqrt(abs(h)) drives to zero from above, and away from it below."""
    model = _tank("sqrt(abs({0}))", 0.25).compile(optimize="-O0")
    with pytest.warns(RuntimeWarning, match="stopped"):
        found = model.simulate((0, 2), method=method, rtol=1e-8, atol=1e-10)
    # h = (1 - t)**2/4 comes within the tolerance of zero at t = 1 - 2*sqrt(4e-9).
    assert found.t[-1] == pytest.approx(1.0, abs=1e-3)
    assert "not unique" in found.message
