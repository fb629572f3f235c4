"""Every jump function with every kink function, against piecewise integration by SciPy.

The laws of the reference are written here, each with the piece that it is on, so that SciPy
integrates smooth functions from one switching surface to the next.
"""

from __future__ import annotations

import math
import warnings
from bisect import bisect_right
from dataclasses import dataclass
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from cotree import Scene

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Sequence

    from cotree import Result

pytestmark = pytest.mark.compiler

T_END = 3.0
METHODS = ("auto", "dopri5", "rodas5", "cvode")

#: A hundred tolerances; methods of variable order begin anew at each of up to forty switches, with
#: an error of five more.
TIGHT = {"rtol": 1e-10, "atol": 1e-11}
CLOSE = {"auto": 1e-8, "dopri5": 1e-8, "rodas5": 1e-8, "cvode": 3e-8}


@dataclass(frozen=True)
class Law:
    """A piecewise law: its text, its value on the piece of a point, and that piece."""

    text: Callable[[str], str]
    value: Callable[[float, float], float]
    piece: Callable[[float], Hashable]

    def of(self, inner: Law) -> Law:
        """Return the law of another law."""
        return Law(
            lambda x: self.text(f"({inner.text(x)})"),
            lambda x, at: self.value(inner.value(x, at), inner.value(at, at)),
            lambda at: (inner.piece(at), self.piece(inner.value(at, at))),
        )

    def plus(self, other: Law) -> Law:
        """Return the sum of two laws."""
        return Law(
            lambda x: f"{self.text(x)} + {other.text(x)}",
            lambda x, at: self.value(x, at) + other.value(x, at),
            lambda at: (self.piece(at), other.piece(at)),
        )

    def times(self, other: Law) -> Law:
        """Return the product of two laws."""
        return Law(
            lambda x: f"({self.text(x)})*({other.text(x)})",
            lambda x, at: self.value(x, at) * other.value(x, at),
            lambda at: (self.piece(at), other.piece(at)),
        )


def _table(x: float, at: float) -> float:
    points, values = (-1.1, -0.3, 0.25, 0.9), (0.4, -0.2, 0.3, 0.1)
    k = min(max(bisect_right(points, at) - 1, 0), 2)
    if at < points[0] or at > points[-1]:  # the ends are held
        return values[0] if at < points[0] else values[-1]
    return values[k] + (values[k + 1] - values[k]) * (x - points[k]) / (points[k + 1] - points[k])


JUMPS = {
    "sign": Law(
        lambda x: f"sign({x} - 0.31)",
        lambda x, at: math.copysign(1.0, at - 0.31),
        lambda at: at > 0.31,
    ),
    "sign of a square": Law(
        lambda x: f"sign(({x})**2 - 0.3)",
        lambda x, at: math.copysign(1.0, at * at - 0.3),
        lambda at: at * at > 0.3,
    ),
    "floor": Law(
        lambda x: f"floor(2*{x} + 0.17)/2",
        lambda x, at: math.floor(2.0 * at + 0.17) / 2.0,
        lambda at: math.floor(2.0 * at + 0.17),
    ),
    "ceiling": Law(
        lambda x: f"-floor(0.4 - 3*{x})/3",
        lambda x, at: -math.floor(0.4 - 3.0 * at) / 3.0,
        lambda at: math.floor(0.4 - 3.0 * at),
    ),
    "mod": Law(
        lambda x: f"mod({x} + 0.05, 0.7)",
        lambda x, at: x + 0.05 - 0.7 * math.floor((at + 0.05) / 0.7),
        lambda at: math.floor((at + 0.05) / 0.7),
    ),
    "where": Law(
        lambda x: f"where({x} > 0.42, 1, 0.2*{x})",
        lambda x, at: 1.0 if at > 0.42 else 0.2 * x,
        lambda at: at > 0.42,
    ),
    "between": Law(
        lambda x: f"where(-0.22 < {x} <= 0.53, 0.8, -0.1)",
        lambda x, at: 0.8 if -0.22 < at <= 0.53 else -0.1,
        lambda at: (at > -0.22, at > 0.53),
    ),
    "nested": Law(
        lambda x: f"where({x} > 0.21, where({x} > 0.63, 0.5*{x}, 0.9), -0.3)",
        lambda x, at: (0.5 * x if at > 0.63 else 0.9) if at > 0.21 else -0.3,
        lambda at: (at > 0.21, at > 0.63),
    ),
}

