"""Scenes with every joint, constraint and law, whose fields all depend on parameters."""

from __future__ import annotations

from typing import Any

from cotree import Scene, register_component

PARAMETERS = {"g": 9.81, "a": 0.3, "b": 0.7, "c": 0.5, "d": 0.6, "m": 2.0}

#: Fields of each joint, as expressions of the parameters.
FIELDS: dict[str, dict[str, Any]] = {
    "revolute": {"axis": ["a", 0.3, "b"], "damping": "b"},
    "prismatic": {"axis": ["a", 0.3, "b"], "stiffness": 3.0, "damping": "b"},
    "cylindrical": {"axis": ["a", 0.3, "b"]},
    "universal": {"axis": ["a", 0.3, "b"], "axis2": ["b", -0.3, 0.5]},
    "spherical": {},
    "planar": {"normal": ["a", 0.3, "b"]},
    "free": {},
    "screw": {"axis": ["a", 0.3, "b"], "pitch": "0.3*b"},
    "weld": {},
    "arm": {"vector": ["a", "b", 1], "rotation": [0.1, "a", "b"]},
    "distance": {"length": "a+0.1*t"},
    "slot": {"axis": ["a", "b*t", 1]},
    "knife_edge": {"axis": ["a", 1, 0.3]},
    "rolling_disc": {"normal": ["a", 1, 0.2], "axis": ["b", 1, 1], "radius": "b"},
    "bushing": {
        "stiffness": ["a", 10, 3],
        "damping": [1, "b", 2],
        "rotation_stiffness": ["5*a", 2, 3],
        "rotation_damping": [0.1, 0.2, "b"],
    },
    "line_force": {"force": "-a*(length-b)**3 - 0.3*rate + sin(t)*B.theta1 + P2.x*Q2.vy"},
    "air_drag": {"c": "a"},
    "hardening": {"axis": ["a", 1, 0], "k3": "a", "l0": "b*P2.x"},
}

#: Joints that a tree may hold.
JOINTS = (
    "revolute",
    "prismatic",
    "cylindrical",
    "universal",
    "spherical",
    "planar",
    "free",
    "screw",
)


def _empty(name: str, gravity: list[Any]) -> Scene:
    # A user's own laws: forces along the velocity, and along an axis.
    register_component("air_drag", lambda speed, c: -c * speed**2, along="velocity")
    register_component("hardening", lambda length, rate, k3, l0: -k3 * (length - l0) ** 3 - rate)
    scene = Scene(name, gravity=gravity)
    for parameter, value in PARAMETERS.items():
        scene.parameter(parameter, value)
    return scene


def two_joints(kind: str, is_inward: bool) -> Scene:
    """Two bodies on joints of one kind, which point inwards or outwards."""
    scene = _empty(f"two-{kind}", [0.3, "-g", 1.0])
    fields = dict(FIELDS[kind])
    if kind in ("revolute", "screw"):
        fields["stiffness"] = "10*a"
    nodes = ("Q", "P") if is_inward else ("P", "Q")
    scene.edge("w0", "arm", "ground", "P", vector=["a", 0.2, "0.1*b"], rotation=["a", "0.2+b", 0.4])
    scene.edge("j1", kind, *nodes, **fields)
    scene.edge("w1", "arm", "Q", "R", vector=["b", 0.4, "a"], rotation=[0.3, "a", "b"])
    tensor = [["a+1", 0.1, "0.1*b"], [0.1, "1.2+b", 0.2], ["0.1*b", 0.2, 1.5]]
    scene.edge("b1", "rigid_body", "ground", "R", mass="m", inertia=tensor)
    scene.edge("j2", kind, *(("R", "S") if is_inward else ("S", "R")), **fields)
    scene.edge("w2", "arm", "S", "T", vector=[0.3, "b", "a"])
    scene.edge("b2", "rigid_body", "ground", "T", mass="m+a", inertia=[1, "1+a", 1.3])
    spring = {"stiffness": "100*b", "free_length": "a", "damping": 2.0}
    scene.edge("k", "spring", "R", "T", **spring)
    scene.edge("k2", "spring", "T", "P", axis=["a", "b", 0.2], **spring)
    scene.edge("f", "force", "T", "R", force=["a", "b", 1.0])
    scene.output("o", "T.x + 2*R.vy + 3*T.vz + R.z + T.ax + R.wz*R.r12")
    return scene


