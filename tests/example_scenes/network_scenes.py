"""Networks of any size: ladders, grids and meshes, all of the same few parameters."""

from __future__ import annotations

import numpy as np

from cotree import Scene


def rc_ladder(n: int) -> Scene:
    """A source, then n times a resistor in series and a capacitor to the ground."""
    scene = _driven(f"rc-ladder-{n}", R=1.0, C=1.0)
    for i in range(1, n + 1):
        scene.edge(f"R{i}", "resistor", f"n{i - 1}", f"n{i}", resistance="R")
        scene.edge(f"C{i}", "capacitor", f"n{i}", "ground", capacitance="C")
    scene.output("last", f"n{n}.v")
    return scene


def rc_ladder_matrix(n: int) -> np.ndarray:
    """x' = A x + e_1 / (R C) of the ladder with R = C = 1."""
    matrix = -2.0 * np.eye(n) + np.eye(n, k=1) + np.eye(n, k=-1)
    matrix[-1, -1] = -1.0
    return matrix


def rlc_ladder(n: int) -> Scene:
    """A source, then n times a resistor and an inductor in series and a capacitor to the ground."""
    scene = _driven(f"rlc-ladder-{n}", R=0.1, L=1.0, C=1.0)
    for i in range(1, n + 1):
        scene.edge(f"R{i}", "resistor", f"n{i - 1}", f"m{i}", resistance="R")
        scene.edge(f"L{i}", "inductor", f"m{i}", f"n{i}", inductance="L")
        scene.edge(f"C{i}", "capacitor", f"n{i}", "ground", capacitance="C")
    scene.output("last", f"n{n}.v")
    return scene


def rc_grid(n: int) -> Scene:
    """n by n nodes, resistors between neighbours, a capacitor at each; driven at a corner."""
    scene = resistor_mesh(n)
    for i in range(n):
        for j in range(n):
            if (i, j) != (n - 1, n - 1):
                scene.edge(f"C{i}_{j}", "capacitor", f"n{i}_{j}", "ground", capacitance="C")
    return scene


def resistor_mesh(n: int) -> Scene:
    """n by n nodes, resistors between neighbours; driven at a corner, a capacitor at the other."""
    scene = _driven(f"mesh-{n}", R=1.0, C=1.0)
    scene.edge("entry", "resistor", "n0", "n0_0", resistance="R")
    for i in range(n):
        for j in range(n):
            for a, b in ((i - 1, j), (i, j - 1)):
                if min(a, b) >= 0:
                    name = f"R{a}_{b}to{i}_{j}"
                    scene.edge(name, "resistor", f"n{a}_{b}", f"n{i}_{j}", resistance="R")
    last = f"n{n - 1}_{n - 1}"
    scene.edge("end", "capacitor", last, "ground", capacitance="C")
    scene.output("last", f"{last}.v")
    return scene


def _driven(name: str, **parameters: float) -> Scene:
    scene = Scene(name)
    for key, value in parameters.items():
        scene.parameter(key, value)
    scene.input("drive", 1.0)
    scene.edge("source", "voltage_source", "n0", "ground", voltage="drive")
    return scene
