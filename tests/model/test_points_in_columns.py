"""Kernels at many points in one call: the bits of single calls, and errors that name the column."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import ParameterError, load
from cotree.model import columns

# Scenes with inputs, outputs, algebraic unknowns, constraints, and sensitivities that vanish.
SCENES = ["slider-pendulum", "bridge-rectifier", "motor-linkage", "battery-cell"]


@pytest.fixture(scope="module", params=SCENES)
def model(request):
    scene = load(request.param)
    return scene.compile(list(scene.compile().parameters)[:2])


@pytest.fixture(params=["C", "points"])
def way(request, monkeypatch):
    """Points in one call, and one by one, as where there is no compiler."""
    if request.param == "points":
        monkeypatch.setattr(columns, "load_columns", lambda: None)


@pytest.fixture
def points(model):
    rng, n, m = np.random.default_rng(3), len(model.states), 5
    y = model.initial_state[:, None] + 0.01 * rng.normal(size=(n, m))
    s = (
        rng.normal(size=(n, len(model.sensitivities), m))
        * model.kernels.structure.sensitivity_pattern[..., None]
    )
    p = model.default_parameters[:, None] * (1.0 + 0.01 * rng.random((len(model.parameters), m)))
    u = rng.normal(size=(len(model.inputs), m))
    return 0.1 * np.arange(m), y, s, p, u


@pytest.mark.usefixtures("way")
def test_points_have_the_bits_of_single_calls(model, points):
    t, y, s, p, u = points
    names = ["rhs", "jacobian", "output_values", "constraint_values"]
    for name in names:
        call, own = getattr(model.kernels, name), {} if name == "constraint_values" else {"u": u}
        together = call(t, y, p=p, **own)
        for j in range(len(t)):
            at = {key: value[:, j] for key, value in own.items()}
            assert np.array_equal(together[..., j], call(t[j], y[:, j], p=p[:, j], **at))
    for name in ("sensitivity_rhs", "output_sensitivity"):
        call = getattr(model, name)
        together = call(t, y, s, p, u)
        for j in range(len(t)):
            assert np.array_equal(
                together[..., j], call(t[j], y[:, j], s[..., j], p[:, j], u[:, j])
            )


@pytest.mark.usefixtures("way")
def test_what_points_share_is_given_once(model, points):
    t, y, _, p, u = points
    first = p[:, 0]
    alone = [model.rhs(0.2, y[:, j], first) for j in range(len(t))]
    assert np.array_equal(model.rhs(0.2, y, first), np.transpose(alone))
    named = dict(zip(model.parameters, first.tolist(), strict=True))
    assert np.array_equal(model.rhs(0.2, y, named), np.transpose(alone))
    whole = model.rhs(np.full(len(t), 0.2), y.tolist(), np.tile(first[:, None], (1, len(t))))
    assert np.array_equal(whole, np.transpose(alone))
    driven = [model.rhs(0.2, y[:, j], first, u[:, 0]) for j in range(len(t))]
    assert np.array_equal(model.rhs(0.2, y, first, u[:, 0]), np.transpose(driven))
    # A call at one point after those of many has its own parameters again.
    assert np.array_equal(model.rhs(0.2, y[:, 0]), model.rhs(0.2, y[:, :1])[:, 0])
    assert model.rhs(0.2, y[:, :0]).shape == (len(model.states), 0)


@pytest.mark.usefixtures("way")
def test_errors_name_the_column():
    model = load("slider-pendulum").compile(["L"])
    y = np.tile(model.initial_state[:, None], (1, 3))
    p = np.tile(model.default_parameters[:, None], (1, 3))
    p[model.parameters.index("L"), 1] = np.nan
    with pytest.raises(ParameterError, match="column 1: parameter 'L' is not finite"):
        model.rhs(0.0, y, p)
    with pytest.raises(ParameterError, match="column 2: t is inf"):
        model.rhs([0.0, 1.0, np.inf], y)
    for wrong in ({"t": [0.0, 1.0]}, {"p": p[:, :2]}, {"u": np.zeros((1, 3))}):
        with pytest.raises(ParameterError, match="must be an array of shape"):
            model.rhs(**{"t": 0.0, "y": y, **wrong})
    with pytest.raises(ParameterError, match=r"the states must be an array of shape \(4, 3\)"):
        model.rhs(0.0, y[:3])
    with pytest.raises(ParameterError, match=r"the states must be an array of shape \(4,\)"):
        model.kernels.jacobian_sparse(0.0, y)
