"""Corners of rates that depend on the state, against motions that are exact on each piece."""

from __future__ import annotations

import math
import re
import shlex
import subprocess
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import brentq
from scipy.special import iv, modstruve

from cotree import Scene

if TYPE_CHECKING:
    from pathlib import Path

    from cotree import Model
    from cotree.program.program import Program

pytestmark = pytest.mark.compiler

METHODS = ("dop853", "dopri5", "rkf45", "rodas5", "rodas4")
_TIGHT = {"rtol": 1e-10, "atol": 1e-12}

#: A state (x, v, 1) moves by A (x, v, 1) on each piece; a piece ends where one of its values,
#: linear in the state, becomes negative, and the next piece goes on.
Piece = tuple[np.ndarray, Sequence[tuple[np.ndarray, int]]]


def exactly(pieces: Sequence[Piece], now: int, z: Sequence[float], times: np.ndarray) -> np.ndarray:
    """Return the positions at ascending times, piece by piece."""
    t, z, found = 0.0, np.array([*z, 1.0]), []
    for wanted in times:
        while True:
            a, ends = pieces[now]
            leaves = [
                (at, following)
                for value, following in ends
                if (at := _root(a, z, value, wanted - t)) is not None
            ]
            if not leaves:
                break
            at, now = min(leaves)
            t, z = t + at, expm(at * a) @ z
        found.append((expm((wanted - t) * a) @ z)[0])
    return np.array(found)


def _root(a: np.ndarray, z: np.ndarray, value: np.ndarray, longest: float) -> float | None:
    """Find the first time at which a value becomes negative, within a time."""

    def at(t: float) -> float:
        return float(value @ expm(t * a) @ z)

    # Begins behind the corner at which the piece was entered.
    times = np.append(np.arange(1e-6, longest, 0.01), longest)
    values = [at(t) for t in times]
    for i in range(len(times) - 1):
        if values[i] >= 0.0 > values[i + 1]:
            return float(brentq(at, times[i], times[i + 1], xtol=1e-15))
    return None


def moved(x: float, v: float, push: float) -> np.ndarray:
    """Return A for the acceleration x * position + v * speed + push."""
    return np.array([[0.0, 1.0, 0.0], [x, v, push], [0.0, 0.0, 0.0]])


def mass(force: str, parameters: dict[str, float] | None = None, **initial: float) -> Scene:
    """Build a mass of 1 kg on a rail."""
    scene = Scene("mass")
    for name, value in (parameters or {}).items():
        scene.parameter(name, value)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force=force, initial=initial)
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    return scene


def bilinear(t: np.ndarray, k1: complex = 4.0, k2: complex = 1.0) -> np.ndarray:
    """Return the motion from x = 0, v = 1 on a spring of stiffness k1 above zero and k2 below."""
    w1, w2 = np.sqrt(k1), np.sqrt(k2)
    half, period = math.pi / w1, math.pi / w1 + math.pi / w2
    n = np.floor(t / np.real(period))
    own = t - n * period
    return np.where(
        np.real(own) < np.real(half), np.sin(w1 * own) / w1, -np.sin(w2 * (own - half)) / w2
    )


