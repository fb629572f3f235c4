"""Random scenes that switch, and an independent solution of each.

A law is a random expression of jumps and kinks, of states and of time. It stands in one element of
a small circuit, mechanism or hydraulic network whose right-hand side is written here by hand. The
reference integrates that by SciPy: from one switching surface of a jump to the next, with pieces
held in between and each surface found by bisection; kinks, which are continuous, as they are.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy
from scipy.integrate import DOP853

from cotree import Scene, register_component

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T_END = 2.5
TIMES = np.linspace(0.0, T_END, 6)

#: Of the reference, whose steps are as short as switching functions are smooth.
RTOL, ATOL, LONGEST, GLANCES = 1e-12, 1e-13, 0.02, 8
#: Crossings after which a reference gives up, and the time within which one that goes back is a
#: motion that is driven back to where the law jumps.
MOST, SHORT = 400, 1e-7
#: Beyond this a scene grows, and nothing is compared.
LARGEST = 30.0

SITUATIONS = ("free", "start", "rest", "decay")
POINTS, VALUES = (-0.8, -0.1, 0.35, 0.9), (0.5, -0.3, 0.4, 0.1)

# ------------------------------------------------------------------------------------------------
# Laws


@dataclass
class Law:
    """An expression: its text in a scene, its text in Python, and the kinds that it is made of."""

    text: str
    code: str
    kinds: tuple[str, ...] = ()


@dataclass
class Writer:
    """Writes laws of some names.

    Attributes
    ----------
    rng : Generator
        Draws everything.
    names : list of str
        Names of states in the scene; in Python they are ``x[0]``, ``x[1]``, ...
    is_smooth : bool
        Whether laws have kinks alone.
    level : float or None
        The value of the first state at which arguments vanish; None draws one.
    is_registered : bool
        Whether laws are functions of the first state alone that SymPy has, too.
    is_within : bool
        Whether kinks may stand within roots, exponentials and divisors.
    """

    rng: np.random.Generator
    names: list[str]
    is_smooth: bool
    level: float | None
    is_registered: bool = False
    is_within: bool = False
    n_jumps: int = 0

    def number(self, low: float, high: float) -> float:
        """Draw a number of three digits."""
        return float(round(self.rng.uniform(low, high), 3))

    def argument(self) -> Law:
        """Write a sum of states and perhaps of time, less a level that is a parameter."""
        rng, a = self.rng, self.number(0.5, 2.0)
        if self.level is not None:
            level = -a * self.level
            return Law(f"({a}*{self.names[0]} + {level!r} - d)", f"({a}*x[0] + {level!r} - d)")
        i = int(rng.integers(len(self.names)))
        text, code = f"{a}*{self.names[i]}", f"{a}*x[{i}]"
        if self.is_registered:
            pass
        elif rng.random() < 0.2:
            n = self.number(2.0, 9.0)
            text, code = f"sin({n}*{self.names[i]})", f"sin({n}*x[{i}])"
        if self.is_registered:
            pass
        elif rng.random() < 0.3:
            b, w = self.number(0.1, 0.4), self.number(1.0, 5.0)
            text, code = f"{text} + {b}*sin({w}*t)", f"{code} + {b}*sin({w}*t)"
        elif rng.random() < 0.15:
            w = self.number(2.0, 6.0)
            text, code = f"sin({w}*t)", f"sin({w}*t)"
        level = self.number(-0.5, 0.5)
        return Law(f"({text} - {level} - d)", f"({code} - {level} - d)")

    def law(self, depth: int = 0) -> Law:
        """Write a law; those of laws are at most three deep."""
        rng = self.rng
        inner = self.argument()
        # SymPy folds branches within conditions to others than comparisons, which are refused.
        if depth < 2 and rng.random() < 0.25 and not self.is_registered:
            own = self.law(depth + 1)
            a = self.number(0.3, 0.9)
            inner = Law(f"({inner.text} + {a}*({own.text}))", f"({inner.code} + {a}*({own.code}))")
            inner.kinds = own.kinds
        kinds = list(_KINKS) if self.is_smooth else [*_JUMPS, *_JUMPS, *_KINKS]
        if self.is_registered:
            kinds = [kind for kind in _KINKS if kind not in ("table", "by sign")]
        kinds += [*_WITHIN, *_WITHIN] if self.is_within else []
        kind = str(rng.choice(kinds))
        text, code = (_KINKS | _WITHIN | _JUMPS)[kind]
        if kind in _JUMPS:
            self.n_jumps += 1
        values = {
            "u": inner,
            "k": str(self.n_jumps - 1),
            "m": self.number(0.3, 0.9),
            "a": self.number(0.2, 0.9),
            "b": self.number(-0.9, -0.1),
        }
        spelt = Law(
            text.format(**values | {"u": inner.text}),
            code.format(**values | {"u": inner.code}),
            (*inner.kinds, kind),
        )
        if depth < 2 and rng.random() < 0.25:
            other, sign = self.law(depth + 1), str(rng.choice(["+", "-", "*"]))
            spelt = Law(
                f"({spelt.text}) {sign} ({other.text})",
                f"({spelt.code}) {sign} ({other.code})",
                (*spelt.kinds, *other.kinds),
            )
        return spelt


#: Text in a scene, and in Python; ``j`` chooses the piece of a jump, which the reference holds.
_JUMPS = {
    "sign": ("sign({u})", "(1.0 if j({k}, {u} > 0) else -1.0)"),
    "step": ("where({u} > 0, 1, 0)", "(1.0 if j({k}, {u} > 0) else 0.0)"),
    "floor": ("floor(2*{u})/2", "j({k}, floor(2*{u}))/2"),
    "ceiling": ("-floor(-2*{u})/2", "-j({k}, floor(-2*{u}))/2"),
    "mod": ("mod({u}, {m})", "({u} - {m}*j({k}, floor({u}/{m})))"),
    "where": ("where({u} >= 0, {a}, {b}*{u})", "({a} if j({k}, {u} >= 0) else {b}*{u})"),
    "between": (
        "where({b} < {u} <= {a}, {a}, {b})",
        "({a} if j({k}, ({u} > {b}, {u} <= {a})) == (True, True) else {b})",
    ),
    "either": (
        "where({u} > {a} or not {u} > {b}, {a} + {u}, {b})",
        "({a} + {u} if j({k}, ({u} > {a}, {u} > {b})) != (False, True) else {b})",
    ),
}
_KINKS = {
    "abs": ("abs({u})", "abs({u})"),
    "min": ("min({u}, {a}*{u})", "min({u}, {a}*{u})"),
    "max": ("max({u}, 0)", "max({u}, 0.0)"),
    "clip": ("min(max({u}, {b}), {a})", "min(max({u}, {b}), {a})"),
    "square": ("{u}*abs({u})", "{u}*abs({u})"),
    "hertz": ("where({u} > 0, {a}*{u}**1.5, 0)", "{a}*max({u}, 0.0)**1.5"),
    "root of max": ("max({u}, 0)**1.5", "max({u}, 0.0)**1.5"),
    "exchanged": (
        "where({u} < 0, -(({a} - 0.1*{u})*(-{u})), ({a} + 0.1*{u})*{u})",
        "({a} + 0.1*abs({u}))*{u}",
    ),
    "bent": ("where({u} < 0, {a}*{u}, {m}*{u} + 0.3*{u}**2)", "bent({u}, {a}, {m})"),
    "table": ("curve({u})", "curve({u})"),
    "by sign": ("{u}*sign({u})", "abs({u})"),
}


_WITHIN = {
    "root": ("max({u}, 0)**0.6", "max({u}, 0.0)**0.6"),
    "exponential": ("2**(-{a}*abs({u}))", "2**(-{a}*abs({u}))"),
    "divided": ("1/(1 + max({u}, 0))", "1/(1 + max({u}, 0.0))"),
    "rounded": ("(0.1 + abs({u}))**0.5", "(0.1 + abs({u}))**0.5"),
}

#: From this seed on laws are continuous, and kinks may stand within functions.
FIRST_WITHIN = 10_000


def _bent(u: float, a: float, m: float) -> float:
    return a * u if u < 0 else m * u + 0.3 * u * u


def _curve(u: float) -> float:
    if u <= POINTS[0] or u >= POINTS[-1]:
        return VALUES[0] if u <= POINTS[0] else VALUES[-1]
    k = bisect_right(POINTS, u) - 1
    slope = (VALUES[k + 1] - VALUES[k]) / (POINTS[k + 1] - POINTS[k])
    return VALUES[k] + slope * (u - POINTS[k])


# ------------------------------------------------------------------------------------------------
# Scenes


@dataclass
class Made:
    """A scene, its states at the start, and its rates as a function of the law's value."""

    scene: Scene
    names: list[str]
    start: list[float]
    rates: Callable[[float, Sequence[float], float, float], list[float]]
    law: Law = field(default_factory=lambda: Law("0", "0"))
    situation: str = "free"
    n_jumps: int = 0

    @property
    def is_continuous(self) -> bool:
        """Whether the law has kinks alone."""
        return self.n_jumps == 0


