"""Kernels that eliminate algebraic unknowns, against numeric elimination of the same equations."""

from __future__ import annotations

import functools
import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "c"))
from circuits import circuit
from hand_made import Made
from test_embedded_algebraic import bridge

from cotree import Scene, load
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import ARGUMENT_OF, symbols_in
from cotree.model.bound import BoundModel
from cotree.model.unknowns import of_model

# Some hundred operations: 1e-12 leaves a factor of ten. Where equations are solved, each route may
# lose what the condition of their matrix says.
RTOL = 1e-12

MODELS = {
    "amplifier": lambda: circuit("ivp_transistor_amplifier").compile(["R1", "UF"]),
    "rectifier": lambda: circuit("spice_rectifier").compile(["Is"]),
    "bridge": lambda: load("bridge-rectifier").compile(["C", "Is"]),
    "by hand": lambda: bridge().model(["R", "Is"]),
}


@functools.cache
def model_of(name):
    return MODELS[name]()


def evaluated(model, name, t, x, s=(), p=None):
    """Evaluate a kernel from its program, at complex numbers if need be."""
    roots = model.kernels.program.kernels[name].results
    p = model.default_parameters if p is None else p
    arrays = {"t": [t], "x": x, "s": np.ravel(s), "p": p}
    inputs = model.kernels.program.kernels["inputs"].results
    arrays["u"] = evaluate(
        inputs,
        {n: arrays[ARGUMENT_OF[n.data[0]]][n.data[1]] for n in symbols_in(inputs)},
        "complex_",
    )
    values = {node: arrays[ARGUMENT_OF[node.data[0]]][node.data[1]] for node in symbols_in(roots)}
    return np.array(evaluate(roots, values, "complex_"))


def points(model, n_points=6):
    """Return points near solutions, where junctions are within what exponentials can show."""
    rng = np.random.default_rng(3)
    n, m = len(model.states), len(model.sensitivities)
    start = model.start().y
    for _ in range(n_points):
        x = start + 0.05 * rng.uniform(-1.0, 1.0, n)
        yield rng.uniform(0.0, 0.01), x, rng.uniform(-1.0, 1.0, (m, n))


def matrix(model, t, x):
    return model.kernels.bound_jacobian(model.default_parameters)(t, x, None)


def close(found, expected, solved=None):
    rtol = RTOL
    if solved is not None:
        rows = solved / np.max(np.abs(solved), axis=1, keepdims=True)
        rtol += 1e-15 * np.linalg.cond(rows)
    scale = np.max(np.abs(expected), initial=0.0)
    np.testing.assert_allclose(found, expected, rtol=rtol, atol=rtol * scale)


@pytest.mark.parametrize("name", MODELS)
def test_unknowns_move_so_that_residuals_stay(name):
    model = model_of(name)
    cut = len(model.states) - model.kernels.layout.n_algebraic
    for t, x, s in points(model):
        rates = evaluated(model, "rhs", t, x).real
        slopes = matrix(model, t, x)
        of_time = evaluated(model, "rhs", t + 1e-30j, x).imag[cut:] / 1e-30
        known = slopes[cut:, :cut] @ rates[:cut] + of_time
        found = evaluated(model, "extended_augmented_rhs", t, x, s[:, :cut]).real
        close(found[:cut], rates[:cut])
        square = slopes[cut:, cut:]
        close(found[cut : len(x)], np.linalg.solve(square, -known), square)


@pytest.mark.parametrize("name", MODELS)
def test_sensitivities_of_unknowns_are_eliminated(name):
    model = model_of(name)
    n = len(model.states)
    cut = n - model.kernels.layout.n_algebraic
    for t, x, s in points(model):
        slopes = matrix(model, t, x)
        s[:, cut:] = 0.0
        along = evaluated(model, "augmented_rhs", t, x, s).real[n:].reshape(s.shape)
        s[:, cut:] = -np.linalg.solve(slopes[cut:, cut:], along[:, cut:].T).T
        along = evaluated(model, "augmented_rhs", t, x, s).real[n:].reshape(s.shape)
        unknowns = evaluated(model, "algebraic_sensitivity", t, x, s[:, :cut]).real
        close(unknowns, s[:, cut:].ravel(), slopes[cut:, cut:])
        rates = evaluated(model, "extended_augmented_rhs", t, x, s[:, :cut]).real[n:]
        close(rates, along[:, :cut].ravel(), slopes[cut:, cut:])