SPRINGS = {
    "where": "-where(j.s > 0, k1*j.s, k2*j.s)",
    "abs": "-(k1 + k2)/2*j.s - (k1 - k2)/2*abs(j.s)",
    "max": "-k1*max(j.s, 0) - k2*min(j.s, 0)",
    "sign": "-(k1 + k2)/2*j.s - (k1 - k2)/2*j.s*sign(j.s)",
    "sides": "-j.s*((k1 + k2)/2 + where(j.s > 0, 1, -1)*(k1 - k2)/2)",
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("force", SPRINGS.values(), ids=SPRINGS)
def test_a_bilinear_spring(force: str, method: str) -> None:
    model = mass(force, {"k1": 4.0, "k2": 1.0}, s_dot=1.0).compile(["k1", "k2"])
    assert model.states == ("j.s", "j.s_dot")
    # Ten periods of pi (1/2 + 1).
    t = np.linspace(0.0, 15 * math.pi, 101)[1:] + 0.0123
    result = model.simulate((0, t[-1]), t_eval=t, method=method, **_TIGHT)
    h, scale = 1e-20, {"dopri5": 40.0, "rodas4": 40.0, "rkf45": 40.0}.get(method, 1.0)
    # Methods of low orders take thousands of steps, whose errors add up.
    assert result["j.s"] == pytest.approx(bilinear(t), abs=1e-10 * scale)
    exact = {
        "k1": bilinear(t, 4.0 + h * 1j).imag / h,
        "k2": bilinear(t, 4.0, 1.0 + h * 1j).imag / h,
    }
    for name, slopes in exact.items():
        own = result.sensitivity("j.s", name)
        assert own == pytest.approx(slopes, abs=1e-9 * scale), name
    assert not result.events


@pytest.mark.parametrize("method", ["cvode", "ida", "rodas5", "dop853"])
def test_all_methods_agree_on_a_bilinear_spring(method: str) -> None:
    """Multistep methods begin anew at each corner."""
    model = mass(SPRINGS["abs"], {"k1": 4.0, "k2": 1.0}, s_dot=1.0).compile()
    t = np.linspace(0.0, 10.0, 51)
    result = model.simulate((0, 10), t_eval=t, method=method, **_TIGHT)
    assert result["j.s"] == pytest.approx(bilinear(t), abs=2e-8)


def _tabled() -> tuple[Scene, Callable[[np.ndarray], np.ndarray]]:
    scene = Scene("tabled")
    scene.table("f", [-1.0, 0.4, 1.0], [1.0, 0.3, -2.0])
    scene.edge(
        *("j", "prismatic", "ground", "A"),
        axis=[1, 0, 0],
        force="f(j.s) - 0.05*j.s_dot",
        initial={"s": 0.1, "s_dot": 1.7},
    )
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    x = np.array([1.0, 0.0, 0.0])
    low, middle, high = (np.array([0.0, 0.0, at]) for at in (-1.0, 0.4, 1.0))
    pieces = [
        (moved(0.0, -0.05, 1.0), [(low - x, 1)]),
        (moved(-0.5, -0.05, 0.5), [(x - low, 0), (middle - x, 2)]),
        (moved(-23.0 / 6.0, -0.05, 0.3 + 0.4 * 23.0 / 6.0), [(x - middle, 1), (high - x, 3)]),
        (moved(0.0, -0.05, -2.0), [(x - high, 2)]),
    ]
    return scene, lambda t: exactly(pieces, 1, (0.1, 1.7), t)


def _saturated() -> tuple[Scene, Callable[[np.ndarray], np.ndarray]]:
    scene = mass("min(max(-20*j.s - 2*j.s_dot, -1), 1)", s=0.3)
    wish = np.array([-20.0, -2.0, 0.0])
    one = np.array([0.0, 0.0, 1.0])
    pieces = [
        (moved(0.0, 0.0, -1.0), [(-wish - one, 1)]),
        (moved(-20.0, -2.0, 0.0), [(wish + one, 0), (one - wish, 2)]),
        (moved(0.0, 0.0, 1.0), [(wish - one, 1)]),
    ]
    return scene, lambda t: exactly(pieces, 0, (0.3, 0.0), t)


def _attracted() -> tuple[Scene, Callable[[np.ndarray], np.ndarray]]:
    """Return x'' = 1/2 - |x|: it oscillates on one side, and runs away from a hill on the other."""
    scene = mass("0.5 - abs(j.s)", s_dot=0.6)
    x = np.array([1.0, 0.0, 0.0])
    pieces = [(moved(-1.0, 0.0, 0.5), [(x, 1)]), (moved(1.0, 0.0, 0.5), [(-x, 0)])]
    return scene, lambda t: exactly(pieces, 0, (0.0, 0.6), t)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("made", [_tabled, _saturated, _attracted])
def test_motions_that_are_exact_on_each_piece(
    made: Callable[[], tuple[Scene, Callable[[np.ndarray], np.ndarray]]], method: str
) -> None:
    scene, exact = made()
    t = np.linspace(0.0, 6.0, 25)[1:]
    result = scene.compile().simulate((0, 6), t_eval=t, method=method, **_TIGHT)
    assert result["j.s"] == pytest.approx(exact(t), abs=2e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_bilinear_map_is_followed_along_both_axes(method: str) -> None:
    """The motion on each piece is no exponential: tolerances and methods are compared."""
    scene = Scene("map")
    values = [[3, 2, 1], [1, 0.5, 0], [0.5, 0, -0.5], [0, -1, -2], [-1, -2, -4]]
    scene.table("g", [-2, -0.5, 0, 1, 2], [-2, 0, 2], values=values)
    scene.parameter("c", 1.0)
    scene.edge(
        *("j", "prismatic", "ground", "A"),
        axis=[1, 0, 0],
        force="c*g(j.s, j.s_dot)",
        initial={"s": 1.5},
    )
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    model = scene.compile(["c"])
    found = model.simulate((0, 8), method=method, **_TIGHT)
    exact = model.simulate((0, 8), method="dop853", rtol=1e-13, atol=1e-15)
    assert found["j.s"][-1] == pytest.approx(exact["j.s"][-1], abs=1e-9)
    own, other = (r.sensitivity("j.s", "c")[-1] for r in (found, exact))
    assert own == pytest.approx(other, abs=1e-8)
    h = 1e-5
    ends = [
        model.simulate((0, 8), parameters={"c": c}, method="dop853", rtol=1e-13, atol=1e-15)
        for c in (1.0 + h, 1.0 - h)
    ]
    difference = (ends[0]["j.s"][-1] - ends[1]["j.s"][-1]) / (2 * h)
    assert other == pytest.approx(difference, abs=1e-7)


@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_starts_exactly_on_a_corner(method: str) -> None:
    # Pushed off it.
    pushed = mass("1 - 3*abs(j.s)").compile().simulate((0, 1), method=method, **_TIGHT)
    w = math.sqrt(3.0)
    assert pushed["j.s"][-1] == pytest.approx((1.0 - math.cos(w)) / 3.0, abs=1e-10)
    # At rest on it: nothing happens.
    rested = mass("-5*max(j.s, 0) - j.s_dot").compile().simulate((0, 5), method=method, **_TIGHT)
    assert (rested["j.s"] == 0.0).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_corner_that_is_only_touched(method: str) -> None:
    """s = (t - 1)**2/2 touches zero at t = 1; sensitivities are continuous and are not refused."""
    model = mass("1 + 50*k*min(j.s, 0)", {"k": 1.0}, s=0.5, s_dot=-1.0).compile(["k"])
    result = model.simulate((0, 3), method=method, **_TIGHT)
    assert result["j.s"][-1] == pytest.approx(2.0, abs=1e-9)
    assert result.sensitivity("j.s", "k")[-1] == pytest.approx(0.0, abs=1e-8)


@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_a_motion_that_comes_to_rest_on_a_corner(method: str) -> None:
    """Nothing chatters: what the tolerance does not tell from the corner is no crossing."""
    model = mass("-500*max(j.s, 0) - 50*j.s_dot", s=1.0).compile()
    result = model.simulate((0, 20), method=method, rtol=1e-8, atol=1e-10)
    assert result["j.s"][-1] == pytest.approx(0.0, abs=1e-8)
    assert result.statistics.n_steps < 2000


@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_a_dip_below_a_corner_within_a_step(method: str) -> None:
    """A stiff floor, which a mass falls on and leaves again: half a period of sqrt(k) each time."""
    k, fall = 1e6, 0.5
    model = mass("-1 + 1e6*max(-j.s, 0)", s=fall).compile()
    down = math.sqrt(2.0 * fall)
    # On the floor: s = -1/k + A cos(w t + a), from s = 0 at the speed of the fall.
    w = math.sqrt(k)
    contact = 2.0 * (math.pi - math.atan(down * w)) / w
    period = 2.0 * down + contact
    result = model.simulate((0, 5 * period), method=method, rtol=1e-11, atol=1e-14)
    assert result["j.s"][-1] == pytest.approx(fall, abs=1e-7)


@pytest.mark.parametrize("method", METHODS)
def test_a_corner_of_a_nonlinear_function_of_time(method: str) -> None:
    """x'' = |sin 3 t| - x, whose corners are no stops that are known beforehand."""
    found = mass("abs(sin(3*t)) - j.s").compile().simulate((0, 10), method=method, **_TIGHT)
    # The response to f by the convolution with sin, half a period of f at a time.
    ends = [k * math.pi / 3.0 for k in range(10)] + [10.0]
    total = 0.0
    for k, (a, b) in enumerate(pairwise(ends)):
        x, weights = np.polynomial.legendre.leggauss(40)
        t = 0.5 * (b - a) * x + 0.5 * (a + b)
        sign = (-1.0) ** k
        total += 0.5 * (b - a) * float(weights @ (sign * np.sin(3 * t) * np.sin(10.0 - t)))
    assert found["j.s"][-1] == pytest.approx(total, abs=3e-9)


def test_an_event_at_a_corner() -> None:
    """A mass bounces where the stiffness changes: on both sides of it the sine of one spring."""
    scene = mass("-4*max(j.s, 0) - min(j.s, 0)", s_dot=1.0)
    scene.event("hit", "j.s", direction=-1, set={"j.s_dot": "-0.5*j.s_dot"})
    result = scene.compile().simulate((0, 2.0), **_TIGHT)
    assert result.events["hit"].t == pytest.approx([math.pi / 2.0])
    exact = 0.25 * math.sin(2.0 * (2.0 - math.pi / 2.0))
    assert result["j.s"][-1] == pytest.approx(exact, abs=1e-10)


def test_an_event_that_takes_the_argument_to_another_piece() -> None:
    scene = Scene("jumps")
    scene.table("f", [0, 1, 2, 3], [0, 1, 3, 7])
    scene.edge("a", "capacitor", "a", "ground", capacitance=1.0, initial={"v": 0.5})
    scene.edge("I", "current_source", "ground", "a", current="1")
    scene.edge("b", "capacitor", "b", "ground", capacitance=1.0)
    scene.edge("J", "current_source", "ground", "b", current="f(a.v)")
    scene.event("jump", "a.v - 0.75", direction=1, set={"a.v": "2.5"})
    result = scene.compile().simulate((0, 1.0), **_TIGHT)
    # 0.25 s along the first piece, 0.5 s along the third one, and 0.25 s beyond the table.
    exact = 0.25 * 0.625 + 0.5 * 6.0 + 0.25 * 7.0
    assert result["b.v"][-1] == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_a_corner_of_an_algebraic_equation(method: str) -> None:
    """A piecewise linear resistor beside R, fed by a source through R1: i = g max(v - 1/2, 0)."""
    scene = Scene("network")
    scene.parameter("g", 2.0)
    scene.edge("V", "voltage_source", "a", "ground", voltage="2*sin(3*t)")
    scene.edge("R1", "resistor", "a", "n", resistance=1.0)
    scene.edge("I", "current_source", "n", "ground", current="g*max(n.v - 0.5, 0) + 0.05*n.v**3")
    scene.edge("R2", "resistor", "n", "c", resistance=2.0)
    scene.edge("C", "capacitor", "c", "ground", capacitance=0.3)
    model = scene.compile(["g"])
    assert any(model.kernels.layout.algebraic)
    result = model.simulate((0, 4), method=method, **_TIGHT)
    h = 1e-5
    high, exact, low = (
        model.simulate((0, 4), parameters={"g": g}, method="dop853", rtol=1e-13, atol=1e-14)
        for g in (2.0 + h, 2.0, 2.0 - h)
    )
    scale = 20.0 if method in ("cvode", "ida") else 1.0
    assert result["C.v"][-1] == pytest.approx(exact["C.v"][-1], abs=1e-9 * scale)
    slope = (high["C.v"][-1] - low["C.v"][-1]) / (2 * h)
    assert result.sensitivity("C.v", "g")[-1] == pytest.approx(slope, abs=2e-9 * scale)


def test_backwards_corners_are_left_to_the_error_test() -> None:
    model = mass(SPRINGS["abs"], {"k1": 4.0, "k2": 1.0}, s_dot=1.0).compile()
    result = model.simulate((0, -4), **_TIGHT)
    # Mirrored, the sides of the spring are exchanged.
    mirrored = -bilinear(np.array([4.0]), 1.0, 4.0)[0]
    assert result["j.s"][-1] == pytest.approx(mirrored, abs=1e-8)


_NODES = {"i": "in", "g": "ground"}


def test_roots_of_infinite_slope_on_both_sides_have_one_band() -> None:
    for force in (
        "-sign(j.s_dot)*sqrt(abs(j.s_dot))",
        "-where(j.s > 0, j.s**0.7, -(-j.s)**0.7)",
        "-abs(j.s)**0.7",
    ):
        assert mass(force, s=1.0).compile().kernels.layout.kinks == ((0, 0, True),), force


def test_what_is_left_to_the_error_test() -> None:
    """Times are known, and outputs move nothing."""
    assert not mass("sin(max(t - 1, 0))", s=1.0).compile().kernels.layout.kinks
    scene = mass("-j.s", s=1.0)
    scene.output("side", "abs(j.s)")
    assert not scene.compile().kernels.layout.kinks
    # Capacitances of loops are a linear system, as masses are, and its pivots are chosen by sizes.
    scene = Scene("amplifier")
    scene.edge("V", "voltage_source", "in", "ground", voltage="0.4*sin(t)")
    for name, ends, capacitance in (("Ci", "ib", 1e-6), ("Ce", "eg", 2e-6), ("Co", "co", 3e-6)):
        tail, head = (_NODES.get(end, end) for end in ends)
        scene.edge(name, "capacitor", tail, head, capacitance=capacitance)
    for name, ends, resistance in (("Rb", "bg", 9e3), ("Rc", "cg", 4e3), ("Ro", "og", 9e3)):
        tail, head = (_NODES.get(end, end) for end in ends)
        scene.edge(name, "resistor", tail, head, resistance=resistance)
    junctions = {"saturation_current": 1e-14, "be_capacitance": 1e-11, "bc_capacitance": 5e-12}
    gains = {"forward_gain": 100.0, "reverse_gain": 1.0}
    scene.edge("Q", "bjt_npn", "b", "c", "e", **junctions, **gains)
    assert not scene.compile().kernels.layout.kinks
    dense = np.linspace(-1.0, 1.0, 1002)
    scene = Scene("dense")
    scene.table("f", dense, -np.sin(dense))
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="f(j.s)")
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    assert not scene.compile().kernels.layout.kinks


@pytest.mark.parametrize("power", ["1.5", "0.7", "0.5", "n"])
@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_a_power_of_a_clipped_function_of_time(method: str, power: str) -> None:
    """An arch of t (1 - t) to the power of n has the area B(n + 1, n + 1), wherever it lies."""
    scene = Scene("arch")
    scene.parameter("k", 2.0)
    scene.parameter("d", 0.37)
    scene.parameter("n", 0.6)
    arch = f"k*max((t - d)*(1 - t + d), 0)**{power}"
    scene.edge("I", "current_source", "ground", "a", current=arch)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    result = scene.compile(["k"]).simulate((0, 2), method=method, rtol=1e-8, atol=1e-10)
    n = 0.6 if power == "n" else float(power)
    area = math.gamma(n + 1.0) ** 2 / math.gamma(2.0 * n + 2.0)
    # Eight tolerances of a smooth end, and 40 of an infinite slope, near which steps are of a low
    # order. Where no step ended there, errors were hundreds, and cvode went over the whole arch.
    most = (8e-8 if n > 1.0 else 4e-7) * (10.0 if method in ("cvode", "ida") else 1.0)
    assert result["C.v"][-1] == pytest.approx(2.0 * area, abs=most * 2.0 * area)
    assert result.sensitivity("C.v", "k")[-1] == pytest.approx(area, abs=most * area)


#: Functions of x with a corner at zero, and their integrals over a period of x = sin t.
_WITHIN = {
    "exp(x*sign(x))": 2 * math.pi * (iv(0, 1) + modstruve(0, 1)),
    "exp(max(x, 0))": math.pi * (1 + iv(0, 1) + modstruve(0, 1)),
    "1/(1 + abs(x))": 4.0,
    "where(x > 0, 1/(1 + x), 1)": math.pi + 2.0,
    "(1 + x*sign(x))**-2": 8.0 / 3.0,
    "sqrt(1 + 2*abs(x) + x**2)": 2 * math.pi + 4.0,
    "2**abs(x)": 2 * math.pi * (iv(0, math.log(2)) + modstruve(0, math.log(2))),
    "cosh(abs(x))": 2 * math.pi * iv(0, 1),
}


@pytest.mark.parametrize("law", _WITHIN)
@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_a_corner_within_a_function(method: str, law: str) -> None:
    scene = Scene("within")
    scene.parameter("k", 2.0)
    scene.edge("I", "current_source", "ground", "a", current="cos(t)")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    current = re.sub(r"\bx\b", "C.v", f"k*{law}")
    scene.edge("J", "current_source", "ground", "b", current=current)
    scene.edge("D", "capacitor", "b", "ground", capacitance=1.0)
    model = scene.compile(["k"])
    assert model.kernels.layout.kinks
    result = model.simulate((0, 2 * math.pi), method=method, rtol=1e-8, atol=1e-10)
    # Eight tolerances; over corners that nothing located errors were up to a thousand.
    most = 8e-8 * (12.0 if method in ("cvode", "ida") else 1.0)
    assert result["D.v"][-1] == pytest.approx(2.0 * _WITHIN[law], rel=most)
    assert result.sensitivity("D.v", "k")[-1] == pytest.approx(_WITHIN[law], rel=most)


@pytest.mark.parametrize(
    ("law", "is_located"),
    [
        ("sqrt(1 + x**2*abs(x))", False),
        ("sqrt(1 + x*abs(x))", True),
        ("sqrt(1 + abs(x))", True),
        ("1/where(x > 0, 1 + x + x**2/2, exp(x))", False),
        ("1/where(x > 0, 1 + x + x**2, exp(x))", True),
    ],
)
def test_what_is_twice_differentiable_within_a_root_is_not_located(
    law: str, is_located: bool
) -> None:
    scene = Scene("smooth")
    current = re.sub(r"\bx\b", "C.v", law)
    scene.edge("I", "current_source", "a", "ground", current=current)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    assert bool(scene.compile([]).kernels.layout.kinks) == is_located


@pytest.mark.parametrize("name", ["two-tanks", "crane"])
def test_orifices_meet_their_smoothed_part_smoothly(
    program_of: Callable[[str], Program], name: str
) -> None:
    assert not program_of(name).layout.kinks


@pytest.mark.parametrize(
    "law", ["f(sign(C.v)*C.v)", "where(C.v > 0, f(C.v), f(-C.v))", "f(abs(C.v))"]
)
def test_a_corner_within_a_table(law: str) -> None:
    """The table is linear from 0 to 1: 4 is the integral of abs(sin(t)) over a period."""
    scene = Scene("table")
    scene.table("f", [0, 1, 2], [0, 3, 10])
    scene.edge("I", "current_source", "ground", "a", current="cos(t)")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("J", "current_source", "ground", "b", current=law)
    scene.edge("D", "capacitor", "b", "ground", capacitance=1.0)
    model = scene.compile()
    assert model.kernels.layout.kinks
    found = model.simulate((0, 2 * math.pi), method="dopri5", rtol=1e-8, atol=1e-10)
    assert found["D.v"][-1] == pytest.approx(12.0, rel=8e-8)  # eight tolerances


@pytest.mark.parametrize(
    # Methods of variable order begin by the first one, which costs a tolerance or two each time.
    ("method", "of_each"),
    [("rodas5", 0.0), ("dopri5", 0.0), ("cvode", 2.0), ("ida", 2.0)],
)
def test_what_a_corner_costs_that_is_none(method: str, of_each: float) -> None:
    """A spring that is a straight line of 81 points: cos(2 t), which passes 255 of them in 10 s."""
    scene = Scene("straight")
    points = np.linspace(-2.0, 2.0, 81)
    scene.table("f", list(points), list(4.0 * points))
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="-f(j.s)", initial={"s": 1.0})
    scene.edge("m", "rigid_body", "ground", "A", mass=1.0)
    found = scene.compile().simulate((0, 10), method=method, rtol=1e-6, atol=1e-8)
    # One tolerance of the smooth motion, which is cut into short steps.
    off = np.abs(found["j.s"] - np.cos(2.0 * found.t)).max()
    assert off <= (1.0 + of_each * 255) * 1e-6