def _capacitor(scene: Scene, drive: str, law: str, start: Sequence[float]) -> Made:
    scene.edge("I", "current_source", "ground", "a", current=f"{drive} + {law}")
    scene.edge("C", "capacitor", "a", "ground", capacitance=0.8, initial={"v": start[0]})
    scene.edge("R", "resistor", "a", "ground", resistance=1.5)

    def rates(t: float, x: Sequence[float], f: float, q: float) -> list[float]:
        return [(f + q - x[0] / 1.5) / 0.8]

    return Made(scene, ["C.v"], list(start[:1]), rates)


def _ladder(scene: Scene, drive: str, law: str, start: Sequence[float]) -> Made:
    scene.edge("V", "voltage_source", "a", "ground", voltage=f"{drive} + {law}")
    scene.edge("R1", "resistor", "a", "b", resistance=0.9)
    scene.edge("C1", "capacitor", "b", "ground", capacitance=0.7, initial={"v": start[0]})
    scene.edge("R2", "resistor", "b", "c", resistance=0.6)
    scene.edge("C2", "capacitor", "c", "ground", capacitance=0.4, initial={"v": start[1]})

    def rates(t: float, x: Sequence[float], f: float, q: float) -> list[float]:
        between = (x[0] - x[1]) / 0.6
        return [((f + q - x[0]) / 0.9 - between) / 0.7, between / 0.4]

    return Made(scene, ["C1.v", "C2.v"], list(start), rates)


