"""Random open-chain scenes, spatial and planar, for property tests."""

from __future__ import annotations

import random

from cotree import Scene
from cotree.components import COMPONENTS

PLANAR_JOINTS = ("revolute", "prismatic")
JOINTS = (*PLANAR_JOINTS, "cylindrical")


def vector(rng: random.Random) -> list[float]:
    return [round(rng.uniform(-1.0, 1.0), 3) for _ in range(3)]


def inertia(rng: random.Random) -> list[list[float]]:
    """A physical inertia tensor: that of a few point masses, plus a little of a ball."""
    tensor = [[0.02 * (i == j) for j in range(3)] for i in range(3)]
    for _ in range(4):
        mass, at = rng.uniform(0.1, 1.0), vector(rng)
        square = sum(c * c for c in at)
        for i in range(3):
            for j in range(3):
                tensor[i][j] += mass * (square * (i == j) - at[i] * at[j])
    return [[tensor[min(i, j)][max(i, j)] for j in range(3)] for i in range(3)]


def random_scene(seed: int, n_joints: int = 4, *, is_planar: bool = False) -> Scene:
    """A random tree of bodies with springs, dampers, forces and torques between its nodes."""
    rng = random.Random(seed)
    scene = Scene(f"random-{seed}", gravity=["g*0.3", "-g", "0.2*g"])
    scene.parameter("g", 9.81)
    scene.parameter("a", 0.7)
    scene.parameter("b", 1.3)
    scene.input("u1", "sin(t)")
    ends = ["ground"]
    for i in range(n_joints):
        _add_body(scene, rng, i, rng.choice(ends), is_planar)
        ends.append(f"C{i}")
        ends.append(f"B{i}")
    _add_forces(scene, rng, ends)
    return scene


def _add_body(scene: Scene, rng: random.Random, i: int, parent: str, is_planar: bool) -> None:
    kind = rng.choice(PLANAR_JOINTS if is_planar else JOINTS)
    axis = vector(rng)
    if is_planar:
        axis = [0, 0, 1] if kind == "revolute" else [axis[0], axis[1], 0]
    hinge = f"A{i}"
    scene.edge(f"r{i}", "arm", parent, hinge, vector=[f"a*{v}" for v in vector(rng)])
    nodes = [hinge, f"B{i}"]
    if rng.random() < 0.5:
        nodes.reverse()
    names = [freedom.name for freedom in COMPONENTS[kind].motion_space]
    initial = {f"{name}{dot}": rng.uniform(-1, 1) for name in names for dot in ("", "_dot")}
    if not is_planar:
        axis = [f"{axis[0]} + a", *axis[1:]]  # parameters may turn an axis
    fields = {"axis": axis}
    if kind in PLANAR_JOINTS:
        drive = "torque" if kind == "revolute" else "force"
        fields |= {"damping": "b*0.1", "stiffness": 0.5, drive: "0.3*u1"}
    scene.edge(f"j{i}", kind, *nodes, initial=initial, **fields)
    arm = [f"B{i}", f"C{i}"]
    if rng.random() < 0.5:
        arm.reverse()
    scene.edge(f"c{i}", "arm", *arm, vector=[f"b*{v}" for v in vector(rng)])
    tensor = [[f"b*{entry!r}" for entry in row] for row in inertia(rng)]
    scene.edge(f"m{i}", "rigid_body", "ground", f"C{i}", mass=f"a+{i}", inertia=tensor)


def _add_forces(scene: Scene, rng: random.Random, ends: list[str]) -> None:
    pairs = [rng.sample(ends, 2) for _ in range(6)]
    scene.edge("f0", "spring", *pairs[0], stiffness="3*a", free_length=0.4, damping=0.2)
    scene.edge(
        "f1", "spring", *pairs[1], axis=vector(rng), stiffness=2.0, free_length="0.1*b", damping="a"
    )
    scene.edge("f2", "damper", *pairs[2], damping="0.4*b")
    scene.edge("f3", "damper", *pairs[3], axis=vector(rng), damping=0.7)
    scene.edge("f4", "force", *pairs[4], force=["a*sin(t)", 0.3, f"u1*j0.{_first(scene)}"])
    scene.edge("f5", "torque", *pairs[5], torque=[0.1, "b", f"j0.{_first(scene)}_dot"])
    scene.output("x", f"{ends[-1]}.x + 2*{ends[-2]}.vz*a")
    scene.output("y", f"{ends[-1]}.vy*{ends[-1]}.z")


def _first(scene: Scene) -> str:
    return scene.edges["j0"].component.motion_space[0].name
