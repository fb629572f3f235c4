"""Rates as functions of CasADi and JAX: values are those of the model, derivatives are exact."""

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


# JAX starts threads, after which other tests could not fork: it runs in a process of its own.
JAX = """
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
"""


def test_jax_has_the_rates_and_their_derivatives_both_ways(cart):
    if find_spec("jax") is None:
        pytest.skip("jax is not installed")
    model, u, p = cart
    arrays = {"x": POINT, "u": u, "p": p, "known": by_differences(model, u, p)}
    program = JAX.format(**{name: array.tolist() for name, array in arrays.items()})
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
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
