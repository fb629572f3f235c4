"""Robots that tests share: where their files are, their scenes, and arrays by name."""

from __future__ import annotations

import importlib.metadata
from dataclasses import replace
from pathlib import Path

import numpy as np

import cotree

HERE = Path(__file__).parent
STORED = {
    "ur5": ("ur5_robot.urdf", "fixed"),
    "panda": ("panda.urdf", "fixed"),
    "solo12": ("solo12.urdf", "free"),
    "kinova": ("kinova.urdf", "fixed"),
}


def stored_file(name):
    """Return the path of a robot in the folder of the tests."""
    return HERE / "urdf" / STORED[name][0]


def installed_file(name):
    """Return the path of a robot of the package example-robot-data."""
    files = importlib.metadata.files("example-robot-data") or []
    return next(Path(f.locate()).resolve() for f in files if str(f).endswith(f"robots/{name}"))


def without_losses(scene):
    """Take damping and friction to zero: Pinocchio's forward dynamics has none."""
    for name, row in scene.parameters.items():
        if name.endswith(("_damping", "_friction")):
            scene.parameters[name] = replace(row, value=0.0)
    return scene


def read(path, base="fixed", mimic=False):
    return without_losses(cotree.read_urdf(path, base, mimic))


def array_of(names, values):
    """Return values by name as an array; missing values are zero."""
    return np.array([values.get(name, 0.0) for name in names])


def follow(scene, state):
    """Add to a state what followers take from their leaders."""
    for edge in scene.edges.values():
        if edge.component.name != "gear":
            continue
        one, other = (edge.fields[f"coordinate{i}"].text for i in (1, 2))
        ratio, phase = (edge.fields[name].number for name in ("ratio", "phase"))
        state[one] = ratio * state[other] + phase
        state[f"{one}_dot"] = ratio * state[f"{other}_dot"]
    return state


#: A link of each robot, to whose inertia sensitivities are taken; joints follow it.
LINKS = {
    "ur5": "forearm_link",
    "panda": "panda_link5",
    "solo12": "FL_UPPER_LEG",
    "kinova": "j2s6s200_link_3",
}
INERTIAL = ("mass", "cx", "cy", "cz", "ixx", "ixy", "ixz", "iyy", "iyz", "izz")


def inertia_of(scene, link):
    """Return a link's inertia in the file: axes, mass, centre of mass, moments."""
    rows = scene.edges[f"{link}_centre"].fields.get("rotation")
    turn = np.eye(3) if rows is None else np.array([[e.number for e in row] for row in rows])
    mass, x, y, z, *moments = (scene.parameters[f"{link}_{name}"].value for name in INERTIAL)
    return turn, mass, (x, y, z), tuple(moments)


def sensitivities_to(link):
    """Name the parameters of a link's inertia."""
    return [f"{link}_{name}" for name in INERTIAL]
