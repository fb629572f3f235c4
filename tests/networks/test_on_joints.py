"""One-dimensional components on joints: what they do, and what messages advise."""

from __future__ import annotations

import re
from unittest.mock import patch

import numpy as np
import pytest

import cotree
from cotree import Scene
from cotree.components import COMPONENTS, OWN, Kind
from cotree.components.mechanical import ON_JOINTS, counterpart_of

#: Required fields of components of one port, and what else makes them do something here.
FIELDS = {
    "mass": "k",
    "inertia": "k",
    "stiffness": "k",
    "damping": 0.3,
    "lower": -0.1,
    "upper": 0.2,
    "force": "0.1*k",
    "torque": "0.1*k",
    "normal_force": "k",
    "friction": 0.2,
    "radius": 0.5,
    "breakaway": "0.2*k",
    "stribeck_speed": 0.1,
}
MECHANICAL = ("translational", "rotational")
ALONE = sorted(
    name
    for name in OWN
    if len(COMPONENTS[name].ports) == 1
    and COMPONENTS[name].ports[0].domain in MECHANICAL
    and COMPONENTS[name].ports[0].kind is not Kind.ACROSS_SOURCE
    # Bristles have a deflection of their own in place of the stretch that is given here.
    and COMPONENTS[name].ports[0].integral is None
)
ACCURATE = {"method": "dop853", "rtol": 1e-9, "atol": 1e-11}


def is_turning(name):
    return COMPONENTS[name].ports[-1].domain == "rotational"


def given(name):
    fields = {row.name: FIELDS[row.name] for row in COMPONENTS[name].fields if row.required}
    if name.endswith("_rigid_stop"):
        fields["upper"] = 0.9  # beyond the start
    if name.endswith("_backlash"):
        fields |= {"lower": FIELDS["lower"], "upper": FIELDS["upper"]}
    return {"stiffness": "k", **fields} if name.endswith("_spring") else fields


def moving(turns):
    """Build a body on a joint, in motion."""
    scene = Scene("on-a-joint")
    scene.parameter("k", 3.0)
    scene.parameter("m", 2.0)
    if turns:
        scene.revolute("j", "ground", "A", axis=[0, 0, 1], initial={"theta": 0.5, "theta_dot": 1})
        scene.rigid_body("b", "ground", "A", mass=1.0, inertia="m")
    else:
        scene.prismatic("j", "ground", "A", axis=[1, 0, 0], initial={"s": 0.5, "s_dot": 1})
        scene.rigid_body("b", "ground", "A", mass="m")
    return scene


def in_a_graph(name):
    """Build the same motion between two nodes of a one-dimensional graph."""
    scene = Scene("between-nodes")
    scene.parameter("k", 3.0)
    scene.parameter("m", 2.0)
    rate, integral = ("w", "theta") if is_turning(name) else ("v", "s")
    kind, field = (
        ("rotational_inertia", "inertia")
        if is_turning(name)
        else (
            "translational_mass",
            "mass",
        )
    )
    scene.edge("M", kind, "ground", "A", initial={rate: 1.0}, **{field: "m"})
    stretched = COMPONENTS[name].ports[0].kind in (Kind.SPRING, Kind.STOP) or name == "shaft"
    initial = {integral: 0.5} if stretched else None
    scene.edge("e", name, "ground", "A", initial=initial, **given(name))
    return scene


@pytest.mark.compiler
@pytest.mark.sampled(4)
@pytest.mark.parametrize("name", ALONE)
@pytest.mark.filterwarnings("ignore:no state or output depends on parameter")
def test_a_joint_moves_as_a_graph_of_one_dimension_does(name):
    scene = moving(is_turning(name))
    scene.edge("e", name, joint="j", **given(name))
    on_joint = scene.compile(["k", "m"], optimize="-O0").simulate((0, 1), **ACCURATE)
    alone = in_a_graph(name).compile(["k", "m"], optimize="-O0").simulate((0, 1), **ACCURATE)
    pair = ("j.theta_dot", "M.w") if is_turning(name) else ("j.s_dot", "M.v")
    # The same equations, formed by way of a mechanism: two runs at 1e-9 agree to some 1e-8; stops
    # multiply errors by their stiffness.
    assert abs(on_joint[pair[0]][-1] - alone[pair[1]][-1]) < 1e-7
    for parameter in ("k", "m"):
        slopes = (
            r.sensitivity(n, parameter)[-1] for r, n in zip((on_joint, alone), pair, strict=True)
        )
        assert abs(next(slopes) - next(slopes)) < 1e-6


