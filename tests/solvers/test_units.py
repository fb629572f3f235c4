"""Units of length, mass and time decide nothing about constraints."""

from __future__ import annotations

import numpy as np
import pytest

import cotree
from cotree.model.bound import BoundModel

UNITS = {"metre": 1.0, "kilogram": 1.0, "second": 1.0}
BARS = {"crank": 1.0, "coupler": 2.0, "rocker": 2.0}


def linkage(shape: str = "four-bar", metre: float = 1.0) -> cotree.Scene:
    """Draw a linkage whose units are parameters: a four-bar, or a parallelogram in one line."""
    scene = cotree.Scene(shape, gravity=[0, "-9.81*metre/second**2", 0])
    for name, value in {**UNITS, "metre": metre}.items():
        scene.parameter(name, value)
    is_flat = shape == "flat"
    lengths = {"crank": 1.0, "coupler": 1.5, "rocker": 1.0} if is_flat else BARS
    nodes = {"crank": ("A", "B"), "coupler": ("B2", "C"), "rocker": ("D2", "C2")}
    for bar, (start, end) in nodes.items():
        scene.edge(bar, "arm", start, end, vector=[f"{lengths[bar]}*metre", 0, 0])
        inertia = {"mass": "kilogram", "inertia": "0.1*kilogram*metre**2"}
        scene.edge(f"m_{bar}", "rigid_body", "ground", end, **inertia)
    scene.edge("base", "arm", "ground", "D", vector=["1.5*metre", 0, 0])
    given = {"theta": 0.0} if is_flat else {"theta": 1.5, "theta_dot": "6.0/second"}
    z = [0, 0, 1]
    scene.edge("a", "revolute", "ground", "A", axis=z, initial=given)
    scene.edge("b", "revolute", "B", "B2", axis=z)
    scene.edge("c", "revolute", "C", "C2", axis=z)
    scene.edge("d", "revolute", "D", "D2", axis=z)
    return scene


BODIES = ["base", *BARS, *(f"m_{bar}" for bar in BARS)]


def _values(model, p):
    projection = BoundModel(model.kernels, 0.0, p)
    start = model.start(p=p)
    return projection, np.concatenate([start.y, start.s.T.ravel()])


@pytest.mark.sampled(1)
@pytest.mark.parametrize(
    ("shape", "n", "tree"),
    [("four-bar", 0, None), ("four-bar", 0, BODIES), ("flat", 1, BODIES)],
    ids=["joints", "bodies", "flat"],
)
def test_rank_is_free_of_units(shape, n, tree):
    model = linkage(shape).compile(tree=tree, optimize="-O0")
    found = []
    for unit in (1e-3, 1.0, 1e3):
        for name in UNITS:
            projection, z = _values(model, model.kernels.parameter_array({name: unit}))
            found.append((projection.singular(0.0, z), projection.redundant(0.0, z)))
    assert set(found) == {found[0]}
    # In one line a parallelogram can go on in two ways: one constraint less holds it.
    assert (bool(found[0][0]), found[0][1]) == (bool(n), n)


@pytest.mark.sampled(1)
@pytest.mark.parametrize("metre", [0.1, 1e-3])
def test_a_small_linkage_takes_the_method_of_a_large_one(metre):
    model = linkage().compile(tree=BODIES, optimize="-O0")
    result = model.simulate((0, 0.02), [0.02], "rodas5", parameters={"metre": metre})
    assert result.success
    assert "rodas5" in result.message
    assert "dependent" not in result.message


@pytest.mark.parametrize(
    "tree", [None, pytest.param(BODIES, marks=pytest.mark.slow)], ids=["joints", "bodies"]
)
def test_steps_are_those_of_a_linkage_of_any_size(tree):
    model = linkage().compile(tree=tree, optimize="-O0")
    state = "m_crank.theta" if tree else "a.theta"
    for method in ("dop853", "dopri5", "rodas5"):
        found = [
            model.simulate((0, 1), [1.0], method, 1e-7, 1e-30, parameters={"metre": metre})
            for metre in (1e-3, 1.0, 1e3)
        ]
        assert len({result.statistics.n_steps for result in found}) == 1
        # Some hundred steps, each with roundings of a few units in the last place.
        assert np.ptp([result[state][-1] for result in found]) < 1e-12


def test_a_small_linkage_is_written_for_rodas5(tmp_path):
    model = linkage(metre=1e-3).compile(tree=BODIES, optimize="-O0")
    model.write(tmp_path, "rodas5")
