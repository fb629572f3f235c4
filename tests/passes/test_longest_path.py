"""Passes and eliminations that shorten the longest path: same values, fewer cycles."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest

from cotree.dag.evaluate import evaluate
from cotree.dag.nodes import Dag, symbols_in
from cotree.formulation.first_graph import form_first_graph, tree_links
from cotree.pipeline import formulate, trees_to_try
from cotree.program import passes as order
from cotree.program.counts import bounds, by_need
from cotree.program.lower import lower
from cotree.program.passes import RECIPE, balance_sums, run_passes
from cotree.program.solved import factorise_bordered

from rod_chain import rod_chain  # isort: skip


def _longest(nodes, known=()):
    return bounds(nodes, known)[1]


def _kernel(program, name, results):
    kernel = replace(program.kernels[name], results=tuple(results))
    return replace(program, kernels={name: kernel})


@pytest.fixture(scope="module")
def chain():
    """Lower a chain of ten rods."""
    return lower(formulate(rod_chain(10)[0], (), None)[1])


def _at_random(roots, seed):
    rng = random.Random(seed)
    return np.array(evaluate(roots, {node: rng.uniform(0.5, 1.5) for node in symbols_in(roots)}))


def test_a_long_sum_becomes_a_tree(chain):
    dag = chain.dag
    terms = [dag.symbol("x", i) * dag.symbol("x", i + 1) for i in range(16)]
    total = terms[0]
    for i, term in enumerate(terms[1:]):
        total = total + term if i % 3 else total - term
    before = _kernel(chain, "rhs", [total])
    after = balance_sums(before)
    old, new = before.kernels["rhs"], after.kernels["rhs"]
    # Fifteen sums in a row of four cycles each are four levels; one product stands before both.
    assert (_longest(old.order), _longest(new.order)) == (64.0, 20.0)
    assert new.operations.total == old.operations.total
    # Sixteen terms between 0.25 and 2.25: 16 roundings of their sum.
    np.testing.assert_allclose(_at_random(new.results, 1), _at_random(old.results, 1), atol=1e-14)


def test_what_arrives_late_is_added_last(chain):
    dag = chain.dag
    x, late = dag.symbol("x", 0), dag.function("exp", dag.symbol("x", 1))
    early = [x * x, x * dag.symbol("x", 2), x * dag.symbol("x", 3)]
    total = late + early[0] - early[1] - early[2]
    found = balance_sums(_kernel(chain, "rhs", [total])).kernels["rhs"].results[0]
    assert _longest([*balance_sums(_kernel(chain, "rhs", [total])).kernels["rhs"].order]) == 54.0
    assert late in found.args


def test_differences_of_arguments_stay(chain):
    # Of two that are close the difference is exact; a third one added first would round it away.
    dag = chain.dag
    a, b, c = (dag.symbol("x", i) for i in range(3))
    product = dag.function("exp", c) * c
    total = (a - b) + product
    found = balance_sums(_kernel(chain, "rhs", [total])).kernels["rhs"].results[0]
    assert found is total


def test_residuals_keep_their_sums(program_of):
    program = program_of("bridge-rectifier")
    assert any(program.layout.algebraic)
    assert balance_sums(program) is program


def test_balanced_chains_keep_their_values_on_a_shorter_path(chain):
    before, after = chain, balance_sums(chain)
    for name in ("rhs", "jacobian"):
        old, new = before.kernels[name], after.kernels[name]
        assert new.operations.total <= old.operations.total
        for seed in range(3):
            expected = _at_random(old.results, seed)
            # Ten rods: errors against 50 digits are 3e-13 at most.
            scale = np.max(np.abs(expected))
            np.testing.assert_allclose(
                _at_random(new.results, seed), expected, rtol=0.0, atol=1e-11 * scale
            )
    assert _longest(after.kernels["rhs"].order) < _longest(before.kernels["rhs"].order)


def test_the_order_of_needs_is_one_of_evaluation(chain):
    kernel = replace(balance_sums(chain).kernels["rhs"], is_by_need=True)
    place = {node: i for i, node in enumerate(kernel.order)}
    assert all(place[arg] < place[node] for node in place for arg in node.args)
    assert set(place) == set(replace(kernel, is_by_need=False).order)


def test_the_longest_path_stands_first_among_what_is_ready():
    dag = Dag()
    x = [dag.symbol("x", i) for i in range(4)]
    aside = x[2] * x[3]
    root = dag.function("exp", x[0] * x[1]) + aside
    order = by_need([*x, aside, *dict.fromkeys((x[0] * x[1], root.args[1], root.args[0], root))])
    # The product that the exponential waits for comes before the one that only the sum reads.
    assert order.index(x[0] * x[1]) < order.index(aside)


def test_short_kernels_keep_their_order(program_of):
    program = program_of("slider-pendulum", ["L"])
    assert RECIPE["order"](program).kernels == program.kernels


@pytest.mark.parametrize("own_axes", [(), tuple(range(1, 9))])
def test_deferred_elimination_gives_the_same_unknowns(own_axes):
    scene = rod_chain(8)[0]
    first = form_first_graph(scene, trees_to_try(scene, None)[0], own_axes)
    links = tree_links(first)
    deferred = tuple(replace(link, is_deferred=True) for link in links)
    found = []
    for each in (links, deferred, ()):
        factors = factorise_bordered(first.system.dag, first.matrix, first.is_safe, (), each)
        found.append(factors.solve(first.forcing))
    for seed in range(3):
        along, later, by_matrix = (_at_random(roots, seed) for roots in found)
        # The matrix of eight rods has a condition of some 1e3.
        scale = np.max(np.abs(by_matrix))
        np.testing.assert_allclose(later, along, rtol=0.0, atol=1e-11 * scale)
        np.testing.assert_allclose(later, by_matrix, rtol=0.0, atol=1e-11 * scale)


def test_deferring_shortens_the_path_of_a_chain():
    alternatives = formulate(rod_chain(20)[0], (), None)[2]
    assert alternatives[0].is_deferred
    other = next(row for row in alternatives if row.is_along_tree and not row.is_deferred)
    assert alternatives[0].n_cycles < other.n_cycles
    assert "along the tree, deferred" in alternatives[0].cells()


def test_kernels_of_very_many_links_stay_as_they_were_formed(monkeypatch):
    """In the order of needs links do not follow one another, and are no loops."""
    program = lower(formulate(rod_chain(20)[0], [], None)[1])
    assert run_passes(program)[0].kernels["rhs"].is_by_need
    monkeypatch.setattr(order, "_MANY", 1_000)
    assert not run_passes(program)[0].kernels["rhs"].is_by_need