def _resonator(scene: Scene, drive: str, law: str, start: Sequence[float]) -> Made:
    scene.edge("I", "current_source", "ground", "a", current=f"{drive} + {law}")
    scene.edge("C", "capacitor", "a", "ground", capacitance=0.5, initial={"v": start[0]})
    scene.edge("R", "resistor", "a", "ground", resistance=2.0)
    scene.edge("L", "inductor", "a", "ground", inductance=0.4, initial={"i": start[1]})

    def rates(t: float, x: Sequence[float], f: float, q: float) -> list[float]:
        return [(f + q - x[0] / 2.0 - x[1]) / 0.5, x[0] / 0.4]

    return Made(scene, ["C.v", "L.i"], list(start), rates)


def _inertia(scene: Scene, drive: str, law: str, start: Sequence[float]) -> Made:
    given = {"theta": start[0], "w": start[1]}
    scene.edge("J", "rotational_inertia", "ground", "b", inertia=0.8, initial=given)
    scene.edge("c", "rotational_damper", "ground", "b", damping=0.3)
    scene.edge("T", "torque_source", "ground", "b", torque=f"{drive} - 2*J.theta + {law}")

    def rates(t: float, x: Sequence[float], f: float, q: float) -> list[float]:
        return [x[1], (f + q - 2.0 * x[0] - 0.3 * x[1]) / 0.8]

    return Made(scene, ["J.theta", "J.w"], list(start), rates)


