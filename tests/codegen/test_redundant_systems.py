"""Linear systems with redundant unknowns: C, Python and numpy's pseudoinverse agree."""

from __future__ import annotations

import numpy as np
import pytest
from evaluated_kernels import EvaluatedKernels
from made_up_scenes import solve_case

from cotree.dag.multi_output import SolveShape, solve, solve_pivoted
from cotree.errors import SingularSystemError

NONE = np.zeros(0)

# Singular values lie between 0.3 and 3 by construction (those of a saddle system, from matrices of
# that kind, above 0.03): a hundred roundings of 2e-16 are magnified by that, twice.
CLOSE = {"rtol": 1e-11, "atol": 1e-11}


def _of_rank(rng, n_rows, n_columns, rank):
    """Build a matrix with singular values between 0.3 and 3."""
    left, _ = np.linalg.qr(rng.normal(size=(n_rows, rank)))
    right, _ = np.linalg.qr(rng.normal(size=(n_columns, rank)))
    return (left * rng.uniform(0.3, 3.0, rank)) @ right.T


def _semidefinite(rng, n, rank):
    vectors, _ = np.linalg.qr(rng.normal(size=(n, rank)))
    matrix = (vectors * rng.uniform(0.3, 3.0, rank)) @ vectors.T
    return 0.5 * (matrix + matrix.T)


def _saddle(mass, jacobian):
    """Return the matrix of a constrained system: unknowns, then multipliers."""
    m = len(jacobian)
    return np.block([[mass, jacobian.T], [jacobian, np.zeros((m, m))]])


def _pinv(a):
    return np.linalg.pinv(a, rcond=1e-9, hermitian=True)


def _in_python(a, b, shape, request):
    solution, rank, is_accepted = solve_pivoted(a, b, 0.0, shape)
    return solution, rank, is_accepted


def _in_c(a, b, shape, request):
    made_up, load = request.getfixturevalue("made_up"), request.getfixturevalue("load_kernels")
    n = shape.size
    dag, results = solve_case(n, shape)
    kernels = load(made_up(dag, n_parameters=n * n + n, outputs=results))
    kernels.prepare(np.array([*a.ravel(), *b]))
    try:
        kernels("outputs", 0.0, np.ones(1), NONE, NONE)
        is_refused = False
    except SingularSystemError:
        is_refused = True
    found = kernels._own.bound["outputs"][2]  # what a refused call has written too
    assert is_refused == (found[-1] == 0.0)
    return found[:n], found[n], found[n + 1]


@pytest.fixture(params=["python", pytest.param("C", marks=pytest.mark.compiler)])
def solved(request):
    """Return the solution, the rank and whether it is accepted, by either language."""
    by = {"python": _in_python, "C": _in_c}[request.param]
    return lambda a, b, shape: by(a, b, shape, request)


@pytest.mark.sampled(4)
@pytest.mark.parametrize(("n", "rank"), [(1, 0), (2, 1), (5, 4), (5, 2), (7, 3), (8, 0), (6, 6)])
def test_semidefinite_systems(solved, n, rank):
    rng = np.random.default_rng(10 * n + rank)
    a = _semidefinite(rng, n, rank)
    b = a @ rng.normal(size=n)
    solution, found_rank, is_accepted = solved(a, b, SolveShape(n, 0))
    assert found_rank == rank
    assert is_accepted  # nothing is asked of the unknowns
    np.testing.assert_allclose(solution, _pinv(a) @ b, **CLOSE)
    # Every unknown of a random system has a share in its null space.
    assert bool(solved(a, b, SolveShape(n, 1))[2]) == (rank == n)


