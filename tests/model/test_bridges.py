"""Rates as functions of CasADi, JAX and PyTorch: the values of the model, exact derivatives."""

from __future__ import annotations

import subprocess
import sys
from importlib.util import find_spec

import numpy as np
import pytest

import cotree
from cotree.errors import ParameterError

POINT = np.array([0.1, -0.2, 0.3, 0.4])


@pytest.fixture(scope="module")
def cart():
    """Return a model with an input, and two of its parameters."""
    model = cotree.load("cart-pole").compile(["L", "m"])
    assert model.inputs == ("push",)
    return model, np.array([1.5]), np.array([0.7, 0.3])


def by_differences(model, u, p):
    """Differentiate the rates by complex-free central differences, good to about 1e-9."""

    def rates(z):
        given = dict(zip(model.sensitivities, z[5:], strict=True))
        return model.rhs(0.0, z[:4], given, z[4:5])

    z, h = np.concatenate([POINT, u, p]), 1e-5
    columns = [(rates(z + h * row) - rates(z - h * row)) / (2 * h) for row in np.eye(len(z))]
    return np.array(columns).T


def test_casadi_has_the_rates_and_their_jacobian(cart):
    casadi = pytest.importorskip("casadi", reason="casadi is not installed")
    model, u, p = cart
    function = model.as_casadi()
    x, v, q = casadi.MX.sym("x", 4), casadi.MX.sym("u", 1), casadi.MX.sym("p", 2)
    rates = function(x, v, q)
    jacobian = casadi.jacobian(rates, casadi.vertcat(x, v, q))
    whole = casadi.Function("whole", [x, v, q], [rates, jacobian])
    found, derivatives = whole(POINT, u, p)
    given = dict(zip(model.sensitivities, p, strict=True))
    np.testing.assert_array_equal(found.full().ravel(), model.rhs(0.0, POINT, given, u))
    # Differences of steps of 1e-5 lose 1e-10 by curvature, and 1e-11 by rounding.
    np.testing.assert_allclose(derivatives.full(), by_differences(model, u, p), atol=1e-7)


# JAX and PyTorch start threads, after which other tests could not fork: each has its own process.
JAX = r"""
import os

if hasattr(os, "sched_setaffinity"):  # JAX has as many threads as the process has cores
    os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:1])
import jax
import numpy as np
import pytest

import cotree
from cotree.errors import ParameterError

model = cotree.load("cart-pole").compile(["L", "m"])
x, u, p = np.array({x}), np.array({u}), np.array({p})
with pytest.raises(ParameterError, match="jax_enable_x64"):
    model.as_jax()
jax.config.update("jax_enable_x64", True)
function = model.as_jax()
given = dict(zip(model.sensitivities, p, strict=True))
np.testing.assert_array_equal(function(x, u, p), model.rhs(0.0, x, given, u))
for derive in (jax.jacfwd, jax.jacrev):
    found = jax.jit(derive(function, argnums=(0, 1, 2)))(x, u, p)
    np.testing.assert_allclose(np.hstack(found), np.array({known}), atol=1e-7)
points = np.stack([x, 2 * x])
many = jax.vmap(lambda x: function(x, u, p))(points)
np.testing.assert_allclose(many[1], function(points[1], u, p), rtol=1e-15)

# All points of a batch are evaluated in one call, in SIMD lanes.
rng = np.random.default_rng(1)
xs, us = rng.normal(size=(300, 4)), rng.normal(size=(300, 1))
ps = p * (1 + 0.1 * rng.random((300, 2)))
calls, rhs = [], model.kernels.rhs
model.kernels.rhs = lambda *given: calls.append(1) or rhs(*given)
many = jax.jit(jax.vmap(function))(xs, us, ps)
np.testing.assert_allclose(function(xs, us, ps), many, rtol=1e-15)
np.testing.assert_allclose(function(xs, u, p), jax.vmap(function, (0, None, None))(xs, u, p))
assert len(calls) == 4
del model.kernels.rhs
derive = jax.jacrev(function, argnums=(0, 1, 2))
slopes = jax.vmap(derive)(xs, us, ps)
for i in (0, 299):
    np.testing.assert_allclose(many[i], function(xs[i], us[i], ps[i]), rtol=1e-12)
    for block, alone in zip(slopes, derive(xs[i], us[i], ps[i]), strict=True):
        np.testing.assert_allclose(block[i], alone, rtol=1e-11, atol=1e-12)
nested = jax.vmap(jax.vmap(function, (None, 0, None)), (0, None, None))(xs[:3], us[:2], p)
np.testing.assert_allclose(nested[2, 1], function(xs[2], us[1], p), rtol=1e-12)
# JAX would copy arrays of this size in its thread, which waits in the callback.
many = np.tile(xs, (67, 1))
whole = jax.jit(lambda x: function(x, u, p))(many)
np.testing.assert_allclose(whole[-300:], jax.vmap(function, (0, None, None))(xs, u, p), rtol=1e-15)
# Without inputs and parameters, and without points.
free = cotree.load("slider-pendulum").compile()
np.testing.assert_allclose(free.as_jax()(many).T, free.rhs(0.0, many.T), rtol=1e-12, atol=1e-12)
by_state = jax.vmap(jax.jacfwd(free.as_jax()))(xs)
known = np.moveaxis(free.jacobian(0.0, xs.T), -1, 0)
np.testing.assert_allclose(by_state, known, rtol=1e-12, atol=1e-12)
assert free.as_jax()(xs[:0]).shape == (0, 4)
with pytest.raises(ParameterError, match=r"u must be an array of shape \(..., 1\), not \(2,\)"):
    function(x, x[:2], p)
"""