def _tanks(scene: Scene, drive: str, law: str, start: Sequence[float]) -> Made:
    scene.edge("Q", "flow_source", "ground", "a", flow=f"{drive} + {law}")
    unit = {"density": 1.0, "gravity": 1.0}
    for name, node, area, p in (("T1", "a", 0.6, start[0]), ("T2", "b", 0.5, start[1])):
        scene.edge(name, "tank", node, "ground", area=area, **unit, initial={"p": p})
    scene.edge("R1", "hydraulic_resistor", "a", "b", resistance=0.8)
    scene.edge("R2", "hydraulic_resistor", "b", "ground", resistance=1.1)

    def rates(t: float, x: Sequence[float], f: float, q: float) -> list[float]:
        between = (x[0] - x[1]) / 0.8
        return [(f + q - between) / 0.6, (between - x[1] / 1.1) / 0.5]

    return Made(scene, ["T1.p", "T2.p"], list(start), rates)


def _pendulum(scene: Scene, drive: str, law: str, start: Sequence[float]) -> Made:
    given = {"theta": start[0], "theta_dot": start[1]}
    torque = f"{drive} + {law}"
    scene.edge(
        "h", "revolute", "ground", "A", axis=[0, 0, 1], torque=torque, damping=0.3, initial=given
    )
    scene.edge("rod", "arm", "A", "B", vector=[0, -0.5, 0])
    scene.edge("bob", "rigid_body", "ground", "B", mass=1.0, inertia=0.05)

    def rates(t: float, x: Sequence[float], f: float, q: float) -> list[float]:
        turned = f + q - 0.3 * x[1] - 0.5 * 9.81 * math.sin(x[0])
        return [x[1], turned / (0.25 + 0.05)]

    return Made(scene, ["h.theta", "h.theta_dot"], list(start), rates)


def _registered(scene: Scene, drive: str, law: str, start: Sequence[float]) -> Made:
    """A law that a user registers, of the voltage, in SymPy's own functions."""
    functions = {
        "where": lambda holds, own, other: sympy.Piecewise((own, holds), (other, True)),
        **{"min": sympy.Min, "max": sympy.Max, "abs": sympy.Abs},
    }
    text = law.replace("C.v", "v")

    def through(across: Any, q: Any, d: Any) -> Any:
        return eval(text, functions, {"v": across, "q": q, "d": d})

    register_component("switching", through, domain="electrical", gives="through")
    scene.edge("I", "current_source", "ground", "a", current=drive)
    scene.edge("C", "capacitor", "a", "ground", capacitance=0.8, initial={"v": start[0]})
    scene.edge("R", "resistor", "a", "ground", resistance=1.5)
    scene.edge("D", "switching", "a", "ground", q="q", d="d")

    def rates(t: float, x: Sequence[float], f: float, q: float) -> list[float]:
        return [(f - q - x[0] / 1.5) / 0.8]

    return Made(scene, ["C.v"], list(start[:1]), rates)


PLACES: dict[str, tuple[Callable[..., Made], list[str]]] = {
    "capacitor": (_capacitor, ["C.v"]),
    "inertia": (_inertia, ["J.theta", "J.w"]),
    "tanks": (_tanks, ["T1.p", "T2.p"]),
    "resonator": (_resonator, ["C.v", "L.i"]),
    "pendulum": (_pendulum, ["h.theta", "h.theta_dot"]),
    "ladder": (_ladder, ["C1.v", "C2.v"]),
    "registered": (_registered, ["C.v"]),
}