@pytest.mark.sampled(5)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("n", "m", "rank"), [(2, 2, 1), (4, 3, 2), (5, 5, 3), (3, 4, 3), (4, 2, 2)]
)
def test_redundant_multipliers_are_accepted(solved, n, m, rank, seed):
    rng = np.random.default_rng(seed)
    # The mass matrix sees one direction less than there are, the constraints see it.
    jacobian = _of_rank(rng, m, n, rank)
    seen = np.linalg.svd(jacobian)[2][0]
    keep = np.eye(n) - np.outer(seen, seen)
    a = _saddle(keep @ _semidefinite(rng, n, n) @ keep, jacobian)
    b = a @ rng.normal(size=n + m)
    solution, found_rank, is_accepted = solved(a, b, SolveShape(n + m, n))
    assert found_rank == n + rank
    assert is_accepted
    np.testing.assert_allclose(solution, _pinv(a) @ b, **CLOSE)
    if rank < m:
        assert not solved(a, b, SolveShape(n + m, n + m))[2]


@pytest.mark.parametrize("seed", range(4))
def test_a_leading_unknown_that_is_not_determined_is_refused(solved, seed):
    rng = np.random.default_rng(seed)
    jacobian = _of_rank(rng, 3, 5, 2)
    # No mass along one direction that the constraints leave free.
    free = np.linalg.svd(jacobian)[2][-1]
    keep = np.eye(5) - np.outer(free, free)
    a = _saddle(keep @ _semidefinite(rng, 5, 5) @ keep, jacobian)
    b = a @ rng.normal(size=8)
    solution, rank, is_accepted = solved(a, b, SolveShape(8, 5))
    assert rank == 6
    assert not is_accepted
    np.testing.assert_allclose(solution, _pinv(a) @ b, **CLOSE)


def test_only_the_unknowns_asked_for_need_one_value(solved):
    # Unknowns 0 and 2 have one value; 1 and 3 only as a sum. Exchanges must not mix them up.
    a = np.zeros((4, 4))
    a[0, 0], a[2, 2], a[np.ix_([1, 3], [1, 3])] = 2.0, 5.0, 7.0
    b = np.array([4.0, 14.0, 10.0, 14.0])
    for n_determined, accepted in ((0, 1), (1, 1), (2, 0), (3, 0), (4, 0)):
        solution, rank, is_accepted = solved(a, b, SolveShape(4, n_determined))
        assert (rank, is_accepted) == (3, accepted)
        np.testing.assert_allclose(solution, [2.0, 1.0, 2.0, 1.0], rtol=1e-15)
    order = [1, 3, 0, 2]
    assert not solved(a[np.ix_(order, order)], b[order], SolveShape(4, 1))[2]
    order = [2, 0, 3, 1]
    assert solved(a[np.ix_(order, order)], b[order], SolveShape(4, 2))[2]


@pytest.mark.parametrize(("tolerance", "rank"), [(1e-13, 2), (1e-5, 1)])
def test_the_tolerance_of_the_shape_decides_the_rank(solved, tolerance, rank):
    a, b = np.diag([1.0, 1e-8]), np.array([3.0, 0.0])
    solution, found, is_accepted = solved(a, b, SolveShape(2, 1, tolerance))
    assert (found, is_accepted) == (rank, 1)
    assert solution.tolist() == [3.0, 0.0]


@pytest.mark.compiler
def test_several_right_hand_sides_of_one_redundant_matrix(made_up, load_kernels):
    rng = np.random.default_rng(7)
    a = _saddle(_semidefinite(rng, 3, 3), _of_rank(rng, 2, 3, 1))
    shape = SolveShape(5, 3)
    dag, results = solve_case(5, shape)
    matrix = [[dag.symbol("p", 5 * i + j) for j in range(5)] for i in range(5)]
    other = solve(dag, matrix, results[:5], shape=shape)  # pinv(A)^2 b, without another factoring
    program = made_up(dag, n_parameters=30, outputs=[*results, *other])
    b = a @ rng.normal(size=5)
    for kernels in (load_kernels(program), EvaluatedKernels(program)):
        kernels.prepare(np.array([*a.ravel(), *b]))
        found = kernels("outputs", 0.0, np.ones(1), NONE, NONE)
        np.testing.assert_allclose(found[7:12], _pinv(a) @ _pinv(a) @ b, **CLOSE)