@pytest.mark.parametrize("name", MODELS)
def test_a_step_is_newtons_and_one_order_better(name):
    model, p = model_of(name), model_of(name).default_parameters
    n, m = len(model.states), model.kernels.layout.n_algebraic
    cut = n - m
    t, x, _ = next(points(model))
    of_model(BoundModel(model.kernels, t, p)).solve(t, x)
    exact = evaluated(model, "rhs", t, x).real[:cut]
    direction = np.cos(np.arange(m))
    left, rates = [], []
    for size in (4e-4, 2e-4):  # a hundredth of what exponentials bend over
        guess = x.copy()
        guess[cut:] += size * direction
        found = evaluated(model, "algebraic_step", t, guess).real
        step, last = found[cut:n], found[n : n + m]
        square = matrix(model, t, guess)[cut:, cut:]
        newton = -np.linalg.solve(square, evaluated(model, "rhs", t, guess).real[cut:])
        close(step - last, newton, square)
        left.append(np.max(np.abs(guess[cut:] + step - x[cut:])))
        rates.append(np.max(np.abs(found[:cut] - exact) / (1.0 + np.abs(exact))))
    # Half the distance, an eighth of the error, or rounding.
    assert left[1] < left[0] / 6.0 or left[0] < 1e-14
    assert rates[1] < rates[0] / 6.0 or rates[0] < 1e-12


def test_operations():
    """Rates of states and unknowns cost about as much as rates and Jacobian at one point.

    Solving for the unknowns at each point took these three times or more, and loops of their own.
    """
    operations = circuit("ivp_transistor_amplifier").compile().operations
    former = operations["rhs"].kernel + operations["jacobian"].kernel
    assert operations["extended_rhs"].kernel <= 1.1 * former
    assert operations["algebraic_step"].kernel <= 2 * former


@pytest.mark.parametrize("method", ["dopri5", "dop853"])
def test_pivots_that_lose_all_digits_are_left_to_loops(method):
    """0 = z + y - x and 0 = z + (1 + e) y - x - e: y is 1, and z = x - 1, but for rounding."""
    e = 1e-10
    made = Made(
        "close",
        {"x": 2.0},
        {"z": 0.0, "y": 0.0},
        {},
        lambda v: [
            v["z"] * -1.0,
            v["z"] + v["y"] - v["x"],
            v["z"] + (1.0 + e) * v["y"] - v["x"] - e,
        ],
    )
    result = made.model().simulate((0.0, 1.0), [1.0], method, 1e-8, 1e-10, throw=True)
    assert result.statistics.method == method
    # x' = 1 - x. Rounding of 1e-16, divided by e.
    assert result["x"][0] == pytest.approx(1.0 + np.exp(-1.0), abs=1e-5)
    assert result["y"][0] == pytest.approx(1.0, abs=1e-5)


def test_unknowns_that_rounding_decides_do_not_shorten_steps():
    """Three diodes that block share a voltage by 1e12 ohm: what flows through 10 ohm hides it."""
    scene = Scene("blocked")
    scene.edge("V", "sine_voltage", "s", "ground", amplitude=20.0, frequency=50.0)
    scene.edge("R", "resistor", "s", "n0", resistance=10.0)
    for i in range(3):
        scene.edge(f"D{i}", "diode", f"n{i}", f"n{i + 1}", saturation_current=1e-13)
        scene.edge(f"L{i}", "resistor", f"n{i}", f"n{i + 1}", resistance=1e12)
    scene.edge("C", "capacitor", "n3", "ground", capacitance=1e-5)
    scene.edge("RL", "resistor", "n3", "ground", resistance=1e3)
    model = scene.compile()
    result = model.simulate((0.0, 0.1), [0.1], "dop853", 1e-8, 1e-10, throw=True)
    assert result.statistics.method == "dop853"
    # Measured: 420; 76000 where voltages of diodes that block are held to the tolerance.
    assert result.statistics.n_steps < 1000
    other = model.simulate((0.0, 0.1), [0.1], "dopri5", 1e-9, 1e-11, throw=True)
    # Some hundred steps with errors of 1e-8 of 20 V.
    assert result["C.v"][0] == pytest.approx(other["C.v"][0], abs=2e-6)


def test_few_steps_and_evaluations():
    """Every evaluation is one kernel; one projection a step and its rate come to twelve stages."""
    model = circuit("ivp_transistor_amplifier").compile()
    result = model.simulate((0.0, 0.2), [0.2], "dop853", 1e-6, 1e-8, throw=True)
    exact = model.simulate((0.0, 0.2), [0.2], "dop853", 1e-11, 1e-13, throw=True)
    assert result.statistics.nfev <= 15 * result.statistics.n_steps
    assert result.statistics.nfev < 16_500  # whatever steps the control of their size prefers
    # Measured: 1e-9. A step's error is 1e-6 at most, and there is much damping.
    np.testing.assert_allclose(result.y, exact.y, atol=1e-7)
