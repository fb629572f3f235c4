"""Hard cases: scenes, what to compare them with, and what a run of one reaches.

In: a case and a tolerance. Out: an :class:`Outcome`: digits, what should stay constant, and cost
in steps and evaluations.
"""

from __future__ import annotations

import functools
import math
import re
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import hard_scenes as hs
import numpy as np
from circuits import battery, circuit, output_of
from domain_scenes import scene_of_domain
from reference_scenes import read_reference, scene_of

from cotree.errors import SolveError
from cotree.studies.accuracy import find_reference, starts_implicit

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from cotree import Model, Result, Scene

Array = hs.Array
Values = hs.Values

TOLERANCES = (1e-4, 1e-7, 1e-10)


@dataclass(frozen=True)
class Case:
    """One hard case.

    Attributes
    ----------
    make : callable
        Makes its scene.
    times : ndarray
        Where it is compared; the last is the end of the run.
    hard : str
        What is hard about it, and what became of that.
    against : str
        What it is compared with.
    expected : callable or None
        Gives values by output or state at ``times``; None compares two methods.
    method : str
        What runs it.
    atol : float
        Absolute tolerance as a share of the relative one.
    is_each : bool
        Whether errors are relative to each value; else to the largest of a quantity.
    digits : float
        The most that can be told.
    drift : callable or None
        Gives what should stay zero, of a result, with its name before.
    settings : mapping
        Further arguments of ``simulate``.
    tolerances : tuple of float
        Those that it runs at.
    """

    make: Callable[[], Scene]
    times: Array
    hard: str
    against: str
    expected: Callable[[], Values] | None = None
    method: str = "auto"
    atol: float = 1e-2
    is_each: bool = False
    digits: float = 15.0
    drift: tuple[str, Callable[[Result], float]] | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    tolerances: tuple[float, ...] = TOLERANCES


@dataclass(frozen=True)
class Outcome:
    """Result of one run: its error and its cost.

    Attributes
    ----------
    method : str
        The method, as it was chosen.
    digits : float
        Digits of the worst value; nan where the run failed.
    drift : float
        What became of an invariant; nan where there is none.
    steps, evaluations : int
        Cost.
    stopped : str
        Where the run failed, else "".
    """

    method: str
    digits: float
    drift: float
    steps: int
    evaluations: int
    stopped: str = ""


@functools.cache
def model_of(name: str) -> Model:
    """Compile a case once."""
    return CASES[name].make().compile()


@functools.cache
def expected_of(name: str) -> tuple[Values, float]:
    """Return the reference of a case, and its number of correct digits."""
    case = CASES[name]
    if case.expected is not None:
        return case.expected(), case.digits
    model = model_of(name)
    is_stiff = starts_implicit(run(case, model, "auto", 1e-3).statistics.method)

    def tight(method: str, rtol: float) -> Result:
        if method == "Radau" and not is_stiff:
            raise SolveError("tens of thousands of steps in Python, where others take hundreds")
        return run(case, model, method, rtol)

    pair = find_reference(tight, is_stiff)
    values = dict(zip(model.states, pair.solution.y, strict=True))
    return values, -math.log10(max(pair.agreement, 1e-15))


def two_explicit(name: str) -> Values:
    """Take a run that another explicit method agrees with to eleven digits.

    Where constraints lose rank, methods with a memory may pass with a looser tolerance only, which
    leaves less than that.
    """
    case, model = CASES[name], model_of(name)
    one, other = (run(case, model, method, 1e-12).y for method in ("dop853", "dopri5"))
    if not np.max(np.abs(one - other)) <= 1e-11 * np.max(np.abs(one)):
        raise AssertionError(f"{name}: two explicit methods disagree")
    return dict(zip(model.states, one, strict=True))