def test_a_root_holds_the_side_on_which_it_is_constant() -> None:
    """An infinite slope begins where the argument of a root rises through zero."""
    scene = Scene("clipped")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    current = "max(sin(4.262*t) - 0.435, 0)**0.5"
    scene.edge("I", "current_source", "ground", "a", current=current)
    result = scene.compile().simulate((0, 2), method="dopri5", rtol=1e-8, atol=1e-10)
    w, first = 4.262, math.asin(0.435) / 4.262
    ends = [(first, math.pi / w - first), (first + 2 * math.pi / w, 2.0)]
    # The square root of the distance from both ends is taken out by t = a + (b - a) sin(u)**2.
    u, weights = np.polynomial.legendre.leggauss(60)
    u = 0.25 * math.pi * (u + 1.0)
    total = 0.0
    for a, b in ends:
        t = a + (b - a) * np.sin(u) ** 2
        values = np.sqrt(np.maximum(np.sin(w * t) - 0.435, 0.0)) * (b - a) * np.sin(2 * u)
        total += 0.25 * math.pi * float(weights @ values)
    # Forty tolerances, as above; it was 301.
    assert result["C.v"][-1] == pytest.approx(total, abs=40 * (1e-10 + 1e-8 * total))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    "law", ["k*max(j.s, 0)**1.5", "where(j.s > 0, k*j.s**1.5, 0)", "max(k**(2/3)*j.s, 0)**1.5"]
)
def test_a_collision_by_hertz(law: str, method: str) -> None:
    """A mass comes back from an elastic contact as fast as it met it, after a known time."""
    model = mass(f"-({law})", {"k": 30.0}, s=-0.2, s_dot=1.0).compile()
    assert len(model.kernels.layout.kinks) == 1
    result = model.simulate((0, 1.5), method=method, rtol=1e-8, atol=1e-10)
    depth = (5.0 / (4.0 * 30.0)) ** 0.4
    beta = math.gamma(0.4) * math.gamma(0.5) / math.gamma(0.9)
    lasts = 0.8 * beta * depth  # both ways, at 1 m/s
    # Thirty tolerances: some steps of each way, and what they begin with.
    assert result["j.s_dot"][-1] == pytest.approx(-1.0, abs=3e-7)
    assert result["j.s"][-1] == pytest.approx(-(1.5 - 0.2 - lasts), abs=3e-7)


