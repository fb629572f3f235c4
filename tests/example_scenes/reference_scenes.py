"""Scenes from the physical topology of reference files.

In: a file of tests/references: bodies with their poses, joints, forces and outputs. Out: a scene.
Every body is a node at its origin, with arms to its centre of mass and to the points that joints
and forces use. The poses are absolute in the files; coordinates of joints are differences of them,
so that a scene runs in joint coordinates and in absolute ones alike.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotree import Scene
from cotree.components import Role

if TYPE_CHECKING:
    from collections.abc import Sequence

Value = float | str

_FOLDER = Path(__file__).resolve().parents[1] / "references"
_IDENTITY = ((1, 0, 0), (0, 1, 0), (0, 0, 1))

Term = tuple[str, Any]


def _of(kind: str, first: str, second: str = "") -> tuple[Term, ...]:
    """Return the angle or rate of a body, less that of another."""
    terms = (("+", (kind, first)), ("-", (kind, second)))
    return terms if second else terms[:1]


#: Outputs of files that describe theirs in words, as signed terms.
_DESCRIBED: dict[str, dict[str, tuple[Term, ...]]] = {
    "ivp_andrews": {
        prefix + name: _of(kind, *bodies)
        for prefix, kind in (("", "theta"), ("d", "omega"))
        for name, bodies in {
            "beta": ("K1",),
            "Theta": ("K2", "K1"),
            "gamma": ("K3",),
            "Phi": ("K4", "K5"),
            "delta": ("K5",),
            "Omega": ("K6", "K7"),
            "epsilon": ("K7",),
        }.items()
    },
    "ivp_car_axis": {
        f"{prefix}{'xy'[i]}{side}": (("+", (kind, f"P{side}", (0, 0), i)),)
        for prefix, kind in (("", "point"), ("v", "vpoint"))
        for side in "lr"
        for i in (0, 1)
    },
    "iftomm_a02_fourbar_N2": {"thdot": (("-", ("omega", "V0")),)},  # counted clockwise
}


def read_reference(name: str) -> dict[str, Any]:
    """Read a file of tests/references."""
    data: dict[str, Any] = json.loads((_FOLDER / f"{name}.json").read_text())
    return data


def scene_of(reference: dict[str, Any], with_free_joints: bool = False) -> Scene:
    """Build the scene of a reference file, with its quantities and the energy as outputs.

    Parameters
    ----------
    reference : dict
        The file, from :func:`read_reference`.
    with_free_joints : bool
        Whether bodies that no joint reaches get one that lets them move freely.
    """
    reader = _Reader(reference, with_free_joints)
    for name, value in reference["parameters"].items():
        reader.scene.parameter(name, value)
    for name in reader.bodies:
        reader.add_body(name)
    for joint in reader.topology["joints"]:
        _JOINTS[joint["type"]](reader, joint)
    for force in reader.topology["forces"]:
        _FORCES[force["type"]](reader, force)
    own = {name: (("+", output),) for name, output in reference.get("outputs", {}).items()}
    for name, terms in {**own, **_DESCRIBED.get(reference["name"], {})}.items():
        text = "".join(f"{sign}({reader.observed(*output)})" for sign, output in terms)
        reader.scene.output(name, text.removeprefix("+"))
    reader.scene.output("energy", "energy.kinetic + energy.potential")
    return reader.scene


def absolute_tree(scene: Scene) -> list[str]:
    """Name the branches of absolute coordinates: bodies, arms, and supports that are moved."""
    return [
        edge.name
        for edge in scene.edges.values()
        if edge.component.role in (Role.BODY, Role.ARM) or "motion" in edge.fields
    ]


def tree_without(scene: Scene, cuts: Sequence[str]) -> list[str]:
    """Name the branches of joint coordinates that leave some joints as chords."""
    return [
        edge.name
        for edge in scene.edges.values()
        if edge.component.role in (Role.JOINT, Role.ARM) and edge.name not in cuts
    ]


class _Reader:
    """One file on its way to a scene.

    Attributes
    ----------
    nodes : dict
        Node by body and point, as text.
    paths : dict of str to list of (str, dict)
        Signs and joints from the ground to each body that joints reach, by the fewest joints.
    """

    def __init__(self, reference: dict[str, Any], with_free_joints: bool) -> None:
        self.topology = reference["topology"]
        self.bodies: dict[str, dict[str, Any]] = self.topology["bodies"]
        self.is_planar = self.topology["kind"] == "planar"
        self.with_free_joints = with_free_joints
        self.scene = Scene(reference["name"], gravity=_spatial(self.topology["gravity"]))
        self.nodes: dict[tuple[str, ...], str] = {}
        self.paths = _paths(self.topology["joints"])

    def add_body(self, name: str) -> None:
        """Draw a body; one that no joint reaches starts by its own edge, or by a free joint."""
        body = self.bodies[name]
        com = body.get("com", [0, 0])
        initial = self._free_start(name) if name not in self.paths else {}
        if initial and self.with_free_joints:
            kind = {"type": "planar", "normal": [0, 0, 1]} if self.is_planar else {"type": "free"}
            self.scene.edge(
                f"free_{name}", str(kind.pop("type")), "ground", name, initial=initial, **kind
            )
            initial = {}
        self.scene.edge(
            f"inertia_{name}",
            "rigid_body",
            "ground",
            self.node(name, com),
            mass=body["mass"],
            inertia=body["inertia"],
            initial=initial,
        )

    def _free_start(self, name: str) -> dict[str, Any]:
        """Return the pose and the velocity of a body."""
        if not _is_zero(self.bodies[name].get("com", [0])):
            raise ValueError(f"body '{name}' is free: put its origin at its centre of mass")
        pose = self.bodies[name]["initial"]
        if self.is_planar:
            values = [*pose["r"], *pose.get("v", [0, 0]), pose["theta"], pose.get("omega", 0)]
            names = ("x", "y", "x_dot", "y_dot", "theta", "theta_dot")
            return dict(zip(names, values, strict=True))
        values = [*pose["r"], *pose.get("v", [0, 0, 0])]
        names = ("x", "y", "z", "vx", "vy", "vz")
        return {**dict(zip(names, values, strict=True)), **_turned(pose)}

    def node(self, body: str, point: Sequence[Value]) -> str:
        """Return the node of a point that is fixed in a body, or that moves in the ground."""
        if _is_zero(point):
            return body
        key = (body, *map(str, point))
        if key not in self.nodes:
            self.nodes[key] = f"{body}_{len(self.nodes) + 1}"
            if any(_is_timed(entry) for entry in point):
                self._move(self.nodes[key], point)
            else:
                arm = f"arm_{self.nodes[key]}"
                self.scene.edge(arm, "arm", body, self.nodes[key], vector=_spatial(point))
        return self.nodes[key]

    def _move(self, node: str, point: Sequence[Value]) -> None:
        """Lead a node along given motions, by a massless slide for each direction."""
        before = "ground"
        for i, motion in enumerate(point):
            after = node if i == len(point) - 1 else f"{node}_{i}"
            slide = f"slide_{after}"
            self.scene.edge(slide, "prismatic", before, after, axis=_IDENTITY[i], motion=motion)
            before = after

    def ends(self, row: dict[str, Any]) -> tuple[str, str]:
        """Return the nodes of a joint or a force between two points."""
        return self.node(*row["a"]), self.node(*row["b"])

    def turned_by(self, row: dict[str, Any], key: str) -> Value:
        """Return the difference of the bodies' angles, or their rates, at the start."""
        first, second = (self.start(row[end][0], key) for end in "ab")
        if isinstance(first, str) or isinstance(second, str):
            return f"({second}) - ({first})"
        return second - first

    def start(self, body: str, key: str) -> Value:
        """Return an angle, or its rate, of a body at the start."""
        value: Value = 0.0 if body == "ground" else self.bodies[body]["initial"].get(key, 0.0)
        return value

    def turning(self, body: str, variable: str) -> str:
        """Return the angle of a body, or its rate, by the joints that lead to it."""
        if body not in self.paths:
            return f"{'free' if self.with_free_joints else 'inertia'}_{body}.{variable}"
        terms = (f"{sign}{name}.{variable}" for sign, name in self.turns(body))
        return "".join(terms).removeprefix("+") or "0"

    def turns(self, body: str) -> list[tuple[str, str]]:
        """List signs and names of the revolute joints from the ground to a body."""
        path = self.paths[body]
        return [(sign, row["name"]) for sign, row in path if row["type"] == "revolute"]

    def damping(self, joint: str) -> Value:
        """Return the damper of a joint, which is that of the body it turns."""
        found = [
            force["c"]
            for force in self.topology["forces"]
            if force["type"] == "rot_damper_planar" and self.turns(force["body"])[-1][1] == joint
        ]
        return found[0] if found else 0.0

    def observed(self, kind: str, body: str, *rest: Any) -> str:
        """Return the expression of an output."""
        if kind == "theta":
            return self.turning(body, "theta")
        if kind == "omega":
            return self.turning(body, "theta_dot")
        if kind == "omega_body":
            (k,) = rest
            return " + ".join(f"{body}.r{j + 1}{k + 1}*{body}.w{'xyz'[j]}" for j in range(3))
        point, i = rest
        return f"{self.node(body, point)}.{'v' if kind == 'vpoint' else ''}{'xyz'[i]}"


