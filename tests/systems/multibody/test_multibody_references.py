"""Multibody reference problems in joint and in absolute coordinates, built from their topology.

Errors are relative to the largest value that a quantity takes at the file's times.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from reference_scenes import absolute_tree, read_reference, scene_of, tree_without

import cotree

if TYPE_CHECKING:
    from cotree import Model, Result, Scene

pytestmark = pytest.mark.compiler

TIGHT = {"method": "dop853", "rtol": 1e-13, "atol": 1e-13}

#: The issue asks for eight digits; the runs keep ten and more, but for what a problem amplifies.
DIGITS = 8

PROBLEMS = (
    "heavy_top",
    "iftomm_a01_pendulum",
    "ivp_andrews",
    "ivp_car_axis",
    "nonholonomic_skate",
    "torque_free_top",
    "slider_pendulum",
)

LONG = (("ivp_andrews", "absolute"), ("heavy_top", "absolute"))

each_coordinates = pytest.mark.parametrize("coordinates", ["joint", "absolute"])


def in_both_coordinates(*names: str) -> pytest.MarkDecorator:
    """Try each problem in both; those that take seconds in absolute ones only where asked for."""
    pairs = [(name, coordinates) for name in names for coordinates in ("joint", "absolute")]
    long = [pair for pair in pairs if pair in LONG]
    short = [pair for pair in pairs if pair not in LONG]
    marked = [pytest.param(*pair, marks=pytest.mark.slow) for pair in long]
    return pytest.mark.parametrize(("name", "coordinates"), [*short, *marked])


def described(name: str, coordinates: str) -> tuple[Scene, list[str] | None]:
    """Return a problem's scene and the tree of its coordinates."""
    if coordinates == "joint":
        return scene_of(read_reference(name), with_free_joints=True), None
    scene = scene_of(read_reference(name))
    return scene, absolute_tree(scene)


@functools.cache
def compiled(name: str, coordinates: str, sensitivities: tuple[str, ...] = ()) -> Model:
    scene, tree = described(name, coordinates)
    return scene.compile(list(sensitivities), tree)


def simulated(model: Model, rows: list[dict[str, Any]], **settings: Any) -> Result:
    """Run to the times of a reference."""
    t = [row["t"] for row in rows]
    return model.simulate((0.0, t[-1]), t_eval=t, throw=True, **settings)


def sampled(reference: dict[str, Any]) -> list[dict[str, Any]]:
    """Return rows of times that are denser than those of the file."""
    return [{"t": t} for t in np.linspace(0.0, reference["t_end"], 101)]