def make(seed: int) -> Made:
    """Build a random scene."""
    rng = np.random.default_rng([33, seed])
    place = list(PLACES)[seed % len(PLACES)]
    build, names = PLACES[place]
    situation = str(rng.choice(SITUATIONS, p=[0.55, 0.15, 0.15, 0.15]))
    start = [float(round(rng.uniform(-0.8, 0.8), 3)) for _ in range(2)]
    level = None
    if situation == "start":
        level = start[0]
    elif situation in ("rest", "decay"):
        level = 0.0
        start = [0.0, 0.0] if situation == "rest" else start
    is_within, is_registered = seed >= FIRST_WITHIN, place == "registered"
    is_smooth = bool(rng.random() < 0.4) or is_within
    writer = Writer(rng, names, is_smooth, level, is_registered, is_within)
    law = writer.law()
    a, w = writer.number(0.6, 1.6), writer.number(1.0, 3.0)
    drive, force = f"{a}*cos({w}*t)", f"{a}*cos({w}*t)"
    if situation == "decay":
        drive = force = "0"
    elif situation == "rest":  # until something pushes, continuously
        drive, force = f"where(t > 0.7, {a}*sin({w}*(t - 0.7)), 0)", f"{a}*late(t, {w})"
    scene = Scene(f"switching-{seed}", gravity=[0, -9.81, 0])
    scene.parameter("q", float(round(rng.uniform(0.3, 0.9), 3)))
    scene.parameter("d", 0.0)
    scene.table("curve", list(POINTS), list(VALUES))
    made = build(scene, drive, f"q*({law.text})", start)
    made.law = Law(law.text, f"({force}, {law.code})", law.kinds)
    made.situation, made.n_jumps = situation, writer.n_jumps
    return made


# ------------------------------------------------------------------------------------------------
# The reference


@dataclass
class Reference:
    """An independent solution.

    Attributes
    ----------
    y : ndarray, shape (n, 6)
        The states at ``TIMES``, as far as it goes.
    end : float
        Where it ends: the time at which the motion is driven back to where the law jumps, or
        ``T_END``.
    order : list of int
        The jumps that were crossed, in turn.
    is_open : bool
        Whether it could not be told how it goes on: from rest on a surface, or after many switches.
    """

    y: np.ndarray
    end: float
    order: list[int]
    is_open: bool = False


class _Switched:
    """Rates with pieces that are held, and the pieces that hold at a point."""

    def __init__(self, made: Made, q: float, d: float) -> None:
        self.made, self.q = made, q
        self.held: dict[int, Any] = {}
        self.seen: dict[int, Any] = {}
        self._code = compile(made.law.code, "law", "eval")
        late = lambda t, w: math.sin(w * (t - 0.7)) if t > 0.7 else 0.0  # noqa: E731
        self._names = {
            **{"floor": math.floor, "sin": math.sin, "cos": math.cos, "abs": abs},
            **{"min": min, "max": max, "bent": _bent, "curve": _curve, "late": late},
            **{"j": self._piece, "d": d},
        }

    def _piece(self, k: int, natural: Any) -> Any:
        self.seen[k] = natural
        return self.held.get(k, natural)

    def __call__(self, t: float, x: Sequence[float]) -> np.ndarray:
        force, law = eval(self._code, self._names, {"t": t, "x": x})
        return np.array(self.made.rates(t, x, force, self.q * law))

    def pieces(self, t: float, x: Sequence[float]) -> dict[int, Any]:
        """Return the pieces at a point, where all inner ones are held."""
        self.seen = {}
        self(t, x)
        return dict(self.seen)

    def settle(self, t: float, x: Sequence[float]) -> None:
        """Hold the pieces of a point: those of inner jumps decide where outer ones stand."""
        self.held = {}
        self.held = self.pieces(t, x)


