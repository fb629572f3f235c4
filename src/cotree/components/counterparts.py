"""Types that do along a length what others do about an angle."""

from __future__ import annotations

#: Components of rotation, each with that of translation.
_PAIRS = {
    "rotational_inertia": "translational_mass",
    "rotational_spring": "translational_spring",
    "rotational_damper": "translational_damper",
    "rotational_stop": "translational_stop",
    "rotational_rigid_stop": "translational_rigid_stop",
    "rotational_friction": "translational_friction",
    "rotational_dry_friction": "translational_dry_friction",
    "rotational_lugre": "translational_lugre",
    "rotational_backlash": "translational_backlash",
    "torque_source": "force_source",
    "speed_source": "velocity_source",
    "ideal_gear": "lever",
    "dc_motor": "voice_coil",
    "hydraulic_machine": "hydraulic_cylinder",
}
_COUNTERPARTS = {**_PAIRS, **{along: about for about, along in _PAIRS.items()}}

#: For components between two nodes: those of one-dimensional graphs that may sit on a joint.
ON_JOINTS = {
    "spring": ("translational_spring", "rotational_spring"),
    "damper": ("translational_damper", "rotational_damper"),
    "force": ("force_source",),
    "line_force": ("force_source",),
    "torque": ("torque_source",),
    "rigid_body": ("translational_mass", "rotational_inertia"),
}


def counterpart_of(type: str) -> str:
    """Give the type of rotation for one of translation, and the reverse; empty if there is none."""
    return _COUNTERPARTS.get(type, "")