@pytest.mark.compiler
def test_dry_friction_of_a_joint_sticks_and_slips_by_events():
    """A law with a jump becomes events; each half swing ends where work and friction meet."""
    with patch.dict(COMPONENTS):
        cotree.register_component(
            "coulomb_of_test", lambda across, F: _sign(across) * F, domain="rotational"
        )
        scene = Scene("bearing")
        scene.parameter("F", 0.1)
        scene.revolute("h", "ground", "A", axis=[0, 0, 1], stiffness=4.0, initial={"theta": 1.0})
        scene.rigid_body("disc", "ground", "A", mass=1.0, inertia=1.0)
        scene.edge("f", "coulomb_of_test", joint="h", F="F")
        scene.output("work", "f.tau*f.w")
        result = scene.compile(["F"], optimize="-O0").simulate((0, np.pi), **ACCURATE)
    # Each half swing, pi/2 long, takes 2 F / k off the amplitude (Den Hartog): after two of them
    # 1 - 4 F / k is left, and its slope is -4 / k = -1.
    assert abs(result["h.theta"][-1] - (1.0 - 4 * 0.1 / 4.0)) < 1e-7
    assert abs(result.sensitivity("h.theta", "F")[-1] + 1.0) < 1e-6


def _sign(x):
    import sympy

    return sympy.sign(x)


@pytest.mark.compiler
def test_a_stop_throws_back_by_its_stiffness():
    """A body meets an elastic limit and comes back as fast; the event sees the contact."""
    scene = Scene("limit")
    scene.parameter("k", 1e4)
    scene.prismatic("rail", "ground", "A", axis=[1, 0, 0], initial={"s_dot": 2.0})
    scene.rigid_body("b", "ground", "A", mass=1.0)
    scene.translational_stop(
        "stop", joint="rail", lower=-1, upper=1.0, stiffness="k", transition=1e-9
    )
    scene.event("touch", "stop.s - 1", direction=1)
    result = scene.compile(["k"], optimize="-O0").simulate((0, 0.8), **ACCURATE)
    assert abs(result.events["touch"].t[0] - 0.5) < 1e-6
    # Half a period of contact, pi sqrt(m/k), then back: s = 1 - 2 (t - 0.5 - pi sqrt(m/k)); its
    # slope by k is -pi sqrt(m) k**-1.5. The corner is smoothed over 1e-9.
    contact = np.pi / 100
    assert abs(result["rail.s"][-1] - (1 - 2 * (0.3 - contact))) < 1e-6
    assert abs(result.sensitivity("rail.s", "k")[-1] / (-contact / 1e4) - 1) < 1e-4


# What a newcomer writes, and what the message says to write in its place: a test does that.
MOTOR = {"electrical": ["a", "ground"], "resistance": 1.0, "constant": 1.0}


def workshop(joint="prismatic"):
    """Build a scene with a joint of each kind, and a supply."""
    scene = Scene("workshop")
    scene.voltage_source("V", "a", "ground", voltage=1.0)
    scene.pressure_source("p", "q", "ground", pressure=1.0)
    for name, type, axes in (
        ("rail", "prismatic", {"axis": [1, 0, 0]}),
        ("hinge", "revolute", {"axis": [0, 0, 1]}),
        ("fork", "universal", {"axis": [1, 0, 0], "axis2": [0, 1, 0]}),
        ("tube", "cylindrical", {"axis": [0, 0, 1]}),
    ):
        if name in ("rail", "hinge") or name == joint:
            scene.edge(name, type, "ground", name.upper(), **axes)
            scene.rigid_body(f"of_{name}", "ground", name.upper(), mass=1.0, inertia=1.0)
    return scene


