"""The four-bar linkage of README: a crank, a coupler and a rocker on four hinges."""

from __future__ import annotations

from typing import Any

from cotree import Scene


def four_bar(name: str = "four-bar", gravity: float = 9.81, **of_a: Any) -> Scene:
    """Draw it; what is given of the hinge of the crank takes the place of README's start."""
    scene = Scene(name, gravity=[0, -gravity, 0])
    for bar, start, end, length in [
        ("crank", "A", "B", 1.0),
        ("coupler", "B2", "C", 2.0),
        ("rocker", "D2", "C2", 2.0),
    ]:
        scene.edge(bar, "arm", start, end, vector=[length, 0, 0])
        scene.edge(f"m_{bar}", "rigid_body", "ground", end, mass=1.0, inertia=0.1)
    scene.edge("base", "arm", "ground", "D", vector=[1.5, 0, 0])
    own = of_a or {"initial": {"theta": 1.5, "theta_dot": 6.0}}
    scene.edge("a", "revolute", "ground", "A", axis=[0, 0, 1], **own)
    for hinge, first, second in [("b", "B", "B2"), ("c", "C", "C2"), ("d", "D", "D2")]:
        scene.edge(hinge, "revolute", first, second, axis=[0, 0, 1])
    return scene
