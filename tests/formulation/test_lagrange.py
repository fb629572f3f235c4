"""The balances against Lagrange's equations of an independent model, in 60-digit arithmetic.

The independent model knows homogeneous transforms only: it places the bodies for given
coordinates, takes their velocities by central differences, and differentiates kinetic less
potential energy. With steps of 1e-20 its own error is near 1e-20.
"""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from random_scenes import inertia, vector

from cotree import Scene
from cotree.dag.evaluate import evaluate
from cotree.formulation.first_graph import form_first_graph
from cotree.pipeline import draw_graphs
from cotree.scene.graphs import joint_tree

STEP = mp.mpf(10) ** -20


def rotation(axis, angle):
    e = mp.matrix(axis) / mp.norm(mp.matrix(axis))
    k = mp.matrix([[0, -e[2], e[1]], [e[2], 0, -e[0]], [-e[1], e[0], 0]])
    return mp.eye(3) + mp.sin(angle) * k + (1 - mp.cos(angle)) * (k * k)


def motions(body):
    """The freedoms of a joint as the walk meets them: whether each turns, and its axis."""
    kinds = {
        "revolute": [(True, "axis")],
        "prismatic": [(False, "axis")],
        "cylindrical": [(False, "axis"), (True, "axis")],
    }
    found = [(i, turns, body[axis]) for i, (turns, axis) in enumerate(kinds[body["kind"]])]
    return found[::-1] if body["reversed"] else found


def place(bodies, q):
    """Orientation and centre of mass of every body."""
    at, turn, found, first = mp.matrix([0, 0, 0]), mp.eye(3), [], 0
    for body in bodies:
        at = at + turn * mp.matrix(body["arm"])
        sign = -1 if body["reversed"] else 1  # the edge then points towards the ground
        for i, turns, axis in motions(body):
            value = sign * q[first + i]
            if turns:
                turn = turn * rotation(axis, value)
            else:
                at = at + turn * (mp.matrix(axis) / mp.norm(mp.matrix(axis))) * value
        first += len(motions(body))
        found.append((turn, at + turn * mp.matrix(body["centre"])))
    return found


def lagrangian(bodies, gravity, q, v):
    ahead = place(bodies, [a + STEP * b for a, b in zip(q, v, strict=True)])
    behind = place(bodies, [a - STEP * b for a, b in zip(q, v, strict=True)])
    total = mp.mpf(0)
    for body, here, (r1, c1), (r0, c0) in zip(bodies, place(bodies, q), ahead, behind, strict=True):
        turn, centre = here
        speed = (c1 - c0) / (2 * STEP)
        spin = turn.T * (r1 - r0) / (2 * STEP)  # [omega]x in the body's axes
        omega = mp.matrix([spin[2, 1], spin[0, 2], spin[1, 0]])
        total += mp.mpf(body["mass"]) * (speed.T * speed)[0] / 2
        total += (omega.T * mp.matrix(body["tensor"]) * omega)[0] / 2
        total += mp.mpf(body["mass"]) * (mp.matrix(gravity).T * centre)[0]
    return total


def lagrange_residual(bodies, gravity, q, v, a):
    """d/dt dL/dv - dL/dq, the time derivative taken along the motion."""
    n, h = len(q), mp.mpf(10) ** -8  # of the outer differences; their error is h^2

    def slope(q, v, i, by):
        up, down = list(q), list(q)
        vup, vdown = list(v), list(v)
        (up if by == "q" else vup)[i] += h
        (down if by == "q" else vdown)[i] -= h
        return (lagrangian(bodies, gravity, up, vup) - lagrangian(bodies, gravity, down, vdown)) / (
            2 * h
        )

    def moved(sign):
        return (
            [x + sign * h * y for x, y in zip(q, v, strict=True)],
            [x + sign * h * y for x, y in zip(v, a, strict=True)],
        )

    residual = []
    for i in range(n):
        rate = (slope(*moved(1), i, "v") - slope(*moved(-1), i, "v")) / (2 * h)
        residual.append(float(rate - slope(q, v, i, "q")))
    return np.array(residual)


def chain(seed, kinds):
    import random

    rng = random.Random(seed)
    return [
        {
            "kind": kind,
            "reversed": rng.random() < 0.5,
            "arm": vector(rng),
            "axis": vector(rng),
            "centre": vector(rng),
            "mass": round(rng.uniform(0.5, 2.0), 3),
            "tensor": inertia(rng),
        }
        for kind in kinds
    ]


def scene_of(bodies, gravity):
    scene = Scene("chain", gravity=gravity)
    end = "ground"
    for i, body in enumerate(bodies):
        scene.edge(f"r{i}", "arm", end, f"A{i}", vector=body["arm"])
        nodes = [f"A{i}", f"B{i}"]
        if body["reversed"]:
            nodes.reverse()
        scene.edge(f"j{i}", body["kind"], *nodes, axis=body["axis"])
        scene.edge(f"c{i}", "arm", f"B{i}", f"C{i}", vector=body["centre"])
        scene.edge(
            f"m{i}", "rigid_body", "ground", f"C{i}", mass=body["mass"], inertia=body["tensor"]
        )
        end = f"B{i}"
    return scene


@pytest.mark.sampled(2)
@pytest.mark.parametrize("own_axes", [(), (1, 2, 3, 4)])
@pytest.mark.parametrize(
    ("seed", "kinds"),
    [
        (1, ["revolute", "revolute", "revolute"]),
        (2, ["prismatic", "revolute", "prismatic"]),
        (3, ["revolute", "prismatic", "revolute"]),
        (4, ["revolute", "cylindrical"]),
        (5, ["cylindrical", "revolute", "cylindrical"]),
    ],
)
def test_balances_are_lagranges_equations(seed, kinds, own_axes):
    gravity = [0.5, -9.81, 1.0]
    bodies = chain(seed, kinds)
    scene = scene_of(bodies, gravity)
    _, trees = draw_graphs(scene, None)
    first = form_first_graph(scene, joint_tree(scene, trees), own_axes)
    rng = np.random.default_rng(seed)
    dag, n = first.system.dag, len(first.unknowns)
    q, v, a = (rng.uniform(-1.0, 1.0, n) for _ in range(3))
    values = {dag.symbol("t", 0): 0.0}
    values |= {dag.symbol("x", i): float(x) for i, x in enumerate([*q, *v])}
    values |= {dag.symbol("w", i): float(a[i]) for i in range(n)}
    ours = np.array(evaluate(first.balance.residual, values))
    with mp.workdps(60):
        theirs = lagrange_residual(
            bodies, gravity, *([mp.mpf(float(x)) for x in row] for row in (q, v, a))
        )
    # The outer differences carry h^2 = 1e-16 times third derivatives of order ten to a hundred;
    # ours are sums of doubles of order ten.
    assert np.allclose(ours, theirs, rtol=1e-12, atol=1e-12)
