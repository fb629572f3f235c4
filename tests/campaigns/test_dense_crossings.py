"""Random functions of one angle with many zeros in a step: events, jumps and corners, none missed.

The angle of a free or damped inertia is known in closed form, so that the zeros of any function of
it are found on a grid that no step of a run has. A commutated inertia keeps its energy less the
work of a triangular wave. The environment variable ``COTREE_CASES`` gives the number of cases.
"""

from __future__ import annotations

import os
import warnings
from typing import TYPE_CHECKING

import numpy as np
import pytest

from cotree import Scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from cotree import Model

pytestmark = pytest.mark.compiler

CASES = int(os.environ.get("COTREE_CASES", "2"))
METHODS = ("dop853", "dopri5", "rkf45", "rodas4", "rodas5", "cvode", "ida")

#: Angles from nought to this, in grid points so many that no zero of a function lies between two
#: unseen: the fastest has some 2,000, and pairs nearer than the grid are told by its values.
TURN, POINTS = 6.0, 2_000_001


def _cosine_of_multiple(rng):
    """A polynomial of the cosine that has all of the zeros of cos(n x) - c."""
    n, c = int(rng.integers(2, 9)), rng.uniform(-0.98, 0.98)
    terms = np.polynomial.chebyshev.cheb2poly([0.0] * n + [1.0])
    text = " + ".join(f"({a:.17g})*cos(J.theta)**{k}" for k, a in enumerate(terms) if a)
    return f"{text} - ({c:.17g})"


FUNCTIONS: dict[str, Callable[[np.random.Generator], str]] = {
    "teeth": lambda rng: f"sin({rng.integers(2, 300)}*J.theta + {rng.uniform(0, 6):.6g})",
    "narrow teeth": lambda rng: f"cos({rng.integers(2, 200)}*J.theta) - 0.999",
    "two sines": lambda rng: (
        f"sin({rng.uniform(1, 40):.6g}*J.theta) + {rng.uniform(0.1, 1.5):.6g}"
        f"*sin({rng.uniform(40, 150):.6g}*J.theta) + {rng.uniform(-1, 1):.6g}"
    ),
    "parabola": lambda rng: (
        f"(J.theta - {rng.uniform(0, TURN):.6g})**2 - {10 ** rng.uniform(-8, -1):.6g}"
    ),
    "quartic": lambda rng: "*".join(f"(J.theta - {a:.6g})" for a in rng.uniform(0, TURN, size=4)),
    "pulse": lambda rng: (
        f"1/(1 + ({10 ** rng.uniform(1, 5):.6g}*(J.theta - {rng.uniform(0, TURN):.6g}))**2) - 0.5"
    ),
    "bell": lambda rng: (
        f"exp(-({10 ** rng.uniform(1, 4):.6g}*(J.theta - {rng.uniform(0, TURN):.6g}))**2) - 0.3"
    ),
    "polynomial of a cosine": _cosine_of_multiple,
    "product": lambda rng: (
        f"sin({rng.uniform(1, 50):.6g}*J.theta)*cos({rng.uniform(1, 50):.6g}*J.theta)"
        f" - {rng.uniform(-0.9, 0.9):.6g}"
    ),
    "sine of a square": lambda rng: f"sin({rng.uniform(1, 30):.6g}*J.theta**2) - 0.2",
    "distance": lambda rng: (
        f"abs(sin({rng.uniform(1, 60):.6g}*J.theta)) - {rng.uniform(0.05, 0.95):.6g}"
    ),
    "largest": lambda rng: (
        f"max(sin({rng.uniform(1, 60):.6g}*J.theta), cos({rng.uniform(1, 60):.6g}*J.theta)) - 0.9"
    ),
    "cotangent": lambda rng: (
        f"1/tan({rng.uniform(0.1, 0.45):.6g}*J.theta + 0.1) - {rng.uniform(1, 9):.6g}"
    ),
    "angle": lambda rng: (
        f"atan2(sin({rng.uniform(1, 9):.6g}*J.theta), 2 + cos({rng.uniform(1, 90):.6g}*J.theta))"
        f" - {rng.uniform(-0.4, 0.4):.6g}"
    ),
}


def zeros_of(text: str, angles: np.ndarray) -> np.ndarray:
    """List the angles at which a function passes through zero, to the distance of the grid."""
    names = {name: getattr(np, name) for name in ("sin", "cos", "exp", "tan", "abs")}
    names |= {"atan2": np.arctan2, "max": np.maximum}
    values = eval(text.replace("J.theta", "q"), {"__builtins__": {}}, {"q": angles, **names})
    return angles[:-1][np.diff(values > 0.0)]