def refused(scene, name, type, *nodes, **fields):
    """Return the message about an edge."""
    with pytest.raises(cotree.Error) as caught:
        _added(scene, name, type, *nodes, **fields).compile(optimize="-O0")
    return str(caught.value)


def _added(scene, name, type, *nodes, **fields):
    scene.edge(name, type, *nodes, **fields)
    return scene


def accepted(scene, type, *nodes, **fields):
    scene.edge("new", type, *nodes, **fields)
    return scene.compile(optimize="-O0")


WRONG = [
    ("dc_motor", MOTOR, "rail"),
    ("voice_coil", MOTOR, "hinge"),
    *(("hydraulic_machine", {"chamber": ["q", "ground"], "displacement": 1e-3}, "rail"),),
    *(("hydraulic_cylinder", {"chamber": ["q", "ground"], "area": 1e-3}, "hinge"),),
    *((name, given(name), "rail" if is_turning(name) else "hinge") for name in ALONE),
]
OTHER_FIELDS = {"torque": "force", "inertia": "mass", "displacement": "area"}
OTHER_FIELDS |= {other: own for own, other in OTHER_FIELDS.items()}


@pytest.mark.sampled(6)
@pytest.mark.parametrize(("type", "fields", "joint"), WRONG, ids=[row[0] for row in WRONG])
def test_a_joint_of_the_other_kind_is_answered_with_the_type_that_fits(type, fields, joint):
    fields = {
        key: 1.0 if isinstance(item, str) and key not in MOTOR else item
        for key, item in fields.items()
    }
    told = refused(workshop(), "x", type, joint=joint, **fields)
    what, kind = ("angle", "prismatic") if joint == "rail" else ("length", "revolute")
    assert f"joint '{joint}' of type '{kind}' has no {what} to act on" in told
    # The message names a joint that fits ...
    does = "turns" if joint == "rail" else "slides"
    assert told.endswith(f"act on a joint that {does}")
    accepted(workshop(), type, joint="hinge" if joint == "rail" else "rail", **fields)
    # ... and, where there is one, the type that fits the joint.
    named = re.search(r"use a (\w+) instead of the (\w+)", told)
    assert (named[1] if named else "") == counterpart_of(type)
    if named:
        other = {field.name for field in COMPONENTS[named[1]].fields}
        renamed = {
            key if key in other or key in MOTOR or key == "chamber" else OTHER_FIELDS[key]: item
            for key, item in fields.items()
        }
        accepted(workshop(), named[1], joint=joint, **renamed)


@pytest.mark.parametrize(
    ("joint", "coordinate"), [("fork", ""), ("fork", ".theta3"), ("tube", ".s"), ("fork", ".s")]
)
def test_every_coordinate_that_is_named_in_a_message_is_accepted(joint, coordinate):
    told = refused(workshop(joint), "x", "rotational_damper", joint=joint + coordinate, damping=1.0)
    named = re.findall(r'joint = "([\w.]+)"', told)
    assert len(named) == {"fork": 2, "tube": 1}[joint]
    for place in named:
        model = accepted(workshop(joint), "rotational_damper", joint=place, damping=1.0)
        assert f"{place}_dot" in model.states


@pytest.mark.parametrize("type", ON_JOINTS)
def test_components_between_nodes_name_those_that_take_a_joint(type):
    told = refused(workshop(), "x", type, joint="rail")
    cures = re.search(r"use a (.*) instead", told)[1].split(" or ")
    assert tuple(cures) == ON_JOINTS[type]
    for cure in cures:
        fields = {
            key: 1.0 if item == "k" or item == "0.1*k" else item
            for key, item in given(cure).items()
        }
        accepted(workshop(), cure, joint="hinge" if is_turning(cure) else "rail", **fields)


