"""Statuses of FMUs whose values cannot be computed, steps not be finished, or states were freed."""

from __future__ import annotations

import ctypes
from ctypes import byref, c_double

import numpy as np
import pytest
from fmpy import simulate_fmu
from fmpy.fmi1 import FMICallException
from fmpy.fmi3 import fmi3Boolean
from fmu_importer import Unit

from cotree import Scene

OK, DISCARD, ERROR = 0, 2, 3


def _ending():
    """Build a mass whose force exists until t = end, and one whose force exists for v < 1."""
    scene = Scene("ending")
    scene.parameter("end", 0.5)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("F", "force_source", "ground", "A", force="sqrt(end - t)")
    scene.edge("N", "translational_mass", "ground", "B", mass=1.0)
    scene.edge("G", "force_source", "ground", "B", force="0.1*sqrt(1 - N.v)")
    return scene


def _speed(t):
    """Integrate sqrt(0.5 - t) from zero."""
    return (0.5**1.5 - (0.5 - t) ** 1.5) / 1.5


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    model, made = _ending().compile(), {}

    def make(version):
        if version not in made:
            made[version] = tmp_path_factory.mktemp("ending") / f"{version}.fmu"
            with pytest.warns(RuntimeWarning, match="no expected results, since"):
                model.export_fmu(made[version], version)
        return made[version]

    return make


def _status(call, *given):
    """Return the status of a call, which FMPy raises if it is not OK."""
    try:
        call(*given)
    except FMICallException as error:
        return error.status
    return OK


VERSIONS = pytest.mark.parametrize("version", [3, pytest.param(2, marks=pytest.mark.slow)])


@VERSIONS
def test_rates_that_do_not_exist_are_discarded_and_smaller_steps_go_on(exported, version, capfd):
    with Unit(exported(version), loggingOn=True) as unit:
        unit.initialize()
        unit.update()
        unit.fmu.enterContinuousTimeMode()
        read = unit.fmu.getContinuousStateDerivatives if version == 3 else unit.fmu.getDerivatives
        rates = (c_double * 2)()
        at = {name: i for i, name in enumerate(unit.states)}
        unit.go(0.1, np.array([1.5 if name == "N.v" else 0.0 for name in at]))
        assert _status(read, rates, 2) == DISCARD
        assert _status(unit.get, "der(N.v)") == DISCARD
        unit.go(0.1, np.array([0.75 if name == "N.v" else 0.0 for name in at]))
        assert _status(read, rates, 2) == OK
        # The speed stands at 0.75: 0.1 sqrt(1 - 0.75).
        assert rates[at["N.v"]] == pytest.approx(0.05)
        # Integrators that diverge are told so before the states are taken over.
        assert _status(unit.go, 0.1, np.array([np.nan, np.nan])) == DISCARD
        assert unit.get("N.v")[0] == 0.75
    said = "".join(capfd.readouterr())
    assert "the derivative of state 'N.v' is not finite at t = 0.1" in said
    assert "'M.v' is set to a value that is not finite" in said


@pytest.mark.parametrize("kind", ["ModelExchange", "CoSimulation"])
@VERSIONS
def test_a_start_without_rates_is_an_error(exported, version, kind, capfd):
    with Unit(exported(version), kind) as unit:
        unit.begin(values={"end": -1.0})
        assert _status(unit.fmu.exitInitializationMode) == ERROR
    assert "the derivative of state 'M.v' is not finite at t = 0" in "".join(capfd.readouterr())


def _step_of_3(unit, t, size):
    """Take a step of FMI 3: its status, and the time that it reaches."""
    flags = [fmi3Boolean() for _ in range(3)]
    reached = c_double()
    call = unit.fmu.dll.fmi3DoStep
    status = call(
        unit.fmu.component, c_double(t), c_double(size), fmi3Boolean(True), *map(byref, flags),
        byref(reached),
    )  # fmt: skip
    return status, reached.value


def test_a_step_that_cannot_be_finished_leaves_the_state_as_it_was(exported):
    with Unit(exported(3), "CoSimulation") as unit:
        unit.initialize(1e-11)
        unit.step(0.0, 0.25)
        before = unit.get("time", "M.v", "N.v")
        status, reached = _step_of_3(unit, 0.25, 0.5)
        assert status == DISCARD
        # The force ends at 0.5, which steps approach from below.
        assert reached == pytest.approx(0.5, abs=1e-6)
        assert reached <= 0.5
        assert np.array_equal(unit.get("time", "M.v", "N.v"), before)
        # Two of half the size: the first one is possible.
        assert _step_of_3(unit, 0.25, 0.125) == (OK, 0.375)
        assert unit.get("M.v")[0] == pytest.approx(_speed(0.375), abs=1e-9)


@pytest.mark.slow
def test_a_step_of_fmi_2_that_cannot_be_finished_says_how_far_it_came(exported, capfd):
    with Unit(exported(2), "CoSimulation", loggingOn=True) as unit:
        unit.initialize(1e-11)
        unit.step(0.0, 0.25)
        kept = unit.fmu.getFMUstate()
        assert _status(unit.step, 0.25, 0.5) == DISCARD
        reached = unit.fmu.getRealStatus(2)
        assert reached == pytest.approx(0.5, abs=1e-6)
        assert unit.fmu.getBooleanStatus(3) is False
        # For debugging values can be read, but the step has to be repeated from the kept state.
        assert unit.get("time")[0] == reached
        assert _status(unit.step, reached, 0.1) == ERROR
        unit.fmu.setFMUstate(kept)
        unit.step(0.25, 0.125)
        assert unit.get("M.v")[0] == pytest.approx(_speed(0.375), abs=1e-9)
        unit.fmu.freeFMUstate(kept)
    said = "".join(capfd.readouterr())
    assert "the simulation stops at t = 0.5" in said
    assert "fmi2DoStep is not allowed in the state Step Failed" in said