KINKS = {
    "abs": Law(
        lambda x: f"abs({x} - 0.12)",
        lambda x, at: math.copysign(1.0, at - 0.12) * (x - 0.12),
        lambda at: at > 0.12,
    ),
    "min": Law(
        lambda x: f"min({x}, 0.33)",
        lambda x, at: min(at, 0.33) if at > 0.33 else x,
        lambda at: at > 0.33,
    ),
    "max": Law(
        lambda x: f"max({x} - 0.1, 0)",
        lambda x, at: x - 0.1 if at > 0.1 else 0.0,
        lambda at: at > 0.1,
    ),
    "clip": Law(
        lambda x: f"min(max({x}, -0.4), 0.45)",
        lambda x, at: x if -0.4 < at < 0.45 else math.copysign(0.425, at) + 0.025,
        lambda at: (at > -0.4, at > 0.45),
    ),
    "square": Law(
        lambda x: f"0.2*({x})*abs({x})",
        lambda x, at: math.copysign(0.2, at) * x * x,
        lambda at: at > 0.0,
    ),
    "size by sign": Law(
        lambda x: f"({x})*sign({x})",
        lambda x, at: math.copysign(1.0, at) * x,
        lambda at: at > 0.0,
    ),
    "dead band": Law(
        lambda x: f"where({x} > d, {x} - d, where({x} < -d, {x} + d, 0))",
        lambda x, at: x - math.copysign(0.24, at) if abs(at) > 0.24 else 0.0,
        lambda at: (at > 0.24, at < -0.24),
    ),
    "table": Law(
        lambda x: f"curve({x})",
        _table,
        lambda at: [at > p for p in (-1.1, -0.3, 0.25, 0.9)].count(True),
    ),
}

ARRANGED = {
    "sum": lambda jump, kink: jump.plus(kink),
    "product": lambda jump, kink: jump.times(kink),
    "kink of jump": lambda jump, kink: kink.of(jump),
    "jump of kink": lambda jump, kink: jump.of(kink),
}


def _breaks(law: Law) -> list[float]:
    """List where a law goes on to another piece."""
    grid = np.linspace(-4.0, 4.0, 4001) + 1.7e-4
    pieces = [law.piece(x) for x in grid]
    found = []
    for i in np.flatnonzero([a != b for a, b in pairwise(pieces)]):
        low, high = float(grid[i]), float(grid[i + 1])
        while np.nextafter(low, high) < high:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if law.piece(middle) == pieces[i] else (low, middle)
        found.append(high)
    return found


def _moved(law: Law, rate: Callable, z: Sequence[float]) -> tuple[float, list[float]]:
    """Integrate z' = rate(t, z, law of z[0]) piece by piece, until the end or where none holds."""
    t, z, breaks = 0.0, list(z), [-np.inf, *_breaks(law), np.inf]
    now = bisect_right(breaks, z[0]) - 1
    while t < T_END:
        low, high = breaks[now], breaks[now + 1]
        at = 0.5 * (max(low, -9.0) + min(high, 9.0))

        def along(t: float, z: Sequence[float], at: float = at) -> Sequence[float]:
            return rate(t, z, law.value(z[0], at))

        def above(t: float, z: Sequence[float], high: float = high) -> float:
            return z[0] - min(high, 1e9)

        def below(t: float, z: Sequence[float], low: float = low) -> float:
            return z[0] - max(low, -1e9)

        # Steps are short, since crossings are told by what steps end in.
        for surface, direction in ((above, 1.0), (below, -1.0)):
            surface.terminal, surface.direction = True, direction  # type: ignore[attr-defined]
        found = solve_ivp(
            along, (t, T_END), z, "DOP853", rtol=1e-11, atol=1e-12, max_step=0.004,
            events=(above, below),
        )  # fmt: skip
        t, z = float(found.t[-1]), list(found.y[:, -1])
        if found.status == 0:
            break
        way = 1 if found.t_events[0].size else -1
        now += way
        z[0] = breaks[now] if way > 0 else breaks[now + 1]
        inside = 0.5 * (max(breaks[now], -9.0) + min(breaks[now + 1], 9.0))
        if way * rate(t, z, law.value(z[0], inside))[0] < 0.0:
            return t, z  # from either side it is driven back
    return t, z


