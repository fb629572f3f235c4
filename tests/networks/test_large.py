"""Networks of hundreds of states: closed forms, every method, and costs that grow no faster."""

from __future__ import annotations

import numpy as np
import pytest
from network_scenes import rc_grid, rc_ladder, rc_ladder_matrix, resistor_mesh, rlc_ladder

from cotree.pipeline import formulate, generate
from cotree.solvers.select import integrate

N = 150  # beyond the size up to which dense matrices are taken


def ladder_response(n: int, t: float) -> np.ndarray:
    """Voltages of the RC ladder after a step from rest, by the eigenvectors of its matrix."""
    values, vectors = np.linalg.eigh(rc_ladder_matrix(n))
    drive = vectors.T @ np.eye(n)[0]
    return np.asarray(vectors @ (np.expm1(values * t) / values * drive))


@pytest.mark.sampled(2)
@pytest.mark.compiler
@pytest.mark.parametrize("method", ["auto", "dop853", "Radau", "BDF", "cvode", "ida"])
def test_a_long_ladder_by_every_method(method):
    if method in ("cvode", "ida"):
        pytest.importorskip("sksundae")
    settings = {"rtol": 1e-7, "atol": 1e-10, "throw": True, "method": method}
    result = rc_ladder(N).compile().simulate((0.0, 10.0), [3.0, 10.0], **settings)
    # Errors of multistep methods at 1e-7 add up over some hundred steps.
    for j, t in enumerate(result.t):
        assert np.abs(result.y[:, j] - ladder_response(N, t)).max() <= 1e-5


@pytest.mark.compiler
def test_a_stiff_long_ladder_is_found_stiff():
    """Over 2000 time constants explicit methods would take thousands of steps."""
    model = rc_ladder(N).compile()
    result = model.simulate((0.0, 5000.0), [5000.0], rtol=1e-6, atol=1e-9, throw=True)
    assert "stiff, the span is" in result.message
    assert result.statistics.n_steps < 1000
    assert np.abs(result.y[:, -1] - ladder_response(N, 5000.0)).max() <= 1e-4


@pytest.mark.sampled(1)
@pytest.mark.compiler
@pytest.mark.parametrize("make", [rc_ladder, rlc_ladder, rc_grid])
def test_loops_compute_what_the_statements_did(make):
    """Compiled kernels, where statements became loops, against the program evaluated in Python."""
    from evaluated_kernels import EvaluatedKernels

    from cotree.model.model import CompiledModel

    model = make(13 if make is rc_grid else N).compile(sensitivities=["R"])
    assert model.kernels.source.count("for (int i") >= 4
    other = CompiledModel(model.kernels.text, EvaluatedKernels(model.kernels.program))
    rng = np.random.default_rng(0)
    y, p = rng.normal(size=len(model.states)), np.array([0.7, *rng.uniform(0.5, 2.0, 2)])
    p = p[: len(model.parameters)]
    s = rng.normal(size=(len(y), 1))
    # The same operations in the same order: equal to the last bit.
    assert np.array_equal(model.rhs(0.0, y, p), other.rhs(0.0, y, p))
    assert np.array_equal(model.jacobian(0.0, y, p), other.jacobian(0.0, y, p))
    assert np.array_equal(model.sensitivity_rhs(0.0, y, s, p), other.sensitivity_rhs(0.0, y, s, p))


@pytest.mark.compiler
def test_values_that_differ_from_stage_to_stage_are_read_from_tables():
    """Numbers folded into the code, no two of them alike."""
    from cotree import Scene

    rng = np.random.default_rng(1)
    r, c = rng.uniform(0.5, 2.0, (2, N))
    scene = Scene("uneven")
    scene.edge("source", "voltage_source", "n0", "ground", voltage=1.0)
    for i in range(1, N + 1):
        scene.edge(f"R{i}", "resistor", f"n{i - 1}", f"n{i}", resistance=float(r[i - 1]))
        scene.edge(f"C{i}", "capacitor", f"n{i}", "ground", capacitance=float(c[i - 1]))
    model = scene.compile()
    assert "static const double c_0" in model.kernels.source
    y = rng.normal(size=N)
    into = (np.concatenate([[1.0], y[:-1]]) - y) / r
    expected = (into - np.append(into[1:], 0.0)) / c
    assert np.allclose(model.rhs(0.0, y), expected, rtol=1e-14, atol=1e-14)


def test_the_text_of_a_ladder_does_not_grow_with_it():
    from cotree.codegen.context import model_context

    lines = []
    for n in (100, 400):
        _, equations, _ = formulate(rc_ladder(n), (), None)
        context = model_context(generate(equations)[0])
        lines.append(sum(len(kernel.body.lines) for kernel in context.kernels))
    assert lines[0] == lines[1] < 100


def test_the_arena_of_a_ladder_grows_linearly():
    sizes = []
    for n in (100, 200, 400):
        _, equations, _ = formulate(rc_ladder(n), (), None)
        generate(equations)
        sizes.append(len(equations.dag))
    assert sizes[2] - sizes[1] <= 2.02 * (sizes[1] - sizes[0])


@pytest.mark.compiler
def test_a_mesh_of_resistors_against_its_nodal_equations():
    """One state; a linear block of a hundred unknowns at each instant."""
    n = 10
    model = resistor_mesh(n).compile()
    size = n * n
    nodal = np.zeros((size, size))
    for i in range(n):
        for j in range(n):
            for a, b in ((i - 1, j), (i, j - 1)):
                if min(a, b) >= 0:
                    pair = [a * n + b, i * n + j]
                    nodal[np.ix_(pair, pair)] += [[1.0, -1.0], [-1.0, 1.0]]
    nodal[0, 0] += 1.0
    entry = np.eye(size)[0]
    inner = slice(0, size - 1)
    y = 0.3
    potentials = np.linalg.solve(nodal[inner, inner], entry[inner] - nodal[inner, -1] * y)
    rate = -(nodal[-1, inner] @ potentials + nodal[-1, -1] * y)
    assert model.rhs(0.0, [y])[0] == pytest.approx(rate, rel=1e-11)


def test_the_fastest_decay_of_a_sparse_jacobian():
    """A pulse at the end of a diffusion whose rates are known: 4 / (R C) in the limit."""
    from scipy.sparse import csc_matrix

    from cotree import Settings
    from cotree.solvers.problem import RunProblem

    matrix = csc_matrix(rc_ladder_matrix(N))
    problem = RunProblem(
        rhs=lambda t, y: matrix @ y,
        jacobian=None,
        n_states=N,
        n_sensitivities=0,
        z0=np.ones(N),
        settings=Settings(t_span=(0.0, 10.0)),
        sparse_jacobian=lambda t, y: matrix,
    )
    assert "40 times the shortest decay" in integrate(problem).message
