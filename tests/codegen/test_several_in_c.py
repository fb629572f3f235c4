"""Nodes with several results: C and Python give the same numbers and the same rank."""

from __future__ import annotations

import numpy as np
import pytest
from evaluated_kernels import EvaluatedKernels
from made_up_scenes import SWIRL_C, call_case, solve_case

from cotree.dag.multi_output import SolveShape, solve, solve_pivoted
from cotree.errors import SingularSystemError, SolveError
from cotree.program.passes import run_passes

pytestmark = pytest.mark.compiler

NONE = np.zeros(0)


def _systems():
    rng = np.random.default_rng(0)
    well = rng.normal(size=(4, 4))
    yield "well conditioned", well, well @ [1.0, -2.0, 0.5, 3.0]
    permuted = np.diag([2.0, 3.0, 4.0, 5.0])[[2, 0, 3, 1]]
    yield "permuted", permuted, np.array([1.0, 2.0, 3.0, 4.0])
    graded = np.diag([1e-8, 1.0, 1e3, 1e-3]) + 1e-9
    yield "graded", graded, np.ones(4)
    tiny = well * 1e-200
    yield "tiny", tiny, well @ np.ones(4) * 1e-200
    hilbert = 1.0 / (1.0 + np.add.outer(np.arange(4), np.arange(4)))
    yield "hilbert", hilbert, hilbert @ np.ones(4)


SYSTEMS = {name: (a, b) for name, a, b in _systems()}


def _both(made_up, load_kernels, dag, results, p, y=(1.0,)):
    program = made_up(dag, n_parameters=len(p), outputs=results)
    compiled, python = load_kernels(program), EvaluatedKernels(program)
    found = []
    for kernels in (compiled, python):
        kernels.prepare(np.asarray(p))
        found.append(kernels("outputs", 0.0, np.array(y), NONE, NONE).copy())
    return found


@pytest.mark.parametrize("name", SYSTEMS)
def test_regular_systems(made_up, load_kernels, name):
    a, b = SYSTEMS[name]
    dag, results = solve_case(4)
    compiled, python = _both(made_up, load_kernels, dag, results, [*a.ravel(), *b])
    assert compiled[4:].tolist() == python[4:].tolist() == [4.0, 1.0]
    # Both eliminate in the same order; numpy may sum a row in another one, which the condition
    # number of the scaled matrix (at most 2e4, Hilbert's) magnifies.
    np.testing.assert_allclose(compiled[:4], python[:4], rtol=1e-11)
    np.testing.assert_allclose(a @ compiled[:4], b, rtol=1e-10)


def _symmetric():
    rng = np.random.default_rng(1)
    factor = rng.normal(size=(4, 4))
    definite = factor @ factor.T
    yield "definite", definite, 4
    yield "negative", -definite, 4
    yield "indefinite", factor + factor.T, 4
    flat = factor[:, :3] @ factor[:, :3].T
    yield "of rank three", flat, 3
    yield "nearly of rank three", flat + 1e-9 * np.eye(4), 4


SYMMETRIC = {name: rest for name, *rest in _symmetric()}


@pytest.mark.parametrize("name", SYMMETRIC)
def test_symmetric_systems_are_written_out_where_they_are_definite(made_up, load_kernels, name):
    from cotree.codegen.context import model_context
    from cotree.dag.nodes import Dag

    matrix, rank = SYMMETRIC[name]
    b = matrix @ [1.0, -2.0, 0.5, 3.0]
    dag = Dag()
    places = iter(range(10))
    lower = {(i, j): dag.symbol("p", next(places)) for i in range(4) for j in range(i + 1)}
    rows = [[lower[max(i, j), min(i, j)] for j in range(4)] for i in range(4)]
    rhs = [dag.symbol("p", 10 + i) for i in range(4)]
    sizes = [dag.function("abs", rows[i][i]) for i in range(4)]
    results = solve(dag, rows, rhs, dag.one, SolveShape(4, 0), sizes)
    values = [*(matrix[i, j] for i, j in lower), *b]
    context = model_context(made_up(dag, n_parameters=14, outputs=results))
    assert context.definite_sizes == [4]
    compiled, python = _both(made_up, load_kernels, dag, results, values)
    assert compiled[4:].tolist() == python[4:].tolist() == [rank, 1.0]
    # Python always exchanges rows: the condition number (at most 1e11) magnifies roundings.
    np.testing.assert_allclose(compiled[:4], python[:4], rtol=1e-3 if "nearly" in name else 1e-11)
    np.testing.assert_allclose(matrix @ compiled[:4], b, rtol=1e-11, atol=1e-12)


def test_singular_systems_say_so_in_both(made_up, load_kernels):
    a = np.outer([1.0, 2.0, 3.0, 4.0], [1.0, -1.0, 2.0, 0.5])  # consistent, of rank one
    b = a @ np.ones(4)
    assert solve_pivoted(a, b)[1] == 1
    dag, results = solve_case(4)
    program = made_up(dag, n_parameters=20, outputs=results)
    for kernels in (load_kernels(program), EvaluatedKernels(program)):
        kernels.prepare(np.array([*a.ravel(), *b]))
        with pytest.raises(SingularSystemError):
            kernels("outputs", 0.0, np.ones(1), NONE, NONE)


