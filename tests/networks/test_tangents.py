"""Sensitivity graphs of every scalar component against the complex step, on its page's example."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from cotree import Scene
from cotree.components import COMPONENTS, OWN, Role
from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import PACKED_SENSITIVITY, SENSITIVITY
from cotree.pipeline import formulate
from cotree.program.lower import lower
from cotree.scene.toml_file import read_scene

PAGES = Path(__file__).parents[2] / "docs" / "components"
NETWORK = [
    name
    for name, row in COMPONENTS.items()
    if name in OWN and row.role is Role.NETWORK and (PAGES / f"{name}.md").exists()
]


@pytest.mark.sampled(9)
@pytest.mark.parametrize("name", NETWORK)
def test_graphs_agree_with_the_complex_step(name):
    text = (PAGES / f"{name}.md").read_text(encoding="utf-8")
    scene = read_scene(re.findall(r"```toml\n(.*?)```", text, re.DOTALL)[0], name, Scene)
    wanted = list(scene.parameters)
    _, equations, _ = formulate(scene, wanted, None)
    program = lower(equations)
    dag, n = equations.dag, len(equations.states)
    parameters = [dag.symbol("p", i) for i in range(len(wanted))]
    values = dict(zip(parameters, equations.parameter_values, strict=True))
    values[dag.symbol("t", 0)] = 0.37
    random = np.random.default_rng(3)
    start = evaluate([state.initial for state in equations.states], values)
    states = [state.symbol for state in equations.states]
    # Near the start, since laws hold for positive temperatures and concentrations.
    values |= {s: 1.1 * x + 0.1 * random.random() for s, x in zip(states, start, strict=True)}
    layout = program.layout
    reached = np.zeros((len(wanted), n))
    for j, (first, last) in enumerate(pairwise(layout.sensitivity_starts)):
        reached[j, list(layout.sensitivity_rows[first:last])] = 1.0
    # Those that vanish are never anything else, and rates know the others only, one after another.
    seeds = random.normal(size=(len(wanted), n)) * reached
    left = reached.ravel() > 0.0

    def along(nodes, direction):
        h = 1e-30  # the complex step subtracts nothing
        moved = {k: v + 1j * h * direction.get(k, 0.0) for k, v in values.items()}
        return np.imag(evaluate(nodes, moved, "complex_")) / h

    def close(found, expected):
        # The same products in another order; a few hundred roundings.
        size = np.max(np.abs(expected), initial=1e-300)
        np.testing.assert_allclose(np.array(found) / size, np.array(expected) / size, atol=1e-12)

    kernels = {key: list(row.results) for key, row in program.kernels.items()}
    dense = np.zeros((n, n))
    found = evaluate(kernels["jacobian"], values)
    for j in range(n):
        for k in range(program.layout.column_starts[j], program.layout.column_starts[j + 1]):
            dense[program.layout.row_indices[k], j] = found[k]
    close(dense, np.array([along(kernels["rhs"], {s: 1.0}) for s in states]).T)
    directions = [
        {p: 1.0, **dict(zip(states, seed, strict=True))}
        for p, seed in zip(parameters, seeds, strict=True)
    ]

    def graphs(kernel, given):
        # Either kind, in the order of the kernel's argument.
        kinds = (SENSITIVITY, PACKED_SENSITIVITY)
        known = {dag.symbol(kind, i): float(s) for i, s in enumerate(given) for kind in kinds}
        return evaluate(kernels[kernel], values | known)

    rates, outputs = (
        np.concatenate([along(kernels[kernel], d) for d in directions])
        for kernel in ("rhs", "outputs")
    )
    assert not rates[~left].any()
    close(graphs("sensitivity_rhs", seeds.ravel()[left]), rates[left])
    close(graphs("output_sensitivity", seeds.ravel()), outputs)
