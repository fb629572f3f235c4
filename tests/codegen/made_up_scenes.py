"""Programs with what the shipped scenes lack: tables, branches, loops, call, hostile texts."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import cotree
from cotree.dag.lookup import LinearTable
from cotree.dag.multi_output import Function, SolveShape, call, solve, table
from cotree.dag.nodes import Dag

if TYPE_CHECKING:
    from cotree import Scene

#: What a text from a file may try.
HOSTILE = '*/ int system("x"); /* ??/ ?? \\ " \' %s \n\r\t\x00\x1b # é \u202e ' + "/" * 3 + "*\\"

SWIRL = Function(
    "swirl",
    2,
    lambda a: [a[0] * a[1], a[0] - a[1]],
    Function("swirl_partials", 4, lambda a: [a[1], a[0], 1.0, -1.0]),
)

#: The same in C, for whoever links the model.
SWIRL_C = """
int swirl(const double *arguments, double *results);
int swirl_partials(const double *arguments, double *results);
int swirl(const double *arguments, double *results)
{
    results[0] = arguments[0] * arguments[1];
    results[1] = arguments[0] - arguments[1];
    return arguments[0] > 100.0;
}
int swirl_partials(const double *arguments, double *results)
{
    results[0] = arguments[1];
    results[1] = arguments[0];
    results[2] = 1.0;
    results[3] = -1.0;
    return 0;
}
"""


def busy_scene() -> Scene:
    """Return a scene with tables, branches, hostile texts and pivots checked at run time."""
    scene = cotree.Scene("double", gravity=[0, 0, "-9.81"])  # a word that C has taken
    scene.parameter("m", 2.0, unit="kg", doc=HOSTILE)
    scene.parameter("a", 0.7)
    scene.input("F", ([0, 1, 1.5, 4], [0, 2, "-1", 0.5]), unit="N", doc=HOSTILE)
    scene.input("G", "min(t, a) + max(t - 1, a*t) + sign(t - 2) + abs(t - 3)*exp(-t)")
    scene.edge("j1", "prismatic", "ground", "A", axis=[1, 0, 0], force="F - 3*sign(j1.s_dot)")
    scene.edge("j2", "revolute", "A", "B", axis=[0, 1, 0], torque="G*atan2(t, a)")
    scene.edge("r", "arm", "B", "C", vector=[0, 0, "-a"])
    scene.edge("j3", "revolute", "C", "D", axis=[0, 1, 0], initial={"theta": "a**2.5"})
    scene.edge("r2", "arm", "D", "E", vector=["a/2", 0, "-a"])
    scene.edge("b1", "rigid_body", "ground", "A", mass="m")
    scene.edge("b2", "rigid_body", "ground", "E", mass="sqrt(m)")
    scene.output("where", "E.x + tan(a)*j1.s")
    return scene


def closed_scene() -> Scene:
    """Return two swings tied by a bar, all in a plane, beside a pendulum on a ball joint.

    Three of the five constraints of the joint that closes the loop say nothing new, and what it
    starts with is no state. The ball joint has a quaternion.
    """
    scene = cotree.Scene("closed", gravity=[0, 0, -9.81])
    scene.parameter("m", 1.3)
    scene.parameter("L", 0.7)
    scene.edge("j1", "revolute", "ground", "A", axis=[0, 1, 0])
    scene.edge("r1", "arm", "A", "B", vector=[0, 0, "-L"])
    scene.edge("b1", "rigid_body", "ground", "A", mass="m", inertia=0.2)
    scene.edge("r0", "arm", "ground", "G", vector=[0.5, 0, 0])
    scene.edge("j2", "revolute", "G", "D", axis=[0, 1, 0])
    scene.edge("r2", "arm", "D", "E", vector=[0, 0, "-L"])
    scene.edge("b2", "rigid_body", "ground", "D", mass="m", inertia=0.1)
    scene.edge("j3", "revolute", "B", "C", axis=[0, 1, 0])
    scene.edge("r3", "arm", "C", "F", vector=[0.5, 0, 0])
    scene.edge("b3", "rigid_body", "ground", "F", mass=0.4, inertia=0.05)
    scene.edge("j4", "revolute", "E", "F", axis=[0, 1, 0], initial={"theta": 0.3})
    scene.edge("ball", "spherical", "ground", "S")
    scene.edge("r5", "arm", "S", "T", vector=[0, 0, "-2*L"])
    scene.edge("b5", "rigid_body", "ground", "T", mass="m", inertia=[0.1, 0.2, 0.3])
    scene.output("height", "F.z + T.z")
    return scene


def solve_case(n: int, shape: SolveShape | None = None) -> tuple[Dag, list[Any]]:
    """Return n unknowns, the rank and whether it is accepted: a system of n^2 + n parameters."""
    dag = Dag()
    p = [dag.symbol("p", i) for i in range(n * n + n)]
    matrix = [p[n * i : n * (i + 1)] for i in range(n)]
    x = dag.symbol("x", 0)
    return dag, list(solve(dag, matrix, [b * x for b in p[n * n :]], shape=shape))


def call_case() -> tuple[Dag, list[Any]]:
    """Return values of an external function, its partials, a table, and a select of them."""
    dag = Dag()
    x, p = dag.symbol("x", 0), dag.symbol("p", 0)
    first, second = call(dag, SWIRL, [x, p * x])
    partials = call(dag, SWIRL.partials, [x, p])  # type: ignore[arg-type]
    value, slope = table(dag, LinearTable((-1.0, 0.0, 2.0), (3.0, 1.0, 5.0)), second)
    chosen = dag.select(value - 2.0, first, -slope)
    return dag, [first, second, *partials, value, slope, chosen, dag.function("sign", -second)]
