"""CasADi imports an FMU, and differentiates its integration."""

from __future__ import annotations

import zipfile

import numpy as np
import pytest

import cotree


@pytest.mark.slow
@pytest.mark.parametrize("version", [3, 2])
def test_gradient_of_an_end_state(tmp_path, version):
    ca = pytest.importorskip("casadi")
    model = cotree.load("slider-pendulum").compile(["L"])
    model.export_fmu(tmp_path / "unit.fmu", version)
    folder = tmp_path / "unit"
    with zipfile.ZipFile(tmp_path / "unit.fmu") as archive:
        archive.extractall(folder)
    dae = ca.DaeBuilder("unit", str(folder))
    assert dae.x() == list(model.states)
    rates = dae.create("rates", ["t", "x", "p"], ["ode"])
    n, m = len(model.states), len(model.parameters)
    t, x, p = ca.MX.sym("t"), ca.MX.sym("x", n), ca.MX.sym("p", m)
    options = {"reltol": 1e-12, "abstol": 1e-13, "max_num_steps": 100000}
    problem = {"x": x, "p": p, "t": t, "ode": rates(t, x, p)}
    solve = ca.integrator("solve", "cvodes", problem, 0.0, 1.0, options)
    end = solve(x0=x, p=p)["xf"][0]
    gradient = ca.Function("gradient", [x, p], [end, ca.gradient(end, p)])
    value, slopes = gradient(model.initial_state, model.default_parameters)
    wanted = model.simulate((0.0, 1.0), rtol=1e-12, atol=1e-13)
    # Both integrate to about 1e-11; the bound is the aim.
    assert float(value) == pytest.approx(wanted["j1.s"][-1], abs=1e-8)
    found = np.array(slopes).ravel()[model.parameters.index("L")]
    assert found == pytest.approx(wanted.sensitivity("j1.s", "L")[-1], abs=1e-8)