def spatial_chain(closing: str, start: str = "D") -> Scene:
    """Three bodies on a spherical, a universal and a revolute joint; one more edge ties the last.

    ``start`` is where that edge begins: D is fixed, P belongs to the first body.
    """
    scene = _empty(f"tied-by-{closing}", [0.2, "-g", 1])
    scene.edge("A", "spherical", "ground", "P")
    scene.edge("la", "arm", "P", "P2", vector=["a", 0.1, 0.2], rotation=[0.1, "a", 0.4])
    scene.edge("ba", "rigid_body", "ground", "P2", mass="m", inertia=[1, "1+a", 1.5])
    scene.edge("B", "universal", "Q", "P2", axis=["a", 0, 1], axis2=[1, "b", 0])
    scene.edge("lb", "arm", "Q", "Q2", vector=["b", 0.3, "a"])
    scene.edge("bb", "rigid_body", "ground", "Q2", mass="m", inertia=[1, "1+b", 1.5])
    scene.edge("C", "revolute", "Q2", "R", axis=[0.3, "a", 1])
    scene.edge("lc", "arm", "R", "R2", vector=["c", 0, 0.4], rotation=[0.4, "b", 0.1])
    scene.edge("bc", "rigid_body", "ground", "R2", mass="m+a", inertia=[0.5, "1+b", 1.2])
    scene.edge("g0", "arm", "ground", "D", vector=["d", 0.1, 0], rotation=["a", "b", 0.3])
    scene.edge("tie", closing, start, "R2", **FIELDS[closing])
    for i, name in enumerate(
        ("R2.x", "R2.vy", "R2.ax", "R2.alphax", "R2.roll", "C.fx", "C.tz", "B.ty", "A.fz")
    ):
        scene.output(f"o{i}", name)
    scene.output("energy", "energy.kinetic + energy.potential")
    return scene


#: Trees of the joints of :func:`spatial_chain`, and of its bodies.
CHAIN_TREE = ["A", "la", "B", "lb", "C", "lc", "g0"]
BODY_TREE = ["ba", "bb", "bc", "la", "lb", "lc", "g0"]


def four_bar(closing: str = "revolute") -> Scene:
    """A planar four-bar linkage, or its three bars tied by another edge."""
    scene = _empty(f"four-bar-{closing}", [0, "-g", 0])
    scene.edge("A", "revolute", "ground", "P", axis=[0, 0, 1], damping=0.1)
    scene.edge("la", "arm", "P", "P2", vector=["a", 0, 0])
    scene.edge("ca", "arm", "P", "Pc", vector=["a/2", 0, 0])
    scene.edge("ba", "rigid_body", "ground", "Pc", mass="m", inertia=0.1)
    scene.edge("B", "revolute", "P2", "Q", axis=[0, 0, 1])
    scene.edge("lb", "arm", "Q", "Q2", vector=["b", 0, 0])
    scene.edge("cb", "arm", "Q", "Qc", vector=["b/2", 0.1, 0])
    scene.edge("bb", "rigid_body", "ground", "Qc", mass="m", inertia=0.2)
    scene.edge("C", "revolute", "Q2", "R", axis=[0, 0, 1])
    scene.edge("lc", "arm", "R", "R2", vector=["c", 0, 0])
    scene.edge("cc", "arm", "R", "Rc", vector=["c/2", 0, 0])
    scene.edge("bc", "rigid_body", "ground", "Rc", mass="m+a", inertia=0.3)
    scene.edge("g0", "arm", "ground", "D", vector=["d", 0, 0])
    fields = {
        "revolute": {"axis": [0, 0, 1], "damping": 0.3, "stiffness": 2.0, "free_angle": 0.3},
        "prismatic": {"axis": ["a", "b", 0], "stiffness": 10},
        "slot": {"axis": ["a", "b*t", 0]},
        "distance": {"length": "a"},
        "gear": {"coordinate1": "A.theta", "coordinate2": "C.theta", "ratio": "a"},
        "constraint": {"expression": "R2.x**2 - b*R2.y*A.theta + t"},
        "knife_edge": {"axis": ["a", 1, 0]},
        "rolling_disc": {"normal": ["a", 1, 0], "axis": [0, 0, 1], "radius": "b"},
    }[closing]
    scene.edge("tie", closing, "D", "R2", **fields)
    for i, name in enumerate(("Rc.x", "Rc.vy", "tie.fx", "A.fy", "B.tz")):
        scene.output(f"o{i}", name)
    return scene


#: The tree of the bodies of :func:`four_bar`.
FOUR_BAR_BODIES = ["ba", "bb", "bc", "la", "ca", "lb", "cb", "lc", "cc", "g0"]
