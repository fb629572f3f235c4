"""Initial values of chords, and of bodies that joints carry, are conditions of the start."""

from __future__ import annotations

import numpy as np
import pytest
from bare_models import evaluated

import cotree
from cotree import Scene

Z = [0, 0, 1]
BARS = {"crank": ("A", "B", 1.0), "coupler": ("B2", "C", "L"), "rocker": ("D2", "C2", 2.0)}
TREES = {
    "joints": ["base", *BARS, "a", "b", "d"],
    "bodies": ["base", *BARS, *(f"m_{bar}" for bar in BARS)],
}


def linkage(**given: dict[str, float | str]) -> Scene:
    """Draw README's four-bar, with initial values of any edge."""
    scene = Scene("four-bar", gravity=[0, -9.81, 0])
    scene.parameter("L", 2.0, unit="m")
    scene.parameter("q", 0.9)
    for bar, (start, end, length) in BARS.items():
        scene.edge(bar, "arm", start, end, vector=[length, 0, 0])
        own = given.get(f"m_{bar}")
        scene.edge(f"m_{bar}", "rigid_body", "ground", end, mass=1.0, inertia=0.1, initial=own)
    scene.edge("base", "arm", "ground", "D", vector=[1.5, 0, 0])
    nodes = {"a": ("ground", "A"), "b": ("B", "B2"), "c": ("C", "C2"), "d": ("D", "D2")}
    for name, (start, end) in nodes.items():
        scene.edge(name, "revolute", start, end, axis=Z, initial=given.get(name))
    for node in ("B", "C"):
        for name in ("x", "y", "vx", "vy"):
            scene.output(f"{node}_{name}", f"{node}.{name}")
    return scene


def start_of(scene: Scene, tree: str, wanted=("L", "q")):
    model = evaluated(scene, TREES[tree], wanted)
    return model, model.start()


@pytest.mark.sampled(7)
@pytest.mark.parametrize(
    "given",
    [
        {"m_coupler": {"x": "q", "x_dot": 0.4}},
        {"m_coupler": {"theta": "q", "theta_dot": 0.4}},
        {"m_crank": {"y": "q"}, "m_rocker": {"theta_dot": 2.0}},
        {"c": {"theta": "q", "theta_dot": -1.0}},
    ],
    ids=str,
)
@pytest.mark.parametrize("tree", TREES)
def test_what_is_given_holds_with_its_sensitivities(given, tree):
    model, start = start_of(linkage(**given), tree)
    h = 1e-6
    for j, parameter in enumerate(("L", "q")):
        value = model.kernels.parameter_array()[model.parameters.index(parameter)]
        ends = [model.start(p={parameter: value + k * h}).y for k in (1, -1)]
        # Rounding over h, enlarged by the levers; third derivatives times its square.
        expected = (ends[0] - ends[1]) / (2 * h)
        np.testing.assert_allclose(start.s[:, j], expected, rtol=1e-6, atol=1e-7)


def test_bodies_start_as_given_whatever_the_tree():
    """A linkage with x = 0.9 at 0.4 m/s has few configurations; each tree starts in one."""
    found = []
    for tree in TREES:
        model, start = start_of(linkage(m_coupler={"x": 0.9, "x_dot": 0.4}), tree, ())
        found.append(model.output_values(0.0, start.y))
        place = dict(zip(model.outputs, found[-1], strict=True))
        assert place["C_x"] == pytest.approx(0.9, abs=1e-12)
        assert place["C_vx"] == pytest.approx(0.4, abs=1e-12)
        assert np.hypot(place["B_x"], place["B_y"]) == pytest.approx(1.0, abs=1e-12)
        assert np.hypot(place["C_x"] - 1.5, place["C_y"]) == pytest.approx(2.0, abs=1e-12)


def test_rates_of_a_body_in_space():
    scene = Scene("rotor", gravity=[0, 0, -9.81])
    scene.edge("u", "spherical", "ground", "A")
    scene.edge("r", "arm", "A", "B", vector=[0.5, 0, 0])
    turning = {"w1": 1.0, "w2": 2.0, "w3": 3.0}
    scene.edge("m", "rigid_body", "ground", "B", mass=1, inertia=[1, 2, 3], initial=turning)
    model = evaluated(scene, ["u", "r"])
    np.testing.assert_allclose(model.start().y, [1, 0, 0, 0, 1, 2, 3], atol=1e-13)