def test_one_piece_serves_tables_of_one_argument_and_one_axis() -> None:
    scene = Scene("shared")
    x = list(range(50))
    scene.table("f", x, [0.1 * i for i in x])
    scene.table("g", x, [0.2 * i for i in x])
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("I", "current_source", "ground", "a", current="1 + f(C.v)*g(C.v)")
    layout = scene.compile().kernels.layout
    # Both ends of the piece that is held, however many points there are.
    assert (layout.n_pieces, len(layout.kinks)) == (1, 2)


def test_members_of_ensembles_locate_kinks() -> None:
    scene = mass(SPRINGS["abs"], {"k1": 4.0, "k2": 1.0}, s_dot=1.0)
    members = [{"k1": 1.0 + 0.5 * i} for i in range(8)]
    run = {"t_eval": [3.0, 10.0], "lanes": 4, **_TIGHT}
    found = scene.compile().ensemble((0, 10), members, **run)
    assert found.attrs["lanes"] == (
        "members run side by side, except for those close to a kink or jump of the rates"
    )
    for i, member in enumerate(members):
        exact = bilinear(np.array([3.0, 10.0]), member["k1"])
        assert found["j.s"].values[i] == pytest.approx(exact, abs=1e-9)
    tested = scene.compile(locate_kinks=False).ensemble((0, 10), members, **run)
    assert tested.attrs["lanes"] == "members run side by side"