def values_of(rows: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Return the values of each quantity over time."""
    return {key: np.array([row["values"][key] for row in rows]) for key in rows[0]["values"]}


def error(found: np.ndarray, expected: np.ndarray) -> float:
    """Return the largest error, relative to the largest value, or absolute if all are zero."""
    return float(np.max(np.abs(found - expected)) / (np.max(np.abs(expected)) or 1.0))


def check_states(model: Model, reference: dict[str, Any], bound: float, **settings: Any) -> None:
    rows = reference["reference"]
    result = simulated(model, rows, **settings)
    for key, expected in values_of(rows).items():
        assert error(result[key], expected) < bound, key
    # The projection ends at rounding. The fastest, of 150 rad/s by 1 m and of 1500 by 0.04, have
    # rates of 150 m/s in sums of a few terms: some times 3e-14.
    assert result.drift is None or result.drift.worst < 2e-13


def check_sensitivities(
    model: Model, reference: dict[str, Any], digits: int, **settings: Any
) -> None:
    data = reference["sensitivities"]
    trusted = data.get("digits_by_parameter", {})
    result = simulated(model, next(iter(data["values"].values())), **settings)
    for parameter, rows in data["values"].items():
        bound = 10.0 ** -min(digits, trusted.get(parameter, data["digits_trusted"]))
        for key, expected in values_of(rows).items():
            assert error(result.sensitivity(key, parameter), expected) < bound, (key, parameter)


def parameters_of(name: str) -> tuple[str, ...]:
    return tuple(read_reference(name)["sensitivities"]["values"])


@pytest.mark.sampled(1)
@each_coordinates
@pytest.mark.parametrize("name", PROBLEMS)
def test_every_reference_value_to_eight_digits(name, coordinates):
    """A one-step method of order 8; the worst, a top of 150 rad/s, is at 4e-11."""
    reference = read_reference(name)
    bound = 10.0 ** -min(DIGITS, reference["digits_trusted"])
    check_states(compiled(name, coordinates), reference, bound, **TIGHT)


@pytest.mark.sampled(2)
@in_both_coordinates(*PROBLEMS)
def test_multistep_methods(name, coordinates):
    """Local errors of 1e-10 add up over 1e3 to 2e4 steps, and problems amplify them tenfold."""
    method = {"joint": "cvode", "absolute": "ida"}[coordinates]
    model, reference = compiled(name, coordinates), read_reference(name)
    check_states(model, reference, 1e-5, method=method, rtol=1e-10, atol=1e-10)


@pytest.mark.sampled(1)
@each_coordinates
@pytest.mark.parametrize("name", ["nonholonomic_skate", "slider_pendulum"])
def test_sensitivities_to_eight_digits(name, coordinates):
    """Measured at 5e-12: the rod's radius hardly matters, so its sensitivities are small."""
    model = compiled(name, coordinates, parameters_of(name))
    check_sensitivities(model, read_reference(name), DIGITS, **TIGHT)


@pytest.mark.slow
@each_coordinates
def test_sensitivities_of_andrews_mechanism(coordinates):
    """Measured at 5e-12, beyond the 7 to 10 digits that the file is trusted to."""
    name = "ivp_andrews"
    model = compiled(name, coordinates, parameters_of(name))
    check_sensitivities(model, read_reference(name), DIGITS, **TIGHT)


@pytest.mark.slow
@each_coordinates
@pytest.mark.parametrize("method", ["cvode", "ida"])
@pytest.mark.parametrize("name", ["nonholonomic_skate", "slider_pendulum", "ivp_andrews"])
def test_sensitivities_by_multistep_methods(name, coordinates, method):
    """As states are reached to 1e-5, so are sensitivities: all take part in the error test."""
    model = compiled(name, coordinates, parameters_of(name))
    settings = {"method": method, "rtol": 1e-10, "atol": 1e-10}
    check_sensitivities(model, read_reference(name), 5, **settings)


@pytest.mark.slow
def test_both_trees_of_the_shipped_slider_pendulum_give_the_same_sensitivities():
    parameters = list(cotree.load("slider-pendulum").parameters)
    results = []
    for with_bodies in (False, True):
        scene = cotree.load("slider-pendulum")
        for key, value in {"s": "A.x", "v": "A.vx", "theta": "h2.theta"}.items():
            scene.output(key, value)
        model = scene.compile(parameters, absolute_tree(scene) if with_bodies else None)
        t = np.linspace(0.0, 10.0, 11)
        results.append(model.simulate((0.0, 10.0), t_eval=t, throw=True, **TIGHT))
    joint, absolute = results
    assert len(absolute.states) > len(joint.states) == 4
    for parameter in parameters:
        for key in joint.outputs:
            one, other = (result.sensitivity(key, parameter) for result in results)
            # Each is measured to be within 5e-12 of the reference, relative to the largest.
            assert error(other, one) < 1e-10, (key, parameter)


@pytest.mark.parametrize("method", ["dop853", "ida"])
def test_the_oscillator_with_its_body_in_the_tree(method):
    """The mass is the branch, so its guide is a chord that carries the initial values."""
    reference = read_reference("spring_mass_damper")
    scene = cotree.load("spring-mass-damper")
    scene.output("v", "s.s_dot")
    model = scene.compile(list(scene.parameters), ["m"])
    # Measured: 1e-12 by the method of order 8 and 3e-10 by the multistep method.
    settings = {"method": method, "rtol": 1e-12, "atol": 1e-14}
    check_states(model, reference, 1e-8, **settings)
    check_sensitivities(model, reference, 8, **settings)


@pytest.mark.slow
@pytest.mark.parametrize(
    "cuts",
    [
        ("E1", "E2", "E3"),
        pytest.param(("O", "G", "H"), marks=pytest.mark.slow),
        pytest.param(("F", "A1", "E3"), marks=pytest.mark.slow),
    ],
)
def test_any_pins_of_andrews_mechanism_may_be_cut(cuts):
    """Left to itself the tree leaves out B, A1 and A2."""
    name = "ivp_andrews"
    rows = read_reference(name)["reference"]
    expected = simulated(compiled(name, "joint"), rows, **TIGHT)
    scene = scene_of(read_reference(name))
    model = scene.compile(tree=tree_without(scene, cuts))
    chords = {row.partition(".")[0] for row in model.kernels.constraints}
    assert chords == set(cuts)
    result = simulated(model, rows, **TIGHT)
    for key in values_of(rows):
        # Errors of 1e-13 a step are amplified by 1e5 at most, the problem's condition, and only
        # the first of them by so much: nine digits are kept.
        assert error(result[key], expected[key]) < 1e-9, key


@pytest.mark.sampled(2)
@in_both_coordinates(
    "heavy_top", "iftomm_a01_pendulum", "ivp_andrews", "nonholonomic_skate", "torque_free_top"
)
def test_energy_is_kept(name, coordinates):
    """The published task of A01 asks for 5e-5 J in 10 s."""
    reference = read_reference(name)
    result = simulated(compiled(name, coordinates), sampled(reference), **TIGHT)
    energy = result["energy"]
    if name == "ivp_andrews":  # a motor of constant torque feeds it
        energy = energy - reference["parameters"]["mom"] * result["beta"]
    # A step's error of 1e-13 adds up over at most 2000 steps. Potentials may count from any
    # height, so what is left is measured against at least 1 J.
    assert np.ptp(energy) < 1e-9 * max(1.0, np.max(np.abs(energy)))


@each_coordinates
def test_the_torque_free_top_keeps_its_angular_momentum_in_space(coordinates):
    reference = read_reference("torque_free_top")
    scene = scene_of(reference, with_free_joints=coordinates == "joint")
    places = [f"r{i}{k}" for i in "123" for k in "123"]
    for place in places:
        scene.output(place, f"body.{place}")
    tree = absolute_tree(scene) if coordinates == "absolute" else None
    result = simulated(scene.compile(tree=tree), sampled(reference), **TIGHT)
    axes = np.array([result[place] for place in places]).reshape(3, 3, -1)
    inertia = np.array([reference["parameters"][f"I{k}"] for k in "123"])
    omega = np.array([result[f"w{k}"] for k in "123"])
    momentum = np.einsum("ikt,kt->it", axes, inertia[:, None] * omega)
    # Its axes are those of the ground at the start. The flips, at 2 and at 5 s, amplify errors.
    start = inertia * omega[:, 0]
    assert np.max(np.abs(momentum - start[:, None])) < 1e-10 * np.max(start)


@each_coordinates
def test_the_four_bar_up_to_its_first_singular_position(coordinates):
    name = "iftomm_a02_fourbar_N2"
    rows = read_reference(name)["reference"][:1]
    result = simulated(compiled(name, coordinates), rows, **TIGHT)
    for key, expected in values_of(rows).items():
        assert error(result[key], expected) < 1e-8, key


# Where the links lie in one line, twice a turn, the constraints are dependent and the mechanism
# may go on in more directions than one.
@pytest.mark.sampled(1)
@each_coordinates
def test_the_four_bar_through_singular_positions(coordinates):
    """The published task asks for an error of energy below 0.1 J over 10 s."""
    name = "iftomm_a02_fourbar_N2"
    reference = read_reference(name)
    # Some 300 steps lead through; a run that is caught in a position takes them without end. In
    # coordinates of bodies rounding, which the positions enlarge, decides below 1e-9 whether it is.
    rtol = 1e-9 if coordinates == "absolute" else 1e-12
    result = simulated(
        compiled(name, coordinates),
        reference["reference"],
        rtol=rtol,
        atol=rtol,
        method="dop853",
        max_steps=6_000,
    )
    # As for the regular problems; there are 44 J at the start.
    assert np.ptp(result["energy"]) < 1e-9 * np.max(np.abs(result["energy"]))
    for key, expected in values_of(reference["reference"]).items():
        # Some 300 steps, of which each has an error of rtol.
        assert error(result[key], expected) < max(1e-8, 30 * rtol), key