def test_what_almost_closes_is_refused_by_name():
    """All angles zero close this linkage but for a millimetre, which only a quarter turn takes."""
    scene = Scene("almost")
    for bar, (start, end, length) in {**BARS, "coupler": ("B2", "C", 2.501)}.items():
        scene.edge(bar, "arm", start, end, vector=[length, 0, 0])
        scene.edge(f"m_{bar}", "rigid_body", "ground", end, mass=1.0, inertia=0.1)
    scene.edge("base", "arm", "ground", "D", vector=[1.5, 0, 0])
    for name, start, end in (("a", "ground", "A"), ("b", "B", "B2"), ("d", "D", "D2")):
        scene.edge(name, "revolute", start, end, axis=Z, initial={"theta": 0.0})
    scene.edge("c", "revolute", "C", "C2", axis=Z)
    with pytest.raises(cotree.ParameterError, match=r"violate the constraints"):
        evaluated(scene, TREES["joints"]).start()


def beam(nothing: object) -> Scene:
    scene = Scene("beam", gravity=[0, -9.81, nothing])
    scene.parameter("L", 2.0)
    scene.edge("h", "revolute", "ground", "A", axis=[nothing, 0, 1])
    scene.edge("r", "arm", "A", "B", vector=["L", 0, nothing])
    scene.edge("m", "rigid_body", "ground", "B", mass=1.0, inertia=0.1)
    return scene


@pytest.mark.parametrize("nothing", ["0*L", "L - L", "-0"])
def test_what_folds_to_zero_keeps_a_plane(nothing):
    model = evaluated(beam(nothing), ["r", "m"])
    assert model.states == evaluated(beam(0), ["r", "m"]).states


def test_parameters_are_an_array_or_a_mapping():
    model = cotree.load("slider-pendulum").compile(["L"])
    array = model.kernels.parameter_array({"L": 1.3})
    start = model.start(p=array)
    for other in (array, {"L": 1.3}, array.tolist()):
        assert np.array_equal(model.start(p=other).s, start.s)
        assert np.array_equal(model.rhs(0.0, start.y, other), model.rhs(0.0, start.y, array))
        assert np.array_equal(model.linearize(p=other).A, model.linearize(p=array).A)
        ends = [
            model.simulate((0, 0.5), [0.5], parameters=parameters).y
            for parameters in (array, other)
        ]
        assert np.array_equal(*ends)
    with pytest.raises(cotree.ParameterError, match="no tunable parameter 'l'"):
        model.rhs(0.0, start.y, {"l": 1.3})
    with pytest.raises(cotree.ParameterError, match="shape"):
        model.simulate((0, 0.5), parameters=[1.0])


@pytest.mark.sampled(1)
@pytest.mark.parametrize("level", ["whole", "positions"])
@pytest.mark.parametrize("tree", TREES)
def test_a_run_goes_on_from_any_state(tree, level):
    """The initial value of a joint that is no state gives way to a run's own start."""
    model = linkage(a={"theta": 1.5, "theta_dot": 6.0}).compile(tree=TREES[tree])
    settings = {"rtol": 1e-8, "atol": 1e-10, "method": "dop853"}
    first = model.simulate((0.0, 0.1), **settings)
    given = dict(zip(model.states, first.y[:, -1], strict=True))
    if level == "positions":  # speeds then begin as the scene says: a turns at 6 rad/s
        given = {name: value for name, value in given.items() if not name.endswith("_dot")}
        start = model.start(initial=given)
        assert start.y[: len(given)] == pytest.approx(first.y[: len(given), -1], abs=1e-9)
        joint = "a.theta_dot" if tree == "joints" else "m_crank.theta_dot"
        assert start.y[model.states.index(joint)] == pytest.approx(6.0, abs=1e-9)
        return
    rest = model.simulate((0.1, 0.2), initial=given, **settings)
    whole = model.simulate((0.0, 0.2), **settings)
    # A hundred tolerances of a step, for the sum of some tens of them.
    assert rest.y[:, -1] == pytest.approx(whole.y[:, -1], rel=1e-6, abs=1e-6)