def test_kernels_and_linearisations_take_the_piece_of_their_point() -> None:
    model = mass(SPRINGS["max"], {"k1": 4.0, "k2": 1.0}).compile()
    assert model.rhs(0.0, [0.5, 0.0])[1] == -2.0
    model.simulate((0, 1.0), initial={"j.s": 0.5})
    assert model.rhs(0.0, [-0.5, 0.0])[1] == 0.5
    assert model.jacobian(0.0, [0.5, 0.0])[1, 0] == -4.0
    assert model.jacobian(0.0, [-0.5, 0.0])[1, 0] == -1.0
    assert model.linearize(y=[-0.5, 0.0]).A[1, 0] == -1.0


@pytest.mark.parametrize("method", ["dop853", "rodas5"])
@pytest.mark.parametrize("end", [10.0, -4.0])
def test_a_c_project_locates_kinks(tmp_path: Path, method: str, end: float) -> None:
    """Forwards; backwards, as everywhere, the error test finds them."""
    model = mass(SPRINGS["abs"], {"k1": 4.0, "k2": 1.0}, s_dot=1.0).compile()
    project = model.write(tmp_path, method)
    subprocess.run(shlex.split(project.command), cwd=tmp_path, check=True)
    command = [str(tmp_path / "mass"), "--t-end", str(end), "--rtol", "1e-10", "--atol", "1e-12"]
    lines = subprocess.run(command, check=True, capture_output=True, text=True).stdout.splitlines()
    found = dict(line.split("=")[:2] for line in lines if "=" in line)
    position = next(float(text.split()[0]) for name, text in found.items() if name.strip() == "j.s")
    exact = bilinear(np.array([end]))[0] if end > 0.0 else -bilinear(np.array([-end]), 1.0, 4.0)[0]
    assert position == pytest.approx(exact, abs=1e-9 if end > 0.0 else 1e-8)


