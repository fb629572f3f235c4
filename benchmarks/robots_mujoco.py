"""Robots by MuJoCo: Pinocchio's model as MJCF, and a C loop around ``mj_forward``.

Contacts, constraints and sensors are disabled. The remaining computations are kinematics, composite
inertias, the factorised mass matrix and the bias forces.
"""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import numpy as np

HERE = Path(__file__).parent
_AXES = {"X": "1 0 0", "Y": "0 1 0", "Z": "0 0 1"}


def _text(values: Any) -> str:
    return " ".join(f"{value:.17g}" for value in np.ravel(values))


def _joint(joint: Any) -> dict[str, str]:
    """Return the type and the axis of a joint."""
    name = joint.shortname()
    if name == "JointModelFreeFlyer":
        return {"type": "free"}
    kind = "slide" if name.startswith("JointModelP") else "hinge"
    if name.endswith("Unaligned"):
        return {"type": kind, "axis": _text(joint.extract().axis)}
    if name[-1] not in _AXES:
        raise ValueError(f"joints of type {name} are not written")
    return {"type": kind, "axis": _AXES[name[-1]]}


def mjcf(model: Any) -> str:
    """Return Pinocchio's model as MJCF text."""
    import pinocchio

    root = xml.Element("mujoco")
    xml.SubElement(root, "compiler", angle="radian", boundmass="0", balanceinertia="false")
    option = xml.SubElement(root, "option", gravity=_text(model.gravity.linear))
    xml.SubElement(option, "flag", contact="disable", constraint="disable")
    places = {0: xml.SubElement(root, "worldbody")}
    for i in range(1, model.njoints):
        place, inertia = model.jointPlacements[i], model.inertias[i]
        turn = pinocchio.Quaternion(place.rotation)
        body = xml.SubElement(
            places[model.parents[i]],
            "body",
            pos=_text(place.translation),
            quat=_text([turn.w, turn.x, turn.y, turn.z]),
        )
        xml.SubElement(body, "joint", **_joint(model.joints[i]))
        j = inertia.inertia
        moments = [j[0, 0], j[1, 1], j[2, 2], j[0, 1], j[0, 2], j[1, 2]]
        xml.SubElement(
            body,
            "inertial",
            pos=_text(inertia.lever),
            mass=f"{inertia.mass:.17g}",
            fullinertia=_text(moments),
        )
        places[i] = body
    return xml.tostring(root, encoding="unicode")


def difference(model: Any, text: str) -> float:
    """Compare joint accelerations with Pinocchio's at a random position at rest."""
    import mujoco
    import pinocchio

    rng = np.random.default_rng(0)
    n_free = 6 if model.joints[1].shortname() == "JointModelFreeFlyer" else 0
    n_joints = model.nv - n_free
    angles, tau = np.zeros(model.nv), np.zeros(model.nv)
    angles[n_free:], tau[n_free:] = rng.uniform(-1.0, 1.0, (2, n_joints))
    q = pinocchio.integrate(model, pinocchio.neutral(model), angles)
    theirs = pinocchio.aba(model, model.createData(), q, np.zeros(model.nv), tau)[n_free:]
    known = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(known)
    data.qpos[known.nq - n_joints :] = angles[n_free:]
    data.qfrc_applied[n_free:] = tau[n_free:]
    mujoco.mj_forward(known, data)
    return float(np.max(np.abs(data.qacc[n_free:] - theirs)) / np.max(np.abs(theirs)))


def forward_time(model: Any, folder: Path, seconds: float) -> float | None:
    """Return the time of the forward dynamics, [ns]; None without MuJoCo or a compiler."""
    try:
        import mujoco
    except ImportError:
        return None
    there = Path(mujoco.__file__).parent
    library = next(there.glob("libmujoco.so*"), None)
    if library is None or not shutil.which("gcc"):
        return None
    text = mjcf(model)
    off = difference(model, text)
    if not off < 1e-6:  # MJCF's principal axes cost digits
        raise SystemExit(f"MuJoCo computes something else, by {off:.1e}")
    program = folder / "robots_mujoco"
    if not program.exists():
        command = ["gcc", "-O3", "-march=native", str(HERE / "robots_mujoco.c"), "-o", str(program)]
        ends = [f"-I{there / 'include'}", f"-L{there}", f"-Wl,-rpath,{there}", f"-l:{library.name}"]
        subprocess.run([*command, *ends, "-lm"], check=True)
    file = folder / "robot.xml"
    file.write_text(text)
    command = [str(program), str(file), str(seconds)]
    return float(subprocess.run(command, check=True, capture_output=True, text=True).stdout)
