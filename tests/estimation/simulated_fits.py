"""Fits of simulated noisy experiments, and the coverage of their confidence intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from network_scenes import rc_ladder

import cotree

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True)
class Case:
    """A fit of simulated noisy experiments.

    Attributes
    ----------
    scene : callable
        Returns the scene.
    truth : dict of str to float
        True values of the estimated parameters.
    noise : dict of str to float
        Standard deviation of the noise of each measured output.
    t : ndarray, shape (n,)
        Times of measurements, [s].
    inputs : tuple of dict
        Inputs of each experiment.
    is_noise_given : bool
        Whether the noise is given to the fit; otherwise it is estimated.
    """

    scene: Callable[[], cotree.Scene]
    truth: dict[str, float]
    noise: dict[str, float]
    t: np.ndarray
    inputs: tuple[dict[str, Any], ...] = ({},)
    is_noise_given: bool = True


def motor_drive() -> cotree.Scene:
    """Return the motor drive of the gallery example on fitting."""
    scene = cotree.Scene("motor-drive")
    scene.parameter("K", 0.06, unit="N m/A")
    scene.parameter("J", 3e-4, unit="kg m^2")
    scene.parameter("d", 2e-4, unit="N m s/rad")
    scene.input("voltage", 12.0, unit="V")
    scene.edge("V", "voltage_source", "p", "ground", voltage="voltage")
    ports = {"electrical": ["p", "ground"], "shaft": ["ground", "shaft"]}
    scene.edge("M", "dc_motor", **ports, resistance=0.5, inductance=1.5e-3, constant="K")
    scene.edge("rotor", "rotational_inertia", "ground", "shaft", inertia="J")
    scene.edge("bearing", "rotational_damper", "ground", "shaft", damping="d")
    return scene


def ladder() -> cotree.Scene:
    """Return a ladder of ten stages; R and C are identifiable thanks to the input current."""
    scene = rc_ladder(10)
    scene.output("drawn", "R1.i")
    return scene


CASES = {
    "slider-pendulum": Case(
        lambda: cotree.load("slider-pendulum"),
        {"k": 50.0, "L": 1.0, "zeta": 10.0},
        {"j1.s": 0.005},
        np.linspace(0.0, 5.0, 61)[1:],
    ),
    "motor drive": Case(
        motor_drive,
        {"K": 0.06, "J": 3e-4, "d": 2e-4},
        {"rotor.w": 2.0, "M.i": 0.3},
        np.linspace(0.0, 0.5, 51),
        ({"voltage": 12.0}, {"voltage": "6 + 4*sin(20*t)"}),
        is_noise_given=False,
    ),
    "motor-linkage (four-bar)": Case(
        lambda: cotree.load("motor-linkage"),
        {"L": 0.35, "K": 0.05, "R": 0.8},
        {"rocker_angle": 0.005, "current": 0.05},
        np.linspace(0.0, 1.0, 51)[1:],
    ),
    "RC ladder of 10": Case(
        ladder,
        {"R": 1.0, "C": 1.0},
        {"last": 0.01, "drawn": 0.01},
        np.linspace(0.0, 200.0, 51)[1:],
        is_noise_given=False,
    ),
    "battery-cell": Case(
        lambda: cotree.load("battery-cell"),
        {"R0": 0.02, "R1": 0.015, "C1": 2000.0, "R2": 0.03, "C2": 30000.0},
        {"voltage": 1e-3},
        np.linspace(0.0, 3600.0, 361)[1:],
    ),
    "bouncing-ball": Case(
        lambda: cotree.load("bouncing-ball"),
        {"e": 0.8, "h": 2.0},
        {"height": 0.01},
        np.linspace(0.0, 3.0, 61)[1:],
    ),
}


def covered(name: str, seeds: range) -> dict[str, int]:
    """Count for each parameter the 95 % intervals that contain the true value."""
    case = CASES[name]
    scene = case.scene()
    times = np.concatenate([[0.0], case.t[case.t > 0.0]])
    model = scene.compile()
    exact = [
        model.simulate((0.0, times[-1]), times, inputs=inputs, rtol=1e-8, atol=1e-10)
        for inputs in case.inputs
    ]
    ranges = {key: (value / 10, value * 10, "log") for key, value in case.truth.items()}
    found = dict.fromkeys(case.truth, 0)
    for seed in seeds:
        experiments = simulated(case, exact, seed)
        result = cotree.fit(scene, experiments, ranges, starts=1, start=case.truth, progress=False)
        for key, (low, high) in result.intervals().items():
            if key in found:  # skips estimated noise parameters
                found[key] += low <= case.truth[key] <= high
    return found


def simulated(case: Case, exact: list[cotree.Result], seed: int) -> list[cotree.Experiment]:
    """Build experiments by adding noise to exact runs."""
    rng, n = np.random.default_rng(seed), case.t.size
    noise = case.noise if case.is_noise_given else None
    experiments = []
    for inputs, run in zip(case.inputs, exact, strict=True):
        data = {
            out: run[out][-n:] + size * rng.standard_normal(n) for out, size in case.noise.items()
        }
        experiments.append(cotree.Experiment({"t": case.t, **data}, inputs=inputs, noise=noise))
    return experiments