def compiled(text: str, damping: float = 0.0) -> Model:
    """Compile an inertia whose angle an event looks at."""
    scene = Scene("encoder")
    scene.edge(
        "J", "rotational_inertia", "ground", "A", inertia=1.0, initial={"w": 1.0, "theta": 0.0}
    )
    if damping:
        scene.edge("d", "rotational_damper", "ground", "A", damping=damping)
    scene.event("mark", text)
    return scene.compile()


def check_marks(text: str, method: str, damping: float) -> None:
    """Compare the angles at which an event happens with those on a grid."""
    rate = damping or 1.0
    end = -np.log(1.0 - TURN / 8.0) / rate if damping else TURN
    model = compiled(text, damping)
    # Damped, the angle goes on to 8: the speed falls to a quarter within the run.
    initial = {"J.w": 8.0 * damping} if damping else {}
    result = model.simulate((0.0, end), method=method, rtol=1e-8, initial=initial, max_events=10**6)
    assert result.status == 0, (text, method, result.message)
    times = result.events["mark"].t
    found = 8.0 * (1.0 - np.exp(-rate * times)) if damping else times
    angles = np.linspace(0.0, TURN, POINTS)
    expected = zeros_of(text, angles)
    # At both ends the grid and the run may differ in what they count.
    margin = 1e-5
    found = found[(found > margin) & (found < TURN - margin)]
    expected = expected[(expected > margin) & (expected < TURN - margin)]
    assert len(found) == len(expected), (text, method, damping)
    # Steps err by their tolerance: that of the angle over a few hundred restarts, and of the grid.
    assert np.allclose(found, expected, atol=3e-5), (text, method, damping)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", FUNCTIONS)
@pytest.mark.campaign
def test_events_happen_at_every_zero(kind: str, method: str) -> None:
    """Every zero of a random function of a known angle is an event, once."""
    rng = np.random.default_rng([*kind.encode(), *method.encode()])
    for _ in range(CASES):
        check_marks(FUNCTIONS[kind](rng), method, rng.choice([0.0, 0.5]))


def test_an_event_that_rounding_of_the_angle_leaves_inexact_happens_once() -> None:
    """Newton's method found no time at which the function was zero within its own rounding."""
    text = "sin(29.774*J.theta) + 0.374228*sin(53.9728*J.theta) + 0.751218"
    check_marks(text, "rodas5", 0.5)


def commutated(n: int) -> Model:
    """Compile an inertia under a torque that changes its sign n times in half a turn."""
    scene = Scene("motor")
    scene.parameter("J", 0.1)
    scene.parameter("T", 2.0)
    scene.edge("J", "rotational_inertia", "ground", "A", inertia="J", initial={"w": 1.0})
    scene.edge("M", "torque_source", "ground", "A", torque=f"T*sign(sin({n}*J.theta))")
    return scene.compile()


def drawn(rng: np.random.Generator) -> dict[str, float]:
    """Draw parameters and a start: some go round, some turn back in a valley."""
    return {
        "J": 10 ** rng.uniform(-2, 0),
        "T": rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1),
        "J.w": rng.choice([-1, 1]) * 10 ** rng.uniform(-1, 1.5),
        "J.theta": rng.uniform(-3, 3),
    }


def after(n: int, given: dict[str, float], span: float) -> tuple[float, float, float]:
    """Follow a commutated inertia from parabola to parabola; also how far a start is enlarged."""
    a = given["T"] / given["J"]
    t, x, v = 0.0, given["J.theta"], given["J.w"]
    piece, growth = int(np.floor(n * x / np.pi)), 1.0
    while True:
        push = a if piece % 2 == 0 else -a
        times = []
        for end in (piece, piece + 1):
            root = v * v - 2.0 * push * (x - end * np.pi / n)
            if root >= 0.0:
                times += [((-v + s * np.sqrt(root)) / push, end) for s in (1.0, -1.0)]
        dt, end = min(row for row in times if row[0] > 1e-12)
        if t + dt >= span:
            dt = span - t
            return x + dt * (v + 0.5 * push * dt), v + push * dt, growth
        t, x, v = t + dt, end * np.pi / n, v + push * dt
        # The slower it passes, the more an error of its speed moves the next time.
        growth += abs(a / v) * dt
        piece += 1 if end == piece + 1 else -1


def check_commutated(model: Model, n: int, method: str | None, rng: np.random.Generator) -> None:
    """Compare the end of a run with the parabolas."""
    given, span = drawn(rng), 10 ** rng.uniform(-0.5, 0.5)
    parameters = {name: given[name] for name in ("J", "T")}
    initial = {name: given[name] for name in ("J.w", "J.theta")}
    settings = {} if method is None else {"method": method}
    result = model.simulate(
        (0.0, span), parameters=parameters, initial=initial, rtol=1e-9, **settings
    )
    assert result.status == 0, (n, given, method, result.message)
    x, _, growth = after(n, given, span)
    # A crossing that is missed changes the speed by some of itself; tolerances add up over up to
    # a few hundred crossings, each enlarged by how slowly the next is passed.
    near = 1e-6 * (1.0 + abs(x)) * growth * (10.0 if method in ("cvode", "ida") else 1.0)
    assert abs(result["J.theta"][-1] - x) < near, (n, given, span, method)


