"""Random drive lines with up to twelve friction elements: what holds for each of them."""

import numpy as np
import pytest

import cotree

#: Lines that a slow run tries; each is compiled for itself.
N_LINES = 200


def _friction(scene, name, pair, rng):
    """Add one element of friction: a clutch that opens and closes, or one of many laws."""
    force = float(rng.uniform(0.1, 4))
    if rng.random() < 0.25:
        w, phase = rng.uniform(0.5, 3), rng.uniform(0, 6)
        peak = {"peak": 1.2} if rng.random() < 0.5 else {}
        faces = {"normal_force": f"{force}*sin({w}*t + {phase})", "friction": 0.4, "radius": 1.0}
        scene.edge(name, "clutch", *pair, **faces, **peak)
        return
    law = {}
    if rng.random() < 0.5:
        law["breakaway"] = force * float(rng.uniform(1, 1.6))
        if rng.random() < 0.6:
            law["stribeck_speed"] = float(rng.uniform(0.05, 1))
    if rng.random() < 0.3:
        law["damping"] = float(rng.uniform(0, 0.5))
    scene.edge(name, "rotational_dry_friction", *pair, torque=force, **law)


def drive_line(seed):
    """Make inertias, springs, friction between any two of them, and a torque in half of all."""
    rng = np.random.default_rng(seed)
    is_driven = bool(rng.random() < 0.5)
    scene = cotree.Scene("line")
    nodes = [f"n{i}" for i in range(rng.integers(1, 7))]
    energy = []
    for i, node in enumerate(nodes):
        inertia = float(rng.choice([0.1, 0.5, 1.0, 2.0]))
        w = float(rng.normal() * 5) if rng.random() < 0.4 else 0.0
        own = {"inertia": inertia, "initial": {"w": w}}
        scene.edge(f"J{i}", "rotational_inertia", "ground", node, **own)
        energy.append(f"0.5*{inertia}*{node}.w**2")
    for i in range(rng.integers(0, len(nodes) + 1)):
        pair = rng.choice(["ground", *nodes], 2, replace=False)
        own = {"stiffness": float(rng.uniform(1, 50)), "initial": {"theta": float(rng.normal())}}
        scene.edge(f"K{i}", "rotational_spring", *pair, **own)
        energy.append(f"0.5*{own['stiffness']}*K{i}.theta**2")
    n = int(rng.integers(1, 13))
    for i in range(n):
        _friction(scene, f"F{i}", rng.choice(["ground", *nodes], 2, replace=False), rng)
        for short, name in (("f", "tau"), ("u", "upper"), ("w", "w")):
            scene.output(f"{short}{i}", f"F{i}.{name}")
    if is_driven:
        torque = f"{rng.uniform(1, 8)}*sin({rng.uniform(0.5, 6)}*t)"
        scene.edge("T", "torque_source", "ground", rng.choice(nodes), torque=torque)
    scene.output("energy", " + ".join(energy))
    return scene, n, is_driven


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, N_LINES, 10))
def test_random_drive_lines_stick_and_slide_as_friction_does(first):
    for seed in range(first, first + 10):
        scene, n, is_driven = drive_line(seed)
        model = scene.compile(optimize="-O0")
        result = model.simulate((0, 6), method="dop853", rtol=1e-9)
        assert result.success, (seed, result.message)
        if not is_driven:
            energy = result["energy"]
            # Errors of the steps, some hundred of them, each a tolerance of 1e-9.
            assert np.max(np.diff(energy), initial=0.0) <= 1e-6 * (1 + energy[0]), seed
        for i in range(n):
            mode = np.rint(result[f"F{i}.mode"])
            force, most, w = (result[f"{short}{i}"] for short in "fuw")
            is_stuck, slides = mode == 0.0, np.abs(mode) == 1.0
            # Located to rounding, but limits of clutches change within a step, as forces do.
            assert np.all((np.abs(force) - most)[is_stuck] <= 1e-7), (seed, i)
            assert np.all(np.abs(w)[is_stuck] <= 1e-8), (seed, i)
            assert np.all((mode * w)[slides] >= -1e-7), (seed, i)