def _rc(t: float, z: Sequence[float], law: float) -> list[float]:
    return [2.2 * math.cos(2.1 * t) - 0.4 * z[0] - 0.5 * z[0] ** 3 + 0.6 * law]


def _shaft(t: float, z: Sequence[float], law: float) -> list[float]:
    return [z[1], (3.0 * math.cos(2.3 * t) - 0.2 * z[1] - 2.0 * z[0] + 0.6 * law) / 0.8]


def _circuit(scene: Scene, text: str) -> None:
    # The cube keeps what laws of second degree drive within their listed switches.
    drive = "2.2*cos(2.1*t) - 0.5*C.v**3"
    scene.edge("I", "current_source", "ground", "a", current=f"{drive} + 0.6*({text})")
    scene.edge("C", "capacitor", "a", "ground", capacitance=1.0, initial={"v": -0.55})
    scene.edge("R", "resistor", "a", "ground", resistance=2.5)


def _inertia(scene: Scene, text: str) -> None:
    given = {"theta": -0.55, "w": 0.4}
    scene.edge("J", "rotational_inertia", "ground", "b", inertia=0.8, initial=given)
    scene.edge("k", "rotational_spring", "ground", "b", stiffness=2.0, initial={"theta": -0.55})
    scene.edge("c", "rotational_damper", "ground", "b", damping=0.2)
    scene.edge("T", "torque_source", "ground", "b", torque=f"3*cos(2.3*t) + 0.6*({text})")


ELEMENTS = {
    "C.v": (_circuit, _rc, (-0.55,)),
    "J.theta": (_inertia, _shaft, (-0.55, 0.4)),
}


def _run(scene: Scene, method: str) -> Result:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a run that stops is told by its status
        return scene.compile().simulate((0, T_END), method=method, **TIGHT)


def _scene() -> Scene:
    scene = Scene("both")
    scene.parameter("d", 0.24)
    scene.table("curve", [-1.1, -0.3, 0.25, 0.9], [0.4, -0.2, 0.3, 0.1])
    return scene


def _check(scene: Scene, method: str, expected: dict[str, tuple[float, list[float]]]) -> None:
    found, close = _run(scene, method), CLOSE[method]
    first = min(t for t, _ in expected.values())
    assert (found.status < 0) == (first < T_END), found.message
    assert found.t[-1] == pytest.approx(first, abs=close), found.message
    for name, (t, z) in expected.items():
        if t == first:
            assert found[name][-1] == pytest.approx(z[0], abs=close)


def _cases(kinds: Sequence[str], places: Sequence[str]) -> list[tuple[str, ...]]:
    return list(product(kinds, JUMPS, KINKS, places))


@pytest.mark.campaign
@pytest.mark.parametrize(("how", "jump", "kink", "place"), _cases(list(ARRANGED), list(ELEMENTS)))
def test_a_jump_and_a_kink_in_one_law(how, jump, kink, place):
    _check_law(how, jump, kink, place)


@pytest.mark.sampled(4)
@pytest.mark.parametrize("number", range(64))
def test_one_arrangement_of_each_jump_and_kink(number):
    jump, kink = list(product(JUMPS, KINKS))[number]
    how, place = list(ARRANGED)[(number + number // 8) % 4], list(ELEMENTS)[number // 4 % 2]
    _check_law(how, jump, kink, place)


def _check_law(how: str, jump: str, kink: str, place: str) -> None:
    law = ARRANGED[how](JUMPS[jump], KINKS[kink])
    make, rate, z = ELEMENTS[place]
    scene = _scene()
    make(scene, law.text(place))
    method = METHODS[(len(how) + len(jump) + len(kink)) % len(METHODS)]
    _check(scene, method, {place: _moved(law, rate, z)})


@pytest.mark.sampled(2)
@pytest.mark.parametrize(("jump", "kink"), list(product(JUMPS, KINKS)))
def test_a_jump_and_a_kink_in_elements_apart(jump, kink):
    laws = [JUMPS[jump], KINKS[kink]]
    turned = (len(jump) + len(kink)) % 2
    scene, expected = _scene(), {}
    for law, (place, (make, rate, z)) in zip(
        laws[::-1] if turned else laws, ELEMENTS.items(), strict=True
    ):
        make(scene, law.text(place))
        expected[place] = _moved(law, rate, z)
    _check(scene, METHODS[len(jump) % len(METHODS)], expected)