@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
@pytest.mark.parametrize("law", ["f(x.v)", "max(0, 1 - 100*abs(x.v - 1.01))"])
def test_a_peak_that_a_long_step_would_not_see(law: str, method: str) -> None:
    """It is 0.02 wide, beyond a second in which nothing changes at all."""
    scene = Scene("peak")
    scene.table("f", [0, 1, 1.01, 1.02], [0, 0, 1, 0])
    for name, current in (("x", "1"), ("y", law)):
        scene.edge(name, "capacitor", name, "ground", capacitance=1.0)
        scene.edge(f"I{name}", "current_source", "ground", name, current=current)
    result = scene.compile().simulate((0, 20), method=method, **_TIGHT)
    assert result["y.v"][-1] == pytest.approx(0.01, rel=1e-9)


def backlash(c: float) -> Scene:
    """Build a mass of 1 kg that flies at 1 m/s between two springs."""
    scene = Scene("play")
    for name, value in (("k", 400.0), ("a", 0.2), ("c", c)):
        scene.parameter(name, value)
    scene.edge("m", "translational_mass", "ground", "A", mass=1.0, initial={"v": 1.0})
    scene.edge(
        *("K", "translational_backlash", "ground", "A"),
        lower="-a",
        upper="a",
        stiffness="k",
        damping="c",
        initial={"s": 0.0},
    )
    return scene


