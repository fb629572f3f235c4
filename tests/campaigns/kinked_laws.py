"""Continuous piecewise laws in five situations, each as an expression and as a registered law."""

from __future__ import annotations

import math
import re
import warnings
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy
from scipy.integrate import solve_ivp

from cotree import Scene
from cotree.components import register_component

if TYPE_CHECKING:
    from collections.abc import Callable

#: Values of what a law depends on besides ``v``.
VALUES = {"k": 0.8, "c": 0.3, "z": 0.0}
METHODS = ("dopri5", "rkf45", "dop853", "rodas4", "rodas5", "cvode", "ida")
SITUATIONS = ("cross", "start", "rest", "decay", "touch")
END = 2.0
RTOL = 1e-8

#: The points of the table ``bent``, which goes on with its slopes beyond them.
BENT = ([-1.0, 0.0, 1.0], [-0.5, 0.0, 2.0])


@dataclass(frozen=True)
class Kinked:
    """A continuous law of ``v``.

    Attributes
    ----------
    text : str
        The law, in the grammar of expressions.
    at : str
        Where it has its corner, which is one of the names of :data:`VALUES`.
    is_steep : bool
        Whether its slope is infinite there.
    is_registered : bool
        Whether a registered law can say the same.
    """

    text: str
    at: str = "z"
    is_steep: bool = False
    is_registered: bool = True


_CHANNEL = "where({0} < c, k*(c - {0}/2)*{0}, k*c**2/2)"

LAWS = {
    "spring": Kinked("where(v > 0, k*v, 0)"),
    "spring_from": Kinked("where(v >= c, k*(v - c), 0)", "c"),
    "spring_max": Kinked("k*max(v, 0)"),
    "spring_max_from": Kinked("k*max(v - c, 0)", "c"),
    "diode": Kinked("where(v > 0, v/0.5, v/1000)"),
    "diode_knee": Kinked("where(v < c, k*v, (v - c)*5 + k*c)", "c"),
    "diode_max": Kinked("k*v + (5 - k)*max(v - c, 0)", "c"),
    "diode_at_zero": Kinked("where(v > z, k*v, 0)"),
    "hertz": Kinked("where(v > 0, k*v**1.5, 0)"),
    "hertz_max": Kinked("k*max(v, 0)**1.5"),
    "hertz_root": Kinked("where(v < 0, 0, k*v*sqrt(v))"),
    "hertz_below": Kinked("where(v <= 0, -k*(-v)**1.5, 0)"),
    "saturation": Kinked("min(max(v, -c), c)", "c"),
    "saturation_where": Kinked("where(v > c, c, where(v < -c, -c, v))", "c"),
    "saturation_ratio": Kinked("where(v > c, 1, where(v < -c, -1, v/c))", "c"),
    "dead_band": Kinked("where(v > c, v - c, where(v < -c, v + c, 0))", "c"),
    "dead_band_max": Kinked("max(v - c, 0) + min(v + c, 0)", "c"),
    "drag": Kinked("v*abs(v)"),
    "drag_sign": Kinked("k*v*v*sign(v)"),
    "drag_where": Kinked("where(v > 0, v**2, -v**2)"),
    "orifice": Kinked("sign(v)*sqrt(abs(v))", is_steep=True),
    "orifice_where": Kinked("where(v > 0, k*sqrt(v), -k*sqrt(-v))", is_steep=True),
    "orifice_power": Kinked("where(v > c, k*(v/c - 1)**0.7, 0)", "c", is_steep=True),
    "orifice_laminar": Kinked("where(abs(v) < c, v/sqrt(c), sign(v)*sqrt(abs(v)))", "c"),
    "root": Kinked("sqrt(max(v, 0))", is_steep=True),
    "root_smooth": Kinked("sqrt(c**2 + max(v, 0)**2) - c"),
    "mosfet": Kinked(
        f"where(v < 0, -{_CHANNEL.format('(-v)')}, {_CHANNEL.format('v')})",
    ),
    "mosfet_pinched": Kinked(
        f"where(v < 0, -{_CHANNEL.format('(-v)')}, {_CHANNEL.format('v')})", "c"
    ),
    "smooth": Kinked("where(v > c, k*(v - c)**2 + v, v)", "c"),
    "smooth_cubic": Kinked("where(v > 0, v**3 + v, v)"),
    "smooth_sine": Kinked("where(v > 0, sin(v), v)"),
    "exponential": Kinked("where(v > 0, exp(v) - 1, k*v)"),
    "logarithm": Kinked("where(v > 0, log(1 + v), 0)"),
    "nested": Kinked("where(v > 0, where(v > c, k*c + 3*(v - c), k*v), 0.1*v)"),
    "nested_upper": Kinked("where(v > 0, where(v > c, k*c + 3*(v - c), k*v), 0.1*v)", "c"),
    "vee": Kinked("k*abs(v - c)", "c"),
    "half": Kinked("k*(v + abs(v))/2"),
    "quotient": Kinked("v/(1 + abs(v))"),
    "divided": Kinked("1/(1 + max(v, 0))"),
    "triangle": Kinked("abs(mod(v - c, 1) - 0.5)", "c"),
    "table": Kinked("bent(v - c)", "c", is_registered=False),
}


