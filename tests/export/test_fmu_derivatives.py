"""Directional and adjoint derivatives of FMUs, in every mode, against the kernels of the model."""

from __future__ import annotations

import numpy as np
import pytest
from fmu_importer import UNITS, Unit, share
from fmu_slopes import close, compare

import cotree


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    made = {}

    def make(name, version=3):
        if (name, version) not in made:
            scene = cotree.load(name)
            model = scene.compile(list(scene.parameters))
            path = tmp_path_factory.mktemp("fmu") / f"{name}-{version}.fmu"
            model.export_fmu(path, version)
            made[name, version] = model, path
        return made[name, version]

    return make


@pytest.mark.parametrize(
    ("name", "version"),
    share(UNITS, UNITS[::3], ("slider-pendulum", 3)),
)
def test_derivatives_in_event_continuous_time_and_step_modes(exported, name, version):
    model, path = exported(name, version)
    n_rates = len(model.states) - model.kernels.layout.n_algebraic
    with Unit(path) as unit:
        unit.initialize()
        y = model.start().y
        compare(unit, model, 0.0, y)  # Event Mode
        # Times behind the next event belong to the Event Mode in between.
        t = min(0.37 * model.spec.scene.defaults.t_end, 0.9 * unit.update())
        unit.fmu.enterContinuousTimeMode()
        y = model.simulate((0.0, t), rtol=1e-9).y[:, -1]
        unit.go(t, y[:n_rates])
        # Algebraic unknowns as the unit has them: both then differ by rounding alone.
        y = unit.get(*model.states)
        compare(unit, model, t, y)
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-9)
        unit.step(0.0, t)
        y = unit.get(*model.states)
        compare(unit, model, t, y)


@pytest.mark.parametrize(
    "name", ["two-tanks", "cart-pole", pytest.param("robot-arm", marks=pytest.mark.slow)]
)
def test_derivatives_by_inputs(exported, name):
    model, path = exported(name)
    with Unit(path) as unit:
        inputs = unit.list("input")
        assert inputs == list(model.inputs)
        unit.initialize(values={inputs[0]: 0.4})
        unit.update()
        unit.fmu.enterContinuousTimeMode()
        y = model.start().y + 0.3
        unit.go(1.0, y)
        u = unit.get(*inputs)
        linear = model.linearize(1.0, y, u=u)
        close(unit.slopes(unit.rates, inputs), linear.B)
        close(unit.slopes(unit.list("output"), inputs), linear.D)
        close(unit.adjoints(unit.rates, inputs), linear.B)


def test_derivatives_while_the_start_is_found(exported):
    # x0 of the ball is its parameter h: rates and outputs follow it.
    _, path = exported("bouncing-ball")
    with Unit(path) as unit:
        unit.begin()
        assert unit.slopes(["j.s", "height", "der(j.s_dot)"], ["h", "g"]).tolist() == [
            [1.0, 0.0],
            [1.0, 0.0],
            [0.0, -1.0],
        ]
        assert unit.adjoints(["height"], ["h", "g"]).tolist() == [[1.0, 0.0]]
    with Unit(path) as unit:
        unit.begin(values={"j.s": 3.0})
        assert unit.get("j.s", "height").tolist() == [3.0, 3.0]
        # What was set follows no parameter.
        assert unit.slopes(["height"], ["h", "j.s"]).tolist() == [[0.0, 1.0]]


@pytest.mark.parametrize("version", [3, pytest.param(2, marks=pytest.mark.slow)])
def test_derivatives_of_a_constrained_start(exported, version):
    # Coupler and rocker follow from the crank and the length of the coupler.
    model, path = exported("motor-linkage", version)
    with Unit(path, "CoSimulation") as unit:
        unit.begin(values={"L": 0.36})
        start = model.start(p={"L": 0.36})
        names = list(model.states)
        np.testing.assert_allclose(unit.get(*names), start.y, atol=1e-12, rtol=1e-12)
        columns = [model.sensitivities.index(n) for n in ("L", "T0")]
        close(unit.slopes(names, ["L", "T0"]), start.s[:, columns])
        # By the angle of the crank, which is given: against differences of starts.
        h = 1e-5
        angle = "crank.theta"
        ahead, back = (model.start(p={"L": 0.36}, initial={angle: 1.0 + d}).y for d in (h, -h))
        wanted = (ahead - back) / (2 * h)
        # Central differences of step h have an error of order h^2, and rounding over h.
        np.testing.assert_allclose(unit.slopes(names, [angle])[:, 0], wanted, atol=1e-9)


def test_unknowns_and_knowns_that_are_none_are_refused(exported):
    _, path = exported("slider-pendulum")
    with Unit(path) as unit:
        unit.initialize()
        for unknowns, knowns in ((["L"], ["k"]), (["rod_x"], ["rod_x"]), (["j1.s"], ["k"])):
            with pytest.raises(Exception, match="failed with status 3"):
                unit.slopes(unknowns, knowns)
