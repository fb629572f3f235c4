"""Second derivatives of the rates, against differences of the sensitivities' rates."""

from __future__ import annotations

import numpy as np
import pytest

from cotree import load
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import ARGUMENT_OF, symbols_in
from cotree.program.columns import form_curvature


@pytest.mark.parametrize(
    ("scene", "names"), [("slider-pendulum", ["L", "k"]), ("bridge-rectifier", ["C", "Is"])]
)
def test_agrees_with_differences(scene: str, names: list[str]) -> None:
    model = load(scene).compile(names)
    program, p = model.kernels.program, model.default_parameters
    curvature = form_curvature(program)
    assert curvature is not None
    rng = np.random.default_rng(1)
    n, m = len(model.states), len(names)
    x, s, v = 0.1 * rng.normal(size=n), rng.normal(size=(n, m)), rng.normal(size=n)
    t = 0.3

    given = {"t": [t], "x": x, "s": s.T.ravel(), "p": p, "u": model.kernels.input_values(t), "v": v}
    symbols = symbols_in([*curvature.at.results, *curvature.along.results])
    values = {node: float(given[ARGUMENT_OF[node.data[0]]][node.data[1]]) for node in symbols}
    found = np.zeros(n * m)
    found[list(curvature.places)] = evaluate(curvature.along.results, values)

    step = 1e-5
    ahead, behind = (model.sensitivity_rhs(t, x + e * v, s) for e in (step, -step))
    expected = ((ahead - behind) / (2.0 * step)).T.ravel()
    # The third root of rounding: what a central difference is good to.
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-6 * size)


def test_rates_that_do_not_depend_on_states_have_none() -> None:
    # An initial value: the rates of its sensitivities are J s, and J is constant.
    assert form_curvature(load("spring-mass-damper").compile(["x0"]).kernels.program) is None