def _registered(law: Kinked) -> Callable[..., Any]:
    """Build the registered law of a text."""
    functions = {
        "where": lambda holds, own, other: sympy.Piecewise((own, holds), (other, True)),
        **{"min": sympy.Min, "max": sympy.Max, "abs": sympy.Abs, "mod": sympy.Mod},
        **{name: getattr(sympy, name) for name in ("sign", "sqrt", "sin", "exp", "log")},
    }

    def through(across: Any, k: Any, c: Any, z: Any) -> Any:
        return eval(law.text, functions, {"v": across, "k": k, "c": c, "z": z})

    return through


def _number(law: Kinked) -> Callable[[float, dict[str, float]], float]:
    """Build the Python function of a text, of v and the values."""
    functions = {
        # A branch that is not taken may have no value.
        "where": lambda holds, own, other: own if holds else other,
        **{"min": min, "max": max, "abs": abs, "sin": math.sin, "exp": math.exp},
        "mod": lambda a, b: a - b * math.floor(a / b),
        "sign": lambda x: float(np.sign(x)),
        "sqrt": lambda x: math.sqrt(max(x, 0.0)),
        "log": lambda x: math.log(max(x, 1e-300)),
        "bent": lambda x: (2.0 if x > 0 else 0.5) * x,
    }
    # Powers of negative numbers are complex, and not taken.
    text = re.sub(r"(?<!max)(\([^()]*\)|\bv)\*\*(\d\.\d)", r"abs(\1)**\2", law.text)
    code = compile(text, "law", "eval")
    return lambda v, values: float(eval(code, functions, {"v": v, **values}))


def _level(law: Kinked) -> float:
    """Return the value of a law on its corner."""
    return _number(law)(VALUES[law.at], VALUES)


def scene_of(name: str, situation: str, *, is_registered: bool) -> Scene:
    """Build the scene of a law in one situation: a capacitor C that its current discharges.

    Where the corner is touched, the law depends on a voltage S.v that it does not load, of
    ``at + 0.5 + 0.5 cos(3 t)``.
    """
    law, scene = LAWS[name], Scene(f"{name}-{situation}")
    at, level, is_touched = law.at, _level(law), situation == "touch"
    for parameter, value in VALUES.items():
        scene.parameter(parameter, value)
    scene.table("bent", x=BENT[0], y=BENT[1], beyond="extend")
    if is_touched:
        scene.edge("U", "voltage_source", "u", "ground", voltage=f"{at} + 0.5")
        scene.edge("L", "inductor", "u", "s", inductance=1 / 9)
        above = {"v": f"{at} + 1"}
        scene.edge("S", "capacitor", "s", "ground", capacitance=1.0, initial=above)
        scene.edge("B", "voltage_source", "x", "ground", voltage="S.v")
        scene.edge("C", "capacitor", "y", "ground", capacitance=1.0)
        scene.edge("G", "current_source", "ground", "y", current="D.i")
    else:
        drive = {
            "cross": "3*sin(5*t)",
            "start": f"{level!r} + 1.3*sin(3*t)",
            "rest": f"{level!r}",
            "decay": f"{level!r} + 2*({at} - C.v)",
        }[situation]
        start = {"v": at if situation in ("start", "rest") else f"{at} + 0.4"}
        scene.edge("I", "current_source", "ground", "x", current=drive)
        scene.edge("C", "capacitor", "x", "ground", capacitance=1.0, initial=start)
    if is_registered:
        register_component("kinked", _registered(law), domain="electrical", gives="through")
        scene.edge("D", "kinked", "x", "ground", k="k", c="c", z="z")
    else:
        current = re.sub(r"\bv\b", "S.v" if is_touched else "C.v", law.text)
        scene.edge("D", "current_source", "x", "ground", current=current)
    return scene