def test_the_solution_of_a_consistent_singular_system_is_one_in_c_too(made_up, load_kernels):
    a = np.array([[1.0, 2.0, 3.0], [2.0, 4.0, 6.0], [1.0, 0.0, 1.0]])
    b = a @ [1.0, -2.0, 0.5]
    expected, rank, _ = solve_pivoted(a, b)
    dag, results = solve_case(3)
    kernels = load_kernels(made_up(dag, n_parameters=12, outputs=results))
    kernels.prepare(np.array([*a.ravel(), *b]))
    with pytest.raises(SingularSystemError):
        kernels("outputs", 0.0, np.ones(1), NONE, NONE)
    found = kernels._own.bound["outputs"][2]  # what the refused call has written
    assert found[3] == rank == 2
    assert found[4] == 0.0
    # The third unknown is the rest of a cancellation: zero in either of them.
    np.testing.assert_allclose(found[:3], expected, rtol=1e-14, atol=2e-15)
    np.testing.assert_allclose(
        found[:3], np.linalg.pinv(a, rcond=1e-10) @ b, rtol=1e-13, atol=1e-14
    )


def test_the_reference_size_decides_the_rank(made_up, load_kernels):
    from cotree.dag.nodes import Dag

    dag = Dag()
    entry, size = dag.symbol("p", 0), dag.symbol("p", 1)
    results = solve(dag, [[entry]], [dag.symbol("x", 0)], size)
    program = made_up(dag, n_parameters=2, outputs=results)
    for kernels in (load_kernels(program), EvaluatedKernels(program)):
        kernels.prepare(np.array([1e-10, 1.0]))
        assert kernels("outputs", 0.0, np.ones(1), NONE, NONE)[1] == 1.0
        kernels.prepare(np.array([1e-15, 1.0]))
        with pytest.raises(SingularSystemError):
            kernels("outputs", 0.0, np.ones(1), NONE, NONE)


def test_one_matrix_is_factorised_once_for_all_right_hand_sides(made_up, load_kernels):
    from cotree.codegen.context import model_context

    dag, results = solve_case(2)
    matrix = [[dag.symbol("p", 0), dag.symbol("p", 1)], [dag.symbol("p", 2), dag.symbol("p", 3)]]
    other = solve(dag, matrix, [results[0], dag.one])
    transposed = solve(dag, [list(row) for row in zip(*matrix, strict=True)], [dag.one, dag.one])
    program = made_up(dag, n_parameters=6, outputs=[*results, *other, *transposed])
    (lines,) = (k.body.lines for k in model_context(program).kernels if "_outputs(" in k.signature)
    assert sum("cotree_factorise(" in line for line in lines) == 2
    p = [2.0, 0.5, -0.3, 1.5, 1.0, 2.0]
    compiled, python = _both(made_up, load_kernels, dag, program.kernels["outputs"].results, p)
    np.testing.assert_allclose(compiled, python, rtol=1e-14)


def test_a_solve_of_parameters_is_met_by_prepare(made_up, load_kernels):
    from cotree.dag.nodes import Dag

    dag = Dag()
    unknown, *_ = solve(dag, [[dag.symbol("p", 0)]], [dag.one])
    program, _ = run_passes(made_up(dag, rhs=[unknown * dag.symbol("x", 0)]))
    for kernels in (load_kernels(program), EvaluatedKernels(program)):
        kernels.prepare(np.array([4.0]))
        assert kernels("rhs", 0.0, np.array([2.0]), NONE, NONE)[0] == 0.5
        with pytest.raises(SingularSystemError):
            kernels.prepare(np.array([0.0]))


@pytest.mark.parametrize("x", [-3.0, -0.4, 0.0, 0.3, 1.7, 5.0])
def test_calls_tables_and_branches(made_up, load_kernels, x):
    dag, results = call_case()
    program = made_up(dag, outputs=results)
    kernels = load_kernels(program, {"swirl.c": SWIRL_C})
    found, expected = [], EvaluatedKernels(program)
    for each in (kernels, expected):
        each.prepare(np.array([0.3]))
        found.append(each("outputs", 0.0, np.array([x]), NONE, NONE).copy())
    # One rounding may fall elsewhere in the interpolation.
    np.testing.assert_allclose(found[0], found[1], rtol=1e-15, atol=1e-15)


def test_a_call_that_fails_is_an_error(made_up, load_kernels):
    dag, results = call_case()
    kernels = load_kernels(made_up(dag, outputs=results), {"swirl.c": SWIRL_C})
    kernels.prepare(np.array([0.3]))
    with pytest.raises(SolveError, match="failed"):
        kernels("outputs", 0.0, np.array([1000.0]), NONE, NONE)