@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_a_mass_with_play(method: str) -> None:
    """Four flights over a, and two halves of a sine, seven times."""
    model = backlash(0.0).compile(["k", "a"])
    end = 7 * (0.8 + 2.0 * math.pi / 20.0) + 0.15
    result = model.simulate((0, end), method=method, **_TIGHT)
    scale = 200.0 if method in ("cvode", "ida") else 10.0
    assert result["K.s"][-1] == pytest.approx(0.15, abs=1e-9 * scale)
    assert result.sensitivity("K.s", "a")[-1] == pytest.approx(-28.0, abs=2e-7 * scale)
    exact = 7 * math.pi * 400.0**-1.5
    assert result.sensitivity("K.s", "k")[-1] == pytest.approx(exact, abs=1e-10 * scale)


@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_corners_within_corners(method: str) -> None:
    """Damping sets in and ends between limits that are corners themselves.

    The derivatives of the law write its conditions in another order, and with other signs.
    """
    model = backlash(3.0).compile(["k", "c"])
    end, h = 7.8, 1e-4
    exact = model.simulate((0, end), method="dop853", rtol=1e-13, atol=1e-14)
    result = model.simulate((0, end), method=method, **_TIGHT)
    scale = 20.0 if method in ("cvode", "ida") else 1.0
    assert result["K.s"][-1] == pytest.approx(exact["K.s"][-1], abs=2e-9 * scale)
    for name, value in (("k", 400.0), ("c", 3.0)):
        high, low = (
            model.simulate((0, end), parameters={name: value + d}, rtol=1e-13, atol=1e-14)
            for d in (h, -h)
        )
        slope = (high["K.s"][-1] - low["K.s"][-1]) / (2 * h)
        assert result.sensitivity("K.s", name)[-1] == pytest.approx(slope, abs=2e-8 * scale)