@np.errstate(over="ignore", invalid="ignore")  # a scene that grows is not compared
def solve(made: Made, q: float, d: float = 0.0, start: Sequence[float] | None = None) -> Reference:
    """Integrate from surface to surface, with two step limits that lead to the same solution.

    A step over a kink may lose digits without any sign in its error estimate.
    """
    longest = LONGEST
    found = _integrate(made, q, d, start, longest)
    for _ in range(3):
        longest *= 0.6
        finer = _integrate(made, q, d, start, longest)
        if np.allclose(found.y, finer.y, rtol=1e-10, atol=1e-11, equal_nan=True):
            break
        found = finer
    return finer


def _integrate(
    made: Made, q: float, d: float, start: Sequence[float] | None, longest: float
) -> Reference:
    f, t = _Switched(made, q, d), 0.0
    x = np.array(made.start if start is None else start, dtype=float)
    found = np.full((len(x), len(TIMES)), np.nan)
    found[:, 0] = x
    if not _begin(f, x):
        return Reference(found, 0.0, [], is_open=True)
    order: list[int] = []
    last, before = -1.0, f.held
    while t < T_END:
        if len(order) > MOST:
            return Reference(found, t, order, is_open=True)
        solver = DOP853(f, t, x, T_END, rtol=RTOL, atol=ATOL, max_step=longest)
        crossed = None
        while crossed is None and solver.status == "running":
            try:
                solver.step()
            except OverflowError:  # of the floor of a value that a stage takes beyond all
                return Reference(found, float(solver.t), order, is_open=True)
            if not np.abs(solver.y).max() < LARGEST:
                return Reference(found, float(solver.t), order, is_open=True)
            dense, begun = solver.dense_output(), solver.t_old
            if made.n_jumps:
                crossed = _first_crossing(f, dense, begun, solver.t)
            now = solver.t if crossed is None else crossed
            inside = (begun < TIMES) & (now >= TIMES)
            if inside.any():
                found[:, inside] = dense(TIMES[inside])
        if crossed is None:
            return Reference(found, T_END, order)
        t, x = crossed, dense(crossed)
        held = f.held
        f.settle(t, x)
        order += [k for k in held if f.held.get(k) != held[k]]
        if t - last < SHORT and f.held == before:
            return Reference(found, last, order)  # from either side it is driven back
        last, before = t, held
    return Reference(found, T_END, order)


def _begin(f: _Switched, x: np.ndarray) -> bool:
    """Hold the pieces behind the start; return whether they can be told."""
    f.settle(0.0, x)
    if not f.made.n_jumps:
        return True
    h = 1e-7
    for side in (0.0, h, -h):
        # Where the start lies on a surface, the pieces of either side are tried.
        f.settle(0.0, x + side)
        ahead = x + h * f(0.0, x)
        held = f.held
        f.held = {}
        if f.pieces(h, ahead) == held and np.abs(f(0.0, x)).max() > 1e-9:
            f.held = held
            if side == 0.0:
                others = []
                for other in (h, -h):
                    f.settle(0.0, x + other)
                    others.append(f.held)
                f.held = held
                # Two ways to go on, of which none is right.
                return all(own == held for own in others) or _leaves(f, x, others, held)
            return True
    return False


def _leaves(f: _Switched, x: np.ndarray, others: list[dict[int, Any]], held: Any) -> bool:
    h, ways = 1e-7, 0
    for own in others:
        f.held = own
        ahead = x + h * f(0.0, x)
        f.held = {}
        ways += f.pieces(h, ahead) == own
    f.held = held
    return ways == 1


def _first_crossing(f: _Switched, dense: Any, begun: float, end: float) -> float | None:
    """Find where the held pieces end, by glances at a step and bisection."""
    low = begun
    for high in np.linspace(begun, end, GLANCES + 1)[1:]:
        if f.pieces(high, dense(high)) != f.held:
            while high - low > 4e-16 * max(1.0, abs(high)):
                middle = 0.5 * (low + high)
                if not low < middle < high:
                    break
                if f.pieces(middle, dense(middle)) != f.held:
                    high = middle
                else:
                    low = middle
            return float(high)
        low = high
    return None
