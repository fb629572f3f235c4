from __future__ import annotations

import dataclasses
import itertools
import random

import numpy as np
import pytest

from cotree.dag.evaluate import evaluate
from cotree.dag.multi_output import solve
from cotree.dag.nodes import Dag, dependent, reachable, symbols_in
from cotree.program.kernels import KERNELS
from cotree.program.passes import RECIPE, run_passes, stage_parameters


def _values(program, rng):
    """Evaluate every kernel from scratch at a random point near one."""
    roots = [node for name, k in program.kernels.items() if name != "prepare" for node in k.results]
    point = {node: rng.uniform(0.5, 1.5) for node in symbols_in(roots)}
    return np.array(evaluate(roots, point))


@pytest.mark.parametrize("name", list(RECIPE))
def test_each_pass_keeps_the_values(lowered_of, scene_name, name):
    program = lowered_of(scene_name)
    for each, transform in RECIPE.items():
        before, program = program, transform(program)
        if each == name:
            break
    for seed in range(5):
        expected = _values(before, random.Random(seed))
        found = _values(program, random.Random(seed))
        # A product with a reciprocal rounds twice where a division rounds once; the values here
        # are of size 1 to 100 and lose a few digits by cancellation at most.
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)


def test_reports_count_before_and_after(lowered_of, scene_name):
    lowered = lowered_of(scene_name)
    program, reports = run_passes(lowered)
    assert [report.name for report in reports] == list(RECIPE)
    first, last = reports[0], reports[-1]
    assert first.before == {n: k.operations.total for n, k in lowered.kernels.items()}
    assert last.after == {n: k.operations.total for n, k in program.kernels.items()}
    for one, next_one in itertools.pairwise(reports):
        assert one.after == next_one.before
    # Staging moves work out of every kernel into prepare.
    stage = next(report for report in reports if report.name == "stage")
    assert stage.after["prepare"] > stage.before["prepare"] == 0
    for name in set(KERNELS) - {"prepare"}:
        assert last.after[name] <= first.before[name]


@pytest.mark.parametrize("sensitivities", [None, ["L", "j1.s"]])
def test_no_kernel_but_prepare_computes_what_depends_on_parameters_only(
    program_of, scene_name, sensitivities
):
    if sensitivities and scene_name != "slider-pendulum":
        sensitivities = ["k", "s.s"]
    program = program_of(scene_name, sensitivities)
    for name, kernel in program.kernels.items():
        if name == "prepare":
            continue
        order = reachable(kernel.results)
        varying = dependent(
            order, [node for node in order if node.op == "symbol" and node.data[0] != "p"]
        )
        own = [node for node in kernel.order if node not in kernel.prepared]
        constant = [node for node in own if node.args and node not in varying]
        assert constant == [], name


def test_prepare_holds_nothing_but_parameters_and_nothing_unread(program_of, scene_name):
    program = program_of(scene_name)
    prepare = program.kernels["prepare"]
    assert {node.data[0] for node in symbols_in(prepare.results)} == {"p"}
    read = {node for k in program.kernels.values() for node in k.order if node in k.prepared}
    assert read == set(prepare.results)
    assert program.n_prepared == len(prepare.results)
    assert list(program.kernels["rhs"].prepared.values()) == list(range(program.n_prepared))


def _divisions(results):
    return sum(node.op == "div" for node in reachable(results))


def test_repeated_divisors_are_inverted_once(made_up):
    dag = Dag()
    a, b, c = (dag.symbol("x", i) for i in range(3))
    program = RECIPE["reciprocals"](made_up(dag, rhs=[a / c, b / c, (a + b) / c]))
    assert _divisions(program.kernels["rhs"].results) == 1


def test_single_divisions_stay(made_up):
    dag = Dag()
    a, b = dag.symbol("x", 0), dag.symbol("x", 1)
    program = made_up(dag, rhs=[a / b])
    assert RECIPE["reciprocals"](program).kernels["rhs"].results == (a / b,)


def test_divisors_of_parameters_are_inverted_by_prepare(made_up):
    dag = Dag()
    x, p = dag.symbol("x", 0), dag.symbol("p", 0)
    program, _ = run_passes(made_up(dag, rhs=[x / p]))
    assert program.kernels["prepare"].results == (1.0 / p,)
    assert program.kernels["rhs"].operations.by_kind == {"mul": 1}


def test_kernels_share_prepared_values(made_up):
    dag = Dag()
    x, p = dag.symbol("x", 0), dag.symbol("p", 0)
    root = dag.function("sin", p)
    program = stage_parameters(made_up(dag, rhs=[root * x], outputs=[root + x, root]))
    assert program.kernels["prepare"].results == (root,)
    assert program.kernels["rhs"].prepared == program.kernels["outputs"].prepared == {root: 0}


def test_constants_and_bare_parameters_are_not_prepared(made_up):
    dag = Dag()
    x, p = dag.symbol("x", 0), dag.symbol("p", 0)
    program = stage_parameters(made_up(dag, rhs=[p * x, p, dag.one]))
    assert program.n_prepared == 0


def test_results_of_a_parameter_only_solve_are_prepared_one_by_one(made_up):
    dag = Dag()
    x, p = dag.symbol("x", 0), dag.symbol("p", 0)
    unknown, *_ = solve(dag, [[p]], [dag.one])
    program = stage_parameters(made_up(dag, rhs=[unknown * x]))
    assert program.kernels["prepare"].results == (unknown,)
    assert program.kernels["rhs"].operations.by_kind == {"mul": 1}


def test_passes_are_pure(lowered_of, scene_name):
    program = lowered_of(scene_name)
    before = dataclasses.replace(program)
    kernels = dict(program.kernels)
    run_passes(program)
    assert program == before
    assert program.kernels == kernels