@pytest.mark.compiler
@pytest.mark.parametrize("joint", ["rail", "tube.s"])
def test_a_given_velocity_of_a_joint_is_held_and_tells_its_effort(joint):
    """A pendulum hangs on a slider that moves as given; the rest follows."""
    scene = Scene("towed")
    scene.parameter("v", 0.5)
    if joint == "rail":
        scene.prismatic("rail", "ground", "A", axis=[1, 0, 0], initial={"s": 1.0})
    else:
        scene.cylindrical("tube", "ground", "A", axis=[1, 0, 0], initial={"s": 1.0})
    scene.rigid_body("block", "ground", "A", mass=2.0, inertia=1.0)
    scene.velocity_source("drive", joint=joint, velocity="v*cos(3*t)")
    scene.output("push", "drive.drive")
    assert f"on {joint}" in scene.summary()
    result = scene.compile(["v"], optimize="-O0").simulate((0, 1), **ACCURATE)
    name = joint if "." in joint else f"{joint}.s"
    # s = 1 + v sin(3 t) / 3, and the force is m times its acceleration; two runs' worth of 1e-9.
    assert abs(result[name][-1] - 1 - 0.5 * np.sin(3) / 3) < 1e-8
    assert abs(result.sensitivity(name, "v")[-1] - np.sin(3) / 3) < 1e-8
    assert abs(result["push"][-1] + 2.0 * 0.5 * 3 * np.sin(3)) < 1e-7
    assert abs(result.sensitivity("push", "v")[-1] + 2.0 * 3 * np.sin(3)) < 1e-7


@pytest.mark.compiler
def test_a_given_velocity_closes_a_loop_with_other_constraints():
    """The crank of a four-bar linkage turns at a constant speed; the loop stays closed."""
    scene = Scene("crank")
    for bar, start, end, length in (
        ("crank", "A", "B", 1.0),
        ("coupler", "B2", "C", 2.0),
        ("rocker", "D2", "C2", 2.0),
    ):
        scene.arm(bar, start, end, vector=[length, 0, 0])
        scene.rigid_body(f"m_{bar}", "ground", end, mass=1.0, inertia=0.1)
    scene.arm("base", "ground", "D", vector=[1.5, 0, 0])
    for name, start, end in (
        ("a", "ground", "A"),
        ("b", "B", "B2"),
        ("c", "C", "C2"),
        ("d", "D", "D2"),
    ):
        initial = {"theta": 1.5} if name == "a" else None
        scene.revolute(name, start, end, axis=[0, 0, 1], initial=initial)
    scene.speed_source("motor", joint="a", speed=2.0)
    scene.output("power", "motor.drive*a.theta_dot")
    scene.output("kinetic", "energy.kinetic")
    result = scene.compile(optimize="-O0").simulate((0, 2), np.linspace(0, 2, 401), **ACCURATE)
    assert abs(result["a.theta"][-1] - 5.5) < 1e-8
    # All work is that of the motor; Simpson's rule over 400 intervals is exact to 1e-6 here.
    work = _simpson(result["power"], result.t)
    assert abs(work - (result["kinetic"][-1] - result["kinetic"][0])) < 1e-5


def _simpson(values, times):
    from scipy.integrate import simpson

    return simpson(values, x=times)


@pytest.mark.parametrize(
    ("fields", "told"),
    [
        ({"joint": "rail", "velocity": "sign(t - 1)"}, "would require an impulse"),
        ({"joint": "rail", "velocity": "rail.s"}, "may depend on parameters and t only"),
        ({"joint": "rial", "velocity": 1.0}, "joint 'rial'; did you mean 'rail'"),
        (
            {"joint": "hinge", "velocity": 1.0},
            "use a speed_source instead of the velocity_source",
        ),
        ({"line": ["RAIL", "HINGE"], "velocity": 1.0}, "use a distance between its nodes"),
        ({"velocity": 1.0}, 'needs two nodes, or joint = "..."'),
    ],
)
def test_what_cannot_be_held_is_refused(fields, told):
    assert told in refused(workshop(), "x", "velocity_source", **fields)


