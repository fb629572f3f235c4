"""Circuits, built from their elements, against reference solutions."""

from __future__ import annotations

import circuits
import numpy as np
import pytest
from reference_scenes import read_reference

from cotree import load

pytestmark = pytest.mark.compiler

TIGHT = {"rtol": 1e-11, "atol": 1e-13}


def _run(scene, data, method):
    sensitivities = list(data.get("sensitivities", {"values": {}})["values"])
    times = [row["t"] for row in data["reference"]]
    return scene.compile(sensitivities).simulate(
        (0.0, data["t_end"]), t_eval=times, method=method, throw=True, **TIGHT
    )


def _check(result, data, output_of, digits=8):
    """Compare values and sensitivities, relative to the largest of each quantity over time.

    What is zero, or next to nothing, is left with rounding: it is compared with a millionth of the
    largest of all quantities.
    """
    tables = {"": data["reference"], **data.get("sensitivities", {"values": {}})["values"]}
    for parameter, rows in tables.items():
        largest = max(abs(value) for row in rows for value in row["values"].values())
        for quantity in rows[0]["values"]:
            expected = np.array([row["values"][quantity] for row in rows])
            name = output_of(quantity)
            found = result.sensitivity(name, parameter) if parameter else result[name]
            scale = max(np.max(np.abs(expected)), 1e-6 * largest)
            assert np.max(np.abs(found - expected)) <= 10.0**-digits * scale, (quantity, parameter)


@pytest.mark.parametrize("method", ["dop853", "BDF", "cvode"])
def test_rlc_series(method):
    data = read_reference("rlc_series")
    scene = circuits.circuit("rlc_series")
    result = _run(scene, data, method)
    # BDF's errors of a step add up over its few thousand steps.
    _check(result, data, circuits.output_of, 8 if method != "BDF" else 6)


def test_rlc_ladder():
    data = read_reference("spice_rlc_ladder50")
    result = _run(circuits.circuit("spice_rlc_ladder50"), data, "dop853")
    _check(result, data, circuits.output_of)


@pytest.mark.parametrize("method", ["dop853", "LSODA", "auto"])
def test_battery_with_a_switched_current(method):
    data = read_reference("battery_2rc")
    result = _run(circuits.battery(), data, method)
    _check(result, data, lambda name: name)


@pytest.mark.parametrize("method", ["auto", "cvode", "ida"])
def test_rectifier(method):
    data = read_reference("spice_rectifier")
    result = _run(circuits.circuit("spice_rectifier"), data, method)
    _check(result, data, circuits.output_of)


def test_ida_follows_diodes_that_begin_to_conduct():
    model = load("bridge-rectifier").compile()
    settings = {"t_eval": np.linspace(0.0, 0.1, 21), "throw": True}
    # No explicit method: where diodes begin to conduct, its error estimates may vanish by chance.
    expected = model.simulate(method="rodas5", **TIGHT, **settings)
    result = model.simulate(method="ida", rtol=1e-8, atol=1e-10, **settings)
    # Some two thousand steps with errors of 1e-8; diodes conduct a tenth of the time, steeply.
    np.testing.assert_allclose(result["C1.v"], expected["C1.v"], atol=1e-5)
    assert result.statistics.n_steps < 4000


@pytest.mark.parametrize("method", ["cvode", "ida", pytest.param("auto", marks=pytest.mark.slow)])
def test_transistor_amplifier(method):
    data = read_reference("ivp_transistor_amplifier")
    result = _run(circuits.circuit("ivp_transistor_amplifier"), data, method)
    _check(result, data, circuits.output_of)