_STEP = 1e-4  # of parameters, for differences


@cache  # the reference is the same for expressions and registered laws
def expected(name: str, situation: str, parameters: tuple[str, ...] = ()) -> list[float]:
    """Integrate with SciPy in short steps: what C.v is in the end.

    The first value is that of the given parameters. Two values for each of ``parameters`` follow,
    with a larger and a smaller value of the parameter.
    """
    law, level, value = LAWS[name], _level(LAWS[name]), _number(LAWS[name])
    shifted = [(row, VALUES[row] + h) for row in parameters for h in (_STEP, -_STEP)]
    every = [VALUES, *({**VALUES, row: own} for row, own in shifted)]
    places = [values[law.at] for values in every]
    if law.is_steep and situation == "decay":
        # An infinite slope brings it to rest in a finite time, within which Radau hangs.
        return places
    rate = {
        "cross": lambda t, v, at, own: 3 * math.sin(5 * t) - value(v, own),
        "start": lambda t, v, at, own: level + 1.3 * math.sin(3 * t) - value(v, own),
        "rest": lambda t, v, at, own: level - value(v, own),
        "decay": lambda t, v, at, own: level + 2 * (at - v) - value(v, own),
        "touch": lambda t, v, at, own: value(at + 0.5 + 0.5 * math.cos(3 * t), own),
    }[situation]
    above = {"cross": 0.4, "start": 0.0, "rest": 0.0, "decay": 0.4}
    starts = [at + above[situation] if situation in above else 0.0 for at in places]
    found = solve_ivp(
        lambda t, y: [rate(t, *of) for of in zip(y, places, every, strict=True)],
        (0, END),
        starts,
        # Explicit steps do not come to rest at an infinite slope.
        method="Radau" if law.is_steep else "DOP853",
        rtol=1e-10,
        atol=1e-12,
        max_step=0.01,
    )
    return [float(end) for end in found.y[:, -1]]


def slopes(name: str, situation: str, parameters: list[str]) -> dict[str, float]:
    """Return derivatives by differences, where there are any.

    Close to rest on a corner that moves, and where slopes are infinite, there are none.
    """
    law = LAWS[name]
    if law.is_steep or situation == "rest" or (situation == "decay" and law.at != "z"):
        return {}
    _, *ends = expected(name, situation, tuple(parameters))
    differences = zip(parameters, ends[::2], ends[1::2], strict=True)
    return {parameter: (more - less) / (2 * _STEP) for parameter, more, less in differences}


def faults(
    name: str, situation: str, *, is_registered: bool, parameters: list[str], methods: list[str]
) -> list[str]:
    """Run one scene with several methods, and say what is wrong."""
    scene, found = scene_of(name, situation, is_registered=is_registered), []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of parameters that nothing depends on
        model = scene.compile(parameters, optimize="-O0")
    along = slopes(name, situation, parameters)
    want = expected(name, situation, tuple(parameters) if along else ())[0]
    for method in methods:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # runs that stop are told by their status
            result = model.simulate((0, END), method=method, rtol=RTOL, atol=1e-10)
        if not result.success:
            found.append(f"{method}: {result.message}")
            continue
        # Multistep methods err by some hundred tolerances where they begin anew.
        if abs(result["C.v"][-1] - want) > 300 * RTOL:
            found.append(f"{method}: C.v = {result['C.v'][-1]!r}, expected {want!r}")
        # What chatters at a corner takes a hundred thousand.
        if result.statistics.n_steps > 20_000:
            found.append(f"{method}: {result.statistics.n_steps} steps")
        for parameter, slope in along.items():
            own = result.sensitivity("C.v", parameter)[-1]
            # Differences over 1e-4 of a reference that errs by some 1e-9 at corners.
            if abs(own - slope) > 1e-4 * (1.0 + abs(slope)):
                found.append(f"{method}: dC.v/d{parameter} = {own!r}, expected {slope!r}")
    return found
