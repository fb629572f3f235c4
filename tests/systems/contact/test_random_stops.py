"""Random rows of blocks with rigid stops, springs and dry friction: what holds for each of them."""

import numpy as np
import pytest

import cotree

#: Rows that a slow run tries; each is compiled for itself.
N_ROWS = 60


def _block(scene, i, node, x, rng):
    """Add a block at a height, and give the terms of its energy."""
    mass = float(rng.choice([0.1, 0.5, 1.0, 2.0]))
    v = float(rng.normal() * 2) if rng.random() < 0.6 else 0.0
    scene.edge(f"M{i}", "translational_mass", "ground", node, mass=mass, initial={"v": v})
    scene.edge(f"G{i}", "force_source", "ground", node, force=f"-{mass}*g")
    # A stop that is never reached measures the height.
    scene.edge(
        f"H{i}", "translational_rigid_stop", "ground", node, lower=-1e3, initial={"s": float(x)}
    )
    return [f"0.5*{mass}*{node}.v**2", f"{mass}*g*H{i}.s"]


def _spring(scene, i, pair, gap, rng):
    stiffness, length = float(rng.uniform(1, 50)), float(gap * rng.uniform(0.5, 1.5))
    own = {"stiffness": stiffness, "free_length": length, "initial": {"s": float(gap)}}
    scene.edge(f"K{i}", "translational_spring", *pair, **own)
    return [f"0.5*{stiffness}*(K{i}.s - {length})**2"]


def row_of_blocks(seed):
    """Build blocks above each other, on a floor, and a force on one in a third of all."""
    rng = np.random.default_rng(seed)
    scene = cotree.Scene("row")
    scene.parameter("g", float(rng.choice([0.0, 9.81])))
    nodes = [f"n{i}" for i in range(rng.integers(1, 6))]
    heights = np.sort(rng.uniform(0.05, 1.5, len(nodes)))
    is_driven, energy, n = bool(rng.random() < 0.3), [], 0
    for i, (node, x) in enumerate(zip(nodes, heights, strict=True)):
        energy += _block(scene, i, node, x, rng)
        below, gap = (nodes[i - 1], x - heights[i - 1]) if i else ("ground", x)
        if i == 0 or rng.random() < 0.8:
            above = {"upper": float(gap + rng.uniform(0, 1))} if rng.random() < 0.4 else {}
            limits = {"lower": 0.0, "restitution": float(rng.choice([0.0, 0.3, 0.6, 0.9])), **above}
            own = {"rest_speed": 0.02, "initial": {"s": float(gap)}, **limits}
            scene.edge(f"S{n}", "translational_rigid_stop", below, node, **own)
            scene.output(f"f{n}", f"S{n}.f")
            n += 1
        if rng.random() < 0.5:
            force = float(rng.uniform(0.1, 4))
            scene.edge(f"R{i}", "translational_dry_friction", below, node, force=force)
        if rng.random() < 0.4:
            energy += _spring(scene, i, (below, node), gap, rng)
    if is_driven:
        force = f"{rng.uniform(1, 30)}*sin({rng.uniform(0.5, 6)}*t)"
        scene.edge("F", "force_source", "ground", str(rng.choice(nodes)), force=force)
    scene.output("energy", " + ".join(energy))
    return scene, n, is_driven


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, N_ROWS, 10))
def test_random_rows_bounce_and_rest_as_stops_do(first):
    for seed in range(first, first + 10):
        scene, n, is_driven = row_of_blocks(seed)
        model = scene.compile(optimize="-O0")
        result = model.simulate((0, 4), method="dop853", rtol=1e-9, atol=1e-11)
        assert result.success, (seed, result.message)
        if not is_driven:
            energy = result["energy"]
            # Errors of the steps, some hundred of them, each a tolerance of 1e-9.
            assert np.max(np.diff(energy), initial=0.0) <= 1e-6 * (1 + abs(energy[0])), seed
        for i in range(n):
            # A limit that holds is left by what the tolerance allows.
            assert np.min(result[f"S{i}.s"]) >= -1e-7, (seed, i)
            # Forces never pull away from the limit that holds.
            pushed = result[f"f{i}"] * np.rint(result[f"S{i}.mode"])
            assert np.min(pushed) >= -1e-6, (seed, i)
