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


CALLS = {
    "rhs": "rhs",
    "jacobian": "jacobian",
    "outputs": "output_values",
    "sensitivity_rhs": "sensitivity_rhs",
    "output_sensitivity": "output_sensitivity",
}


@pytest.mark.compiler
@pytest.mark.parametrize("share", ["all", "none"])
def test_lanes_have_the_values_of_single_points(model, share, monkeypatch):
    monkeypatch.setattr(columns, "_MANY", 8)
    rng, n, m = np.random.default_rng(4), len(model.states), 83
    y = model.initial_state[:, None] + 0.01 * rng.normal(size=(n, m))
    s = rng.normal(size=(n, len(model.sensitivities), m))
    s *= model.kernels.structure.sensitivity_pattern[..., None]
    p, u = model.default_parameters, None
    if share == "none":
        p = p[:, None] * (1.0 + 0.01 * rng.random((len(p), m)))
        u = rng.normal(size=(len(model.inputs), m))
    t = 0.01 * np.arange(m)
    for kernel, name in CALLS.items():
        call = getattr(model, name)
        slopes = {"s": s} if "sensitivity" in name else {}
        together = call(t, y, p=p, u=u, **slopes)
        for j in (0, 7, 8, 60, 82):
            own = {key: value[..., j] for key, value in slopes.items()}
            own |= {"p": p[..., j], "u": u[:, j]} if share == "none" else {"p": p}
            alone = call(t[j], y[:, j], **own)
            # Sines and fused sums differ in their last digit, which sums of large terms keep.
            size = max(1.0, np.max(np.abs(alone), initial=0.0))
            np.testing.assert_allclose(together[..., j], alone, rtol=1e-12, atol=1e-13 * size)
        # Bits depend neither on the lane nor on the threads.
        monkeypatch.setattr(columns, "_FIRST", 16)
        monkeypatch.setattr(columns, "_WORTH", 1e-12)
        few = {key: value[..., 5:29] for key, value in slopes.items()}
        few |= {"p": p[..., 5:29], "u": u[:, 5:29]} if share == "none" else {"p": p}
        assert np.array_equal(call(t, y, p=p, u=u, **slopes), together)
        assert np.array_equal(call(t[5:29], y[:, 5:29], **few), together[..., 5:29])
        has_solve = any(row.op == "solve" for row in model.kernels.program.kernels[kernel].order)
        assert (model.kernels.code.in_lanes(kernel) is None) == has_solve


@pytest.mark.compiler
def test_lanes_stop_at_the_column_that_a_guard_rejects(monkeypatch):
    monkeypatch.setattr(columns, "_MANY", 8)
    model = load("slider-pendulum").compile()
    y = np.tile(model.initial_state[:, None], (1, 40))
    p = np.tile(model.default_parameters[:, None], (1, 40))
    p[model.parameters.index("m1"), 21] = -1.0
    with pytest.raises(ParameterError, match="column 21: "):
        model.rhs(0.0, y, p)


@pytest.mark.compiler
@pytest.mark.parametrize("features", ["", "avx2", "avx2 fma"])
def test_lanes_of_other_processors_agree(features, monkeypatch):
    if not set(features.split()) <= set(columns.cpu_features().split()):
        pytest.skip(f"this processor lacks {features}")
    monkeypatch.setattr(columns, "_MANY", 8)
    monkeypatch.setattr(columns, "cpu_features", lambda: features)
    for name in ("battery-cell", "slider-pendulum"):
        model = load(name).compile()
        y = model.initial_state[:, None] + 0.1 * np.random.default_rng(5).random((1, 19))
        together = model.rhs(0.1, y)
        alone = np.transpose([model.rhs(0.1, column) for column in y.T])
        assert model.kernels.code.in_lanes("rhs") is not None
        if name == "battery-cell" and "fma" not in features:
            assert np.array_equal(together, alone)
        np.testing.assert_allclose(together, alone, rtol=1e-13, atol=1e-14)