@pytest.mark.parametrize("method", [None, *METHODS])
@pytest.mark.campaign
def test_commutated_inertias_follow_their_parabolas(method: str | None) -> None:
    """Random inertias under a square wave of their angle end where parabolas lead."""
    rng = np.random.default_rng(17)
    for _ in range(4 * CASES):
        n = int(rng.integers(1, 30))
        model = commutated(n)
        for _ in range(3):
            check_commutated(model, n, method, rng)


@pytest.mark.campaign
def test_ensembles_of_commutated_inertias_follow_their_parabolas() -> None:
    """So do the members of an ensemble."""
    rng = np.random.default_rng(18)
    for _ in range(CASES):
        n = int(rng.integers(1, 30))
        rows = [drawn(rng) for _ in range(24)]
        columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
        runs = commutated(n).ensemble((0.0, 1.0), columns, rtol=1e-9)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ends = runs["J.theta"].isel(time=-1).values
        for row, end in zip(rows, ends, strict=True):
            x, _, growth = after(n, row, 1.0)
            assert abs(end - x) < 1e-6 * (1.0 + abs(x)) * growth, (n, row)


CORNERS = {
    "ratchet": ("max(0, sin({n}*J.theta))", lambda q, n: np.maximum(0.0, np.sin(n * q))),
    "rectified": ("abs(sin({n}*J.theta))", lambda q, n: np.abs(np.sin(n * q))),
    "clipped": (
        "min(0.5, max(-0.5, cos({n}*J.theta)))",
        lambda q, n: np.clip(np.cos(n * q), -0.5, 0.5),
    ),
    "table": (
        "cam(mod({n}*J.theta, 6.283185307179586))",
        lambda q, n: np.interp(np.mod(n * q, 2 * np.pi), [0, 1, 2, 5, 2 * np.pi], [0, 1, 1, -1, 0]),
    ),
    "pulse": (
        "max(0, 1 - 100*abs(sin({n}*J.theta)))",
        lambda q, n: np.maximum(0.0, 1.0 - 100.0 * np.abs(np.sin(n * q))),
    ),
}


def check_corner(kind: str, n: int, method: str) -> None:
    """Compare the work of a torque with an angle's kinks with that of a quadrature."""
    text, function = CORNERS[kind]
    scene = Scene("cam")
    scene.table("cam", [0.0, 1.0, 2.0, 5.0, 2 * np.pi], [0.0, 1.0, 1.0, -1.0, 0.0])
    scene.edge("J", "rotational_inertia", "ground", "A", inertia=1.0, initial={"w": 3.0})
    scene.edge("M", "torque_source", "ground", "A", torque=text.format(n=n))
    result = scene.compile().simulate((0.0, 1.5), method=method, rtol=1e-9)
    assert result.status == 0, (kind, n, method, result.message)
    end, w = result["J.theta"][-1], result["J.w"][-1]
    q = np.linspace(0.0, end, 400_001)
    work = np.trapezoid(function(q, n), q)
    # The quadrature errs by 1e-8 at kinks, the method by 1e-9 for each of a few hundred restarts;
    # those of SUNDIALS begin at order one each, and lose ten times as much.
    near = 3e-5 if method in ("cvode", "ida") else 3e-6
    assert 0.5 * (w * w - 9.0) == pytest.approx(work, abs=near), (kind, n, method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("kind", CORNERS)
@pytest.mark.campaign
def test_no_corner_is_passed(kind: str, method: str) -> None:
    """A torque with many kinks in a step does its work."""
    rng = np.random.default_rng([*kind.encode(), *method.encode()])
    for _ in range(CASES):
        check_corner(kind, int(rng.integers(1, 60)), method)


@pytest.mark.parametrize("kind", ["teeth", "parabola", "two sines", "pulse"])
def test_a_default_run_misses_no_zero(kind: str) -> None:
    """A small part of the campaign."""
    check_marks(FUNCTIONS[kind](np.random.default_rng(5)), "dop853", 0.5)


@pytest.mark.parametrize("kind", ["ratchet", "table"])
def test_a_default_run_passes_no_corner(kind: str) -> None:
    """A small part of the campaign."""
    check_corner(kind, 23, "dop853")


def test_a_commutated_inertia_follows_its_parabolas() -> None:
    """A small part of the campaign."""
    rng, model = np.random.default_rng(3), commutated(5)
    for _ in range(5):
        check_commutated(model, 5, None, rng)
