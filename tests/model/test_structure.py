"""The Jacobian's pattern and the colours of its columns."""

from __future__ import annotations

import numpy as np
import pytest
from network_scenes import rc_ladder
from rod_chain import rod_chain

from cotree import Scene, load


def masses_on_a_line(n):
    scene = Scene("line")
    for i in range(n):
        ends = [f"a{i - 1}" if i else "ground", f"a{i}"]
        scene.edge(f"m{i}", "translational_mass", "ground", ends[1], mass=1.0)
        scene.edge(f"k{i}", "translational_spring", *ends, stiffness=1.0 + i)
        scene.edge(f"d{i}", "translational_damper", *ends, damping=0.1)
    return scene


def scenes():
    return {
        "ladder": (rc_ladder(40), 3),  # a band of three
        "one stage": (rc_ladder(1), 1),
        # Rates of masses depend on three speeds and two springs; springs on two speeds.
        "masses": (masses_on_a_line(30), 5),
        # The rate of each speed depends on all angles and speeds.
        "rods": (rod_chain(5)[0], 10),
        "crane": (load("crane"), None),
    }


@pytest.mark.sampled(2)
@pytest.mark.parametrize("name", list(scenes()))
def test_one_product_for_each_colour_gives_all_entries(name):
    scene, expected = scenes()[name]
    model = scene.compile()
    colours = model.kernels.structure.jacobian_colouring
    n = len(model.states)
    assert sorted(set(colours.tolist())) == list(range(colours.max() + 1))
    if expected is not None:
        assert colours.max() + 1 == expected
    y = model.initial_state + np.random.default_rng(0).normal(0.0, 0.1, n)
    exact = model.kernels.jacobian_sparse(0.1, y)
    seeds = np.equal.outer(colours, np.arange(colours.max() + 1)).astype(float)
    products = exact @ seeds
    pattern = model.kernels.structure.jacobian_sparsity.tocoo()
    found = np.zeros((n, n))
    found[pattern.row, pattern.col] = products[pattern.row, colours[pattern.col]]
    # Each product has one entry in a row, and zeros.
    assert np.array_equal(found, exact.toarray())


def test_the_pattern_is_that_of_the_sparse_jacobian():
    model = rc_ladder(20).compile()
    sparse, pattern = (
        model.kernels.jacobian_sparse(0.0, model.initial_state),
        model.kernels.structure.jacobian_sparsity,
    )
    assert np.array_equal(pattern.indptr, sparse.indptr)
    assert np.array_equal(pattern.indices, sparse.indices)
    assert np.array_equal(pattern.toarray(), model.kernels.structure.jacobian_pattern)
    assert pattern.nnz == 3 * 20 - 2


def test_colours_of_a_model_without_states():
    scene = Scene("bare")
    scene.edge("V", "voltage_source", "a", "ground", voltage=1.0)
    scene.edge("R", "resistor", "a", "ground", resistance=1.0)
    assert scene.compile().kernels.structure.jacobian_colouring.shape == (0,)
