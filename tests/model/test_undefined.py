"""A result that is no number is named: the element, its operation, and the values it depends on."""

from __future__ import annotations

import functools
import re

import numpy as np
import pytest

import cotree
from cotree.errors import SingularSystemError

pytestmark = [
    pytest.mark.compiler,
    pytest.mark.filterwarnings("ignore:COTREE_COMPILER:RuntimeWarning"),
]


def network(q, resistance="sqrt(2.5 - C1.v*q)"):
    """A network whose equations are solved at run time; a resistance may have no value."""
    scene = cotree.Scene("network")
    scene.parameter("q", q)
    scene.edge("V1", "voltage_source", "a", "ground", voltage=5.0)
    scene.edge("R1", "resistor", "a", "b", resistance=resistance)
    scene.edge("R2", "resistor", "b", "ground", resistance=2.0)
    scene.edge("R3", "resistor", "b", "c", resistance=2.0)
    scene.edge("C1", "capacitor", "c", "ground", capacitance=1e-3, initial={"v": 1.0})
    scene.edge("T1", "transformer", "b", "d", ratio=2.0)
    scene.edge("R4", "resistor", "d", "ground", resistance=3.0)
    scene.edge("R5", "resistor", "d", "c", resistance=3.0)
    return scene


def test_linear_equations_that_hold_nan():
    model = network(1.5).compile()
    assert any(node.op == "solve" for node in model.kernels.program.kernels["rhs"].order)
    assert np.all(np.isfinite(model.rhs(0.3, [1.0])))
    expected = (
        "at t = 0.3, since a coefficient is not finite (resistance of edge 'R1': sqrt(-0.5) is "
        "nan at 'q' = 1.5, 'C1.v' = 2)"
    )
    with pytest.raises(SingularSystemError, match=re.escape(expected)):
        model.rhs(0.3, [2.0])


def test_a_start_without_a_value():
    with pytest.raises(SingularSystemError, match=r"resistance of edge 'R1': sqrt\(-0\.5\) is nan"):
        network(3.0).compile()


def test_a_rate_that_is_not_finite_at_the_start():
    scene = cotree.Scene("root")
    scene.parameter("a", -1.0)
    scene.edge("j", "prismatic", "ground", "A", axis=[1, 0, 0], force="log(a + t)/(j.s + 1)")
    scene.edge("body", "rigid_body", "ground", "A", mass=1.0)
    expected = r"\(force of edge 'j': log\(-1\) is nan at t = 0, 'a' = -1\)"
    with pytest.raises(SingularSystemError, match=expected):
        scene.compile()


@pytest.mark.sampled(4)
@pytest.mark.parametrize("method", ["dopri5", "rodas5", "cvode", "ida", "RK45"])
@pytest.mark.parametrize("is_solved", [True, False])
def test_a_run_that_stops_names_the_operation(is_solved, method):
    """In C as in Python, whether linear equations are solved at run time or not."""
    if is_solved:
        model, limit = _solved(), 2.5 / 1.8
    else:
        model, limit = _plain(), 0.5
    with pytest.warns(RuntimeWarning, match=r"stopped at t = 0"):
        result = model.simulate((0.0, 0.1), method=method)
    said = re.search(
        r"resistance of edge 'R1': sqrt\(-\S+\) is nan at .*'C1\.v' = ([\d.]*\d)", result.message
    )
    assert result.status != 0
    assert said
    # A step of an explicit method may look far beyond.
    assert float(said[1]) == pytest.approx(limit, abs=1e-3 if method != "RK45" else 1.0)


@functools.cache
def _solved():
    return network(1.8).compile()


@functools.cache
def _plain():
    scene = cotree.Scene("plain")
    scene.edge("V1", "voltage_source", "a", "ground", voltage=5.0)
    scene.edge("R1", "resistor", "a", "b", resistance="1 + sqrt(0.5 - C1.v)")
    scene.edge("C1", "capacitor", "b", "ground", capacitance=1e-3)
    return scene.compile()


def disc(kind="contact", **edge):
    """A disc or cylinder that lies flat on the ground at the start."""
    scene = cotree.Scene("disc", gravity=[0, 0, -9.81])
    scene.edge("j", "free", "ground", "C")
    scene.edge("b", "rigid_body", "ground", "C", mass=1.0, inertia=[0.1, 0.1, 0.2])
    shape = {"normal": [0, 0, 1], "axis": [0, 0, 1], "radius": 0.1}
    scene.edge("floor", kind, "ground", "C", **shape, **edge)
    return scene


def pair(kind, **edge):
    """Two bodies at one place."""
    scene = cotree.Scene("pair")
    for end in "AB":
        scene.edge(f"j{end}", "free", "ground", end)
        scene.edge(f"b{end}", "rigid_body", "ground", end, mass=1.0, inertia=[1, 1, 1])
    scene.edge("touch", kind, "A", "B", stiffness=1e3, **edge)
    return scene


@pytest.mark.parametrize(
    ("scene", "expected"),
    [
        *(
            (
                disc(**own),
                "tilt of edge 'floor', whose axis must not be parallel to the normal; tilt",
            )
            for own in (
                {"stiffness": 1e4},
                {"stiffness": 1e4, "length": 0.1, "friction": 0.3},
                {"kind": "rigid_contact", "length": 0.1, "friction": 0.3},
            )
        ),
        (
            pair("contact", ball=0.1, radius=0.1),
            "distance of the centres of edge 'touch', which must lie apart: 1 / 0 is inf at 'jA.x'",
        ),
        (
            pair("spring", free_length=1.0),
            "length of edge 'touch', whose nodes must lie apart: 1 / 0 is inf at 'jA.x'",
        ),
    ],
)
def test_a_start_at_which_a_length_vanishes_names_the_edge(scene, expected):
    with pytest.raises(SingularSystemError, match=re.escape(f"({expected}")):
        scene.compile()
