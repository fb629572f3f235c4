"""Offsets at which maps write their results."""

from __future__ import annotations

from dataclasses import replace

import pytest
from rod_chain import rod_chain

from cotree.codegen.node_statements import starts_of_maps
from cotree.dag.multi_output import results
from cotree.pipeline import formulate, generate


@pytest.mark.parametrize("kernel", ["jacobian", "augmented_rhs"])
def test_columns_are_written_to_where_they_belong(kernel):
    """Columns of speeds have an entry before those of the map: one, the rate of a coordinate."""
    scene, names = rod_chain(6)
    wanted = generate(formulate(scene, names, None)[1])[0].kernels[kernel]
    (node,) = (node for node in wanted.order if node.op == "map")
    starts, n = starts_of_maps(wanted)[node].places, len(node.data.results)
    for i, result in enumerate(results(node, node.data.n_results)):
        assert wanted.results[starts[i // n] + i % n] is result
    assert len(set(starts)) == node.data.n_columns


def test_results_that_a_kernel_wants_otherwise_have_an_array_of_their_own():
    scene, names = rod_chain(6)
    wanted = generate(formulate(scene, names, None)[1])[0].kernels["jacobian"]
    assert not starts_of_maps(replace(wanted, results=(*wanted.results[:-1], wanted.results[0])))
