"""Derivatives along many directions: the way that is chosen, its cost, and its results."""

from __future__ import annotations

import random

import numpy as np
import pytest
from robot_files import INERTIAL, read, stored_file
from rod_chain import rod_chain

from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import BLOCK
from cotree.dag.nodes import symbols_in
from cotree.pipeline import formulate, generate
from cotree.program import columns
from cotree.program.lower import lower

UR5_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


def _maps(program, kernel):
    return [node.data for node in program.kernels[kernel].order if node.op == "map"]


@pytest.fixture(scope="module")
def ur5():
    """UR5 with sensitivities to all inertial numbers of its links."""
    names = [f"{link}_link_{number}" for link in UR5_LINKS for number in INERTIAL]
    return formulate(read(stored_file("ur5")), names, None)[1]


@pytest.mark.slow
def test_many_parameters_take_the_jacobian_times_their_sensitivities(ur5):
    program, _ = generate(ur5)
    # 60 parameters, 12 states: one map of all took 101 thousand.
    assert program.operations["augmented_rhs"].total < 31_000
    jacobian, _, products = _maps(program, "augmented_rhs")
    assert _maps(program, "jacobian") == [jacobian]  # printed once
    assert products.n_columns == 60
    # Six accelerations by twelve states, but for what turns with the first joint about its axis:
    # of its ten numbers all but four act on nothing.
    assert program.layout.sensitivity_starts[-1] == 54 * 12
    assert products.counts.total() == 2 * 6 * (54 * 12)


@pytest.mark.slow
def test_the_jacobian_times_sensitivities_is_what_statements_give(ur5, monkeypatch):
    kernels = ["augmented_rhs", "jacobian"]
    found = [node for name in kernels for node in lower(ur5).kernels[name].results]
    monkeypatch.setattr(columns, "_WORTH", 0.0)
    expected = [node for name in kernels for node in lower(ur5).kernels[name].results]
    assert not any(node.op == "map" for node in expected)
    rng = random.Random(1)
    numbers = dict(zip(((q.name) for q in ur5.parameters), ur5.parameter_values, strict=True))
    values = list(numbers.values())
    point = {
        node: values[node.data[1]] if node.data[0] == "p" else rng.uniform(-1.0, 1.0)
        for node in symbols_in([*found, *expected])
    }
    np.testing.assert_allclose(
        evaluate(found, point),
        evaluate(expected, point),
        # Sums in orders of their own; the mass matrix enlarges rounding some hundred times.
        rtol=1e-10,
        atol=1e-10,
    )


def test_few_parameters_take_one_map():
    scene, names = rod_chain(10)
    program, _ = generate(formulate(scene, names, None)[1])
    assert [linear.n_columns for linear in _maps(program, "augmented_rhs")] == [20]


def test_limbs_do_not_pay_for_each_other():
    """On four legs most of what moves along one joint vanishes along those of the other legs."""
    program, _ = generate(formulate(read(stored_file("solo12"), "free"), [], None)[1])
    (linear,) = _maps(program, "jacobian")
    assert linear.n_columns == 31  # nothing depends on where the base is
    n_blocks = -(-linear.n_columns // BLOCK)
    assert linear.n_times < n_blocks * len(linear.statements) / 2.5
    # Exact zeros count more: blocks hold columns of more than one joint.
    assert linear.counts.total() < linear.n_columns * len(linear.statements) / 3.0
