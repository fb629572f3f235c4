"""Impacts that have no law, or no sensitivities, are refused by the names of the edges."""

import numpy as np
import pytest

import cotree
from cotree.errors import ExpressionError, FormulationError

TIGHT = {"method": "dop853", "rtol": 1e-11, "atol": 1e-13}


def geared(kind, node, **losses):
    """Build two shafts with a gear, a third one, and a stop at one of them."""
    scene = cotree.Scene("geared")
    for name, w in (("a", 2.0), ("b", 1.0), ("c", 3.0)):
        scene.edge(f"J{name}", "rotational_inertia", "ground", name, inertia=1.0, initial={"w": w})
    scene.edge("G", kind, "a", "b", ratio=2.0, **losses)
    limit = {"upper": 0.5, "restitution": 0.5}
    scene.edge("S", "rotational_rigid_stop", "ground", node, **limit)
    return scene


def test_an_impact_through_a_gear_with_losses_is_refused_by_name():
    with pytest.warns(RuntimeWarning, match="passes the gear with losses 'G', whose"):
        result = geared("lossy_gear", "b", efficiency=0.8).compile().simulate((0, 0.6), **TIGHT)
    assert abs(result.t[-1] - 0.5) <= 1e-9
    # Through an ideal one it passes, and where the gear has no part in it nothing is refused.
    for kind, node, losses in (("ideal_gear", "b", {}), ("lossy_gear", "c", {"efficiency": 0.8})):
        result = geared(kind, node, **losses).compile().simulate((0, 0.6), **TIGHT)
        speed = result[f"J{node}.w"]
        assert abs(speed[-1] + 0.5 * speed[0]) <= 1e-9


def pair(inertia):
    """Build two shafts, of which one runs into the other."""
    scene = cotree.Scene("pair")
    scene.parameter("k", 1.0)
    scene.edge("J", "rotational_inertia", "ground", "a", inertia=inertia, initial={"w": "k"})
    scene.edge("K", "rotational_inertia", "ground", "b", inertia=1.0)
    limit = {"lower": 0.0, "restitution": 0.5, "initial": {"theta": 0.4}}
    scene.edge("S", "rotational_rigid_stop", "a", "b", **limit)
    return scene


def test_impacts_of_inertia_that_is_a_function_of_time_have_no_sensitivities():
    assert pair("2 + t").compile().simulate((0, 1), **TIGHT).success
    told = "inertia of edge 'J' depends on time or an input, and edge 'S' has impacts"
    with pytest.raises(FormulationError, match=told):
        pair("2 + t").compile(["k"])


def test_restitution_that_is_a_function_of_time_has_sensitivities():
    scene = cotree.Scene("ball", gravity=[0, -9.81, 0])
    scene.parameter("h", 0.5)
    start = {"initial": {"y": "0.1 + h"}}
    scene.edge("b", "rigid_body", "ground", "P", mass=1.0, inertia=[0.01] * 3, **start)
    own = {"radius": 0.1, "restitution": "0.3 + 0.1*t"}
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 1, 0], **own)
    result = scene.compile(["h"]).simulate((0, 0.5), **TIGHT)
    # It falls for s, with v = g s, and leaves with e v; s = sqrt(2 h/g), so that s' = 1/(g s).
    s = np.sqrt(2 * 0.5 / 9.81)
    slope = 1 / (9.81 * s)
    wanted = 0.1 * slope * 9.81 * s + (0.3 + 0.1 * s) * 9.81 * slope + 9.81 * slope
    assert abs(result.sensitivity("b.y_dot", "h")[-1] - wanted) <= 1e-9


def test_a_misspelt_variable_of_a_contact_is_answered_with_its_own():
    scene = cotree.Scene("ball", gravity=[0, -9.81, 0])
    scene.edge("b", "rigid_body", "ground", "P", mass=1.0, initial={"y": 0.2})
    scene.edge("c", "rigid_contact", "ground", "P", normal=[0, 1, 0], radius=0.1)
    scene.output("push", "c.forces")
    with pytest.raises(ExpressionError, match="edge 'c' has no variable 'forces'; did you mean 'f"):
        scene.compile()