@VERSIONS
def test_a_step_that_gets_nowhere_is_an_error(exported, version):
    with Unit(exported(version), "CoSimulation") as unit:
        unit.initialize(1e-9)
        unit.step(0.0, 0.25)
        unit.set(end=0.2)
        assert _status(unit.step, 0.25, 0.1) == ERROR


@VERSIONS
def test_importers_end_with_a_message_where_steps_cannot_be_finished(exported, version):
    with pytest.raises(FMICallException):
        simulate_fmu(str(exported(version)), fmi_type="CoSimulation", stop_time=1.0)


@pytest.mark.slow
@VERSIONS
def test_an_event_that_ends_the_simulation(tmp_path, version):
    scene = Scene("falling", gravity=[0, 0, -9.81])
    scene.edge("j", "prismatic", "ground", "B", axis=[0, 0, 1], initial={"s": 2.0})
    scene.edge("ball", "rigid_body", "ground", "B", mass=1.0)
    scene.event("floor", "j.s", direction=-1, stop=True)
    scene.compile().export_fmu(tmp_path / "x.fmu", version)
    # Of a height of 2 m.
    end = np.sqrt(2 * 2.0 / 9.81)
    result = simulate_fmu(
        str(tmp_path / "x.fmu"), fmi_type="CoSimulation", stop_time=1.0, early_return_allowed=True
    )
    assert result["time"][-1] == pytest.approx(end, rel=1e-6)
    with Unit(tmp_path / "x.fmu", "CoSimulation") as unit:
        unit.initialize(1e-12)
        if version == 3:
            assert _step_of_3(unit, 0.0, 1.0) == (OK, pytest.approx(end, rel=1e-10))
        else:
            assert _status(unit.step, 0.0, 1.0) == DISCARD
            assert unit.fmu.getBooleanStatus(3) is True
            assert unit.fmu.getRealStatus(2) == pytest.approx(end, rel=1e-10)
        unit.fmu.terminate()


@VERSIONS
def test_states_that_were_freed_are_refused(exported, version, capfd):
    name = "FMUState" if version == 3 else "FMUstate"
    with Unit(exported(version)) as unit, Unit(exported(version)) as other:
        unit.initialize()
        state = getattr(unit.fmu, f"get{name}")()
        stale = ctypes.c_void_p(state.value)
        # A pointer to a state of another instance, too: bytes bring states there.
        assert _status(getattr(other.fmu, f"set{name}"), state) == ERROR
        getattr(unit.fmu, f"free{name}")(state)
        for call in ("free", "set", "serialize"):
            assert _status(getattr(unit.fmu, f"{call}{name}"), stale) == ERROR, call
        # What is never freed is freed with the instance.
        getattr(unit.fmu, f"get{name}")()
    said = "".join(capfd.readouterr())
    for call in ("Free", "Set", "Serialized"):
        assert f"fmi{version}{call}{name}" in said
    assert "the pointer is not a state of this instance, or the state was freed" in said


@pytest.mark.slow
def test_fmi_2_needs_the_start_time(exported, capfd):
    with Unit(exported(2)) as unit:
        assert _status(unit.fmu.enterInitializationMode) == ERROR
        assert _status(unit.fmu.setupExperiment, None, 0.0, -1.0) == ERROR
        unit.fmu.setupExperiment(startTime=0.125)
        unit.fmu.enterInitializationMode()
        assert unit.get("time")[0] == 0.125
        unit.fmu.reset()
        assert _status(unit.fmu.enterInitializationMode) == ERROR
    said = "".join(capfd.readouterr())
    assert "call fmi2SetupExperiment first" in said
    assert "the stop time -1 is not after the start time 0" in said


@pytest.mark.slow
def test_steps_end_at_the_budget_of_integrator_steps(tmp_path, capfd):
    scene = Scene("fast")
    scene.parameter("k", 1.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0, initial={"v": 1.0})
    scene.edge("K", "translational_spring", "ground", "A", stiffness="k")
    scene.compile().export_fmu(tmp_path / "x.fmu")
    with Unit(tmp_path / "x.fmu", "CoSimulation", loggingOn=True) as unit:
        unit.initialize(1e-6)
        unit.set(k=1e18)  # a period of 6 ns, for which a second has too many steps
        status, reached = _step_of_3(unit, 0.0, 1.0)
        assert status == DISCARD
        assert 0.0 < reached < 1.0
        assert _step_of_3(unit, 0.0, 0.5 * reached)[0] == OK
    assert "the limit of 1000000 integrator steps is reached" in "".join(capfd.readouterr())


@pytest.mark.slow
def test_a_step_with_more_time_events_than_can_be_listed_is_discarded(tmp_path, capfd):
    scene = Scene("sawtooth")
    scene.parameter("f", 4.0)
    scene.edge("M", "translational_mass", "ground", "A", mass=1.0)
    scene.edge("F", "force_source", "ground", "A", force="f*t - floor(f*t)")
    scene.compile().export_fmu(tmp_path / "x.fmu")
    with Unit(tmp_path / "x.fmu", "CoSimulation", loggingOn=True) as unit:
        unit.initialize(1e-8)
        unit.set(f=2.0**34)  # 1.7e10 time events within a second
        assert _step_of_3(unit, 0.0, 1.0)[0] == DISCARD
        # 16 periods of a mean force of one half.
        assert _step_of_3(unit, 0.0, 2.0**-30) == (OK, 2.0**-30)
        assert unit.get("M.v")[0] == pytest.approx(2.0**-31, rel=1e-6)
    said = "".join(capfd.readouterr())
    assert "too many time events to list: the shortest period is 5.82077e-11 s" in said
