"""Tolerances and budgets without sense are refused by every route, loose ones warned of."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import cotree
from cotree.cli import main
from cotree.errors import ModelError, ParameterError, SceneError, SolveError
from cotree.methods import METHODS
from cotree.solvers.native import is_available


@pytest.fixture(scope="module")
def swing() -> cotree.Model:
    """A mass on a spring, x'' = -9 x from x = 1: x = cos(3 t)."""
    return scene().compile()


def scene(**simulation: Any) -> cotree.Scene:
    made = cotree.Scene("swing")
    made.edge("m", "translational_mass", "ground", "A", mass=1.0)
    made.edge("s", "translational_spring", "ground", "A", stiffness=9.0, initial={"s": 1.0})
    made.simulation(t_end=1.0, **simulation)
    return made


@pytest.mark.parametrize("rtol", [1.0, 3.0])
def test_errors_as_large_as_values_are_refused(swing: cotree.Model, rtol: float) -> None:
    for method in [*filter(is_available, METHODS), "auto"]:
        with pytest.raises(SolveError, match=f"rtol is {rtol}: errors as large as"):
            swing.simulate(method=method, rtol=rtol)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"rtol": -1e-6}, "rtol is -1e-06; give a positive"),
        ({"rtol": math.nan}, "rtol is nan: give a finite number"),
        ({"atol": 0.0}, "atol is 0.0; give a positive"),
        ({"atol": math.inf}, "atol is inf: give a finite number"),
        ({"atol": [1e-6, 1e-6]}, "atol is .* give a number"),
        ({"max_step": -1.0}, "max_step is -1.0; give positive"),
        ({"max_step": math.nan}, "max_step is nan: give a finite number"),
        ({"max_steps": 2.5}, "max_steps is 2.5: give a whole number"),
        ({"max_steps": -3}, "max_steps is -3; give a positive number"),
        ({"max_events": 0.5}, "max_events is 0.5: give a whole number"),
        ({"time_limit": math.nan}, "time_limit is nan: give a finite number"),
    ],
)
def test_settings_without_sense_are_named(
    swing: cotree.Model, settings: dict[str, Any], words: str
) -> None:
    with pytest.raises((SolveError, ModelError), match=words):
        swing.simulate(**settings)


def test_loose_tolerances_are_warned_of(swing: cotree.Model) -> None:
    with pytest.warns(RuntimeWarning, match=r"rtol is 0\.1: above 0\.01") as warned:
        swing.simulate(rtol=0.1)
    assert Path(warned[0].filename) == Path(__file__)
    swing.simulate(rtol=0.01)  # warnings are errors here


def test_absolute_tolerance_beyond_the_states_is_warned_of(swing: cotree.Model) -> None:
    """|x| <= 1 and |x'| <= 3: of both, an absolute tolerance of one tests nothing."""
    with pytest.warns(RuntimeWarning, match="no state was ever larger than 3, .* below 0.03") as w:
        swing.simulate(atol=1.0)
    assert Path(w[0].filename) == Path(__file__)
    result = swing.simulate(atol=0.02)
    assert result.success
    assert np.all(swing.simulate(initial={"s.s": 0.0}).y == 0.0)  # at rest nothing is asked for


def test_a_mechanism_that_is_held_at_rest_asks_for_no_tolerance() -> None:
    """A level arm, m g L held by a torque: what rounding leaves of the balance is no motion."""
    arm = cotree.Scene("held", gravity=[0, -9.81, 0])
    arm.input("tau", 0.0, unit="N m")
    arm.edge("h", "revolute", "ground", "A", axis=[0, 0, 1])
    arm.edge("drive", "torque", "ground", "A", torque=[0, 0, "tau"])
    arm.edge("rod", "arm", "A", "B", vector=[0.3, 0, 0])
    arm.edge("bob", "rigid_body", "ground", "B", mass=0.7)
    model = arm.compile()
    # One unit in the last place off, which some hardware would be by itself.
    held = np.nextafter(0.7 * 9.81 * 0.3, 10.0)
    result = model.simulate((0, 2), inputs={"tau": float(held)})  # warnings are errors here
    assert 0.0 < np.max(np.abs(result.y)) < 1e-12


def test_small_motions_are_still_warned_of() -> None:
    """A capacitor at 1e-13 V, of which a tolerance of 1e-10 tests nothing."""
    circuit = cotree.Scene("small")
    circuit.edge("V", "voltage_source", "a", "ground", voltage=1e-13)
    circuit.edge("R", "resistor", "a", "b", resistance=1e3)
    circuit.edge("C", "capacitor", "b", "ground", capacitance=1e-6)
    with pytest.warns(RuntimeWarning, match="no state was ever larger than 1e-13"):
        circuit.compile().simulate((0, 0.01))


def test_scenes_benches_and_projects_refuse_and_warn(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"of the simulation rtol is 1.0: errors as large"):
        scene(rtol=1.0)
    with pytest.raises(SolveError, match=r"tolerances contains an invalid value: rtol is 2.0"):
        cotree.bench(scene(), tolerances=[2.0])
    with pytest.warns(RuntimeWarning, match="above 0.01"):
        scene(rtol=0.5).compile().write(tmp_path)
    with (
        pytest.warns(RuntimeWarning, match="above 0.01"),
        pytest.raises(ParameterError, match="repeats is 0"),
    ):
        cotree.bench(scene(), tolerances=[0.5], repeats=0)


@pytest.mark.parametrize("command", ["run", "bench"])
def test_commands_refuse_in_one_sentence(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    option = {"run": "--rtol", "bench": "--tolerance"}[command]
    assert main([command, "spring-mass-damper", option, "1.0"]) == 2
    assert "rtol is 1.0: errors as large as the values themselves" in capsys.readouterr().err