TORCH = r"""
import numpy as np
import pytest
import torch

import cotree
from cotree.errors import ParameterError

model = cotree.load("cart-pole").compile(["L", "m"])
function = model.as_torch()
x, v, q = (torch.tensor(row, dtype=torch.float64) for row in ({x}, {u}, {p}))
given = dict(zip(model.sensitivities, {p}, strict=True))
np.testing.assert_array_equal(function(x, v, q), model.rhs(0.0, {x}, given, {u}))
for derive in (torch.func.jacrev, torch.func.jacfwd):
    found = np.hstack(derive(function, argnums=(0, 1, 2))(x, v, q))
    np.testing.assert_allclose(found, {known}, atol=1e-7)
with pytest.raises(ParameterError, match=r"x must be an array of shape \(..., 4\), not \(3,\)"):
    function(x[:3], v, q)

rng, p = np.random.default_rng(2), np.array({p})
def drawn(*shape):
    return torch.tensor(rng.normal(size=shape), requires_grad=True)

q = torch.tensor(p, requires_grad=True)

for own in (q, torch.tensor(p * (1 + 0.1 * rng.random((3, 2))), requires_grad=True)):
    assert torch.autograd.gradcheck(function, (drawn(3, 4), drawn(3, 1), own))
    assert torch.autograd.gradcheck(function, (drawn(2, 3, 4), drawn(3, 1), own))
assert torch.autograd.gradcheck(function, (drawn(4), drawn(1), q), check_forward_ad=True)
# Lanes evaluate all points in one call.
x, v = drawn(300, 4).detach(), drawn(300, 1).detach()
together = torch.func.vmap(function, (0, 0, None))(x, v, q.detach())
np.testing.assert_allclose(function(x, v, q.detach()), together, rtol=1e-15)
slopes = torch.func.vmap(torch.func.jacrev(function, argnums=(0, 1, 2)), (0, 0, None))
for i, (row, blocks) in enumerate(zip(together, zip(*slopes(x, v, q.detach())), strict=True)):
    if i % 99 == 0:
        np.testing.assert_allclose(row, function(x[i], v[i], q.detach()), rtol=1e-12)
        alone = torch.func.jacrev(function, argnums=(0, 1, 2))(x[i], v[i], q.detach())
        for block, one in zip(blocks, alone, strict=True):
            np.testing.assert_allclose(block, one, rtol=1e-11, atol=1e-12)
free = cotree.load("slider-pendulum").compile()
rows = free.as_torch()(x)
np.testing.assert_allclose(rows.T, free.rhs(0.0, x.numpy().T), rtol=1e-15)
assert torch.autograd.gradcheck(free.as_torch(), (drawn(3, 4),))
assert free.as_torch()(x[:0]).shape == (0, 4)
with pytest.raises(ParameterError, match="first derivatives only"):
    torch.autograd.gradgradcheck(function, (drawn(4), drawn(1), q))
"""


@pytest.mark.parametrize(("name", "program"), [("jax", JAX), ("torch", TORCH)])
def test_batches_have_the_rates_and_their_derivatives_both_ways(cart, name, program):
    if find_spec(name) is None:
        pytest.skip(f"{name} is not installed")
    model, u, p = cart
    arrays = {"x": POINT, "u": u, "p": p, "known": by_differences(model, u, p)}
    for key, array in arrays.items():
        program = program.replace(f"{{{key}}}", repr(array.tolist()))
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr


def test_models_without_explicit_rates_are_refused():
    with pytest.raises(ParameterError, match=r"'motor-linkage' has constraints"):
        cotree.load("motor-linkage").compile().as_jax()
    with pytest.raises(ParameterError, match=r"'bridge-rectifier' has algebraic unknowns"):
        cotree.load("bridge-rectifier").compile().as_casadi()


def test_rates_that_depend_on_time_ask_for_it():
    scene = cotree.Scene("timed")
    scene.edge("V", "voltage_source", "a", "ground", voltage="sin(t)")
    scene.edge("R", "resistor", "a", "b", resistance=1.0)
    scene.edge("C", "capacitor", "b", "ground", capacitance=1.0)
    with pytest.raises(ParameterError, match=r"depend on time: .*as_casadi\(t=0\.0\)"):
        scene.compile().as_casadi()