def _revolute(reader: _Reader, joint: dict[str, Any]) -> None:
    reader.scene.edge(
        joint["name"],
        "revolute",
        *reader.ends(joint),
        axis=[0, 0, 1],
        damping=reader.damping(joint["name"]),
        initial={
            "theta": reader.turned_by(joint, "theta"),
            "theta_dot": reader.turned_by(joint, "omega"),
        },
    )


def _prismatic(reader: _Reader, joint: dict[str, Any]) -> None:
    """Draw a guide in the ground for the origin of a body."""
    (first, place), (body, point) = joint["a"], joint["b"]
    if first != "ground" or not _is_zero(place) or not _is_zero(point):
        raise ValueError(
            f"prismatic joint '{joint['name']}' must guide an origin from the ground's"
        )
    axis = _spatial(joint["axis_a"])
    pose = reader.bodies[body]["initial"]
    start = {"s": _dot(axis, pose["r"]), "s_dot": _dot(axis, pose.get("v", [0, 0]))}
    reader.scene.edge(joint["name"], "prismatic", first, body, axis=axis, initial=start)


def _spherical(reader: _Reader, joint: dict[str, Any]) -> None:
    first, body = joint["a"][0], joint["b"][0]
    if first != "ground":
        raise ValueError(f"spherical joint '{joint['name']}' must begin at the ground")
    start = _turned(reader.bodies[body]["initial"])
    reader.scene.edge(joint["name"], "spherical", *reader.ends(joint), initial=start)


