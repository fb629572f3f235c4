"""A massless link: fine where it is bent, singular where it is stretched."""

from __future__ import annotations

import numpy as np
import pytest

import cotree


def massless_link(bend):
    """A point mass on two links, the inner of them without mass."""
    scene = cotree.Scene("massless", gravity=[0, -9.81, 0])
    scene.parameter("m", 2.0)
    scene.edge("h1", "revolute", "ground", "A", axis=[0, 0, 1], initial={"theta": 0.3})
    scene.edge("a1", "arm", "A", "B", vector=[1.0, 0, 0])
    scene.edge("h2", "revolute", "B", "C", axis=[0, 0, 1], initial={"theta": bend})
    scene.edge("a2", "arm", "C", "D", vector=[0.5, 0, 0])
    scene.edge("b", "rigid_body", "ground", "D", mass="m")
    return scene


def test_a_bent_link_moves_as_the_point_mass_it_carries():
    """Without constraint forces but those of two massless links, the mass falls freely."""
    model = massless_link(0.9).compile(["m"])
    rates = model.rhs(0.0, model.initial_state)
    q1, q2 = 0.3, 0.3 + 0.9
    a1, a2 = rates[2], rates[2] + rates[3]
    acceleration = np.array(
        [-np.sin(q1) * a1 - 0.5 * np.sin(q2) * a2, np.cos(q1) * a1 + 0.5 * np.cos(q2) * a2]
    )
    assert np.allclose(acceleration, [0.0, -9.81], rtol=0, atol=1e-13)
    # It falls freely whatever its mass.
    assert np.allclose(
        model.sensitivity_rhs(0.0, model.initial_state, np.zeros((4, 1))), 0.0, rtol=0, atol=1e-13
    )


@pytest.mark.parametrize("bend", [0.0, np.pi])
def test_a_stretched_link_is_refused_by_name(bend):
    with pytest.raises(cotree.SingularSystemError, match=r"h1\.theta"):
        massless_link(bend).compile()


@pytest.mark.sampled(1)
@pytest.mark.parametrize("method", ["dop853", "rodas5", "cvode"])
def test_a_run_into_the_stretched_position_ends_with_the_last_good_point(method):
    """The free fall stretches the links within 0.5 s; no step gets past that."""
    model = massless_link(0.9).compile()
    with pytest.warns(RuntimeWarning):
        result = model.simulate((0.0, 2.0), method=method, max_steps=20_000)
    assert not result.success
    assert 0.05 < result.t[-1] < 2.0
    assert np.all(np.isfinite(result.y))


def flat_linkage():
    """A parallelogram in one line, at rest: across it nothing moves, to first order."""
    scene = cotree.Scene("flat", gravity=[0, -9.81, 0])
    bars = {"crank": ("A", "B", 1.0), "coupler": ("B2", "C", 1.5), "rocker": ("D2", "C2", 1.0)}
    for bar, (start, end, length) in bars.items():
        scene.edge(bar, "arm", start, end, vector=[length, 0, 0])
        scene.edge(f"m_{bar}", "rigid_body", "ground", end, mass=1.0, inertia=0.1)
    scene.edge("base", "arm", "ground", "D", vector=[1.5, 0, 0])
    nodes = {"a": ("ground", "A"), "b": ("B", "B2"), "d": ("D", "D2"), "c": ("C", "C2")}
    for name, (start, end) in nodes.items():
        scene.edge(name, "revolute", start, end, axis=[0, 0, 1])
    return scene


@pytest.mark.sampled(1)
def test_a_row_of_zeros_holds_nothing():
    """As in coordinates of bodies, where the same constraint is redundant in that position."""
    found = []
    for tree, names in (
        (["crank", "coupler", "rocker", "base", "a", "b", "d"], ("a", "d")),
        (
            ["crank", "coupler", "rocker", "base", "m_crank", "m_coupler", "m_rocker"],
            ("m_crank", "m_rocker"),
        ),
    ):
        model = flat_linkage().compile(tree=tree, optimize="-O0")
        rates = model.rhs(0.0, model.initial_state)
        found.append([rates[model.states.index(f"{name}.theta_dot")] for name in names])
    assert np.all(np.isfinite(found))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-10)
