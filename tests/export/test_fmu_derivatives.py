"""Directional and adjoint derivatives of FMUs, in every mode, against the kernels of the model."""

from __future__ import annotations

import numpy as np
import pytest
from fmu_importer import UNITS, Unit, share

import cotree


def _expected(model, t, y, p=None, u=None):
    """Rates and outputs by states, inputs and parameters, algebraic unknowns eliminated."""
    layout = model.layout
    n, m = len(layout.states), len(model.sensitivities)
    n_rates = n - layout.n_algebraic
    jacobian = model.jacobian(t, y, p, u)
    of_p = model.sensitivity_rhs(t, y, np.zeros((n, m)), p, u)
    outputs_of_p = model.output_sensitivity(t, y, np.zeros((n, m)), p, u)
    # The kernel of output sensitivities leaves out states that depend on no parameter, such as
    # modes. By states the graphs of the linearisation are taken, which eliminate unknowns, too.
    outputs_of_x = np.zeros((len(layout.outputs), n))
    f = np.vstack([np.hstack([jacobian, of_p]), np.hstack([outputs_of_x, outputs_of_p])])
    g = f[n_rates:n]
    rows = [*range(n_rates), *range(n, len(f))]
    knowns = [*range(n_rates), *range(n, n + m)]
    wanted, rounding = f[np.ix_(rows, knowns)], 0.0
    if layout.n_algebraic:
        z_v = -np.linalg.solve(g[:, n_rates:n], g[:, knowns])
        # Eliminations agree as far as the condition of g_z lets them, in terms that cancel.
        terms = np.abs(f[np.ix_(rows, range(n_rates, n))]) @ np.abs(z_v)
        rounding = 1e-16 * np.linalg.cond(g[:, n_rates:n]) * np.max(terms)
        wanted += f[np.ix_(rows, range(n_rates, n))] @ z_v
    linear = model.linearize(t, y, p, u)
    wanted[n_rates:, :n_rates] = linear.C
    if layout.n_algebraic:
        outputs = _outputs_by_unknowns(model, t, y, p, u)
        wanted[n_rates:, n_rates:] += outputs @ z_v[:, n_rates:]
    return wanted, rounding


def _outputs_by_unknowns(model, t, y, p, u):
    n_rates = len(y) - model.layout.n_algebraic
    m = len(model.sensitivities)
    nothing = model.output_sensitivity(t, y, np.zeros((len(y), m)), p, u)
    columns = []
    for i in range(n_rates, len(y)):
        s = np.zeros((len(y), m))
        s[i] = 1.0
        # The kernel is linear in s.
        columns.append((model.output_sensitivity(t, y, s, p, u) - nothing)[:, 0])
    return np.array(columns).T.reshape(len(nothing), -1)


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


def _close(found, wanted, rounding=0.0):
    # The same operations in another order: rounding of the largest term.
    scale = np.max(np.abs(wanted), initial=1.0)
    np.testing.assert_allclose(found, wanted, rtol=1e-12, atol=1e-12 * scale + rounding)


def _compare(unit, model, t, y):
    names = [*unit.rates, *unit.list("output")]
    knowns = [*unit.states, *model.parameters]
    wanted, rounding = _expected(model, t, y)
    found = unit.slopes(names, knowns)
    _close(found, wanted, rounding)
    if unit.version == 3:
        _close(unit.adjoints(names, knowns), wanted, rounding)
        # Forward and reverse sum the same terms.
        scale = np.max(np.abs(wanted), initial=1.0)
        assert np.max(np.abs(unit.adjoints(names, knowns) - found)) <= 1e-12 * scale + rounding
    return names, knowns


FEW = ["slider-pendulum", "bridge-rectifier", "heated-room"]


@pytest.mark.parametrize(
    ("name", "version"),
    share(UNITS, UNITS[::3], ("slider-pendulum", 3)),
)
def test_derivatives_in_event_continuous_time_and_step_modes(exported, name, version):
    model, path = exported(name, version)
    n_rates = len(model.states) - model.layout.n_algebraic
    with Unit(path) as unit:
        unit.initialize()
        y = model.start().y
        _compare(unit, model, 0.0, y)  # Event Mode
        # Times behind the next event belong to the Event Mode in between.
        t = min(0.37 * model._recipe.defaults.t_end, 0.9 * unit.update())
        unit.fmu.enterContinuousTimeMode()
        y = model.simulate((0.0, t), rtol=1e-9).y[:, -1]
        unit.go(t, y[:n_rates])
        # Algebraic unknowns as the unit has them: both then differ by rounding alone.
        y = unit.get(*model.states)
        _compare(unit, model, t, y)
    with Unit(path, "CoSimulation") as unit:
        unit.initialize(1e-9)
        unit.step(0.0, t)
        y = unit.get(*model.states)
        _compare(unit, model, t, y)


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
        _close(unit.slopes(unit.rates, inputs), linear.B)
        _close(unit.slopes(unit.list("output"), inputs), linear.D)
        _close(unit.adjoints(unit.rates, inputs), linear.B)


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
        _close(unit.slopes(names, ["L", "T0"]), start.s[:, columns])
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