def test_messages_name_the_field_and_what_it_uses():
    scene = workshop()
    scene.input("wave", "sin(t)")
    told = refused(scene, "x", "velocity_source", joint="rail", velocity="wave")
    assert "velocity of edge 'x': uses 'wave', but may depend on parameters and t only" in told
    told = refused(workshop(), "x", "force_source", joint="rail", force="rail.s_ddot")
    assert told.startswith("force of edge 'x' uses 'rail.s_ddot', which is not a coordinate")


def test_cures_for_given_velocities_work():
    accepted(workshop(), "velocity_source", joint="rail", velocity="max(0, t - 1)")
    accepted(workshop(), "speed_source", joint="hinge", speed=1.0)
    scene = Scene("reach")
    scene.prismatic("rail", "ground", "A", axis=[1, 0, 0], initial={"s": 1.0})
    scene.rigid_body("b", "ground", "A", mass=1.0)
    model = accepted(scene, "distance", "ground", "A", length="1 + 0.5*t")
    assert abs(model.simulate((0, 2))["rail.s"][-1] - 2.0) < 1e-8


def test_two_joints_are_tied_by_a_gear():
    told = refused(workshop(), "x", "rack_and_pinion", joint="rail", radius=0.5)
    assert "its other port acts on the multibody system; to couple two joints use a gear" in told
    scene = workshop()
    tie = {"coordinate1": "rail.s", "coordinate2": "hinge.theta", "ratio": 0.5}
    scene.gear("new", "RAIL", "HINGE", **tie)
    scene.force_source("push", joint="rail", force=1.0)
    result = scene.compile(optimize="-O0").simulate((0, 1), **ACCURATE)
    # One newton moves a mass of 1 and an inertia of 1 on a radius of 0.5: s = t**2 / (2 (1 + 4)).
    assert abs(result["rail.s"][-1] - 0.1) < 1e-8


def test_nodes_and_a_joint_are_not_given_together():
    told = refused(workshop(), "x", "rotational_damper", "A", "B", joint="hinge", damping=1.0)
    assert "remove one of them" in told
    accepted(workshop(), "rotational_damper", joint="hinge", damping=1.0)
    scene = workshop()
    scene.rotational_inertia("J", "ground", "A", inertia=1.0)
    accepted(scene, "rotational_damper", "ground", "A", damping=1.0)
    told = refused(workshop(), "x", "rotational_damper", damping=1.0)
    assert told == "edge 'x' needs two nodes, or joint = \"...\" to act on a joint"


def test_nodes_of_a_transducer_and_a_joint_are_not_given_together():
    motor = {"resistance": 1.0, "constant": 1.0, "joint": "rail"}
    told = refused(workshop(), "x", "voice_coil", "a", "b", **motor)
    assert 'give electrical = ["...", "ground"] instead of the nodes' in told
    told = refused(workshop(), "x", "voice_coil", coil=["a", "b"], electrical=["c", "d"], **motor)
    assert "has nodes for its port coil, but also acts on the multibody system by joint" in told
    accepted(workshop(), "voice_coil", electrical=["a", "ground"], **motor)


def test_a_line_takes_translation_only():
    told = refused(workshop(), "x", "rotational_damper", line=["RAIL", "HINGE"], damping=1.0)
    assert 'name a revolute joint as joint = "..."' in told
    scene = Scene("line")
    scene.prismatic("rail", "ground", "A", axis=[1, 0, 0], initial={"s": 1.0, "s_dot": 2.0})
    scene.rigid_body("b", "ground", "A", mass=2.0)
    model = accepted(scene, "translational_damper", line=["ground", "A"], damping=3.0)
    result = model.simulate((0, 1), **ACCURATE)
    assert abs(result["rail.s_dot"][-1] - 2.0 * np.exp(-1.5)) < 1e-8
    assert "on ground - A" in scene.summary()
