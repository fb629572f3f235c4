"""Direct effects of parameters enter sensitivity graphs where these parameters stand."""

from __future__ import annotations

import random

import numpy as np
import pytest
from rod_chain import rod_chain

import cotree
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import SENSITIVITY, STATE_CHANGE, substitute, symbols_in
from cotree.pipeline import formulate
from cotree.program.columns import part_sources


def _driven():
    """Draw a chain that is pulled by an input of parameters, and by parameters themselves."""
    scene, names = rod_chain(3)
    scene.parameter("F", 2.0)
    scene.parameter("f", 3.0)
    scene.input("drive", "F*sin(f*t)")
    scene.edge("pull", "force", "ground", "E1", force=["drive + F*f", 0, 0])
    return scene, [*names, "F", "f"]


def _shipped(name):
    scene = cotree.load(name)
    return scene, [parameter.name for parameter in scene.parameters.values() if parameter.tunable]


SCENES = {
    "chain": lambda: rod_chain(4),
    "driven": _driven,
    **{
        name: lambda name=name: _shipped(name)
        for name in ("slider-pendulum", "crane", "motor-linkage", "spring-mass-damper")
    },
}


@pytest.mark.sampled(2)
@pytest.mark.parametrize("draw", SCENES.values(), ids=SCENES)
def test_both_parts_together_are_the_derivatives(draw):
    equations = formulate(*draw(), None)[1]
    dag, n = equations.dag, len(equations.states)
    parted = part_sources(equations, {})
    common = parted.direction
    found, expected = [], []
    for j, row in enumerate(equations.sensitivities):
        given = {node: parted.given[j].get(i, dag.zero) for i, node in enumerate(parted.sources)}
        moved = {dag.symbol(STATE_CHANGE, i): dag.symbol(SENSITIVITY, j * n + i) for i in range(n)}
        found += substitute([*common.forcing, *common.rates.values()], {**given, **moved})
        expected += [*row.forcing, *(row.rates.get(i, dag.zero) for i in common.rates)]
    rng = random.Random(0)
    point = {node: rng.uniform(0.5, 1.0) for node in symbols_in([*found, *expected])}
    # Sums in orders of their own, of some tens of numbers.
    np.testing.assert_allclose(
        evaluate(found, point), evaluate(expected, point), rtol=1e-12, atol=1e-12
    )


def test_each_parameter_has_as_many_sources_however_long_the_chain_is():
    """Lengths and masses act on their rod and on where the next one begins."""
    most = []
    for n in (5, 20):
        equations = formulate(*rod_chain(n), None)[1]
        solved = {node: equations.dag.symbol("w", i) for i, node in enumerate(equations.unknowns)}
        most.append(max(map(len, part_sources(equations, solved).given)))
    assert most[1] <= most[0] <= 7