def run(case: Case, model: Model, method: str, rtol: float) -> Result:
    """Run without warnings: what they say is looked at in the result."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        return model.simulate(
            (0.0, float(case.times[-1])),
            case.times,
            method,
            rtol,
            rtol * case.atol,
            **case.settings,
        )


def outcome(name: str, rtol: float, method: str | None = None) -> Outcome:
    """Run a case at a tolerance."""
    case = CASES[name]
    result = run(case, model_of(name), method or case.method, rtol)
    work = result.statistics
    if not result.success:
        found = re.search(r"stopped at t = (\S+)", result.message)
        stopped = f"stops at {float(found[1]):.4g} s" if found else "does not start"
        return Outcome(work.method, math.nan, math.nan, work.n_steps, work.nfev, stopped)
    expected, most = expected_of(name)
    worst = max(_error(result[key], values, case.is_each) for key, values in expected.items())
    digits = min(-math.log10(max(worst, 1e-16)), most)
    drift = case.drift[1](result) if case.drift else math.nan
    return Outcome(work.method, digits, drift, work.n_steps, work.nfev)


def reversal(model: Model, t_end: float, method: str, rtol: float) -> float:
    """Run forwards and back again, and give the largest distance from the start.

    Raises
    ------
    SolveError
        If one of the runs fails.
    """
    settings = {"method": method, "rtol": rtol, "atol": rtol, "throw": True}
    there = model.simulate((0.0, t_end), [0.0, t_end], **settings)
    end = dict(zip(model.states, there.y[:, -1].tolist(), strict=True))
    back = model.simulate((t_end, 0.0), [0.0], initial=end, **settings)
    return float(np.max(np.abs(back.y[:, -1] - there.y[:, 0])))


def _error(found: Array, expected: Array, is_each: bool) -> float:
    scale = np.abs(expected) if is_each else np.max(np.abs(expected))
    return float(np.max(np.abs(found - expected) / scale))


def _energy(result: Result) -> float:
    """Return the change of the energy as a share of the largest, which may be zero by its level."""
    energy = result["energy"]
    return float(np.ptp(energy) / max(1.0, np.max(np.abs(energy))))


def _held(result: Result) -> float:
    """Return the residual of constraints."""
    return result.drift.worst if result.drift else math.nan


def _bennett(result: Result) -> float:
    return float(np.max(np.abs(hs.bennett_gap(result["j0.theta"], result["j1.theta"]))))


ENERGY = ("energy", _energy)
CONSTRAINTS = ("constraints", _held)


def _of_file(name: str, make: Callable[[str], Scene], hard: str, **changes: Any) -> Case:
    """Build the case of a file of tests/references."""
    data = read_reference(name)
    rows = data["reference"]
    times = np.array([row["t"] for row in rows])

    def expected() -> Values:
        return {
            _output(name, key): np.array([row["values"][key] for row in rows])
            for key in rows[0]["values"]
        }

    given = {"expected": expected, "digits": float(data["digits_trusted"])}
    return Case(lambda: make(name), times, hard, "reference", **{**given, **changes})


def _output(name: str, key: str) -> str:
    if name.startswith("chem"):
        return f"{key}_c"
    is_circuit = name in ("rlc_series", "spice_rlc_ladder50", "spice_rectifier")
    return output_of(key) if is_circuit or name == "ivp_transistor_amplifier" else key


def _multibody(name: str) -> Scene:
    return scene_of(read_reference(name), with_free_joints=True)


_CHEMICAL = {"atol": 1e-12, "is_each": True}
_SPAN = np.linspace(0.0, 1.0, 21)
_HEAVY = (1.0, 1e8)
_MASSES = ((1e4, 1e-4), (1e4, 1e4), (0.0, 0.0))
_SPRINGS = ((1.0, 1.0), (1.0, 1e10), (0.1, 2e5))
_VDP = np.concatenate([np.arange(1, 16, 2) * 5e4, 9e5 + np.arange(1, 13, 2) * 5e4])
_DRY = np.linspace(0.0, 60.0, 101)
_PERIODS = np.linspace(0.0, 2.0 * np.pi * 1e5, 101)

CASES: dict[str, Case] = {
    "slider_pendulum": _of_file(
        "slider_pendulum", _multibody, "a slider with a long rod", drift=CONSTRAINTS
    ),
    "iftomm_a01_pendulum": _of_file(
        "iftomm_a01_pendulum", _multibody, "a distance constraint", drift=ENERGY
    ),
    "iftomm_a02_fourbar_N2": _of_file(
        "iftomm_a02_fourbar_N2",
        _multibody,
        "all links are collinear twice per turn, where the constraints lose rank",
        drift=ENERGY,
        settings={"max_steps": 10_000},
    ),
    "ivp_andrews": _of_file(
        "ivp_andrews",
        _multibody,
        "three loops, which amplify errors by a factor of 1e5",
        drift=CONSTRAINTS,
    ),
    "ivp_car_axis": _of_file(
        "ivp_car_axis", _multibody, "stiff springs and a moving constraint", drift=CONSTRAINTS
    ),
    "heavy_top": _of_file("heavy_top", _multibody, "a spin of 150 rad/s", drift=ENERGY),
    "torque_free_top": _of_file(
        "torque_free_top", _multibody, "rotation about the unstable axis", drift=ENERGY
    ),
    "nonholonomic_skate": _of_file(
        "nonholonomic_skate", _multibody, "a nonholonomic constraint", drift=ENERGY
    ),
    "spring_mass_damper": _of_file("spring_mass_damper", scene_of_domain, "linear, driven"),
    "rlc_series": _of_file("rlc_series", circuit, "linear; time scale of microseconds"),
    "spice_rlc_ladder50": _of_file(
        "spice_rlc_ladder50", circuit, "100 states; time scale of nanoseconds"
    ),
    "spice_rectifier": _of_file("spice_rectifier", circuit, "stiff; exponential diode laws"),
    "ivp_transistor_amplifier": _of_file(
        "ivp_transistor_amplifier", circuit, "stiff; algebraic unknowns in exponential laws"
    ),
    "battery_2rc": _of_file("battery_2rc", lambda _: battery(), "a current that switches off"),
    "dc_motor_rigid_gear": _of_file(
        "dc_motor_rigid_gear", scene_of_domain, "inertias coupled by a rigid gear"
    ),
    "surge_tank": _of_file("surge_tank", scene_of_domain, "linear, slow"),
    "tank_drain": _of_file(
        "tank_drain", scene_of_domain, "a square root law; the tank is nearly empty at the end"
    ),
    "thermal_3node": _of_file("thermal_3node", scene_of_domain, "linear, slow"),
    "ivp_water_tube": _of_file(
        "ivp_water_tube",
        scene_of_domain,
        "friction jumps at the transition to turbulent flow; the file is accurate to 3 digits",
    ),
    "chem_hires": _of_file("chem_hires", scene_of_domain, "stiff; digits of each", **_CHEMICAL),
    "chem_robertson": _of_file(
        "chem_robertson",
        scene_of_domain,
        "stiff over 1e11 s; digits of each down to 1e-13",
        **{**_CHEMICAL, "atol": 1e-14},
    ),
    "double pendulum, 10 s": Case(
        hs.double_pendulum,
        10.0 * _SPAN,
        "chaotic: errors grow by a factor e about every 1.3 s",
        "two methods",
        drift=ENERGY,
    ),
    "double pendulum, 1000 s": Case(
        hs.double_pendulum,
        1000.0 * _SPAN,
        "chaotic: after 60 s the state is not accurate at any tolerance, but the energy can be",
        "energy",
        lambda: {"energy": np.full(len(_SPAN), -3.0 * 9.81 * np.cos(2.0))},
        method="dop853",
    ),
    "double pendulum, mass ratio 1e8": Case(
        lambda: hs.double_pendulum(_HEAVY, 0.5),
        0.25 * _SPAN,
        "a mode of the inner bob at 7 kHz must not be excited; both rods move like a single "
        "rod to 1e-8",
        "closed form of the limit",
        lambda: hs.long_pendulum_exact(0.25 * _SPAN),
        digits=8.0,
        drift=ENERGY,
    ),
    "two masses, mass ratio 1e8": Case(
        lambda: hs.two_masses(*_MASSES),
        _SPAN,
        "1600 periods of the light mass within a sixth of a period of the heavy mass",
        "closed form",
        lambda: hs.two_masses_exact(*_MASSES, _SPAN),
    ),
    "two masses, spring ratio 1e10": Case(
        lambda: hs.two_masses(*_SPRINGS),
        10.0 * _SPAN,
        "stiff: time constants of 1e-5 s and 10 s",
        "closed form",
        lambda: hs.two_masses_exact(*_SPRINGS, 10.0 * _SPAN),
    ),
    "pF and MPa": Case(
        hs.pressure_sensor,
        _SPAN,
        "stiff: time constants of 1e-6 s and 1 s; states of 1e7 and 10",
        "closed form",
        lambda: hs.pressure_sensor_exact(_SPAN),
    ),
    "Bennett's linkage": Case(
        hs.bennett_loop,
        3.0 * _SPAN,
        "a spatial loop with three redundant constraints of six; the drift is the residual of "
        "Bennett's relation between two angles",
        "two methods",
        lambda: two_explicit("Bennett's linkage"),
        digits=11.0,
        drift=("relation", _bennett),
    ),
    "stiff spring between spinning bodies": Case(
        hs.spinning_pair,
        0.1 * _SPAN,
        "a mode of the spring at 2 kHz must not be excited; the bodies rotate at 100 rad/s",
        "closed form",
        lambda: hs.spinning_pair_exact(0.1 * _SPAN),
        drift=ENERGY,
    ),
    **{
        f"diode, parasitic capacitance {farad:.0e} F" if farad else "diode, none": Case(
            functools.partial(hs.parasitic_rectifier, farad),
            0.04 * _SPAN,
            "stiff: a decay rate of 1/(R C) and a source of 50 Hz"
            if farad
            else "an algebraic unknown instead of a capacitance",
            "two methods",
        )
        for farad in (1e-9, 1e-12, 1e-15, 0.0)
    },
    "van der Pol, mu = 1e6": Case(
        hs.van_der_pol,
        _VDP,
        "fast transitions of 1e-6 s after slow phases of 8e5 s",
        "asymptotic series",
        lambda: hs.van_der_pol_exact(_VDP),
        digits=10.0,
    ),
    "dry friction that jumps, swinging": Case(
        hs.dry_swing,
        _DRY,
        "nineteen jumps of the force, which only the error control resolves",
        "closed form",
        lambda: hs.dry_swing_exact(_DRY),
    ),
    "dry friction that jumps, to rest": Case(
        hs.sliding_to_rest,
        2.0 * _SPAN,
        "at rest the force jumps at every step; the run stops with a message",
        "closed form",
        lambda: hs.sliding_to_rest_exact(2.0 * _SPAN),
        settings={"max_steps": 1000},
    ),
    "smooth dry friction, to rest": Case(
        lambda: hs.sliding_to_rest(1e-6),
        2.0 * _SPAN,
        "stiff at rest: the force increases to 1 N within 1e-6 m/s",
        "closed form",
        lambda: hs.sliding_to_rest_exact(2.0 * _SPAN, 1e-6),
        method="cvode",
    ),
    "1e5 periods": Case(
        hs.light_oscillator,
        _PERIODS,
        "phase errors accumulate over a million steps; artificial damping of 1e-6 per step "
        "would be visible",
        "closed form",
        lambda: hs.light_oscillator_exact(_PERIODS),
        method="dop853",
        tolerances=(1e-7, 1e-10),
    ),
}