def _distance(reader: _Reader, joint: dict[str, Any]) -> None:
    reader.scene.edge(joint["name"], "distance", *reader.ends(joint), length=joint["length"])


def _slot(reader: _Reader, joint: dict[str, Any]) -> None:
    """Hold a point on the line through the origin that a normal is perpendicular to."""
    x, y = joint["normal"]
    axis = [y, f"-({x})", 0]
    reader.scene.edge(joint["name"], "slot", "ground", reader.node(*joint["a"]), axis=axis)


def _skate(reader: _Reader, joint: dict[str, Any]) -> None:
    axis = _spatial(joint["axis_a"])
    reader.scene.edge(joint["name"], "knife_edge", "ground", reader.node(*joint["a"]), axis=axis)


def _spring(reader: _Reader, force: dict[str, Any]) -> None:
    reader.scene.edge(
        force["name"],
        "spring",
        *reader.ends(force),
        stiffness=force["k"],
        free_length=force["l0"],
    )


def _torque(reader: _Reader, force: dict[str, Any]) -> None:
    torque = [0, 0, force["value"]]
    reader.scene.edge(force["name"], "torque", "ground", force["body"], torque=torque)


def _damper(reader: _Reader, force: dict[str, Any]) -> None:
    """Check that a joint damps the turning of a body against the ground."""
    if len(reader.turns(force["body"])) != 1:
        raise ValueError(f"damper '{force['name']}' must act in a joint whose other side is still")


_JOINTS = {
    "revolute": _revolute,
    "prismatic": _prismatic,
    "spherical": _spherical,
    "distance": _distance,
    "slot_through_origin": _slot,
    "skate": _skate,
}
_FORCES = {"spring": _spring, "torque": _torque, "rot_damper_planar": _damper}


def _spatial(given: Sequence[Value]) -> list[Value]:
    """Return three components; those of the plane get a zero."""
    return [*given, 0][:3]


def _is_zero(point: Sequence[Value]) -> bool:
    return all(entry == 0 for entry in point)


def _is_timed(entry: Value) -> bool:
    return re.search(r"\bt\b", str(entry)) is not None


def _dot(a: Sequence[Value], b: Sequence[Value]) -> str:
    return " + ".join(f"({x})*({y})" for x, y in zip(a, b, strict=False))


def _turned(pose: dict[str, Any]) -> dict[str, Any]:
    """Return rotation and angular velocity; the file resolves the latter along ground axes."""
    rotation, omega = pose["R"], pose["omega"]
    own = [_dot([row[k] for row in rotation], omega) for k in range(3)]
    return {"rotation": rotation, **dict(zip(("w1", "w2", "w3"), own, strict=True))}


def _paths(joints: Sequence[dict[str, Any]]) -> dict[str, list[tuple[str, dict[str, Any]]]]:
    """Lead from the ground to bodies, over as few joints as there may be."""
    moving = [joint for joint in joints if joint["type"] in ("revolute", "prismatic", "spherical")]
    paths: dict[str, list[tuple[str, dict[str, Any]]]] = {"ground": []}
    while True:
        found = {}
        for joint in moving:
            for sign, first, second in (("+", "a", "b"), ("-", "b", "a")):
                inner, outer = joint[first][0], joint[second][0]
                if inner in paths and outer not in paths:
                    found[outer] = [*paths[inner], (sign, joint)]
        if not found:
            return paths
        paths |= found
