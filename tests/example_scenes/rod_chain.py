"""A planar chain of rods, hanging from the ground by revolute joints."""

from __future__ import annotations

from cotree import Scene


def rod_chain(n: int) -> tuple[Scene, list[str]]:
    """The scene, and the names of all masses and lengths."""
    scene = Scene(f"chain-{n}", gravity=[0, "-g", 0])
    scene.parameter("g", 9.81, unit="m/s^2")
    end = "ground"
    for i in range(n):
        scene.parameter(f"m{i}", 1.0, unit="kg")
        scene.parameter(f"L{i}", 1.0, unit="m")
        scene.edge(f"h{i}", "revolute", end, f"B{i}", axis=[0, 0, 1], initial={"theta": 0.1 * i})
        scene.edge(f"c{i}", "arm", f"B{i}", f"C{i}", vector=[f"L{i}/2", 0, 0])
        scene.edge(f"e{i}", "arm", f"B{i}", f"E{i}", vector=[f"L{i}", 0, 0])
        inertia = [0, 0, f"m{i}*L{i}**2/12"]
        scene.edge(f"b{i}", "rigid_body", "ground", f"C{i}", mass=f"m{i}", inertia=inertia)
        end = f"E{i}"
    return scene, [f"{kind}{i}" for kind in "mL" for i in range(n)]
