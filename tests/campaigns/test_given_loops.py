"""Random four-bars of which several angles are given as numbers, and a length is varied.

Numbers that agree for one length only cannot all be kept as it changes: those that stand first in
the scene are, whatever the tree, and the others follow, which a warning says. Expected derivatives
solve the closure of the loop. As a campaign:
``pytest --slow --campaign tests/campaigns/test_given_loops.py``, 2000 linkages in two trees.
"""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from bare_models import evaluated

from cotree import Scene

N_QUICK, N_SLOW, N_ALL, BLOCK = 3, 40, 2000, 100

BARS = {"crank": ("A", "B"), "coupler": ("B2", "C"), "rocker": ("D2", "C2")}
JOINTS = {"a": ("ground", "A"), "b": ("B", "B2"), "c": ("C", "C2"), "d": ("D", "D2")}
TREES = {
    "joints": ["base", *BARS, "a", "b", "d"],
    "bodies": ["base", *BARS, *(f"m_{bar}" for bar in BARS)],
}
#: Angles of the joints by those of the bars against the ground: crank, coupler and rocker.
ANGLES = {"a": [1, 0, 0], "b": [-1, 1, 0], "c": [0, -1, 1], "d": [0, 0, 1]}


def random_linkage(rng):
    """Return lengths of base and bars, and the bars' angles, well away from dead centres."""
    while True:
        base, crank, coupler, rocker = rng.uniform(0.5, 2.0, 4)
        phi = rng.uniform(-3, 3)
        gap = np.array([base, 0.0]) - crank * np.array([np.cos(phi), np.sin(phi)])
        far = float(np.hypot(*gap))
        if not abs(coupler - rocker) + 0.1 < far < coupler + rocker - 0.1:
            continue
        cosine = (far**2 + coupler**2 - rocker**2) / (2 * far * coupler)
        turn = np.arctan2(gap[1], gap[0]) + rng.choice([-1, 1]) * np.arccos(cosine)
        end = coupler * np.array([np.cos(turn), np.sin(turn)]) - gap
        bars = np.array([phi, turn, np.arctan2(end[1], end[0])])
        _, rows = closure((base, crank, coupler, rocker), bars)
        free = np.linalg.svd(rows)[2][-1]
        # Each angle moves along with the others.
        if min(abs(np.array(own) @ free) for own in ANGLES.values()) > 0.1:
            return (base, crank, coupler, rocker), bars


def closure(lengths, bars):
    """Differentiate the loop by the length of the coupler, and by the angles of the bars."""
    _, *arms = lengths
    signs = (1, 1, -1)
    turned = [s * r * np.array([-np.sin(q), np.cos(q)])
              for s, r, q in zip(signs, arms, bars, strict=True)]  # fmt: skip
    return np.array([np.cos(bars[1]), np.sin(bars[1])]), np.array(turned).T


def linkage(lengths, bars, given, order):
    scene = Scene("four-bar")
    base, crank, coupler, rocker = lengths
    scene.parameter("L", coupler)
    for (bar, (start, end)), length in zip(BARS.items(), (crank, "L", rocker), strict=True):
        scene.edge(bar, "arm", start, end, vector=[length, 0, 0])
        scene.edge(f"m_{bar}", "rigid_body", "ground", end, mass=1.0, inertia=0.1)
    scene.edge("base", "arm", "ground", "D", vector=[base, 0, 0])
    for name in order:
        initial = {"theta": float(np.array(ANGLES[name]) @ bars)} if name in given else {}
        scene.edge(name, "revolute", *JOINTS[name], axis=[0, 0, 1], initial=initial)
    return scene


def check(seed, tree):
    rng = np.random.default_rng(seed)
    lengths, bars = random_linkage(rng)
    order = [str(name) for name in rng.permutation(list(JOINTS))]
    given = {str(name) for name in rng.choice(order, rng.integers(2, 5), replace=False)}
    scene = linkage(lengths, bars, given, order)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = evaluated(scene, TREES[tree], ["L"])
        start = model.start()
    slopes = dict(zip(model.states, start.s[:, 0], strict=True))
    if tree == "joints":
        first = slopes["a.theta"]
        found = [first, first + slopes["b.theta"], slopes["d.theta"]]
    else:
        found = [slopes[f"m_{bar}.theta"] for bar in BARS]
    by_length, rows = closure(lengths, bars)
    kept = next(name for name in order if name in given)
    expected = np.linalg.solve(np.vstack([rows, ANGLES[kept]]), [*-by_length, 0.0])
    # Some levers of ten, of values that were found to 1e-12.
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-9)
    said = " ".join(str(row.message) for row in caught)
    for name in given:
        moves = abs(np.array(ANGLES[name]) @ expected) > 1e-6
        assert (f"'{name}.theta' with 'L'" in said) == moves, (name, said)


@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize(
    "seed",
    [pytest.param(i, marks=[pytest.mark.slow] if i >= N_QUICK else []) for i in range(N_SLOW)],
)
def test_the_first_of_several_given_angles_is_kept(seed, tree):
    check(seed, tree)


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("tree", TREES)
@pytest.mark.parametrize("first", range(0, N_ALL, BLOCK))
def test_the_first_of_all_given_angles_is_kept(first, tree):
    for seed in range(first, first + BLOCK):
        check(seed, tree)