@pytest.mark.parametrize("method", [*METHODS, "cvode", "ida"])
def test_corners_beside_dry_friction(method: str) -> None:
    """Modes of friction are chosen with the pieces that hold there."""
    scene = Scene("rubbed")
    scene.parameter("k", 30.0)
    scene.edge("mass", "translational_mass", "ground", "A", mass=1.0)
    ends = ("ground", "A")
    scene.edge("spring", "translational_spring", *ends, stiffness="k", initial={"s": 0.9})
    push = "-20*max(spring.s - 0.2, 0) - 5*abs(spring.s)"
    scene.edge("push", "force_source", *ends, force=push)
    scene.edge("rub", "translational_dry_friction", *ends, force=1.0, breakaway=1.2)
    found = scene.compile(["k"]).simulate((0, 3), method=method, **_TIGHT)
    tested = scene.compile(["k"], locate_kinks=False)
    exact = tested.simulate((0, 3), method="dop853", rtol=1e-12, atol=1e-14)
    assert len(found.events["rub stops"].t) == len(exact.events["rub stops"].t) == 5
    assert found["spring.s"][-1] == pytest.approx(exact["spring.s"][-1], abs=1e-9)
    own, other = (r.sensitivity("spring.s", "k")[-1] for r in (found, exact))
    assert own == pytest.approx(other, abs=2e-8)


def _of_fmu(model: Model, path: Path, kind: str, name: str, end: float) -> np.ndarray:
    """Run a model as an FMU; return the times and one output."""
    fmpy = pytest.importorskip("fmpy")
    model.export_fmu(path)
    return fmpy.simulate_fmu(
        str(path),
        stop_time=end,
        fmi_type=kind,
        output=[name],
        relative_tolerance=1e-8,
        output_interval=0.1,
        record_events=False,
    )


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_fmus_of_a_jump_beside_a_curved_corner(tmp_path: Path, kind: str) -> None:
    """Bounds that belong to the corner alone leave the FMU with it."""
    scene = Scene("curved")
    law = "where(C.v < 0.5, 2, 1) + abs(sin(9*t) - C.v)"
    scene.edge("I", "current_source", "ground", "a", current=law)
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("R", "resistor", "a", "ground", resistance=1.0)
    model = scene.compile()
    found = _of_fmu(model, tmp_path / "curved.fmu", kind, "C.v", 1.0)
    exact = model.simulate((0, 1), found["time"], **_TIGHT)
    # The error test steps over corners, which costs it some hundreds of tolerances.
    assert found["C.v"] == pytest.approx(exact["C.v"], abs=1e-5)


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
def test_fmus_leave_corners_to_the_error_test(tmp_path: Path, kind: str) -> None:
    model = mass(SPRINGS["abs"], {"k1": 4.0, "k2": 1.0}, s_dot=1.0).compile()
    found = _of_fmu(model, tmp_path / "mass.fmu", kind, "j.s", 10.0)
    assert found["j.s"] == pytest.approx(bilinear(found["time"]), abs=1e-5)


def test_a_jump_and_a_corner_elsewhere_in_one_scene():
    """R C v' = 2 - v up to 0.5, then 1 - v; beside it, s'' = -10 s while s > 0."""
    scene = Scene("apart")
    scene.edge("V", "voltage_source", "a", "ground", voltage="where(C.v < 0.5, 2, 1)")
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    scene.edge("m", "translational_mass", "ground", "p", mass=1.0, initial={"v": 1.0})
    scene.edge("k", "translational_spring", "ground", "p", force="10*max(k.s, 0)")
    result = scene.compile().simulate((0, 2.0), **_TIGHT)
    switched = math.log(2.0 / 1.5)
    assert result.events["C.v < 0.5 down"].t == pytest.approx([switched], rel=1e-9)
    assert result["C.v"][-1] == pytest.approx(1.0 - 0.5 * math.exp(switched - 2.0), rel=1e-8)
    # Half a period on the spring, then back at the speed that it had.
    assert result["k.s"][-1] == pytest.approx(math.pi / math.sqrt(10.0) - 2.0, rel=1e-8)


@pytest.mark.parametrize("law", ["mod(x.v, 2)", "x.v - 2*floor(x.v/2)"])
def test_a_table_of_what_jumps(law):
    """A tooth of area 1 in each period of 2, passed with unit speed."""
    scene = Scene("teeth")
    scene.table("tooth", [0, 0.5, 1.5, 2], [0, 1, 0, 0])
    scene.edge("x", "capacitor", "a", "ground", capacitance=1.0)
    scene.edge("I", "current_source", "ground", "a", current=1.0)
    scene.edge("y", "capacitor", "b", "ground", capacitance=1.0)
    scene.edge("J", "current_source", "ground", "b", current=f"tooth({law})")
    result = scene.compile().simulate((0, 7.0), **_TIGHT)
    # Three whole teeth of area 3/4, and of the fourth 0.25 to its peak and 0.375 beyond.
    assert result["y.v"][-1] == pytest.approx(3 * 0.75 + 0.25 + 0.375, rel=1e-9)


def test_the_former_name_of_the_option_warns() -> None:
    scene = mass("-abs(j.s)", s=1.0)
    with pytest.warns(DeprecationWarning, match="locate_kinks"):
        model = scene.compile(locate_corners=False)
    assert not model.kernels.layout.kinks
